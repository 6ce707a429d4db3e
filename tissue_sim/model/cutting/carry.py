"""Transfer of the state of an organ to the same organ with more or fewer nodes, after a cut or a reset of cuts."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.data.records import array_of
from tissue_sim.model.data.state import State, fields_of, state_like

# Virtual nodes begin with the position and velocity of the nodes that they copy.
_MOVED = ("position", "velocity", "good_position")
# Inputs for nodes, which are copied for the nodes of the uncut organ.
_GIVEN = (
    "nodal_force",
    "loaded_node",
    "is_loaded",
    "prescribed_node",
    "is_prescribed",
    "prescribed_ticks",
    "prescribed_from",
    "prescribed_to",
)
_KEPT = (
    "status",
    "count",
    "bodies",
    "wrench",
    "body_pose",
    "carried",
    "held_pose",
    "body_goal",
    "body_force",
    "unfaded_wrench",
    "contact_pressed",
    "contact_held",
    "blades",
)
# The next tick computes these again; the region is the whole organ.
_RENEWED = (
    "turned",
    "next_cell",
    "region",
    "region_nodes",
    "region_springs",
    "region_hinges",
    "region_cells",
)


class CarryPlan(NamedTuple):
    """Plan of the k words that are copied from one state to another; all other words keep their values.

    A node's unrelaxed force is divided among the nodes that take its place, by their masses: d words.
    """

    source: Longs  # (k,) places in the words of the state before
    target: Longs  # (k,) places in the words of the state after
    divided: Longs  # (d,) places in the words of the state after
    fraction: Floats  # (d,) of the copied value that remains


_NONE = np.zeros(0, dtype=np.int64)
NO_PLAN = CarryPlan(_NONE, _NONE, _NONE, np.zeros(0))


def carry_plan(before: State, after: State, origin: Longs, own: int, mass: Floats) -> CarryPlan:
    """Return the plan by which a state continues in that of the same organ after a cut.

    The plan depends only on the sizes of both states, not on their values, so that it can be made in parallel to a
    running loop, which only copies the words. Contact points are copied, too: their nodes keep their indices.

    Parameters
    ----------
    before : State
        A state of the organ before.
    after : State
        A state of the organ after.
    origin : Longs, shape (n,)
        Node of the organ before which each node of the organ after replaces.
    own : int
        Number of nodes of the uncut organ.
    mass : Floats, shape (n,), kg
        Masses of the nodes after.
    """
    first, last = _numbered(before, 1), _numbered(after, -1)
    old, new = fields_of(first), fields_of(last)
    for name in _MOVED:
        new[name][...] = old[name][origin]
    for name in _GIVEN:
        new[name][:own] = old[name][:own]
    renewed = {name: array_of(last.status)[name].copy() for name in _RENEWED}
    for name in _KEPT:
        _as_words(new[name])[...] = _as_words(old[name])
    for name in _RENEWED:
        array_of(last.status)[name] = renewed[name]
    last.contacts.words[:] = first.contacts.words
    if len(last.unrelaxed):
        new["unrelaxed"][...] = old["unrelaxed"][origin]
        array_of(last.relaxing)["energy"] = array_of(first.relaxing)["energy"]
    target = np.flatnonzero(last.words > 0)
    return CarryPlan(last.words[target] - 1, target, *_divided(after, origin, mass))


def _divided(after: State, origin: Longs, mass: Floats) -> tuple[Longs, Floats]:
    """Return which words of a state are divided among nodes with the same origin (n,), and their fractions."""
    if not len(after.unrelaxed):
        return NO_PLAN.divided, NO_PLAN.fraction
    part = mass / np.bincount(origin, mass)[origin]
    nodes = np.flatnonzero(part != 1.0)
    places = _numbered(after, 1).unrelaxed.view(np.int64)[nodes] - 1
    return places.reshape(-1), np.repeat(part[nodes], 3)


def _as_words(array: NDArray[Any]) -> NDArray[Any]:
    """Return an array, or the words of records, since NumPy would omit the padding if it copied field by field."""
    return array if array.dtype.names is None else array.reshape(-1).view(np.int64)


def _numbered(state: State, sign: int) -> State:
    """Return a state of the same size whose words are their numbers from 1 on, with a sign."""
    made = state_like(state)
    made.words[:] = sign * np.arange(1, len(made.words) + 1)
    return made


@kernel
def carry(before: Longs, after: Longs, plan: CarryPlan) -> None:
    """Copy the words of a state that continue in another.

    Parameters
    ----------
    before : Longs
        Words of the state before.
    after : Longs
        Words of the state after; updated.
    plan : CarryPlan
        Which are copied.
    """
    for index in range(len(plan.target)):
        after[plan.target[index]] = before[plan.source[index]]
    numbers = after.view(np.float64)
    for index in range(len(plan.divided)):
        numbers[plan.divided[index]] *= plan.fraction[index]
