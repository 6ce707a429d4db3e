"""Flat places of an organ where balls are pressed in, and over which they slide."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats, Mask
from tissue_sim.calibration.cases import surface_of
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.tool_resolution import mean_edge

KINDS = {"node": (1.0, 0.0, 0.0), "edge": (0.5, 0.5, 0.0), "triangle": (1 / 3, 1 / 3, 1 / 3)}  # weights of corners
CLEAR, AROUND = 5.0, 4.0  # edges from the clamp; edges around a place that are to be flat
FLATTEST = 0.25  # of the places that are clear of the clamp
ALIKE = 0.05  # by which the least cosine between a place's normal and those around may be below the flattest one's


class PressPoint(NamedTuple):
    """Spot where a ball is pressed in: number and kind of the place, (3,) m on the surface, inward direction (3,)."""

    place: int
    kind: str
    point: Floats
    direction: Floats


def clear_of_clamp(organ: Organ, points: Floats, edges: float) -> Mask:
    """Return which points (k, 3) m are farther from the clamp than a number of mean edges."""
    if not len(organ.fixed):
        return np.ones(len(points), dtype=np.bool_)
    clamp = organ.surface_positions[organ.fixed]
    return np.asarray(cKDTree(clamp).query(points)[0] > edges * mean_edge(organ))


def flat_locations(organ: Organ, count: int) -> list[list[PressPoint]]:
    """Return spots at a node, on an edge and in a triangle of so many triangles where the organ is flat.

    Clear of the clamp, among the flattest, and far from each other; the flattest comes first. Raises UserError where
    nothing is clear of the clamp.
    """
    surface, edge = surface_of(organ), mean_edge(organ)
    corner = surface.positions[organ.surface_triangles]
    middle = corner.mean(axis=1)
    direction = surface.normal[organ.surface_triangles].mean(axis=1)
    direction /= -np.linalg.norm(direction, axis=1)[:, None]
    chosen = np.flatnonzero(clear_of_clamp(organ, middle, CLEAR))
    if not len(chosen):
        raise UserError(
            f"organ '{organ.name}' has no point {1e3 * CLEAR * edge:.0f} mm from its clamp; use more points"
        )
    near = cKDTree(surface.positions).query_ball_point(middle[chosen], AROUND * edge)
    flat = np.array([(-surface.normal[nodes] @ direction[one]).min() for one, nodes in zip(chosen, near, strict=True)])
    order = np.argsort(-np.round(flat, 2), kind="stable")[: math.ceil(FLATTEST * len(chosen))]
    candidates = chosen[order[flat[order] > flat.max() - ALIKE]]
    picked = [int(candidates[0])]
    while len(picked) < min(count, len(candidates)):
        apart = cKDTree(middle[picked]).query(middle[candidates])[0]
        picked.append(int(candidates[apart.argmax()]))
    return [
        [PressPoint(number, kind, np.array(weights) @ corner[one], direction[one]) for kind, weights in KINDS.items()]
        for number, one in enumerate(picked)
    ]


def thickness(organ: Organ, spot: PressPoint) -> float:
    """Return how far the organ's other side is from a spot, along its direction, m; inf where there is none."""
    corner = organ.surface_positions[organ.surface_triangles] - spot.point
    first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    across = np.cross(first, second)
    facing = across @ spot.direction
    with np.errstate(divide="ignore", invalid="ignore"):
        ahead = np.einsum("tx,tx->t", across, corner[:, 0]) / facing
        sideways = np.cross(corner[:, 0], spot.direction)
        fractions = np.einsum("tx,tx->t", second, sideways) / facing, -np.einsum("tx,tx->t", first, sideways) / facing
    met = (
        (facing > 0.0)
        & (ahead > 0.0)
        & (fractions[0] >= 0.0)
        & (fractions[1] >= 0.0)
        & (fractions[0] + fractions[1] <= 1.0)
    )
    return float(ahead[met].min(initial=np.inf))
