"""Shapes of rigid tools, as the kernels read them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tissue_sim.array_types import Floats, Longs
from tissue_sim.model.data.blades import Blades, make_blades

SPHERE, CAPSULE, CONVEX, GRID = 0, 1, 2, 3


class Shapes(NamedTuple):
    """Shapes of T rigid bodies, each in its own frame, whose origin is the tip.

    A capsule runs from the origin along -z, like an instrument's shaft. A shape that is not convex is a grid of signed
    distances. The bodies of one tool, such as the two jaws of a gripper, are held together.
    """

    kind: Longs  # (T,) SPHERE, CAPSULE, CONVEX or GRID
    size: Floats  # (T, 2) m: radius, and the capsule's length between the centres of its caps
    plane: Floats  # (P, 4) outward normals and offsets of convex shapes: n.y <= d inside
    plane_start: Longs  # (T + 1,) which planes belong to which body
    distance: Floats  # (G,) m, signed distances at the points of every grid, the last axis running fastest
    grid_start: Longs  # (T,) first distance of each
    grid_points: Longs  # (T, 3) points along each axis
    grid_frame: Floats  # (T, 4) m: first point, and the spacing
    tool: Longs  # (T,) which tool each body belongs to
    finest: Floats  # (T,) m, smallest radius of each body
    extent: Floats  # (T,) m, from the origin to the farthest point that a rotation moves
    smoothing: Floats  # (T,) fraction of the time between two poses in which a body moves to the newer one
    blades: Blades  # places on the edges and flanks of blades


def make_shapes(
    kind: ArrayLike,
    size: ArrayLike,
    planes: Sequence[Floats] | None = None,
    grids: Sequence[Grid | None] | None = None,
    tool: ArrayLike | None = None,
    measures: Sequence[tuple[float, float]] | None = None,
) -> Shapes:
    """Return the shapes of bodies.

    Parameters
    ----------
    kind : ArrayLike, shape (T,)
        SPHERE, CAPSULE, CONVEX or GRID.
    size : ArrayLike, shape (T, 2), m
        Radius, and a capsule's length.
    planes : Sequence[Floats] | None, shape (p, 4) each, optional
        Planes of convex bodies; None for none.
    grids : Sequence[Grid | None] | None, optional
        Grids of bodies that aren't convex; None for none.
    tool : ArrayLike | None, shape (T,), optional
        Tool of each body; None for one of its own.
    measures : Sequence[tuple[float, float]] | None, shape (T, 2), m, optional
        `Shapes.finest` and `Shapes.extent` of each; None for those of spheres and capsules.
    """
    kinds = np.asarray(kind, dtype=np.int64).reshape(-1)
    n = len(kinds)
    planes = [np.zeros((0, 4))] * n if planes is None else planes
    grids = [None] * n if grids is None else grids
    counts = [len(one) for one in planes]
    sizes = [0 if grid is None else grid.distance.size for grid in grids]
    size = np.asarray(size, dtype=np.float64).reshape(n, 2)
    measured = np.asarray(size if measures is None else measures, dtype=np.float64).reshape(n, 2)
    return Shapes(
        kind=kinds,
        size=size,
        plane=np.concatenate([*planes, np.zeros((0, 4))]),
        plane_start=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        distance=np.concatenate([*(grid.distance.ravel() for grid in grids if grid is not None), np.zeros(0)]),
        grid_start=(np.cumsum(sizes) - sizes).astype(np.int64),
        grid_points=np.array(
            [(0, 0, 0) if grid is None else grid.distance.shape for grid in grids], dtype=np.int64
        ).reshape(n, 3),
        grid_frame=np.array(
            [(0.0, 0.0, 0.0, 1.0) if grid is None else (*grid.origin, grid.spacing) for grid in grids], dtype=np.float64
        ).reshape(n, 4),
        tool=np.arange(n, dtype=np.int64) if tool is None else np.asarray(tool, dtype=np.int64),
        finest=measured[:, 0].copy(),
        extent=measured[:, 1].copy(),
        smoothing=np.ones(n),
        blades=make_blades(),
    )


class Grid(NamedTuple):
    """Signed distances (i, j, k) m at points `spacing` m apart, the first of which is at origin (3,) m."""

    distance: Floats
    origin: Floats
    spacing: float


def sphere_tools(radius: ArrayLike) -> Shapes:
    """Return the shapes of spherical tools, one for each radius.

    Parameters
    ----------
    radius : ArrayLike, shape (k,), m
        Their radii.
    """
    radii = np.atleast_1d(np.asarray(radius, dtype=np.float64))
    return make_shapes(np.full(len(radii), SPHERE), np.stack([radii, np.zeros(len(radii))], axis=1))


NO_TOOLS = make_shapes([], [])
