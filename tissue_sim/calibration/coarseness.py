"""Whether an organ's surface is fine enough for how thin the organ is, and for loads beside its clamp."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats
from tissue_sim.calibration.cases import CLEARANCE, size_of
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.refinement import NEAREST, Refinement, points_with
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


class Coarse(NamedTuple):
    """Why a surface is too coarse, in words, and how many times as short its edges would have to be."""

    reason: str
    times: float


def check_coarseness(organ: Organ) -> None:
    """Raise UserError, with what to build the organ with, where it is too thin for its triangles to be calibrated.

    Large triangles at thin rims or beside the clamp cost accuracy there, see `accuracy_warning`.
    """
    if _in_thin_tissue(organ) is not None:
        raise UserError(str(coarseness(organ)))


def accuracy_warning(organ: Organ) -> str | None:
    """Return what limits the accuracy of an organ that can be calibrated; None where nothing does, or it is refused."""
    return coarseness(organ) if _in_thin_tissue(organ) is None else None


def coarseness(organ: Organ) -> str | None:
    """Return why an organ's triangles are too large to be calibrated well, and what helps; None where they aren't."""
    found = [one for one in (_in_thin_tissue(organ), _at_thin_rims(organ), _beside_clamp(organ)) if one is not None]
    if not found:
        return None
    worst = max(found, key=lambda one: one.times)
    points = math.ceil(organ.n_surface * worst.times**2 / 100.0) * 100
    auto = Refinement(thin=True, clamp=True)
    count = points_with(auto, organ.surface_positions, organ.surface_triangles, organ.fixed)
    refined = math.ceil(count / 100.0) * 100
    remedies = [f"--refine auto (about {refined} points)"] if refined <= MOST_POINTS else []
    remedies += [f"--points {points}"] if points <= MOST_POINTS else []
    remedy = " or ".join(remedies) or f"another --fixed: more than {MOST_POINTS} points would be needed"
    return f"organ '{organ.name}' {worst.reason}; build it with {remedy}"


def _in_thin_tissue(organ: Organ) -> Coarse | None:
    """Edges against the radius of the medial atoms."""
    if not organ.n_atoms:
        return None
    edges = _edges_at(organ, organ.atom_positions)
    ratio = edges / organ.atom_radius
    worst = float(np.quantile(ratio, 1.0 - THIN))
    if worst <= MOST:
        return None
    thin = ratio >= worst
    return Coarse(
        f"is {2e3 * float(np.median(organ.atom_radius[thin])):.1f} mm thick in places, too thin for triangles with"
        f" edges of {1e3 * float(np.median(edges[thin])):.1f} mm",
        worst / ROOM,
    )


def _at_thin_rims(organ: Organ) -> Coarse | None:
    """Edges against the thickness under the surface."""
    loaded = _loaded(organ)
    edges = local_edges(organ.surface_positions, organ.surface_triangles)[loaded]
    thick = thickness(organ.surface_positions, organ.surface_triangles)[loaded]
    worst = float(np.quantile(edges / thick, 1.0 - RIM))
    if worst <= MOST_THROUGH:
        return None
    thin = edges / thick >= worst
    return Coarse(
        f"has rims {1e3 * float(np.median(thick[thin])):.1f} mm thick, too thin for triangles with edges of"
        f" {1e3 * float(np.median(edges[thin])):.1f} mm",
        worst / ROOM_THROUGH,
    )


def _beside_clamp(organ: Organ) -> Coarse | None:
    """Edges against the distance from the clamp."""
    loaded = _loaded(organ)
    if not len(organ.fixed) or not loaded.any():
        return None
    positions, triangles = organ.surface_positions, organ.surface_triangles
    apart = cKDTree(positions[organ.fixed]).query(positions[loaded])[0]
    apart = np.maximum(apart, NEAREST * size_of(organ))  # a load's patch is as wide as that
    edges = local_edges(positions, triangles)[loaded]
    worst = float(np.quantile(edges / apart, 1.0 - RIM))
    if worst <= MOST_BESIDE:
        return None
    near = edges / apart >= worst
    return Coarse(
        f"has triangles with edges of {1e3 * float(np.median(edges[near])):.1f} mm at"
        f" {1e3 * float(np.median(apart[near])):.1f} mm from its clamp, too coarse for accurate loads there",
        worst / ROOM_BESIDE,
    )


def _loaded(organ: Organ) -> Floats:
    """Which surface nodes loads are centred on, (n,) bool: those away from the clamp."""
    far = np.ones(organ.n_surface, dtype=bool)
    if len(organ.fixed):
        apart = cKDTree(organ.surface_positions[organ.fixed]).query(organ.surface_positions)[0]
        far = apart > CLEARANCE * size_of(organ)
    return far


def _edges_at(organ: Organ, points: Floats) -> Floats:
    """Mean length of the edges at the surface nodes nearest to points (a, 3) m, (a,) m."""
    positions, triangles = organ.surface_positions, organ.surface_triangles
    count = min(12, len(positions))
    near = cKDTree(positions).query(points, k=count)[1].reshape(len(points), count)
    return local_edges(positions, triangles)[near].mean(axis=1)
