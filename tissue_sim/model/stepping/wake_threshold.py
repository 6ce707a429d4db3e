"""Loads below the wake threshold: ligaments that hardly pull, and breathing that hardly bends an organ.

Such loads would keep an organ awake although they don't change its shape visibly. So each tick bounds their effect on
an organ: the displacement, which is at most the tension of each link times the compliance of its node plus the
acceleration of the frame times the compliance to it, and the force. If the effect is s times as large as
WAKE_DISPLACEMENT and WAKE_FORCE allow, the fraction 1 - 1/s^2 of these loads acts on an organ without other loads, and
none while s is below 1. The part that is left out never exceeds these bounds, shrinks as the loads grow, and never
jumps. An organ that a tool, a hand or another organ loads is awake anyway, and all of these loads act on it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse.linalg import splu

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.contact.tool_motion import has_tip_force
from tissue_sim.model.data.links import Links
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.world import World
from tissue_sim.model.elasticity.gravity import is_out_of_balance
from tissue_sim.model.elasticity.modes import free_axes, stiffness_matrix
from tissue_sim.model.stepping.breathing import Carried, set_frame_gravity

WAKE_DISPLACEMENT = 1e-4  # m, too small to be seen
WAKE_FORCE = 1e-3  # N, too small to be felt
UNBOUNDED = 1e30  # m/N or s^2, where no node is fixed, or there are too many to factorise: no load is left out
MAX_NODES = 8000  # of an organ whose stiffness is factorised, which takes a second
_RIGID = 1e-9  # of the largest pivot; less counts as 0
_TOGETHER = 48  # columns solved for at once


class WakeThreshold(NamedTuple):
    """Bounds on the loads of k organs and l links that are left out, and the results of the last tick."""

    limits: Floats  # (2,) m and N, largest effect of loads that are left out; zeros: none is left out
    frame_compliance: Floats  # (k,) s^2, largest displacement of an organ for each m/s^2 of its frame's acceleration
    link_compliance: Floats  # (l, 2) m/N, largest displacement of an organ for each N at a link's end
    displacement: Floats  # (k,) m, bound on the displacement of each organ by these loads
    tension: Floats  # (k,) N, sum of the tensions of its links
    fraction: Floats  # (k,) fraction of these loads that acts on it
    ticks: Longs  # (k,) ticks that each organ slept under loads that were left out


def wake_threshold_of(models: Sequence[Model], links: Links, directions: Floats, most: float) -> WakeThreshold:
    """Return the bounds for organs whose frames move along given directions.

    The numbers are rounded up to two digits, so that libraries that round differently on another processor give the
    same ones, and replays the same bits.

    Parameters
    ----------
    models : Sequence[Model]
        Models of the organs.
    links : Links
        Links between them.
    directions : Floats, shape (k, 3)
        Directions of the frames, of any length.
    most : float, m
        Largest displacement by loads that are left out; 0: none is left out.
    """
    count = len(models)
    frame_compliance, compliance = np.zeros(count), np.zeros(links.organ.shape)
    for organ, model in enumerate(models if most > 0.0 else ()):
        own = links.organ == organ
        nodes, place = np.unique(links.node[own], return_inverse=True)
        frame_compliance[organ], of_nodes = bounds_of(model, nodes, directions[organ])
        compliance[own] = of_nodes[place]
    return WakeThreshold(
        limits=np.array([most, WAKE_FORCE / WAKE_DISPLACEMENT * most]),
        frame_compliance=frame_compliance,
        link_compliance=compliance,
        displacement=np.zeros(count),
        tension=np.zeros(count),
        fraction=np.ones(count),
        ticks=np.zeros(count, dtype=np.int64),
    )


def bounds_of(model: Model, nodes: Longs, way: Floats) -> tuple[float, Floats]:
    """Return bounds on the displacement of nodes about rest, by acceleration, s^2, and by pulls, m/N.

    The acceleration is along `way` (3,); pulls act on nodes (k,) in any direction. Unknown bounds are UNBOUNDED.
    """
    speed = float(np.linalg.norm(way))
    if not len(nodes) and speed == 0.0:
        return 0.0, np.zeros(0)
    unknown = UNBOUNDED, np.full(len(nodes), UNBOUNDED)
    if len(model.moving) > MAX_NODES:
        return unknown
    free = free_axes(model)
    try:
        stiffness = stiffness_matrix(model)[free][:, free].tocsc()
        factor = splu(stiffness, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError:  # exactly singular
        return unknown
    pivots = factor.U.diagonal()
    if pivots.min() <= _RIGID * pivots.max():
        return unknown
    frame_compliance = 0.0
    if speed > 0.0:
        weight = (way / speed) / model.inverse_mass[model.moving][:, None]
        frame_compliance = float(np.linalg.norm(factor.solve(weight.ravel()).reshape(-1, 3), axis=1).max())
    axis_of = np.full(3 * len(model.rest), -1)
    axis_of[free] = np.arange(len(free))
    compliance = np.zeros(len(nodes))
    moving = np.flatnonzero(model.inverse_mass[nodes] > 0.0)
    for first in range(0, len(moving), _TOGETHER // 3):
        some = moving[first : first + _TOGETHER // 3]
        pulls = np.zeros((len(free), 3 * len(some)))
        pulls[axis_of[3 * nodes[some][:, None] + np.arange(3)].ravel(), np.arange(3 * len(some))] = 1.0
        moved = factor.solve(pulls).reshape(-1, 3, len(some), 3)
        square = np.einsum("nakx,naky->nkxy", moved, moved)
        compliance[some] = np.sqrt(
            np.abs(square).sum(axis=3).max(axis=(0, 2))
        )  # no less than their largest eigenvalues
    return rounded_up(frame_compliance), np.array([rounded_up(one) for one in compliance])


def rounded_up(value: float) -> float:
    """Return a positive number rounded up to two digits, or 0."""
    if value <= 0.0:
        return 0.0
    digit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / digit * (1.0 - 1e-9)) * digit


@kernel
def apply_wake_threshold(worlds: Sequence[World], carried: Carried, threshold: WakeThreshold, breathes: bool) -> None:
    """Compute the fraction of the links' and the breath's loads that acts on each organ, and set the organ's weight.

    Call it after the links have been measured, and after hands and other organs have loaded the nodes.

    Parameters
    ----------
    worlds : Sequence[World]
        Worlds of the organs; updated.
    carried : Carried
        How organs follow the breath.
    threshold : WakeThreshold
        The bounds; updated.
    breathes : bool
        Whether there is a breath.
    """
    for organ in range(len(worlds)):
        world = worlds[organ]
        settings = world.settings
        if breathes:
            set_frame_gravity(settings, carried, organ, 0.0)
            change = carried.change[organ]
            size = math.sqrt(change[0] ** 2 + change[1] ** 2 + change[2] ** 2)
            threshold.displacement[organ] += size * threshold.frame_compliance[organ]
        threshold.displacement[organ] /= settings.stiffness_scale
        fraction = loaded_fraction(threshold.displacement[organ], threshold.tension[organ], threshold.limits)
        if fraction < 1.0 and is_loaded_otherwise(world):
            fraction = 1.0
        threshold.fraction[organ] = fraction
        if breathes:
            set_frame_gravity(settings, carried, organ, fraction)
        if (
            fraction == 0.0
            and world.state.status.asleep
            and (threshold.displacement[organ] > 0.0 or threshold.tension[organ] > 0.0)
        ):
            threshold.ticks[organ] += 1


@kernel
def loaded_fraction(bent: float, pulled: float, most: Floats) -> float:
    """Return the fraction of loads that acts on an organ; bent m, pulled N, most (2,) that may be left out."""
    if most[0] <= 0.0:
        return 1.0
    size = max(bent / most[0], pulled / most[1])
    return 1.0 - 1.0 / (size * size) if size > 1.0 else 0.0


@kernel
def is_loaded_otherwise(world: World) -> bool:
    """Return whether a hand, a tool, another organ or its own weight keeps an organ awake."""
    state, settings = world.state, world.settings
    status = state.status
    by_tools = status.touching > 0 or has_tip_force(state, settings)
    return by_tools or status.loaded > 0 or status.prescribed > 0 or is_out_of_balance(world.model, settings)
