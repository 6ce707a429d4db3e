"""The state of an organ after a cut, from that before."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from tissue_sim.array_types import Longs
from tissue_sim.model.data.state import State, fields_of

_MOVED = ("position", "velocity", "good_position")  # virtual nodes begin where and as fast as the nodes they copy
# Of nodes, and carried over for those that the uncut organ has: what a user gave them.
_GIVEN = ("nodal_force", "is_loaded", "is_prescribed", "prescribed_ticks", "prescribed_from", "prescribed_to")
_KEPT = ("count", "bodies", "wrench", "body_pose", "carried", "held_pose", "body_goal", "body_force", "felt")
# The tick finds out about cells again, and about the region, which is the whole organ.
_RENEWED = ("turned", "next_cell", "region", "region_nodes", "region_springs", "region_hinges", "region_cells")


def carried_over(before: State, after: State, origin: Longs, own: int) -> dict[str, NDArray[Any]]:
    """Return the fields of the state after a cut.

    Parameters
    ----------
    before : State
        The state before it.
    after : State
        A new state of the cut organ.
    origin : Longs, shape (n,)
        The node before whose place each node takes.
    own : int
        Number of nodes of the uncut organ.

    Returns
    -------
    dict[str, NDArray[Any]]
        Fields as those of fields_of.
    """
    old, new = fields_of(before), {name: array.copy() for name, array in fields_of(after).items()}
    for name in _MOVED:
        new[name][...] = old[name][origin]
    for name in _GIVEN:
        new[name][:own] = old[name][:own]
    status = old["status"].copy()
    for name in _RENEWED:
        status[name] = new["status"][name]
    for kind, name in (("loaded", "loaded_node"), ("prescribed", "prescribed_node")):
        listed = old[name][: int(getattr(before.status, kind))]
        listed = listed[listed < own]
        new[name][: len(listed)] = listed
        status[kind] = len(listed)
    new["status"] = status
    for name in _KEPT:
        new[name] = old[name].copy()
    return new
