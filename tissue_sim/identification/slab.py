"""Slabs: organs for thick flat phantoms, built from a box and calibrated with defaults, once."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np

from tissue_sim import progress
from tissue_sim.calibration.calibrate import calibrate
from tissue_sim.calibration.checkpoint import Checkpoint
from tissue_sim.calibration.stiffness import Settings
from tissue_sim.errors import UserError
from tissue_sim.organ.meshes.mesh_input import SurfaceMesh
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.pipeline import organ_from_mesh
from tissue_sim.organ.request import Request
from tissue_sim.result_cache import user_cache
from tissue_sim.version import __version__

PREFIX = "slab:"
SMALLEST, LARGEST = 0.005, 0.5  # m, of a side
FLATTEST = 5.0  # length over thickness, up to which there is a skeleton to speak of


def slab_size(word: str) -> tuple[float, float, float]:
    """Return the size, m, that a word such as `slab:60x60x25` gives in mm: length, width and thickness.

    Raises
    ------
    UserError
        For a word that gives none, and for a size out of range.
    """
    try:
        length, width, thickness = (1e-3 * float(part) for part in word.removeprefix(PREFIX).split("x"))
    except ValueError:
        raise UserError(f"'{word}' is not a slab; name its size in mm, such as slab:60x60x25") from None
    size = length, width, thickness
    if not all(SMALLEST <= side <= LARGEST for side in size):
        raise UserError(f"'{word}': a side is outside {1e3 * SMALLEST:g}..{1e3 * LARGEST:g} mm")
    if thickness > min(length, width) or max(length, width) > FLATTEST * thickness:
        raise UserError(f"'{word}': the last size is the thickness, the least one, and at least a fifth of the others")
    return size


def slab_file(size: tuple[float, float, float]) -> Path:
    """Return where a slab of a size, m, is kept in the user's cache."""
    sides = "x".join(f"{1e3 * side:g}" for side in size)
    return user_cache() / f"slab-{__version__}" / f"{sides}.npz"


def cached_slab(size: tuple[float, float, float]) -> Organ:
    """Return a slab that lies on its clamp, of tissue with 10 kPa, calibrated with defaults: four minutes, once.

    Parameters
    ----------
    size : tuple[float, float, float], m
        Length, width, thickness.

    Returns
    -------
    Organ
        The slab; it is kept in the user's cache.

    Raises
    ------
    UserError
        As building and calibration do.
    """
    path = slab_file(size)
    if not path.is_file():
        organ, settings = slab_as_built(size), Settings()
        path.parent.mkdir(parents=True, exist_ok=True)
        inputs = {"organ": organ.digest(), "version": __version__, **asdict(settings)}
        checkpoint = Checkpoint(path.parent / f".{path.stem}.calibration", inputs)
        calibrate(organ, settings, checkpoint, progress.Stages()).organ.save(path)
    return Organ.load(path)


def slab_as_built(size: tuple[float, float, float]) -> Organ:
    """Return a slab of a size, m, with the balloon's points and nothing fitted."""
    import trimesh

    box = trimesh.creation.box(size)
    for _ in range(3):
        box = box.subdivide()
    mesh = SurfaceMesh(np.asarray(box.vertices), np.asarray(box.faces, dtype=np.int32), ())
    return organ_from_mesh(mesh, Request(name="slab", fixed="z<0.1"))
