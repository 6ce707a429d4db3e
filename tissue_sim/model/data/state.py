"""Everything that changes from tick to tick, in one array of words, so that a copy of it is a snapshot."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Longs
from tissue_sim.model.data.blades import BladeSample
from tissue_sim.model.data.contact_set import (
    MAX_CONTACT_POINTS,
    PER_POINT,
    ContactSet,
    contact_set,
    contact_set_words,
    padded,
)
from tissue_sim.model.data.layout import Field, carve, size_of
from tissue_sim.model.data.records import Record, Records, Vector, array_of


class Region(IntEnum):
    """Part of the organ that a tick has solved."""

    WHOLE, FROZEN, MODAL = range(3)


class Fault(IntEnum):
    """Kinds of faults that the guard finds."""

    NONE, NOT_FINITE, RUNAWAY, COLLAPSED = range(4)


FAULT_NAMES = tuple(fault.name.lower().replace("_", " ") for fault in Fault)


class Status(Record):
    """State of the organ; a reset renews it, except for the tick."""

    tick: int  # ticks done
    asleep: bool  # at rest and untouched
    snapped: bool  # recovering from a false rest shape
    collapsing: bool  # more cells are inverted than can recover by themselves
    region: int  # Region, part that the last tick has solved
    fault_kind: int  # Fault, the last one that the guard found
    substeps: int  # of the last tick
    backoff: int  # factor on the substeps after a fault
    faulted: bool  # the guard has found a fault since the last reset to the rest shape
    oscillating: int  # ticks for which a step that was too long remains halved
    halving: int  # ticks for which the next such step will be halved; 0: the smallest number
    turning: float  # m^2/s^2, squared speeds of nodes that reversed at the last check
    quiet: int  # ticks in a row that were nearly at rest
    alone: int  # ticks in a row in which no hand touched or loaded it or a joined organ
    calm: int  # ticks in a row with a load small enough for a local region
    touching: int  # contact points that touched in the last tick
    active: int  # nodes that were integrated in the last tick
    loaded: int  # nodes that nodal_force loads in this tick, listed in loaded_node
    prescribed: int  # nodes whose position is prescribed, listed in prescribed_node
    prescriptions: int  # number of changes of these
    turned: int  # cells of the inside that are inverted
    next_cell: int  # with which the rolling check of the cells continues
    good_age: int  # ticks since the last valid shape was kept; more than KEEP_EVERY right after a fault
    shown: int  # tick in which the nodes outside a modal region were last updated
    region_nodes: int  # nodes in the local region
    region_springs: int
    region_hinges: int
    region_cells: int
    region_boundary: int  # nodes at the region's edge that follow the modes


class Counts(Record):
    """Numbers of events so far; a reset leaves them."""

    faults: int  # times that the guard restored the last valid shape
    oscillations: int  # times that a step was found too long under load
    snaps: int  # recoveries from a false rest shape
    asleep_ticks: int  # ticks that were skipped asleep
    frozen_ticks: int  # ticks that moved only a frozen region
    modal_ticks: int  # ticks that moved a modal region
    clamped_ticks: int  # ticks in which a wrench was limited by the clamp
    slips: int  # times that a tool had slipped into the organ and was put back on its surface
    slewed_ticks: int  # ticks in which the rate of a wrench was limited


class BodyStatus(Record):
    """State of a rigid body of a tool."""

    age: int  # ticks since the newest pose; -1 before the first one
    stamp: int  # ns of the newest pose; 0 where it has none
    remaining: float  # s until the tool reaches the newest pose
    speed: float  # m/s, largest speed of the poses on the rest of its path
    turning: float  # 1/s, the same for its quaternion
    force_age: int  # ticks since the newest external force; -1 before the first one
    engaged: bool  # it may touch: fresh, and outside the organ when it appeared
    cutting: bool  # it is in tissue with a blade
    held_off: bool  # it appeared inside the organ, and nothing resists it until it has been outside
    released: bool  # poses stopped: the next one may be anywhere, as if it were the first
    placed: bool  # a hand began here, or is resisted here: the body remains while poses pause
    resisted: bool  # it was resisted when poses stopped: if they resume soon, it is put back on the surface
    releases: int  # number of releases, resets and slips; an older contact set doesn't belong to its present place
    pose_sequence: int  # which pose is in use
    force_sequence: int  # which external force is in use
    recent_force: float  # N, the largest of the tissue on it since it slipped, unclamped; it decays
    recent_speed: float  # m/s, the largest of its poses; it decays
    slips: int  # slips since it first touched; the first one counts as three unless the body was fast
    bearable: float  # N, largest force with which it presses after three slips; before that, it presses more slowly
    outward: Vector  # N, mean recent force of the tissue on it, until it slips: towards the side from which it came


class Relaxing(Record):
    """State of tissue that relaxes, besides its forces."""

    step: float  # s, of the last substep; 0: the last elastic forces are unknown
    energy: float  # J that the unrelaxed forces have received and not yet returned


class Results(NamedTuple):
    """Results that are posted after every tick, of T rigid bodies."""

    status: Status
    count: Counts  # type: ignore[assignment]  # hides the tuple's method, which nobody needs
    bodies: Records  # (T,) of BodyStatus
    wrench: Floats  # (T, 6) N and N m about the tool's origin: the haptic output
    body_pose: Floats  # (T, 7) m and quaternion xyzw: pose of the body


class State(NamedTuple):
    """Views into the words, with T rigid bodies of tools, n nodes and C contact points."""

    words: Longs  # all that follows
    results: Longs  # the words of Results
    shape: Longs  # the words of shape_tick, carried and position
    status: Status
    count: Counts  # type: ignore[assignment]  # hides the tuple's method, which nobody needs
    bodies: Records  # (T,) of BodyStatus
    wrench: Floats  # (T, 6) N and N m about the tool's origin: the haptic output
    body_pose: Floats  # (T, 7) m and quaternion xyzw: pose of the body
    shape_tick: Longs  # (1,) tick of the positions that were posted last
    carried: Floats  # (3,) m, displacement of the clamp by breathing; positions are in the clamp's frame
    position: Floats  # (n, 3) m
    velocity: Floats  # (n, 3) m/s
    good_position: Floats  # (n, 3) m, last valid shape, at most KEEP_EVERY ticks old
    nodal_force: Floats  # (n, 3) N, for the coming tick
    contact_impulse: Floats  # (n, 3) N s on the tissue in this tick, kept for the modal region
    static_load: Floats  # (n, 3) N that bends the organ outside a modal region: loads, and its springs' forces
    offset: Floats  # (n, 3) m, error of the reduced model when the region was made
    blend: Floats  # (1,) fraction of the offset that is left
    mode_position: Floats  # (m,) sqrt(kg) m
    mode_velocity: Floats  # (m,) sqrt(kg) m/s
    held_pose: Floats  # (T, 7) pose in which the hand holds it, on its way to the newest pose
    body_goal: Floats  # (T, 7) the newest pose
    body_force: Floats  # (T, 3) N, external force on the tissue at the tool's tip
    unfaded_wrench: Floats  # (T, 6) N and N m, the wrench before it fades with a stale pose
    contact_pressed: Floats  # (2, C) N s along the tool's normal in the last substep; row 1 is a buffer
    contact_held: Floats  # (2, C, 3) N s across it; row 1 is a buffer, within a substep for the total
    loaded_node: Longs  # (n,) the nodes that nodal_force loads in this tick
    is_loaded: Longs  # (n,) 1 for those
    prescribed_node: Longs  # (n,) the nodes whose position is prescribed
    is_prescribed: Longs  # (n,) 1 for those
    prescribed_ticks: Longs  # (n,) until they arrive
    prescribed_from: Floats  # (n, 3) m, present prescribed positions
    prescribed_to: Floats  # (n, 3) m, final ones
    is_turned: Longs  # (c,) 1 for cells of the inside that are inverted
    region_hop: Longs  # (n,) 0 loaded, 1, 2 hops away, -1 outside the local region
    blades: Records  # (S,) of BladeSample
    relaxing: Records  # (1,) of Relaxing; for elastic tissue, this field and the next two are empty
    unrelaxed: Floats  # (n, 3) N that relaxes
    last_elastic: Floats  # (n, 3) N, of the last substep
    contacts: ContactSet  # which points may touch


def _result_fields(n_bodies: int) -> dict[str, Field]:
    return {
        "status": Status,
        "count": Counts,
        "bodies": (BodyStatus, n_bodies),
        "wrench": (np.float64, (n_bodies, 6)),
        "body_pose": (np.float64, (n_bodies, 7)),
    }


def result_words(n_bodies: int) -> int:
    """Return the number of words of Results."""
    return size_of(_result_fields(n_bodies))


def results_in(words: Longs, n_bodies: int) -> Results:
    """Return Results that view words.

    Parameters
    ----------
    words : Longs, shape (result_words(),)
        Memory of the results.
    n_bodies : int
        Number of bodies.
    """
    return Results(**carve(words, _result_fields(n_bodies)))


def make_state(
    n: int, n_bodies: int, n_modes: int = 0, n_cells: int = 0, n_samples: int = 0, relaxes: bool = False
) -> State:
    """Return a state of zeros.

    Parameters
    ----------
    n : int
        Number of nodes.
    n_bodies : int
        Number of bodies.
    n_modes : int, optional
        Number of modes.
    n_cells : int, optional
        Number of cells.
    n_samples : int, optional
        Number of places of blades.
    relaxes : bool, optional
        Whether the tissue relaxes.
    """
    real, whole = np.float64, np.int64
    fields: dict[str, Field] = _result_fields(n_bodies) | {
        "shape_tick": (whole, (1,)),
        "carried": (real, (3,)),
        "position": (real, (n, 3)),
        "velocity": (real, (n, 3)),
        "good_position": (real, (n, 3)),
        "nodal_force": (real, (n, 3)),
        "contact_impulse": (real, (n, 3)),
        "static_load": (real, (n, 3)),
        "offset": (real, (n, 3)),
        "blend": (real, (1,)),
        "mode_position": (real, (n_modes,)),
        "mode_velocity": (real, (n_modes,)),
        "held_pose": (real, (n_bodies, 7)),
        "body_goal": (real, (n_bodies, 7)),
        "body_force": (real, (n_bodies, 3)),
        "unfaded_wrench": (real, (n_bodies, 6)),
        "contact_pressed": (real, (2, MAX_CONTACT_POINTS)),
        "contact_held": (real, (2, MAX_CONTACT_POINTS, 3)),
        "loaded_node": (whole, (n,)),
        "is_loaded": (whole, (n,)),
        "prescribed_node": (whole, (n,)),
        "is_prescribed": (whole, (n,)),
        "prescribed_ticks": (whole, (n,)),
        "prescribed_from": (real, (n, 3)),
        "prescribed_to": (real, (n, 3)),
        "is_turned": (whole, (n_cells,)),
        "region_hop": (whole, (n,)),
        "blades": (BladeSample, n_samples),
        "relaxing": (Relaxing, 1 if relaxes else 0),
        "unrelaxed": (real, (n if relaxes else 0, 3)),
        "last_elastic": (real, (n if relaxes else 0, 3)),
    }
    size, first = size_of(fields), result_words(n_bodies)
    words = np.zeros(size + contact_set_words(n_bodies), dtype=np.int64)
    return State(
        words=words,
        results=words[:first],
        shape=words[first : first + 4 + 3 * n],
        contacts=contact_set(n_bodies, words=words[size:]),
        **carve(words, fields),
    )


def state_like(state: State) -> State:
    """Return a state of zeros of the same size as another one.

    Parameters
    ----------
    state : State
        The other one.
    """
    sizes = len(state.position), len(state.bodies), len(state.mode_position), len(state.is_turned)
    return make_state(*sizes, len(state.blades), len(state.relaxing) > 0)


# Fields of records that older bags don't have; they are 0 then.
_ADDED = tuple(f"bodies.{name}" for name in ("cutting", "recent_force", "recent_speed", "slips", "bearable", "outward"))
# Names in bags that were recorded before fields were renamed, by their present names; accepted for one version.
_RENAMED = {"unfaded_wrench": "felt", "status.oscillating": "shivering", "count.oscillations": "shivers"}
_ONLY_HANDED_OUT = ("words", "results", "shape", "shape_tick")  # a tick doesn't start from these


def fields_of(state: State) -> dict[str, NDArray[Any]]:
    """Return the state's fields by name, as arrays that view it; of the contact points only those in use.

    Parameters
    ----------
    state : State
        The state.
    """
    named = {name: value for name, value in state._asdict().items() if name not in _ONLY_HANDED_OUT}
    points = int(state.contacts.header.points)
    for name, value in named.pop("contacts")._asdict().items():
        if name != "words":
            named[f"contacts.{name}"] = value[:points] if name in PER_POINT else value
    return {name: array_of(value) for name, value in named.items()}


def take_fields(state: State, fields: Mapping[str, NDArray[Any]]) -> None:
    """Copy the fields that fields_of returned for a state of the same size.

    Parameters
    ----------
    state : State
        The state; updated.
    fields : Mapping[str, NDArray[Any]]
        Arrays of the fields, by name.

    Raises
    ------
    ValueError
        When a field doesn't fit; the message names it.
    """
    state.words[:] = 0
    header = fields.get("contacts.header")
    points = (
        0
        if header is None or "points" not in (header.dtype.names or ()) or header.size != 1
        else header["points"].item()
    )
    if not 0 <= points <= MAX_CONTACT_POINTS:
        raise ValueError(f"its state counts {points} contact points; there is room for {MAX_CONTACT_POINTS}")
    state.contacts.header.points = points
    for name, target in fields_of(state).items():
        found = fields.get(name, fields.get(_RENAMED.get(name, "")))
        if found is None and target.size == 0:
            continue  # an older state, without this field
        if found is not None and name.startswith("contacts."):
            found = padded(name.removeprefix("contacts."), found)
        if found is None or found.shape != target.shape:
            raise ValueError(f"its state has a different '{name}': it belongs to another organ or to other tools")
        if target.dtype.names is None:
            if found.dtype.kind not in "iufb":
                raise ValueError(f"its state's '{name}' contains no numbers")
            target[...] = found
            continue
        own = found.dtype.names or ()
        for field in target.dtype.names:
            known = field if field in own else _RENAMED.get(f"{name}.{field}", field)
            if f"{name}.{field}" in _ADDED and known not in own:
                continue
            if known not in own:
                raise ValueError(f"its state has no '{name}.{field}'")
            target[field] = found[known]
