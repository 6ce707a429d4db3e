"""Edges of blades: the points on an edge and its flanks at which tissue holds a blade, or is cut by it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tissue_sim.errors import UserError
from tissue_sim.model.cutting.sheet import Coagulation
from tissue_sim.model.data.blades import Blades, make_blades

ALONG = 8  # points along an edge
BEHIND = 2  # rows of points on the flanks behind it
MIN_EDGE = 1e-3  # m
MAX_SPEED = 0.1  # m/s of cautery
MAX_STIFFENING = 20.0  # of the walls of its cut
MAX_SPREAD = 0.01  # m of its heat


class Edge(NamedTuple):
    """Edge of a blade, from its body's origin along -z."""

    ahead: float  # direction along x in which it cuts: 1 or, with scissors, -1
    radius: float  # m, half its thickness
    length: float  # m
    height: float  # m of the blade behind it
    speed: float  # m/s at which it cuts tissue without force; 0: it cuts by force
    coagulation: Coagulation  # effect of its heat on the walls of its cut


def check_edge(name: str, edge: Edge) -> None:
    """Check the dimensions of a blade.

    Parameters
    ----------
    name : str
        Name of the tool.
    edge : Edge
        Its edge.

    Raises
    ------
    UserError
        Where one is out of range; the message names it.
    """
    if not edge.length >= MIN_EDGE:
        raise UserError(f"tool '{name}': length {edge.length:g} m of its edge is below {MIN_EDGE:g}")
    if not 0.0 < edge.height <= 0.5:
        raise UserError(f"tool '{name}': height {edge.height:g} m is outside 0..0.5")
    if not 0.0 <= edge.speed <= MAX_SPEED:
        raise UserError(f"tool '{name}': cautery_speed {edge.speed:g} m/s is outside 0..{MAX_SPEED:g}")
    stiffening, spread = edge.coagulation
    if not 1.0 <= stiffening <= MAX_STIFFENING:
        raise UserError(f"tool '{name}': cautery_stiffening {stiffening:g} is outside 1..{MAX_STIFFENING:g}")
    if not 0.0 <= spread <= MAX_SPREAD:
        raise UserError(f"tool '{name}': cautery_spread {spread:g} m is outside 0..{MAX_SPREAD:g}")
    if stiffening > 1.0 and edge.speed == 0.0:
        raise UserError(
            f"tool '{name}': cautery_stiffening {stiffening:g} needs a hot tool, and without a cautery_speed it"
            " is a cold blade; set cautery_speed above 0, or cautery_stiffening to 1"
        )


def edges_of(edges: Sequence[Edge | None], bodies: Sequence[Sequence[int]]) -> Blades:
    """Return the points of all blades among some tools.

    Parameters
    ----------
    edges : Sequence[Edge | None]
        Edge of each tool; None for those without one.
    bodies : Sequence[Sequence[int]]
        Bodies of each.
    """
    body, at, forward, measures = [], [], [], []
    for edge, own in zip(edges, bodies, strict=True):
        if edge is None:
            continue
        along, deep = edge.length / ALONG, edge.height / BEHIND
        for number in own:
            for row in range(BEHIND + 1):
                back = 0.0 if row == 0 else (row - 0.5) * deep
                for place in range(ALONG):
                    body.append(number)
                    at.append([edge.ahead * (edge.radius - back), 0.0, -(place + 0.5) * along])
                    forward.append([edge.ahead, 0.0, 0.0])
                    width, flank = (along, 0.0) if row == 0 else (0.0, 2.0 * along * deep)
                    measures.append([width, flank, edge.speed])
    return make_blades(body, at, forward, np.tile([0.0, 1.0, 0.0], (len(body), 1)), measures)
