"""Presses, strokes and holds in a stream of tool poses and forces: approach, contact, deepest, release."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats, Longs, Mask
from tissue_sim.errors import UserError
from tissue_sim.identification.measured import Hold, MeasuredPress, MeasuredStroke, Measurement, Sinusoid
from tissue_sim.identification.sinusoids import cycles_of
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.surfaces.surface_distance import distance_to_surface
from tissue_sim.organ.winding import inside

FREE, NEAR = 2e-3, 0.8e-3  # m before the surface at rest: no contact is possible, a press begins
LEAST_DEPTH = 0.3e-3  # m, of a press
MOST_SAMPLES = 24  # of a press; more are averaged by depth
DEEP = 0.96  # of the largest depth, from which a press has ended, and a hold lasts
STRAIGHT = 0.7  # cosine between a press and the inward normal at the least
ASIDE, SLANT = 0.3e-3, 0.1  # m, and of the depth, by which a press leaves the line of its approach at most
STILL = 0.3e-3  # m, by which the tool moves aside in a hold at most
SLID = 3e-3  # m, length of a stroke at the least
RUN_IN = 1.5e-3  # m of a stroke until everything slides
SLIDING = 0.3  # of a stroke's largest speed, below which it doesn't count


class Stream(NamedTuple):
    """Samples of a tool: time (k,) s, its middle (k, 3) m, force on it (k, 3) N, in the organ's axes; its source."""

    source: str
    time: Floats
    positions: Floats
    forces: Floats


class _Contact(NamedTuple):
    """Samples from approach to release, the one at which the press ends, and normals (k, 3) of the surface."""

    stream: Stream
    depth: Floats
    deepest: int
    normal: Floats


def found_in(stream: Stream, organ: Organ, radius: float) -> Measurement:
    """Return the presses, strokes, holds and sinusoids of a stream.

    The mean force while the tool can't touch is taken for the sensor's bias and is subtracted.

    Parameters
    ----------
    stream : Stream
        The samples.
    organ : Organ
        The organ at rest.
    radius : float, m
        Radius of the tool.

    Raises
    ------
    UserError
        For a stream that is unordered, that never touches the organ, or whose forces point into it.
    """
    if len(stream.time) < 2 or (np.diff(stream.time) < 0.0).any():
        raise UserError(f"{stream.source}: its times do not increase")
    depth = depths_in(organ, stream.positions, radius)
    free = depth < -FREE
    if free.any():
        stream = stream._replace(forces=stream.forces - np.median(stream.forces[free], axis=0))
    tree, normals = cKDTree(organ.surface_positions), organ.surface_normals
    presses: list[MeasuredPress] = []
    strokes: list[MeasuredStroke] = []
    holds: list[Hold] = []
    sinusoids: list[Sinusoid] = []
    for number, own in enumerate(_runs(depth > -NEAR), start=1):
        if depth[own].max() < LEAST_DEPTH:
            continue
        some = Stream(stream.source, *(array[own] for array in stream[1:]))
        contact = _Contact(
            some,
            depth[own],
            int(np.argmax(depth[own] >= DEEP * depth[own].max())),
            normals[tree.query(some.positions)[1]],
        )
        press = _press(f"press {number}", contact)
        if press is not None:
            presses.append(press)
            holds += _hold(press, contact)
            sinusoids += _sinusoid(press, contact)
        strokes += _stroke(f"stroke {number}", contact)
    if not presses:
        raise UserError(
            f"{stream.source}: no press was found: the tool comes at most {1e3 * depth.max():.1f} mm deep into the"
            f" surface of organ '{organ.name}' at rest. Are its poses in the organ's axes, and in metres?"
        )
    if np.median([press.forces[-1] for press in presses]) < 0.0:
        raise UserError(
            f"{stream.source}: forces point into the tissue; those on the tool are needed: use --negate for the"
            " tool's force on the tissue"
        )
    return Measurement(stream.source, radius, presses, strokes, holds, True, sinusoids)


def depths_in(organ: Organ, positions: Floats, radius: float) -> Floats:
    """Return how deep a ball at positions (k, 3) m lies in an organ's surface at rest, (k,) m; negative outside."""
    away = distance_to_surface(positions, organ.surface_positions, organ.surface_triangles)
    within = np.zeros(len(positions), dtype=bool)
    low, high = organ.surface_positions.min(axis=0), organ.surface_positions.max(axis=0)
    boxed = ((positions >= low) & (positions <= high)).all(axis=1)
    if boxed.any():
        within[boxed] = inside(positions[boxed], organ.surface_positions, organ.surface_triangles)
    return np.asarray(radius - np.where(within, -away, away))


