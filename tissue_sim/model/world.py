"""All that a tick works on, as one argument that costs nothing to pass."""

from __future__ import annotations

from typing import Any, NamedTuple

from tissue_sim.array_types import Longs
from tissue_sim.jit import kernel
from tissue_sim.model.gravity import add_weight, is_out_of_balance
from tissue_sim.model.implied_boundary import lead_return_springs
from tissue_sim.model.inputs import load_nodes, reset_state, take_contacts, take_force, take_pose
from tissue_sim.model.prescribed import free_nodes, prescribe_nodes
from tissue_sim.model.records import words_of
from tissue_sim.model.regions import leave_region, show_region
from tissue_sim.model.rest import pace
from tissue_sim.model.settings import Settings
from tissue_sim.model.tick import tick


class World(NamedTuple):
    """What the kernels take; passed by reference (tissue_sim.handles.handle)."""

    model: Any
    state: Any
    shapes: Any
    settings: Settings
    settings_words: Longs  # what settings views
    scratch: Any


def make_world(model: Any, state: Any, shapes: Any, settings: Settings, scratch: Any) -> World:
    """All that a tick works on."""
    return World(model, state, shapes, settings, words_of(settings), scratch)


@kernel
def tick_world(world: Any) -> None:
    """Advance by one tick."""
    lead_return_springs(world.model, world.state)
    tick(world.model, world.state, world.shapes, world.settings, world.scratch)


@kernel
def reset_world(world: Any) -> None:
    """Back to the rest shape, asleep, without tools; the counters go on."""
    reset_state(world.model, world.state)


@kernel
def show_world(world: Any) -> None:
    """Bring the nodes outside a modal region up to date."""
    show_region(world.model, world.state, world.settings, world.scratch)


@kernel
def is_world_out_of_balance(world: Any) -> bool:
    """Return True when something other than what holds the rest shape pulls at the organ."""
    return is_out_of_balance(world.model, world.settings)


@kernel
def weigh_world(world: Any, force: Any) -> None:
    """Add the nodes' weight to force (n, 3) N."""
    add_weight(world.model, world.settings, force)


@kernel
def pace_of_world(world: Any) -> float:
    """Return how soon the organ is on its way after it was released, 1/s."""
    return pace(world.model, world.settings)


@kernel
def load_world(world: Any, nodes: Any, forces: Any) -> None:
    """Add forces (k, 3) N to nodes (k,) for the coming tick."""
    load_nodes(world.state, nodes, forces)


@kernel
def prescribe_world(world: Any, nodes: Any, positions: Any, ticks: int) -> None:
    """From the next tick on lead nodes (k,) to positions (k, 3) m within so many ticks, and hold them there.

    The whole organ moves from here on, from where the region and the rest of it are.
    """
    if not world.state.status.asleep:
        leave_region(world.model, world.state, world.settings, world.scratch)
    prescribe_nodes(world.state, nodes, positions, ticks)


@kernel
def free_world(world: Any) -> None:
    """Let prescribed nodes go."""
    free_nodes(world.model, world.state)


@kernel
def pose_world(world: Any, body: int, pose: Any, stamp: int, sequence: int) -> None:
    """Take up a body's newest pose (7,); stamp in ns, 0 where it has none."""
    take_pose(world, body, pose, stamp, sequence)


@kernel
def push_world(world: Any, body: int, force: Any, sequence: int) -> None:
    """Take up the newest external force (3,) N at a body's tip."""
    take_force(world.state, body, force, sequence)


@kernel
def touch_world(world: Any, found: Any, sequence: int) -> None:
    """Take up a contact set."""
    take_contacts(world.state, world.shapes, found, sequence)
