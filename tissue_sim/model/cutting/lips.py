"""The lips of cuts, from the surface of a cut organ: pairs of points that coincided before the cut opened."""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.model.cutting.cut_surface import CutSurface
from tissue_sim.model.data.lips import ENDS, Lips, make_lips


def lips_of(surface: CutSurface, rest: Floats) -> Lips:
    """Return the lips of all cuts of an organ.

    Parameters
    ----------
    surface : CutSurface
        Surface of the cut organ.
    rest : Floats, shape (n, 3), m
        Rest positions of its nodes, with the virtual ones.

    Returns
    -------
    Lips
        The lips; none where it has no cut.
    """
    # Points that lie in no cell have a different cell on each side; all other points have at most two nodes.
    on_edge = (surface.weights[:, ENDS:] == 0.0).all(axis=1)
    paired = on_edge & on_edge[surface.partner]
    upper = (surface.side[surface.triangles] > 0).any(axis=1)
    chosen = (surface.wall > 0) & upper & paired[surface.triangles].all(axis=1)
    triangles = surface.triangles[chosen]
    point, place = np.unique(triangles, return_inverse=True)
    lips = make_lips(len(point), len(triangles))
    if not len(point):
        return lips
    other = surface.partner[point]
    lips.triangles[:] = place.reshape(-1, 3)
    lips.upper[:], lips.lower[:] = surface.nodes[point, :ENDS], surface.nodes[other, :ENDS]
    lips.weight[:] = surface.weights[point, :ENDS]
    edge = np.linalg.norm(rest[lips.upper[:, 0]] - rest[lips.upper[:, 1]], axis=1)
    wall = np.zeros(len(surface.nodes), dtype=np.int64)
    wall[triangles] = surface.wall[chosen, None]
    for number in np.unique(wall[point]):
        of_cut = wall[point] == number
        lips.slide[of_cut] = edge[of_cut & (edge > 0.0)].mean()
    return lips
