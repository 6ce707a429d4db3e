"""Inclusions: parts of an organ that are stiffer or softer than its tissue, such as a tumour."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.errors import UserError
from tissue_sim.organ.winding import inside

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tissue_sim.organ.organ import Organ

LEAST, MOST = 1e-3, 1e3  # of the tissue's moduli
_ALONG = (np.arange(16) + 0.5) / 16  # fractions of a spring's length at which its material is sampled
_FINEST = 8  # parts of a cell's edges, to sample its material


class Inclusion(NamedTuple):
    """Closed surface within an organ, and the factor of the tissue's moduli inside it.

    Attributes
    ----------
    positions : Floats, shape (k, 3), m
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, outward.
    stiffness : float
        Factor of the tissue's moduli.
    """

    positions: Floats  # (k, 3) m
    triangles: Ints  # (t, 3) outward
    stiffness: float


def check_stiffness(stiffness: float) -> None:
    """Check a stiffness factor.

    Parameters
    ----------
    stiffness : float
        The factor.

    Raises
    ------
    UserError
        When it is outside the accepted range.
    """
    if not LEAST <= stiffness <= MOST:
        raise UserError(f"an inclusion's stiffness ratio {stiffness:g} is outside {LEAST:g}..{MOST:g}")


def inclusions_of(organ: Organ) -> list[Inclusion]:
    """Return the inclusions of an organ, in the order of its file.

    Parameters
    ----------
    organ : Organ
        The organ.
    """
    found = []
    for number, stiffness in enumerate(organ.inclusion_stiffness):
        triangles = organ.inclusion_triangles[organ.inclusion_of == number]
        used, inverse = np.unique(triangles, return_inverse=True)
        own = inverse.reshape(-1, 3).astype(np.int32)
        found.append(Inclusion(organ.inclusion_positions[used], own, float(stiffness)))
    return found


def existing_inclusions(organ: Organ) -> list[Inclusion]:
    """Return the inclusions of an organ that must have some.

    Parameters
    ----------
    organ : Organ
        The organ.

    Raises
    ------
    UserError
        Where it has none.
    """
    found = inclusions_of(organ)
    if not found:
        raise UserError(f"organ '{organ.name}' has no inclusion; build it with --mask and --inclusion")
    return found


def with_inclusions(organ: Organ, inclusions: Sequence[Inclusion]) -> Organ:
    """Return the organ with these inclusions in place of its own; its springs and cells are unchanged.

    Parameters
    ----------
    organ : Organ
        The organ.
    inclusions : Sequence[Inclusion]
        The inclusions; where two overlap, the later one counts.
    inclusions : Sequence[Inclusion]
        The new inclusions.

    Raises
    ------
    UserError
        Where one isn't a closed surface, or its stiffness is out of range.
    """
    for inclusion in inclusions:
        check_stiffness(inclusion.stiffness)
    starts = np.cumsum([0, *(len(inclusion.positions) for inclusion in inclusions)])
    return replace(
        organ,
        inclusion_positions=np.concatenate([np.zeros((0, 3)), *(one.positions for one in inclusions)]),
        inclusion_triangles=np.concatenate(
            [np.zeros((0, 3), dtype=np.int32)]
            + [one.triangles + first for one, first in zip(inclusions, starts, strict=False)]
        ),
        inclusion_of=np.repeat(np.arange(len(inclusions)), [len(one.triangles) for one in inclusions]),
        inclusion_stiffness=np.array([one.stiffness for one in inclusions]),
    )


def stiffness_at(inclusions: Sequence[Inclusion], points: Floats) -> Floats:
    """Return the factor of the tissue's moduli at points.

    Parameters
    ----------
    inclusions : Sequence[Inclusion]
        The inclusions; where two overlap, the later one counts.
    points : Floats, shape (..., 3), m
        Points.

    Returns
    -------
    Floats, shape (...)
        Factors; 1 outside all inclusions.
    """
    flat = points.reshape(-1, 3)
    found = np.ones(len(flat))
    for inclusion in inclusions:
        low, high = inclusion.positions.min(axis=0), inclusion.positions.max(axis=0)
        near = np.flatnonzero(np.all((flat >= low) & (flat <= high), axis=1))
        within = near[inside(flat[near], inclusion.positions, inclusion.triangles)]
        found[within] = inclusion.stiffness
    return found.reshape(points.shape[:-1])


def spring_factors(inclusions: Sequence[Inclusion], ends: Floats) -> Floats:
    """Return the stiffness factors of springs; the parts of a spring are in series.

    Parameters
    ----------
    inclusions : Sequence[Inclusion]
        The inclusions; where two overlap, the later one counts.
    ends : Floats, shape (s, 2, 3), m
        Ends of the springs.

    Returns
    -------
    Floats, shape (s,)
        Factors.
    """
    first, last = ends[:, :1], ends[:, 1:]
    along = first + _ALONG[None, :, None] * (last - first)
    factors: Floats = 1.0 / np.mean(1.0 / stiffness_at(inclusions, along), axis=1)
    return factors


def cell_factors(inclusions: Sequence[Inclusion], points: Floats, cells: Longs | Ints) -> Floats:
    """Return the mean factor of the tissue's moduli in cells.

    Parameters
    ----------
    inclusions : Sequence[Inclusion]
        The inclusions; where two overlap, the later one counts.
    points : Floats, shape (n, 3), m
        Positions of the nodes.
    cells : Longs | Ints, shape (c, 4)
        Corner indices into `points`.

    Returns
    -------
    Floats, shape (c,)
        Factors.
    """
    if not inclusions:
        return np.ones(len(cells))
    factors: Floats = stiffness_at(inclusions, _FRACTIONS @ points[cells]).mean(axis=1)
    return factors


def _fractions() -> Floats:
    """Return barycentric coordinates (k, 4) of points spread evenly through a tetrahedron."""
    steps = np.arange(_FINEST)
    a, b, c = (part.ravel() for part in np.meshgrid(steps, steps, steps, indexing="ij"))
    within = a + b + c < _FINEST
    inner = (np.stack([a, b, c], axis=1)[within] + 0.25) / _FINEST
    return np.concatenate([1.0 - inner.sum(axis=1, keepdims=True), inner], axis=1)


_FRACTIONS = _fractions()
