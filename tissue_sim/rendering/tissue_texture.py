"""Texture of moist tissue, computed: it repeats without a seam, and is the same on every machine."""

from __future__ import annotations

import functools

import numpy as np
from scipy.fft import irfft2

from tissue_sim.array_types import Floats, Pixels

SIZE = 512  # texels of a side
SEED = 20061120


@functools.cache
def tissue_texture() -> Pixels:
    """Return the texture.

    Returns
    -------
    Pixels, shape (SIZE, SIZE, 4)
        Mottling, vessels, fine grain, and height: 128 is the middle of the first, third and last, no vessel is 0.
    """
    random = np.random.default_rng(SEED)
    mottling = 0.7 * _noise(random, 5.0) + 0.3 * _noise(random, 17.0)
    grain = _noise(random, 60.0)
    vessels = np.maximum(_vessels(random, 3.0, 0.09), 0.8 * _vessels(random, 8.0, 0.09))
    height = 0.45 * _noise(random, 16.0) + 0.8 * _noise(random, 6.0) + 0.5 * vessels
    return np.stack([_bytes(mottling), _bytes(2.0 * vessels - 1.0, 1.0), _bytes(grain), _bytes(height)], axis=-1)


def _noise(random: np.random.Generator, waves: float) -> Floats:
    """Return random values (SIZE, SIZE) of variance 1 with about so many waves across the texture, periodic."""
    rows, columns = np.fft.fftfreq(SIZE, 1.0 / SIZE)[:, None], np.fft.rfftfreq(SIZE, 1.0 / SIZE)
    fraction = np.hypot(rows, columns) / waves
    amplitude = fraction * np.exp(-(fraction**2))
    phase = random.standard_normal((2, *amplitude.shape))
    made = irfft2(amplitude * (phase[0] + 1j * phase[1]), s=(SIZE, SIZE))
    return np.asarray(made / made.std())


def _vessels(random: np.random.Generator, waves: float, width: float) -> Floats:
    """Return lines (SIZE, SIZE), 1 in their middle, where one noise changes its sign and another lets them be."""
    line = np.exp(-((_noise(random, waves) / width) ** 2))
    return np.asarray(line * np.clip(0.5 + 0.8 * _noise(random, waves), 0.0, 1.0))


def _bytes(values: Floats, scale: float = 3.0) -> Pixels:
    """Return values from -scale to scale as 0 to 255."""
    return np.clip(127.5 + 127.5 / scale * values, 0.0, 255.0).astype(np.uint8)
