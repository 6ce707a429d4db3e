"""What is drawn for a play: hostile tools, loads and settings, for an organ, or for two that are joined and breathe.

Every tool does one thing for the whole of a play; so does the load, which ends suddenly. Settings change at any time.
"""

from typing import NamedTuple

import numpy as np
from hypothesis import strategies as st

TICKS = 160
# Most are small, as the errors of a large one are mostly the same: of a hundred plays, so many.
ALONE = {"springs": 45, "springs, modal": 10, "springs, frozen": 5, "cells": 35, "cells, modal": 5}
JOINED = {"two of springs": 60, "two of springs, folding": 20, "two of cells": 20}
MOTIONS = ("away", "presses", "swings", "snaps", "is inside", "spins", "teleports", "shoots through", "flies far")
BREATHS = ("no breath", "breathes", "pants", "gasps")

Vector = tuple[float, float, float]


class Hand(NamedTuple):
    """What a tool does."""

    motion: str
    node: int = 0  # of the surface, that it aims at
    speed: float = 1.0  # m/s
    turn: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    holes: float = 0.0  # fraction of the ticks without a pose
    wild: bool = False  # stamps
    organ: int = 0


class Load(NamedTuple):
    """Forces on nodes in some ticks, N, and on the tools' tips."""

    nodes: tuple[int, ...] = ()
    patch: int = 0  # number of nodes around the first one that are meant instead, if any
    forces: tuple[Vector, ...] = ()  # as many as nodes, or the first ones again
    ticks: tuple[int, int] = (0, TICKS)
    tips: tuple[Vector, ...] = ()
    organ: int = 0


class Play(NamedTuple):
    """All that happens; noise: seed of what is random in every tick, or the state of its generator."""

    variant: str
    hands: tuple[Hand, ...]
    load: Load = Load()
    breath: tuple[str, float] = ("no breath", 10.0)  # and its period, ticks
    storm: float = 0.0  # probability that settings change in a tick
    noise: int | dict = 0


# what is drawn --------------------------------------------------------------------------------------


def powers(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers of every magnitude between two powers of ten."""
    return st.floats(low, high).map(lambda exponent: 10.0**exponent)


def vectors(size: float = 1.0) -> st.SearchStrategy[Vector]:
    """Vectors in a box of twice this size."""
    return st.tuples(*[st.floats(-size, size)] * 3)


def _unit(four: tuple[float, ...]) -> tuple[float, ...]:
    length = float(np.linalg.norm(four))
    return tuple(one / length for one in four) if length > 1e-6 else (0.0, 0.0, 0.0, 1.0)


quaternions = st.tuples(*[st.floats(-1.0, 1.0)] * 4).map(_unit)
nodes = st.integers(0, 2000)  # of more than any organ here has; they count on from the first one
forces = st.builds(
    lambda size, forces: tuple(tuple(size * one for one in force) for force in forces),
    powers(-2.0, 1.0) | powers(1.0, 9.0),
    st.lists(vectors(), min_size=1, max_size=3),
)


def plays(variants: dict[str, int]) -> st.SearchStrategy[Play]:
    """Plays of some variants, each of which makes up so many of a hundred."""
    organs = st.integers(0, 1 if variants is JOINED else 0)
    hand = st.builds(
        Hand,
        motion=st.sampled_from(MOTIONS),
        node=nodes,
        speed=powers(-1.0, 1.3),
        turn=quaternions,
        holes=st.sampled_from((0.0, 0.3, 0.9)),
        wild=st.sampled_from((*[False] * 7, *[True] * 3)),
        organ=organs,
    )
    load = st.builds(
        Load,
        nodes=st.lists(nodes, min_size=1, max_size=10, unique=True).map(tuple),
        patch=st.sampled_from((0, 1, 10, 60)),
        forces=forces,
        ticks=st.tuples(*[st.integers(0, TICKS)] * 2).map(lambda two: tuple(sorted(two))),
        tips=st.just(()) | forces,
        organ=organs,
    )
    return st.builds(
        Play,
        variant=st.sampled_from([name for name, fraction in variants.items() for _ in range(fraction)]),
        hands=st.tuples(hand, hand, hand),
        load=st.just(Load()) | load,
        breath=st.tuples(st.sampled_from(BREATHS if variants is JOINED else BREATHS[:1]), powers(1.0, 3.0)),
        storm=st.sampled_from((0.0, 0.0, 0.02)),
        noise=st.integers(0, 2**32),
    )
