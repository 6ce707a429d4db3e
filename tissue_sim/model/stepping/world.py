"""Changes of a world between ticks: reset, inputs, prescribed nodes."""

from __future__ import annotations

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.data.contact_set import ContactSet
from tissue_sim.model.data.world import World
from tissue_sim.model.elasticity.gravity import add_weight, is_out_of_balance, write_masses
from tissue_sim.model.regions.active_region import leave_region, update_outside
from tissue_sim.model.stepping.inputs import load_nodes, reset_state, take_contacts, take_force, take_pose
from tissue_sim.model.stepping.prescribed import free_nodes, prescribe_nodes
from tissue_sim.model.stepping.relaxation import forget_relaxation
from tissue_sim.model.stepping.rest_recovery import return_rate


@kernel
def reset_world(world: World) -> None:
    """Return to the rest shape, asleep, without tools; the counters continue.

    Parameters
    ----------
    world : World
        World of the organ; updated.
    """
    reset_state(world.model, world.state)


@kernel
def relax_world(world: World) -> None:
    """Relax the tissue at once.

    Parameters
    ----------
    world : World
        World of the organ; updated.
    """
    forget_relaxation(world.state)


@kernel
def update_hidden_nodes(world: World) -> None:
    """Update the nodes outside a modal region.

    Parameters
    ----------
    world : World
        World of the organ; updated.
    """
    update_outside(world.model, world.state, world.settings, world.scratch)


@kernel
def is_world_out_of_balance(world: World) -> bool:
    """Return whether a load that the rest shape doesn't balance acts on the organ.

    Parameters
    ----------
    world : World
        World of the organ.
    """
    return is_out_of_balance(world.model, world.settings)


@kernel
def add_weight_of_world(world: World, force: Floats) -> None:
    """Add the nodes' weight.

    Parameters
    ----------
    world : World
        World of the organ; updated.
    force : Floats, shape (n, 3), N
        Forces on the nodes; updated.
    """
    mass = world.scratch.mass
    write_masses(world.model, mass)
    add_weight(world.model, world.settings, mass, force)


@kernel
def return_rate_of_world(world: World) -> float:
    """Return the rate at which the organ returns after its release, see `rest_recovery.return_rate`.

    Parameters
    ----------
    world : World
        World of the organ.

    Returns
    -------
    float, 1/s
        The rate.
    """
    return return_rate(world.model, world.settings)


@kernel
def load_world(world: World, nodes: Longs, forces: Floats) -> None:
    """Add forces to nodes for the coming tick.

    Parameters
    ----------
    world : World
        World of the organ; updated.
    nodes : Longs, shape (k,)
        Indices of the nodes.
    forces : Floats, shape (k, 3), N
        Force on each.
    """
    load_nodes(world.state, nodes, forces)


@kernel
def prescribe_world(world: World, nodes: Longs, positions: Floats, ticks: int) -> None:
    """Move nodes to positions within some ticks, from the next one on, and hold them there.

    The whole organ moves from here on, from where the region and the rest of it are.

    Parameters
    ----------
    world : World
        World of the organ; updated.
    nodes : Longs, shape (k,)
        Indices of the nodes.
    positions : Floats, shape (k, 3), m
        Where each goes.
    ticks : int
        Number of ticks that this takes.
    """
    if not world.state.status.asleep:
        leave_region(world.model, world.state, world.settings, world.scratch)
    prescribe_nodes(world.state, nodes, positions, ticks)


@kernel
def free_world(world: World) -> None:
    """Release prescribed nodes.

    Parameters
    ----------
    world : World
        World of the organ; updated.
    """
    free_nodes(world.model, world.state)


@kernel
def pose_world(world: World, body: int, pose: Floats, stamp: int, sequence: int) -> None:
    """Apply a body's newest pose.

    Parameters
    ----------
    world : World
        World of the organ; updated.
    body : int
        Index of the body.
    pose : Floats, shape (7,), m and quaternion xyzw
        The pose.
    stamp : int, ns
        Its time; 0 where it has none.
    sequence : int
        Number of the pose.
    """
    take_pose(world, body, pose, stamp, sequence)


@kernel
def push_world(world: World, body: int, force: Floats, sequence: int) -> None:
    """Apply the newest external force at a body's tip.

    Parameters
    ----------
    world : World
        World of the organ; updated.
    body : int
        Index of the body.
    force : Floats, shape (3,), N
        The force.
    sequence : int
        Number of the force.
    """
    take_force(world.state, body, force, sequence)


@kernel
def touch_world(world: World, found: ContactSet, sequence: int) -> None:
    """Apply a contact set.

    Parameters
    ----------
    world : World
        World of the organ; updated.
    found : ContactSet
        The contact set.
    sequence : int
        Number of the set.
    """
    take_contacts(world.state, world.shapes, found, sequence)
