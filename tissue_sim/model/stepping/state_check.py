"""Checks of states and contact sets from files, whose indices kernels use without checking bounds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.model.data.contact_set import MAX_CONTACT_POINTS, ContactSet, Engaged, contact_set, padded
from tissue_sim.model.data.records import array_of
from tissue_sim.model.data.settings import Integrator, LocalRegion, Settings
from tissue_sim.model.data.state import Fault, Region, State, fields_of
from tissue_sim.model.stepping.critical_step import MAX_SUBSTEPS
from tissue_sim.model.stepping.inputs import MAX_BACKOFF

MAX_NUMBER = 1e15  # largest number in a state; computations with larger ones overflow


def check_state(state: State) -> None:
    """Check that the numbers of a state are finite and its indices in range.

    Parameters
    ----------
    state : State
        The state.

    Raises
    ------
    ValueError
        When a field is invalid; the message names it.
    """
    n, n_cells, status = len(state.position), len(state.is_turned), state.status
    _check_finite(fields_of(state))
    _check_contacts(state.contacts, n)
    listed = {
        "loaded": (state.loaded_node, state.is_loaded),
        "prescribed": (state.prescribed_node, state.is_prescribed),
    }
    for name, (nodes, marks) in listed.items():
        count = int(getattr(status, name))
        if not 0 <= count <= n:
            raise ValueError(f"its state counts {count} {name} nodes of {n}")
        chosen = nodes[:count]
        _check_index(f"{name}_node", chosen, n)
        if not np.array_equal(np.flatnonzero(marks), np.sort(chosen)):
            raise ValueError(f"its state's {name}_node and is_{name} don't match")
    ranges = {
        "backoff": (1, MAX_BACKOFF),
        "region": (0, len(Region) - 1),
        "fault_kind": (0, len(Fault) - 1),
        "next_cell": (0, n_cells),
        "region_nodes": (0, n),
        "region_boundary": (0, n),
        "turned": (0, n_cells),
        "tick": (0, 2**62),
    }
    for name, (least, most) in ranges.items():
        if not least <= getattr(status, name) <= most:
            raise ValueError(f"its state's {name} is {getattr(status, name)}, outside {least}..{most}")


def check_settings(settings: Settings) -> None:
    """Check that every setting is in the range of a node's parameters.

    Parameters
    ----------
    settings : Settings
        Settings of the simulation.

    Raises
    ------
    ValueError
        When a setting is out of range; the message names it.
    """
    for name in Settings.dtype.names or ():
        value = getattr(settings, name)
        if not abs(float(value)) <= MAX_NUMBER:
            raise ValueError(f"its setting {name} is {value}")
    ranges = {
        "tick_time": (1e-5, 1.0),
        "substeps": (1, MAX_SUBSTEPS),
        "region_substeps": (0, MAX_SUBSTEPS),
        "integrator": (0, len(Integrator) - 1),
        "local_region": (0, len(LocalRegion) - 1),
        "stiffness_scale": (0.0, MAX_NUMBER),
        "damping_scale": (0.0, MAX_NUMBER),
        "friction": (0.0, MAX_NUMBER),
    }
    for name, (least, most) in ranges.items():
        if not least <= getattr(settings, name) <= most:
            raise ValueError(f"its setting {name} is {getattr(settings, name)}, outside {least:g}..{most:g}")


def contact_set_of(fields: Mapping[str, NDArray[Any]], n_bodies: int, n_nodes: int) -> ContactSet:
    """Return a contact set from its fields.

    Parameters
    ----------
    fields : Mapping[str, NDArray[Any]]
        Arrays of the fields, by name.
    n_bodies : int
        Number of bodies.
    n_nodes : int
        Number of nodes.

    Raises
    ------
    ValueError
        When a field doesn't fit; the message names it.
    """
    body = fields.get("body")
    points = len(body) if body is not None and body.ndim else -1
    if not 0 <= points <= MAX_CONTACT_POINTS:
        raise ValueError(f"a contact set has no points, or more than {MAX_CONTACT_POINTS}")
    made = contact_set(n_bodies, points)
    for name, value in made._asdict().items():
        if name == "words":
            continue
        target, found = array_of(value), fields.get(name)
        found = None if found is None else padded(name, found)
        if found is None or found.shape != target.shape or found.dtype.names != target.dtype.names:
            raise ValueError(f"a contact set has a different '{name}'")
        if target.dtype.names is None and found.dtype.kind not in "iuf":
            raise ValueError(f"a contact set's '{name}' contains no numbers")
        target[...] = found
    _check_finite({name: array_of(value) for name, value in made._asdict().items()})
    _check_contacts(made, n_nodes)
    return made


def _check_contacts(found: ContactSet, n_nodes: int) -> None:
    points = int(found.header.points)
    if not 0 <= points <= len(found.body):
        raise ValueError(f"a contact set counts {points} points of {len(found.body)}")
    _check_index("body of a contact point", found.body[:points], len(found.engaged))
    _check_index("node of a contact point", found.node[:points], n_nodes)
    if not np.isin(found.engaged, list(Engaged)).all() or found.reach.min(initial=0.0) < 0.0:
        raise ValueError("a contact set has an invalid body, or a negative reach")
    if min(found.compliance[:points].min(initial=0.0), found.most_give[:points].min(initial=0.0)) < 0.0:
        raise ValueError("a contact point has a negative compliance")
    tips = found.tip_node
    _check_index("node under a tip", tips[tips != -1], n_nodes)
    if np.any((tips == -1).any(axis=1) != (tips == -1).all(axis=1)):
        raise ValueError("a contact set names an incomplete point under a tip")


def _check_index(name: str, values: NDArray[Any], count: int) -> None:
    if values.size and (values.min() < 0 or values.max() >= count):
        raise ValueError(f"its {name} is outside 0..{count - 1}")


def _check_finite(fields: Mapping[str, NDArray[Any]]) -> None:
    for name, values in fields.items():
        parts = {name: values} if values.dtype.names is None else {f"{name}.{k}": values[k] for k in values.dtype.names}
        for part, numbers in parts.items():
            if numbers.dtype.kind == "f" and numbers.size and not np.abs(numbers).max() <= MAX_NUMBER:
                raise ValueError(f"its '{part}' contains numbers that are not finite, or beyond {MAX_NUMBER:g}")
