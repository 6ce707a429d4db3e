"""Edges of blades: the places on an edge and its flanks at which tissue holds a blade, or is cut by it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from tissue_sim.errors import UserError
from tissue_sim.model.data.blades import Blades, make_blades

ALONG = 8  # places along an edge
BEHIND = 2  # rows of places on the flanks behind it
LEAST_EDGE = 1e-3  # m
MOST_SPEED = 0.1  # m/s of cautery


class Edged(Protocol):
    """What a tool says about its edge, see contact.tools.Tool."""

    name: str
    shape: str
    radius: float
    length: float
    height: float
    cautery_speed: float


def check_edge(tool: Edged) -> None:
    """Check the dimensions of a blade.

    Parameters
    ----------
    tool : Edged
        The blade, or scissors.

    Raises
    ------
    UserError
        Where one is out of range; the message names it.
    """
    if not tool.length >= LEAST_EDGE:
        raise UserError(f"tool '{tool.name}': length {tool.length:g} m of its edge is below {LEAST_EDGE:g}")
    if not 0.0 < tool.height <= 0.5:
        raise UserError(f"tool '{tool.name}': height {tool.height:g} m is outside 0..0.5")
    if not 0.0 <= tool.cautery_speed <= MOST_SPEED:
        raise UserError(f"tool '{tool.name}': cautery_speed {tool.cautery_speed:g} m/s is outside 0..{MOST_SPEED:g}")


def edges_of(tools: Sequence[Edged], bodies: Sequence[Sequence[int]]) -> Blades:
    """Return the places of all blades among some tools.

    An edge runs from the body's origin along -z. That of a blade cuts towards x, and those of scissors towards each
    other, which is against x.

    Parameters
    ----------
    tools : Sequence[Edged]
        The tools.
    bodies : Sequence[Sequence[int]]
        Bodies of each.
    """
    body, at, forward, measures = [], [], [], []
    for tool, own in zip(tools, bodies, strict=True):
        if tool.shape not in ("blade", "scissors"):
            continue
        ahead = 1.0 if tool.shape == "blade" else -1.0
        along, deep = tool.length / ALONG, tool.height / BEHIND
        for number in own:
            for row in range(BEHIND + 1):
                back = 0.0 if row == 0 else (row - 0.5) * deep
                for place in range(ALONG):
                    body.append(number)
                    at.append([ahead * (tool.radius - back), 0.0, -(place + 0.5) * along])
                    forward.append([ahead, 0.0, 0.0])
                    edge, flank = (along, 0.0) if row == 0 else (0.0, 2.0 * along * deep)
                    measures.append([edge, flank, tool.cautery_speed])
    return make_blades(body, at, forward, np.tile([0.0, 1.0, 0.0], (len(body), 1)), measures)