def _runs(chosen: Mask) -> Iterator[slice]:
    """Yield the runs of samples that are chosen."""
    edges = np.diff(np.concatenate([[0], chosen.astype(np.int8), [0]]))
    for begin, end in zip(np.flatnonzero(edges > 0), np.flatnonzero(edges < 0), strict=True):
        yield slice(int(begin), int(end))


def _deepest(positions: Floats, depth: Floats) -> int:
    """Return the first sample at the largest depth that is reached before the tool leaves its line of approach."""
    moved = positions - positions[0]
    direction = moved[int(np.argmax(depth >= min(0.0, depth.max())))]
    direction = direction / max(float(np.linalg.norm(direction)), 1e-12)
    along = moved @ direction
    aside = np.linalg.norm(moved - along[:, None] * direction, axis=1) > ASIDE + SLANT * np.abs(along)
    count = max(1, int(np.argmax(aside)) if aside.any() else len(depth))
    return int(np.argmax(depth[:count] >= DEEP * depth[:count].max()))


def _press(name: str, contact: _Contact) -> MeasuredPress | None:
    """Return the press that a contact begins with; None where the tool came in sideways."""
    last, places = contact.deepest + 1, contact.stream.positions
    if last < 3:
        return None
    direction = places[last - 1] - places[0]
    length = float(np.linalg.norm(direction))
    direction = direction / max(length, 1e-12)
    if length < LEAST_DEPTH or -direction @ contact.normal[last - 1] < STRAIGHT:
        return None
    along = (places[:last] - places[0]) @ direction
    touched = float(along[int(np.argmax(contact.depth[:last] >= 0.0))])
    drift = places[:last] - places[0] - along[:, None] * direction
    spent = float(contact.stream.time[last - 1] - contact.stream.time[0])
    forces = -contact.stream.forces[:last] @ direction
    group = np.minimum((along / length * MOST_SAMPLES).astype(np.int64), MOST_SAMPLES - 1)
    depths, forces, drift = (_means(values, group) for values in (along - touched, forces, drift))
    return MeasuredPress(
        name, depths, forces, places[0] + touched * direction, direction, drift, length / max(spent, 1e-6)
    )


def _means(values: Floats, group: Longs) -> Floats:
    """Return the means of values (k, ...) of each group (k,) that has any."""
    return np.array([values[group == one].mean(axis=0) for one in np.unique(group)])


def _along(press: MeasuredPress, contact: _Contact) -> tuple[Floats, Floats]:
    """Return depths (k,) m along the direction of a press, and forces (k,) N against it, of its whole contact."""
    return (contact.stream.positions - press.place) @ press.direction, -contact.stream.forces @ press.direction


def _hold(press: MeasuredPress, contact: _Contact) -> list[Hold]:
    """Return the hold at a press's deepest place, if there is one."""
    after = slice(contact.deepest, None)
    places = contact.stream.positions[after]
    left = (contact.depth[after] < DEEP * contact.depth[contact.deepest]) | (
        np.linalg.norm(places - places[0], axis=1) > STILL
    )
    count = int(np.argmax(left)) if left.any() else len(left)
    if count < 2:
        return []
    own = slice(None, contact.deepest + count)
    depths, forces = _along(press, contact)
    time = contact.stream.time - contact.stream.time[contact.deepest]
    return [Hold(press.name, time[own], depths[own], forces[own])]


def _sinusoid(press: MeasuredPress, contact: _Contact) -> list[Sinusoid]:
    """Return the sinusoid in a press's contact, if there is one."""
    depths, forces = _along(press, contact)
    time = contact.stream.time
    own = cycles_of(time, depths, contact.deepest)
    return [] if own is None else [Sinusoid(press.name, time[own] - time[own][0], depths[own], forces[own])]


def _stroke(name: str, contact: _Contact) -> list[MeasuredStroke]:
    """Return the stroke after a contact's deepest place, if there is one."""
    own = slice(contact.deepest, None)
    stream, normal = Stream("", *(array[own] for array in contact.stream[1:])), contact.normal[own]
    deep = contact.depth[own] > 0.5 * contact.depth.max()
    step = np.gradient(stream.positions, axis=0) if len(stream.time) > 2 else np.zeros((len(stream.time), 3))
    step = step - np.einsum("kx,kx->k", step, normal)[:, None] * normal
    length = np.linalg.norm(step, axis=1)
    travelled = np.cumsum(np.where(deep, length, 0.0))
    fast = deep & (travelled > RUN_IN) & (length > SLIDING * length.max(initial=0.0))
    if travelled[-1] < SLID or not fast.any():
        return []
    force = stream.forces[fast]
    pushing = np.einsum("kx,kx->k", force, normal[fast])
    against = -np.einsum("kx,kx->k", force, step[fast] / length[fast, None])
    touching = pushing > 0.0
    return [MeasuredStroke(name, pushing[touching], against[touching], float(travelled[-1]))] if touching.any() else []
