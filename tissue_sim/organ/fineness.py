"""How small a ball an organ's surface is fine enough for, and how many points would do for a smaller one.

Beside finite elements the force of a ball of one mean edge of the surface is to be within 8 %, that of half an edge
within 15 % (`tissue_sim bench palpation --places N`). Smaller ones lie between nodes, which tell nothing of there.
"""

from __future__ import annotations

import math

import numpy as np

from tissue_sim.organ.organ import Organ
from tissue_sim.organ.surfaces.sizing import local_edges, relative_edges

FINE, FINE_WITHIN = 1.0, 8.0  # mean edges, %
FAIR, FAIR_WITHIN = 0.5, 15.0
MOST_POINTS = 20_000  # that a balloon has been tried with
KIDNEY = 1.34e-4  # m^3; in a smaller organ lengths that a kidney is judged by shrink with the root of its volume


def relative_size(volume: float) -> float:
    """Return what a kidney's lengths are multiplied by for an organ of so many m^3: 1 unless it is smaller."""
    return min(1.0, (volume / KIDNEY) ** (1.0 / 3.0))


def mean_edge(organ: Organ) -> float:
    """Return the mean edge of an organ's surface, m."""
    corner = organ.surface_positions[organ.surface_triangles]
    return float(np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).mean())


def usual_edge(organ: Organ) -> float:
    """Return the mean edge of an organ's surface, m; of a graded one that of its coarser half."""
    positions, triangles = organ.surface_positions, organ.surface_triangles
    size = relative_edges(positions, triangles)
    coarser = size >= np.median(size)
    return mean_edge(organ) if size.min() == size.max() else float(local_edges(positions, triangles)[coarser].mean())


def points_for(organ: Organ, radius: float, edges: float = FAIR) -> int:
    """Return with how many surface points a ball, its radius in m, would measure so many mean edges."""
    return math.ceil(organ.n_surface * (edges * mean_edge(organ) / radius) ** 2)


def too_coarse(organ: Organ, radius: float) -> str | None:
    """Return in words why an organ is too coarse for a tool, its radius in m, and what helps; None when it isn't."""
    edge, wanted = mean_edge(organ), points_for(organ, radius)
    if radius >= FAIR * edge:
        return None
    least = 1e3 * FAIR * edge * math.sqrt(organ.n_surface / MOST_POINTS)
    remedy = (
        f"build the organ with --points {wanted} ({points_for(organ, radius, FINE)} for {FINE_WITHIN:g} %), or use a"
        " larger radius"
        if wanted <= MOST_POINTS
        else f"use a radius of {least:.2g} mm or more, for which --points {MOST_POINTS} would do"
    )
    return (
        f"its radius of {1e3 * radius:.3g} mm is below half the mean edge of organ '{organ.name}', {1e3 * edge:.3g} mm:"
        f" forces may be off by more than {FAIR_WITHIN:g} %; {remedy}"
    )
