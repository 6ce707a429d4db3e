"""Interior atoms: further nodes spread through the volume along the spokes.

The centreline alone says little about the tissue between it and the boundary. The spokes of the M-rep reach all of it,
so further atoms are placed on them: each lies on the spoke from a medial atom to a boundary point, at a fraction of its
length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats, Ints
from tissue_sim.errors import UserError
from tissue_sim.organ.medial import nearest_atoms
from tissue_sim.organ.surfaces.intersections import is_crossed
from tissue_sim.organ.surfaces.sizing import relative_edges
from tissue_sim.organ.winding import inside

_FRACTIONS = np.linspace(0.1, 0.9, 17)  # fractions of a spoke's length, from the medial atom
_WALL = 2.0  # atoms keep half as far from the boundary as from each other
_LAYER, _THICK, _DEEP = 0.9, 0.2, 1.6  # mean edges: how deep the layer lies, half of how thick it is, what is deeper


@dataclass(frozen=True, eq=False)
class InteriorAtoms:
    """Interior atoms on spokes.

    Attributes
    ----------
    positions : Floats, shape (m, 3), m
        The atoms.
    spoke : Ints, shape (m, 2)
        Medial atom and boundary point that each atom's spoke joins.
    fraction : Floats, shape (m,)
        Fraction of the spoke's length, from the medial atom.
    """

    positions: Floats
    spoke: Ints
    fraction: Floats


def check_interior(count: int) -> None:
    """Check the number of interior atoms.

    Parameters
    ----------
    count : int
        The number.

    Raises
    ------
    UserError
        When it is negative.
    """
    if count < 0:
        raise UserError(f"--interior {count} is negative; use 0 or more")


def distribute_interior_atoms(
    surface: Floats, triangles: Ints, atoms: Floats, count: int, layer: float = 0.0
) -> InteriorAtoms:
    """`count` interior atoms on the spokes of boundary points (n, 3) m and medial atoms (a, 3) m.

    One after another each takes the place on a spoke that is farthest from all atoms so far and from the
    boundary, whose distance counts double (farthest point sampling, Gonzalez 1985). On a graded surface distances are
    measured in the edges nearby, so that atoms are close where surface points are. Places whose
    spoke leaves the organ before them don't count. layer: the fraction of them that is spread a mean edge under the
    boundary, where cells change most; the others lie deeper then.
    Raises UserError for a negative count or more atoms than there are places.
    """
    check_interior(count)
    owner = nearest_atoms(surface, atoms, 1)[0][:, 0]
    spoke = np.repeat(np.stack([owner, np.arange(len(surface))], axis=1), len(_FRACTIONS), axis=0)
    fraction = np.tile(_FRACTIONS, len(surface))
    places = atoms[spoke[:, 0]] + fraction[:, None] * (surface[spoke[:, 1]] - atoms[spoke[:, 0]])
    apart = cKDTree(atoms).query(places)[0]
    depth, below = cKDTree(surface).query(places)
    size = relative_edges(surface, triangles)[below]
    apart, depth = apart / size, depth / size
    largest = float(size.max())
    corners, within, tree = surface[triangles], inside(atoms, surface, triangles), cKDTree(places)
    chosen: list[int] = []

    def choose(until: int, room: Floats) -> None:
        """Take the places with the most room, until there are so many; room (p,) m is updated."""
        while len(chosen) < until:
            best = int(room.argmax())
            if room[best] <= 0.0:
                return
            atom = spoke[best, 0]
            if within[atom] and not is_crossed(atoms[atom], places[best], corners):
                chosen.append(best)
                # No place has more room than this one, so only nearer ones lose any.
                near = tree.query_ball_point(places[best], room[best] * largest)
                room[near] = np.minimum(room[near], np.linalg.norm(places[near] - places[best], axis=1) / size[near])
                room[best] = 0.0
            else:
                last = (best // len(_FRACTIONS) + 1) * len(_FRACTIONS)
                room[best:last] = 0.0  # beyond it on its spoke is no better

    if layer > 0.0:
        edge = float(np.linalg.norm(surface[triangles] - surface[np.roll(triangles, 1, axis=1)], axis=2).mean())
        choose(round(layer * count), np.where(np.abs(depth - _LAYER * edge) < _THICK * edge, apart, 0.0))
        apart = np.minimum(apart, cKDTree(places[chosen]).query(places)[0] / size) if chosen else apart
        choose(count, np.where(depth > _DEEP * edge, apart, 0.0))
        apart = np.minimum(apart, cKDTree(places[chosen]).query(places)[0] / size) if chosen else apart
    choose(count, np.minimum(apart, _WALL * depth))
    if len(chosen) < count:
        raise UserError(f"--interior {count} is too many for this organ; the largest number is {len(chosen)}")
    index = np.array(chosen, dtype=np.int64)
    return InteriorAtoms(places[index], spoke[index].astype(np.int32), fraction[index])
