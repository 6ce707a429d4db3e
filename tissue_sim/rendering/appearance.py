"""Meaning of the organ's colours, for markers and viewer alike."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Colour = tuple[int, int, int]

TISSUE: Colour = (146, 52, 46)
# Colours of organs, by a word in their names.
BASE: dict[str, Colour] = {
    "liver": (122, 58, 44),
    "spleen": (108, 44, 62),
    "kidney": TISSUE,
}
LIGAMENT: Colour = (226, 214, 188)
INCLUSION: Colour = (214, 196, 150)
# Colour of the surface by its displacement in mm, interpolated in between.
SCALE: tuple[tuple[float, Colour], ...] = (
    (0.5, (176, 66, 48)),
    (1.0, (201, 86, 48)),
    (2.0, (222, 110, 49)),
    (3.0, (237, 138, 54)),
    (4.0, (246, 168, 66)),
    (6.0, (250, 198, 88)),
    (8.0, (252, 224, 122)),
    (10.0, (255, 244, 178)),
)
MARKER_COLOURS = ("none", "displacement", "force", "region")
FULL_DISPLACEMENT = 1e-3 * SCALE[-1][0]  # m with the last colour
FULL_FORCE = 0.1  # N on a node with the last colour
MOVING = 0.4  # place on the scale of a node that the last tick moved


def tissue_colour(name: str) -> Colour:
    """Return the colour of an organ at rest, by its name.

    Parameters
    ----------
    name : str
        The name.
    """
    return next((colour for word, colour in BASE.items() if word in name.lower()), TISSUE)


def shade_of(displacement: NDArray[np.float64], scale: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the colours (n, 3) of a scale at displacements (n, 3) m."""
    fraction = np.linalg.norm(displacement, axis=1) / FULL_DISPLACEMENT
    place = (np.minimum(fraction, 1.0) * (len(scale) - 1)).astype(np.int64)
    return np.asarray(scale[place])


_AT = np.array([0.0, *(level for level, _ in SCALE)]) / SCALE[-1][0]
_N_SHADES = 256


def shades(tissue: Colour) -> NDArray[np.float64]:
    """Return colours (256, 3), 0 to 255, along the scale, which begins with that of the tissue at rest.

    Parameters
    ----------
    tissue : Colour
        That colour.
    """
    ramp = np.linspace(0.0, 1.0, _N_SHADES)
    colours = np.array([tissue, *(colour for _, colour in SCALE)], dtype=np.float64)
    return np.stack([np.interp(ramp, _AT, channel) for channel in colours.T], axis=1)


# (256, 4) red, green, blue, alpha along the scale
SHADES = np.column_stack([shades(TISSUE) / 255.0, np.ones(_N_SHADES)]).astype(np.float32)
