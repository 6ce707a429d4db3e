"""Whether an organ's surface is fine enough for how thin the organ is, and for loads beside its clamp."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats
from tissue_sim.calibration.cases import CLEARANCE, SMOOTH_RADIUS, size_of
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.refinement import Refinement, points_with, wanted_edges
from tissue_sim.organ.surfaces.sizing import local_edges, thickness
from tissue_sim.organ.tool_resolution import MOST_POINTS

THIN = 0.1  # the fraction of the medial atoms that may lie in thinner tissue
# Edges of the surface over the medial radius there. Organs that calibrate well have up to 0.78; a colon of 1.2, held
# out, was off by 4 % in the mean and 26 % at worst. A finer surface is asked for so that some room is left.
MOST, ROOM = 1.0, 0.8
RIM = 0.05  # the fraction of the loaded nodes at which edges may be longer than the following bounds
# Edges over the body's thickness, and over the distance from the clamp. Organs that calibrate well have up to 0.73 and
# 0.59; a liver held along a cut, off by 23 % at worst, has 0.64 and 1.02.
MOST_THROUGH, ROOM_THROUGH = 0.9, 0.7
MOST_BESIDE, ROOM_BESIDE = 0.8, 0.6
TRIES = 4  # of more points with a refinement, before it is given up
AUTO, AUTOMATIC = Refinement(thin=True, clamp=True), "--refine auto"


class Coarse(NamedTuple):
    """Why a surface is too coarse, in words, and how many times as short its edges would have to be."""

    reason: str
    times: float


def check_coarseness(organ: Organ) -> None:
    """Raise UserError, with what to build the organ with, where it is too thin for its triangles to be calibrated.

    Large triangles at thin rims or beside the clamp cost accuracy there, see `accuracy_warning`.
    """
    if _in_thin_tissue(organ, _edges(organ)) is not None:
        raise UserError(str(coarseness(organ)))


def accuracy_warning(organ: Organ) -> str | None:
    """Return what limits the accuracy of an organ that can be calibrated; None where nothing does, or it is refused."""
    return coarseness(organ) if _in_thin_tissue(organ, _edges(organ)) is None else None


def coarseness(organ: Organ) -> str | None:
    """Return why an organ's triangles are too large to be calibrated well, and what helps; None where they aren't."""
    worst = _worst(organ, _edges(organ))
    if worst is None:
        return None
    everywhere = _hundreds(organ.n_surface * worst.times**2)
    refine, refined = _refining(organ, worst)
    cheaper = refine == AUTOMATIC or _is_refined(organ) or refined < everywhere
    remedies = [f"{refine} (about {refined} points)"] if cheaper and refined <= MOST_POINTS else []
    remedies += [f"--points {everywhere}"] if everywhere <= MOST_POINTS and not _is_refined(organ) else []
    remedy = " or ".join(remedies) or f"another --fixed: more than {MOST_POINTS} points would be needed"
    return f"organ '{organ.name}' {worst.reason}; build it with {remedy}"


def _refining(organ: Organ, worst: Coarse) -> tuple[str, int]:
    """Return the options that refine an organ until nothing is too coarse, and the points that it then has.

    The edges that a refinement would give are measured as those that there are. More points are asked for with it where
    it falls short, and where it fell short already.
    """
    before = int(organ.provenance.get("points", organ.n_surface))
    if _is_refined(organ):
        return f"{AUTOMATIC} --points {_hundreds(before * worst.times**2)}", _hundreds(organ.n_surface * worst.times**2)
    closer, surface = 1.0, (organ.surface_positions, organ.surface_triangles, organ.fixed)
    for _ in range(TRIES):
        count = points_with(AUTO, *surface, closer)
        wanted = wanted_edges(AUTO, *surface, closer)(organ.surface_positions)
        still = _worst(organ, np.minimum(_edges(organ) / closer, wanted))
        if still is None:
            more = "" if closer == 1.0 else f" --points {_hundreds(before * closer**2)}"
            return f"{AUTOMATIC}{more}", _hundreds(count)
        closer *= still.times
    return AUTOMATIC, MOST_POINTS + 1


def _is_refined(organ: Organ) -> bool:
    """Return whether an organ was built with the refinement that `coarseness` names."""
    return "auto" in organ.provenance.get("refine", ())


def _hundreds(points: float) -> int:
    return math.ceil(points / 100.0) * 100


def _edges(organ: Organ) -> Floats:
    """Mean length of the edges at each surface node, (n,) m."""
    return local_edges(organ.surface_positions, organ.surface_triangles)


def _worst(organ: Organ, edges: Floats) -> Coarse | None:
    """Return what is worst of an organ whose surface nodes have edges (n,) m; None where those are short enough."""
    found = [_in_thin_tissue(organ, edges), _at_thin_rims(organ, edges), _beside_clamp(organ, edges)]
    return max((one for one in found if one is not None), key=lambda one: one.times, default=None)


def _in_thin_tissue(organ: Organ, lengths: Floats) -> Coarse | None:
    """Compare edges with the radius of the medial atoms."""
    if not organ.n_atoms:
        return None
    edges = _edges_at(organ, organ.atom_positions, lengths)
    said = "is {1:.1f} mm thick in places, too thin for triangles with edges of {0:.1f} mm"
    return _compared(edges, 2.0 * organ.atom_radius, THIN, 0.5 * MOST, 0.5 * ROOM, said)


def _at_thin_rims(organ: Organ, lengths: Floats) -> Coarse | None:
    """Compare edges with the thickness under the surface."""
    loaded = _loaded(organ)
    if not loaded.any():
        return None
    thick = thickness(organ.surface_positions, organ.surface_triangles)[loaded]
    said = "has rims {1:.1f} mm thick, too thin for triangles with edges of {0:.1f} mm"
    return _compared(lengths[loaded], thick, RIM, MOST_THROUGH, ROOM_THROUGH, said)


def _beside_clamp(organ: Organ, lengths: Floats) -> Coarse | None:
    """Compare edges with the distance from the clamp."""
    loaded = _loaded(organ)
    if not len(organ.fixed) or not loaded.any():
        return None
    positions = organ.surface_positions
    apart = cKDTree(positions[organ.fixed]).query(positions[loaded])[0]
    apart = np.maximum(apart, SMOOTH_RADIUS[0] * size_of(organ))  # a load's patch is as wide as that
    said = "has triangles with edges of {0:.1f} mm at {1:.1f} mm from its clamp, too coarse for accurate loads there"
    return _compared(lengths[loaded], apart, RIM, MOST_BESIDE, ROOM_BESIDE, said)


def _compared(edges: Floats, sizes: Floats, left_out: float, most: float, aim: float, said: str) -> Coarse | None:
    """Return where edges (k,) m are longest relative to sizes (k,) m; None where they are at most `most` times as long.

    left_out: fraction of the places that don't count; aim: ratio to be reached; said: text with both in the worst
    places, mm.
    """
    ratio = edges / sizes
    worst = float(np.quantile(ratio, 1.0 - left_out))
    if worst <= most:
        return None
    there = ratio >= worst
    return Coarse(said.format(*(1e3 * float(np.median(each[there])) for each in (edges, sizes))), worst / aim)


def _loaded(organ: Organ) -> Floats:
    """Which surface nodes loads are centred on, (n,) bool: those away from the clamp."""
    far = np.ones(organ.n_surface, dtype=bool)
    if len(organ.fixed):
        apart = cKDTree(organ.surface_positions[organ.fixed]).query(organ.surface_positions)[0]
        far = apart > CLEARANCE * size_of(organ)
    return far


def _edges_at(organ: Organ, points: Floats, lengths: Floats) -> Floats:
    """Mean length of the edges at the surface nodes nearest to points (a, 3) m, (a,) m."""
    positions = organ.surface_positions
    count = min(12, len(positions))
    near = cKDTree(positions).query(points, k=count)[1].reshape(len(points), count)
    found: Floats = lengths[near].mean(axis=1)
    return found
