"""Links, of which ligaments consist in the kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs

POINT = -1  # in place of an organ


class Links(NamedTuple):
    """Links between two ends each; l links.

    An end is a node of an organ, or, if the organ is POINT, a point that may move with the breath.
    """

    organ: Longs  # (l, 2)
    node: Longs  # (l, 2)
    point: Floats  # (l, 2, 3) m, exhaled
    moves: Floats  # (l, 2) motion of points with the breath, as a factor
    slack: Floats  # (l,) m, length up to which they don't pull
    stiffness: Floats  # (l,) N/m
    damping: Floats  # (l,) N s/m
    lightness: Floats  # (l,) 1/kg, sum of the inverse masses of both ends, each times the number of links on its node
    added: Floats  # (1,) (rad/s)^2, bound on the increase of the squared largest frequency by links
    force: Floats  # (l, 3) N on the first end in this substep; only a fraction may act on its organ


def make_links(count: int) -> Links:
    """Return links without effect.

    Parameters
    ----------
    count : int
        Number of links.
    """
    return Links(
        organ=np.full((count, 2), POINT, dtype=np.int64),
        node=np.zeros((count, 2), dtype=np.int64),
        point=np.zeros((count, 2, 3)),
        moves=np.zeros((count, 2)),
        slack=np.zeros(count),
        stiffness=np.zeros(count),
        damping=np.zeros(count),
        lightness=np.zeros(count),
        added=np.zeros(1),
        force=np.zeros((count, 3)),
    )
