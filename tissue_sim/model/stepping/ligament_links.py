"""Links: springs that pull and never push, between two organs, or an organ and a point; they form ligaments.

Organs that links join take their substeps together, and the force of each link is updated in every substep, as for
springs in an organ. The force on one end is the opposite of that on the other, except for the part that is left out
(`wake_threshold`), which the organ's clamp bears. `least_substeps` gives the number of substeps that links need.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.data.links import Links
from tissue_sim.model.data.world import World
from tissue_sim.model.stepping.breathing import Carried
from tissue_sim.model.stepping.critical_step import substeps_for
from tissue_sim.model.stepping.inputs import load_node
from tissue_sim.model.stepping.wake_threshold import WakeThreshold

STRETCH_ROUNDING = 1e-12  # m, stretch of a link that is rounding only, and would keep organs at rest awake


def compute_link_bounds(links: Links, inverse_mass: Sequence[Floats]) -> None:
    """Compute the bound of links on the step from the inverse masses of their ends.

    The square of the largest frequency of organs and links together is at most the sum of both (Weyl); the part of the
    links is bounded by Gershgorin's circles.

    Parameters
    ----------
    links : Links
        The links; updated.
    inverse_mass : Sequence[Floats], shape (n,) each, 1/kg
        Inverse masses of every organ's nodes, 0 where they are held.
    """
    light, load = np.zeros(links.organ.shape), np.zeros(links.organ.shape)
    for organ, inverse in enumerate(inverse_mass):
        of_it = links.organ == organ
        nodes = links.node[of_it]
        light[of_it] = inverse[nodes]
        load[of_it] = np.bincount(nodes, minlength=len(inverse))[nodes]
    links.lightness[:] = (light * load).sum(axis=1)
    row = links.stiffness[:, None] * np.sqrt(light) * np.sqrt(light).sum(axis=1, keepdims=True)  # of each end's circle
    most = 0.0
    for organ, inverse in enumerate(inverse_mass):
        of_it = links.organ == organ
        most = max(most, float(np.bincount(links.node[of_it], row[of_it], len(inverse)).max(initial=0.0)))
    links.added[0] = most


def least_substeps(links: Links, frequency: float, tick_time: float) -> int:
    """Return the number of substeps of a tick that links require.

    Parameters
    ----------
    links : Links
        The links.
    frequency : float, rad/s
        Largest frequency of the organs.
    tick_time : float, s
        Duration of a tick.

    Returns
    -------
    int
        The number; 0 without links.
    """
    if not len(links.slack):
        return 0
    return substeps_for(tick_time, 2.0 / math.sqrt(frequency**2 + links.added[0]))


@kernel
def measure_links(
    worlds: Sequence[World], carried: Carried, links: Links, threshold: WakeThreshold, awake: Longs, step: float
) -> None:
    """Compute the forces of links at the beginning of a tick, and their size for every organ.

    The results are written to links.force, threshold.tension and threshold.displacement; no node is loaded. Links of
    sleeping organs are included, those of released ones aren't.

    Parameters
    ----------
    worlds : Sequence[World]
        Worlds of the organs.
    carried : Carried
        How organs follow the breath.
    links : Links
        The links; updated.
    threshold : WakeThreshold
        Sizes of the loads; updated.
    awake : Longs, shape (k,)
        1 for organs that this tick advances.
    step : float, s
        Duration of the tick.
    """
    for organ in range(len(worlds)):
        threshold.tension[organ] = threshold.displacement[organ] = 0.0
    for link in range(len(links.slack)):
        force = links.force[link]
        force[0] = force[1] = force[2] = 0.0
        if is_there(worlds, links, link, 0, awake) and is_there(worlds, links, link, 1, awake):
            force[0], force[1], force[2] = tension_of(worlds, carried, links, link, step)
            size = math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
            for end in range(2):
                organ = links.organ[link, end]
                if organ >= 0:
                    threshold.tension[organ] += size
                    threshold.displacement[organ] += threshold.link_compliance[link, end] * size


@kernel
def load_links(worlds: Sequence[World], links: Links, threshold: WakeThreshold) -> None:
    """Load the nodes of links with the forces that act on their organs, so that the next tick advances these.

    Parameters
    ----------
    worlds : Sequence[World]
        Worlds of the organs; updated.
    links : Links
        The links.
    threshold : WakeThreshold
        Fractions that organs feel.
    """
    for link in range(len(links.slack)):
        force = links.force[link]
        if force[0] != 0.0 or force[1] != 0.0 or force[2] != 0.0:
            load_end(worlds, links, link, 0, threshold.fraction, (force[0], force[1], force[2]))
            load_end(worlds, links, link, 1, threshold.fraction, (-force[0], -force[1], -force[2]))


@kernel
def pull_links(
    worlds: Sequence[World], carried: Carried, links: Links, threshold: WakeThreshold, awake: Longs, step: float
) -> None:
    """Update the forces of links of organs that this tick advances in a substep.

    A link to a sleeping organ only pulls at its other end; a link that wasn't taut at the beginning of this tick waits
    for the next one, which may wake the organ.

    Parameters
    ----------
    worlds : Sequence[World]
        Worlds of the organs; updated.
    carried : Carried
        How organs follow the breath.
    links : Links
        The links; updated.
    threshold : WakeThreshold
        Fractions that organs feel.
    awake : Longs, shape (k,)
        1 for organs that this tick advances.
    step : float, s
        Duration of the substep.
    """
    for link in range(len(links.slack)):
        first, second, force = is_awake(links, link, 0, awake), is_awake(links, link, 1, awake), links.force[link]
        if not (first or second):
            continue
        all_move = (first or links.organ[link, 0] < 0) and (second or links.organ[link, 1] < 0)
        if not all_move and force[0] == 0.0 and force[1] == 0.0 and force[2] == 0.0:
            continue
        x, y, z = tension_of(worlds, carried, links, link, step)
        x, y, z = x - force[0], y - force[1], z - force[2]
        if x != 0.0 or y != 0.0 or z != 0.0:
            force[0] += x
            force[1] += y
            force[2] += z
            if first:
                load_end(worlds, links, link, 0, threshold.fraction, (x, y, z))
            if second:
                load_end(worlds, links, link, 1, threshold.fraction, (-x, -y, -z))


@kernel
def tension_of(
    worlds: Sequence[World], carried: Carried, links: Links, link: int, step: float
) -> tuple[float, float, float]:
    """Return the force of a link on its first end in a substep of `step` s, N."""
    x0, y0, z0 = end_position(worlds, carried, links, link, 0)
    x1, y1, z1 = end_position(worlds, carried, links, link, 1)
    x, y, z = x1 - x0, y1 - y0, z1 - z0
    length = math.sqrt(x * x + y * y + z * z)
    stretch = length - links.slack[link]
    if stretch <= STRETCH_ROUNDING or length <= 0.0:
        return 0.0, 0.0, 0.0
    x, y, z = x / length, y / length, z / length
    vx0, vy0, vz0 = end_speed(worlds, carried, links, link, 0)
    vx1, vy1, vz1 = end_speed(worlds, carried, links, link, 1)
    rate = x * (vx1 - vx0) + y * (vy1 - vy0) + z * (vz1 - vz0)
    damping = links.damping[link]
    # The damping is implicit in the motion of the link's own nodes, which it must not reverse.
    damping /= 1.0 + step * damping * links.lightness[link]
    tension = max(0.0, links.stiffness[link] * stretch + damping * rate)
    return tension * x, tension * y, tension * z


@kernel
def is_awake(links: Links, link: int, end: int, awake: Longs) -> bool:
    """Return whether an end is at an organ that this tick advances."""
    organ = links.organ[link, end]
    return organ >= 0 and awake[organ] == 1


@kernel
def is_there(worlds: Sequence[World], links: Links, link: int, end: int, awake: Longs) -> bool:
    """Return whether an end is a point, or at an organ that is advanced or asleep, but not released."""
    organ = links.organ[link, end]
    return organ < 0 or awake[organ] == 1 or worlds[organ].state.status.asleep


@kernel
def end_position(
    worlds: Sequence[World], carried: Carried, links: Links, link: int, end: int
) -> tuple[float, float, float]:
    """Return the position of an end, m."""
    organ, node = links.organ[link, end], links.node[link, end]
    if organ >= 0:
        state = worlds[organ].state
        position, shift = state.position[node], state.carried
        return position[0] + shift[0], position[1] + shift[1], position[2] + shift[2]
    fraction = links.moves[link, end] * carried.fraction[0]
    point, breath = links.point[link, end], carried.breath
    return point[0] + fraction * breath.x, point[1] + fraction * breath.y, point[2] + fraction * breath.z


@kernel
def end_speed(
    worlds: Sequence[World], carried: Carried, links: Links, link: int, end: int
) -> tuple[float, float, float]:
    """Return the velocity of an end, m/s."""
    organ, node = links.organ[link, end], links.node[link, end]
    if organ >= 0:
        velocity, speed = worlds[organ].state.velocity, carried.speed[organ]
        return velocity[node, 0] + speed[0], velocity[node, 1] + speed[1], velocity[node, 2] + speed[2]
    fraction, breath = links.moves[link, end] * carried.fraction[1], carried.breath
    return fraction * breath.x, fraction * breath.y, fraction * breath.z


@kernel
def load_end(
    worlds: Sequence[World], links: Links, link: int, end: int, fraction: Floats, force: tuple[float, float, float]
) -> None:
    """Add the fraction (k,) of a force, N, that acts on its organ to an end's node for the coming tick."""
    organ = links.organ[link, end]
    if organ >= 0 and fraction[organ] > 0.0:
        part = fraction[organ]
        load_node(worlds[organ].state, links.node[link, end], part * force[0], part * force[1], part * force[2])
