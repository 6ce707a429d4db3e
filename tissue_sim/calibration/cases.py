"""Load cases: those that the calibration fits, and others, drawn and built differently, that assess it.

Which nodes a case may be centred on is settled first, by a seed of its own: the fit never sees a load at a held-out
centre, nor the held-out loads' profile or sizes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats, Longs
from tissue_sim.errors import UserError
from tissue_sim.organ.edges import directed_edges
from tissue_sim.organ.normals import surface_normals
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.surfaces.sizing import local_edges, relative_edges
from tissue_sim.organ.tool_resolution import relative_size
from tissue_sim.organ.topology import node_area

HELD_OUT_FRACTION = 0.3  # fraction of the nodes that may be pressed
HELD_OUT_SEED = 7919  # seed of the split and of the held-out loads; independent of the fit's seed
CLEARANCE = 0.006  # m from the clamp at least, to the centre of a patch, as all lengths below times `size_of`
FIT_RADII = (0.0, 0.006, 0.009, 0.012, 0.016)  # m; 0: a node and its neighbours
NEAR_CLAMP = 0.12  # fraction of the centres that counts as near the clamp
NEAR = 3  # every third place of the fit lies there
MANY = 5  # every fifth place has several patches
AXES = 3  # cases at each place
SMOOTH_RADIUS = (0.009, 0.013)  # m, of held-out patches
NARROWEST = 1.5  # edges, least radius of a patch: a narrower one would be a load on one node
DEPTH = (0.002, 0.012)  # m, largest displacement of a case under the linear body
SHARP_TRACTION = (0.2, 0.4)  # of Young's modulus, on a node and its neighbours: 0.1 to 0.2 N on the kidney
MOST_TRACTION = 0.4  # of Young's modulus, at any node: near the clamp a depth of 12 mm would crush the tissue
MOST_FORCE = 0.019  # of Young's modulus times the volume's root squared, for each patch: 0.5 N on the kidney


@dataclass(frozen=True, eq=False)
class Cases:
    """Loads on the surface: c cases, n surface nodes; a case may consist of several loads."""

    force: Floats  # (c, n, 3) N
    centre: list[Longs]  # (c,) of the patches' centre nodes
    kind: list[str]  # (c,) bump, pulling bump, two bumps, sharp

    def __len__(self) -> int:
        return len(self.kind)

    def scaled(self, factor: Floats) -> Cases:
        """Return the same cases with their forces multiplied.

        Parameters
        ----------
        factor : Floats, shape (c,)
            Factor of each case.
        """
        return replace(self, force=self.force * factor[:, None, None])

    def chosen(self, index: Longs) -> Cases:
        """Return some of the cases.

        Parameters
        ----------
        index : Longs
            Indices of the cases.
        """
        return Cases(self.force[index], [self.centre[i] for i in index], [self.kind[i] for i in index])


class Surface(NamedTuple):
    """Surface of an organ as the load cases use it."""

    positions: Floats  # (n, 3) m
    normal: Floats  # (n, 3) outward
    area: Floats  # (n,) m^2, a third of the triangles around
    ring: list[Longs]  # neighbours of each node along edges, and itself
    free: NDArray[np.bool_]  # (n,)
    size: float  # factor of lengths, 1 for an organ of a kidney's size or larger
    edge: float  # m, median
    near_edge: Floats  # (n,) m: the same, or on a graded surface the mean around each node


def size_of(organ: Organ) -> float:
    """Return the factor of lengths for an organ, 1 for one of a kidney's size or larger.

    Parameters
    ----------
    organ : Organ
        The organ.
    """
    return relative_size(organ.volume)


def surface_of(organ: Organ) -> Surface:
    """Return normals, areas and neighbours of the organ's surface nodes.

    Parameters
    ----------
    organ : Organ
        The organ.
    """
    positions, triangles = organ.surface_positions, organ.surface_triangles
    n = len(positions)
    pairs = directed_edges(triangles).astype(np.int64)
    pairs = np.concatenate([pairs, pairs[:, ::-1], np.repeat(np.arange(n)[:, None], 2, axis=1)])
    pairs = np.unique(pairs, axis=0)
    ring = np.split(pairs[:, 1], np.flatnonzero(np.diff(pairs[:, 0])) + 1)
    free = np.ones(n, dtype=bool)
    free[organ.fixed] = False
    apart = np.linalg.norm(positions[pairs[:, 0]] - positions[pairs[:, 1]], axis=1)
    edge = float(np.median(apart[apart > 0.0]))
    graded = np.ptp(relative_edges(positions, triangles)) > 0.0
    near = local_edges(positions, triangles) if graded else np.full(n, edge)
    normal, area = surface_normals(positions, triangles), node_area(positions, triangles)
    return Surface(positions, normal, area, ring, free, size_of(organ), edge, near)


def split_centres(organ: Organ) -> tuple[Longs, Longs]:
    """Return centres for the fit and held-out centres: disjoint, the same for every seed of the fit.

    Nodes nearer to the clamp than 6 mm are neither. Raises UserError when fewer than 20 nodes are left.
    """
    surface = surface_of(organ)
    far = np.ones(organ.n_surface, dtype=bool)
    if len(organ.fixed):
        positions = surface.positions
        far = cKDTree(positions[organ.fixed]).query(positions)[0] > CLEARANCE * surface.size
    nodes = np.flatnonzero(far)
    if len(nodes) < 20:
        raise UserError(f"organ '{organ.name}' has {len(nodes)} nodes away from its clamp; calibration needs 20")
    mixed = np.random.default_rng(HELD_OUT_SEED).permutation(nodes)
    held = max(1, round(HELD_OUT_FRACTION * len(nodes)))
    return np.sort(mixed[held:]), np.sort(mixed[:held])


def fit_cases(organ: Organ, count: int, seed: int) -> Floats:
    """Return the loads for the fit, along x, y and z in turn at every place.

    A place is a uniform traction of 1 N in total on a patch of one of five sizes; every fifth place has two to six such
    patches. Every third one lies near the clamp, where small errors turn the whole organ.

    Parameters
    ----------
    organ : Organ
        The organ.
    count : int
        Least number of cases.
    seed : int
        Seed of the random choices.

    Returns
    -------
    Floats, shape (c, n_surface, 3), N
        Forces.
    """
    surface, centres = surface_of(organ), split_centres(organ)[0]
    random = np.random.default_rng([seed, 1])
    places = -(-count // AXES)
    spread = _spread(surface.positions, centres, places, random)
    spread[::NEAR] = _spread(surface.positions, _nearest_to_clamp(organ, centres), len(spread[::NEAR]), random)
    force = np.zeros((places, AXES, organ.n_surface, 3))
    for place, first in enumerate(spread):
        others = random.choice(centres, random.integers(1, 6)) if place % MANY == 0 else centres[:0]
        for node in (first, *others):
            nodes = _patch(surface, node, FIT_RADII[random.integers(len(FIT_RADII))] * surface.size)
            fraction = surface.area[nodes] / surface.area[nodes].sum()
            size = random.uniform(0.5, 1.5) if len(others) else 1.0
            for axis in range(AXES):
                force[place, axis, nodes, axis] += size * fraction
    return force.reshape(-1, organ.n_surface, 3)


def principal(force: Floats, answer: Floats) -> tuple[Floats, Floats]:
    """Return cases along x, y and z at every place as cases along the principal axes of the displacement there.

    The organ yields most along the first axis and least along the last, which separates stiffness in one direction from
    rotation about the clamp: under loads of any direction nearly all displacement is of the second kind.

    Parameters
    ----------
    force : Floats, shape (c, n, 3), N
        Loads of fit_cases.
    answer : Floats, shape (c, n, 3), m
        Displacements under them.

    Returns
    -------
    tuple[Floats, Floats]
        Loads and displacements of the same shapes.
    """
    forces, answers = (part.reshape(-1, AXES, part[0].size) for part in (force, answer))
    axes = np.linalg.eigh(answers @ answers.transpose(0, 2, 1))[1][:, :, ::-1].transpose(0, 2, 1)
    return (axes @ forces).reshape(force.shape), (axes @ answers).reshape(answer.shape)


def held_out_cases(
    organ: Organ, smooth: int, sharp: int, seed: int = HELD_OUT_SEED, centres: Longs | None = None
) -> Cases:
    """Return cases of 1 N for the assessment: smooth bumps, then sharp loads on a node and its neighbours.

    A bump's traction is (1 - (r/R)^2)^2 within R of 9-13 mm and leans away from the normal by up to 75 degrees; every
    fifth pulls, every tenth is two bumps.

    Parameters
    ----------
    organ : Organ
        The organ.
    smooth : int
        Number of bumps.
    sharp : int
        Number of sharp loads.
    seed : int, optional
        Seed of the random choices.
    centres : Longs | None, shape (k,), optional
        Nodes to load; None for the held-out ones.
    """
    surface = surface_of(organ)
    centres = split_centres(organ)[1] if centres is None else centres
    random = np.random.default_rng([seed, 2])
    spread = _spread(surface.positions, centres, smooth + sharp, random)
    force, centre, kind = np.zeros((smooth + sharp, organ.n_surface, 3)), [], []
    for case in range(smooth):
        pair, pulls = case % 10 == 9, case % 5 == 4
        at = np.concatenate([spread[case : case + 1], random.choice(centres, 1)]) if pair else spread[case : case + 1]
        for node in at:
            radius = max(random.uniform(*SMOOTH_RADIUS) * surface.size, NARROWEST * surface.near_edge[node])
            reach = np.linalg.norm(surface.positions - surface.positions[node], axis=1) / radius
            facing = surface.normal @ surface.normal[node] > 0.0
            weight = np.where((reach < 1.0) & facing & surface.free, (1.0 - reach**2) ** 2, 0.0) * surface.area
            lean = np.radians(75.0) * np.sqrt(random.uniform())
            push = _lean(-surface.normal[node], lean, random)
            force[case] += (-1.0 if pulls and not pair else 1.0) * (weight / weight.sum())[:, None] * push
        centre.append(at)
        kind.append("two bumps" if pair else "pulling bump" if pulls else "bump")
    for case in range(smooth, smooth + sharp):
        node = spread[case]
        nodes = _patch(surface, node, 0.0)
        push = _lean(-surface.normal[node], np.radians(30.0) * random.uniform(), random)
        force[case, nodes] = push / len(nodes)
        centre.append(spread[case : case + 1])
        kind.append("sharp")
    return Cases(force, centre, kind)


def scale_to_depth(
    cases: Cases, compliance: Floats, organ: Organ, seed: int, depth: tuple[float, float] = DEPTH
) -> Cases:
    """Return cases of 1 N scaled so that the linear body yields by a random depth, its largest displacement.

    No case gets stronger than `strongest` allows. Sharp ones get a traction of 0.2 to 0.4 of Young's modulus instead,
    as far as the body yields by at most the larger depth.

    Parameters
    ----------
    cases : Cases
        The load cases.
    compliance : Floats, shape (c, n, 3), m
        The linear body's answer to the cases as they are.
    organ : Organ
        The organ.
    seed : int
        Seed of the random choices.
    depth : tuple[float, float], m, optional
        Least and largest depth.
    """
    random = np.random.default_rng([seed, 3])
    surface = surface_of(organ)
    reach = np.linalg.norm(compliance, axis=2).max(axis=1)
    traction = tractions(cases.force, organ) / organ.youngs_modulus
    wanted = surface.size * random.uniform(*depth, len(cases)) / reach
    pressed = random.uniform(*SHARP_TRACTION, len(cases)) / traction
    sharp = np.array([kind == "sharp" for kind in cases.kind], dtype=bool)
    patches = np.array([len(at) for at in cases.centre])
    most = np.minimum(strongest(cases.force, patches, organ), surface.size * depth[1] / reach)
    return cases.scaled(np.minimum(np.where(sharp, pressed, wanted), most))


def strongest(force: Floats, patches: ArrayLike, organ: Organ) -> Floats:
    """Return the largest factor (c,) of loads (c, n, 3) N, which have so many patches each (c,).

    The traction stays under 0.4 of Young's modulus, the mean force of a patch under 0.5 N on an organ like the kidney.
    """
    size = np.linalg.norm(force, axis=2)
    traction = tractions(force, organ) / organ.youngs_modulus
    push = size.sum(axis=1) / np.asarray(patches)
    most: Floats = np.minimum(
        MOST_TRACTION / traction, MOST_FORCE * organ.youngs_modulus * organ.volume ** (2.0 / 3.0) / push
    )
    return most


def tractions(force: Floats, organ: Organ) -> Floats:
    """Return the largest traction of loads at any node.

    Parameters
    ----------
    force : Floats, shape (c, n, 3), N
        Loads on the surface nodes.
    organ : Organ
        The organ.

    Returns
    -------
    Floats, shape (c,), Pa
        Tractions.
    """
    area = node_area(organ.surface_positions, organ.surface_triangles)
    found: Floats = (np.linalg.norm(force, axis=2) / area).max(axis=1)
    return found


def _nearest_to_clamp(organ: Organ, nodes: Longs) -> Longs:
    """Return the fraction NEAR_CLAMP of the nodes that is nearest to the clamp; all of them without one."""
    if not len(organ.fixed):
        return nodes
    apart = cKDTree(organ.surface_positions[organ.fixed]).query(organ.surface_positions[nodes])[0]
    return nodes[np.argsort(apart, kind="stable")[: max(1, round(NEAR_CLAMP * len(nodes)))]]


def _spread(positions: Floats, nodes: Longs, count: int, random: np.random.Generator) -> Longs:
    """Return `count` of the nodes, spread over the surface: farthest points first, all before one is repeated."""
    order: list[int] = []
    while len(order) < count:
        chosen = [int(random.integers(len(nodes)))]
        apart = np.linalg.norm(positions[nodes] - positions[nodes[chosen[0]]], axis=1)
        while len(chosen) < min(count - len(order), len(nodes)):
            chosen.append(int(np.argmax(apart)))
            apart = np.minimum(apart, np.linalg.norm(positions[nodes] - positions[nodes[chosen[-1]]], axis=1))
        order += [int(nodes[i]) for i in random.permutation(chosen)]
    return np.array(order, dtype=np.int64)


def _patch(surface: Surface, node: int, radius: float) -> Longs:
    """Return the free nodes within a radius, m, of a node on its side of the organ; at least its neighbours."""
    near = np.linalg.norm(surface.positions - surface.positions[node], axis=1) < radius
    near &= surface.normal @ surface.normal[node] > 0.0
    near[surface.ring[node]] = True
    return np.flatnonzero(near & surface.free)


def _lean(axis: Floats, angle: float, random: np.random.Generator) -> Floats:
    """Return a unit vector at an angle, rad, from a unit vector, in a random direction about it."""
    across = random.standard_normal(3)
    across -= (across @ axis) * axis
    return np.cos(angle) * axis + np.sin(angle) * across / np.linalg.norm(across)
