"""How small a ball an organ's surface is fine enough for, and how many points a smaller one needs.

Compared with finite elements, the force of a ball whose radius is one mean edge of the surface should be within 8 %,
and that of half an edge within 15 % (`tissue_sim bench palpation --places N`). Smaller balls fit between the nodes,
which carry no information there.
"""

from __future__ import annotations

import math

import numpy as np

from tissue_sim.organ.organ import Organ
from tissue_sim.organ.surfaces import sizing

FINE, FINE_WITHIN = 1.0, 8.0  # mean edges, %
FAIR, FAIR_WITHIN = 0.5, 15.0
CUT_EDGES = 2.0  # edges of the surface that a cut must be deep, and its lips thick, to count as resolved
MOST_POINTS = 20_000  # that a balloon has been tried with
KIDNEY = 1.34e-4  # m^3; in a smaller organ lengths that a kidney is judged by shrink with the root of its volume


def relative_size(volume: float) -> float:
    """Return what a kidney's lengths are multiplied by for an organ of so many m^3: 1 unless it is smaller."""
    return min(1.0, (volume / KIDNEY) ** (1.0 / 3.0))


def mean_edge(organ: Organ) -> float:
    """Return the mean edge length of an organ's surface.

    Parameters
    ----------
    organ : Organ
        The organ.

    Returns
    -------
    float, m
        The mean over all edges of all triangles.
    """
    return sizing.mean_edge(organ.surface_positions, organ.surface_triangles)


def usual_edge(organ: Organ) -> float:
    """Return the mean edge of an organ's surface, m; of a graded one that of its coarser half."""
    positions, triangles = organ.surface_positions, organ.surface_triangles
    size = sizing.relative_edges(positions, triangles)
    coarser = size >= np.median(size)
    return (
        mean_edge(organ)
        if size.min() == size.max()
        else float(sizing.local_edges(positions, triangles)[coarser].mean())
    )


def points_for(organ: Organ, radius: float, edges: float = FAIR) -> int:
    """Return how many surface points make a ball's radius as long as a number of mean edges.

    Parameters
    ----------
    organ : Organ
        The organ.
    radius : float, m
        Radius of the ball.
    edges : float, optional
        Wanted radius in mean edges.

    Returns
    -------
    int
        Number of surface points.
    """
    return math.ceil(organ.n_surface * (edges * mean_edge(organ) / radius) ** 2)


def unresolved_tools_of(organ: Organ, radius: float) -> str | None:
    """Return why an organ is too coarse for a tool, and the remedy.

    Parameters
    ----------
    organ : Organ
        The organ.
    radius : float, m
        Radius of the tool.

    Returns
    -------
    str | None
        A sentence for the user; None where the surface is fine enough.
    """
    edge, wanted = mean_edge(organ), points_for(organ, radius)
    if radius >= FAIR * edge:
        return None
    least = 1e3 * FAIR * edge * math.sqrt(organ.n_surface / MOST_POINTS)
    remedy = (
        f"build the organ with --points {wanted} ({points_for(organ, radius, FINE)} for an error of {FINE_WITHIN:g}"
        " %), or use a larger radius"
        if wanted <= MOST_POINTS
        else f"use a radius of {least:.2g} mm or more, for which --points {MOST_POINTS} is sufficient"
    )
    return (
        f"its radius of {1e3 * radius:.3g} mm is below half the mean edge of organ '{organ.name}', {1e3 * edge:.3g}"
        f" mm: the error of forces may exceed {FAIR_WITHIN:g} %; {remedy}"
    )
