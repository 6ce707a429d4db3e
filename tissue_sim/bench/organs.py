"""Organs, patches and loads for benchmarks, with any number of points."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from tissue_sim.array_types import Floats, Longs
from tissue_sim.organ.normals import surface_normals
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.topology import assemble_organ

PATCH_NODES = 19  # a node and the two rings around it
ALONG = 0.7  # cosine of the angle between two lines that count as parallel
ATOMS = 48
HALF_AXES = np.array([0.016, 0.027, 0.055])  # m, about those of the shipped kidney
BEND = 0.15  # sideways bend of the ends, as a fraction of the long half axis
_FACING = 0.3  # least cosine between normals of the same side
HELD = 0.05  # fraction of the points that is held, the lowest


def bean(points: int) -> Organ:
    """Return a bent ellipsoid of a kidney's size, held at its lower end.

    The points lie on a Fibonacci lattice, so there are 2 points - 4 triangles; 48 medial atoms lie on the axis.

    points: number of surface points.
    """
    k = np.arange(points) + 0.5
    z = 1.0 - 2.0 * k / points
    turn = np.pi * (1.0 + np.sqrt(5.0)) * k
    unit = np.stack([np.sqrt(1.0 - z**2) * np.cos(turn), np.sqrt(1.0 - z**2) * np.sin(turn), z], axis=1)
    triangles = ConvexHull(unit).simplices.astype(np.int32)
    a, b, c = (unit[triangles[:, corner]] for corner in range(3))
    inward = np.einsum("tx,tx->t", np.cross(b - a, c - a), a) < 0.0
    triangles[inward] = triangles[inward][:, [0, 2, 1]]
    along = np.linspace(-0.9, 0.9, ATOMS)
    surface = unit * HALF_AXES
    surface[:, 1] += BEND * HALF_AXES[2] * unit[:, 2] ** 2
    atoms = np.zeros((ATOMS, 3))
    atoms[:, 1], atoms[:, 2] = BEND * HALF_AXES[2] * along**2, HALF_AXES[2] * along
    return assemble_organ(
        name=f"bean of {points} points",
        surface_positions=surface,
        surface_triangles=triangles,
        atom_positions=atoms,
        atom_radius=HALF_AXES[0] * np.sqrt(1.0 - along**2),
        atom_parent=np.arange(-1, ATOMS - 1),
        fixed=np.argsort(surface[:, 2])[: max(3, round(HELD * points))],
    )


def press_node(organ: Organ) -> int:
    """Return the surface node in the middle of a broad side: where the axis of least extent leaves the organ.

    It is the axis of the next larger extent where the first goes through the held nodes.
    """
    middle = organ.surface_positions.mean(axis=0)
    from_centre = organ.surface_positions - middle
    axes = np.linalg.svd(from_centre, full_matrices=False)[2]
    clamp = from_centre[organ.fixed].mean(axis=0) if len(organ.fixed) else np.zeros(3)
    thin = axes[1] if abs(axes[2] @ clamp) > ALONG * np.linalg.norm(clamp) else axes[2]
    thin = thin * np.sign(thin[np.argmax(np.abs(thin))])  # the same side whatever the factorisation's sign
    ahead = from_centre @ thin
    beside = np.linalg.norm(from_centre - ahead[:, None] * thin, axis=1)
    score = np.where(ahead > 0.0, beside, np.inf)
    score[organ.fixed] = np.inf
    return int(np.argmin(score))


def patch(organ: Organ, node: int, count: int = PATCH_NODES) -> Longs:
    """Return the free surface nodes nearest to a node, itself first, (count,)."""
    distance = np.linalg.norm(organ.surface_positions - organ.surface_positions[node], axis=1)
    distance[organ.fixed] = np.inf
    return np.argsort(distance, kind="stable")[:count].astype(np.int64)


def patch_load(organ: Organ, newton: float, count: int = PATCH_NODES) -> tuple[Longs, Floats]:
    """Return an inward load on a patch in the middle of the broad side.

    newton: sum of the forces, N. Returns nodes (count,) and forces (count, 3) N.
    """
    nodes = patch(organ, press_node(organ), count)
    normal = surface_normals(organ.surface_positions, organ.surface_triangles)[nodes].mean(axis=0)
    return nodes, np.tile(-newton / count * normal / np.linalg.norm(normal), (count, 1))


def spread_nodes(organ: Organ, count: int) -> Longs:
    """Return nodes spread over the half of the surface that the broad side faces, its middle first, (count,).

    Each is as far as possible from those before it and from the held nodes (farthest point sampling).
    """
    surface, first = organ.surface_positions, press_node(organ)
    normals = surface_normals(surface, organ.surface_triangles)
    chosen = [first]
    apart = np.linalg.norm(surface - surface[first], axis=1)
    for node in organ.fixed:
        apart = np.minimum(apart, np.linalg.norm(surface - surface[node], axis=1))
    apart[normals @ normals[first] < _FACING] = 0.0
    while len(chosen) < count:
        chosen.append(int(np.argmax(apart)))
        apart = np.minimum(apart, np.linalg.norm(surface - surface[chosen[-1]], axis=1))
    return np.array(chosen, dtype=np.int64)
