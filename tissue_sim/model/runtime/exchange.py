"""Replacement of an organ's arrays between two ticks of a running loop by arrays of another size, after a cut.

Python makes the new arrays in parallel to the loop, with a plan of the words to be copied. The loop reads the arrays
after one tick, copies these words before the next, and continues with the new arrays: it takes no lock, allocates
nothing, and the tick that does it takes some microseconds longer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.handles import HandleRow, row
from tissue_sim.jit import kernel
from tissue_sim.model.cutting.carry import CarryPlan, carry
from tissue_sim.model.data.records import Record
from tissue_sim.model.data.state import State
from tissue_sim.model.data.world import World
from tissue_sim.model.elasticity.forces import elastic_forces
from tissue_sim.model.runtime.mailboxes import Mailboxes, mailbox
from tissue_sim.model.stepping.contact_pairs import renew_surface
from tissue_sim.model.stepping.coupled_step import CoupledOrgans


class ExchangeWords(Record):
    """Words shared by the loop and Python, each written by one of them."""

    asked: int  # raised when new arrays are available
    loaded: int  # `asked` of the last arrays that the loop has preloaded
    done: int  # `asked` of the last arrays, after the first tick with them
    organ: int  # to which they belong
    tick: int  # that first tick
    coarse_square: float  # see joined.ExchangePlan
    added: float
    version: int


class Exchange(NamedTuple):
    """New arrays with which the loop continues; rows of one handle each, whose places Python renews."""

    words: ExchangeWords
    lightness: Floats  # (l,) see joined.ExchangePlan
    worlds: Any
    boxes: Any
    next_world: Longs  # (1,) place of the new world in `worlds`
    next_box: Longs  # (1,)
    world_places: Longs  # (k,) of the organs in the loop's own rows
    box_places: Longs  # (k,)


def boxes_after(before: Mailboxes, state: State, plan: CarryPlan) -> Mailboxes:
    """Return the mailboxes of an organ for a state of another size; those for its inputs remain the same.

    Parameters
    ----------
    before : Mailboxes
        The mailboxes in use.
    state : State
        The new state.
    plan : CarryPlan
        How the new state continues the one in use.
    """
    return before._replace(shape=mailbox(len(state.shape)), snapshot=state.words.copy(), carry=plan)


def make_exchange(worlds: HandleRow, boxes: HandleRow, world: Any, box: Any, links: int) -> Exchange:
    """Return the exchange of a loop before its first use.

    Parameters
    ----------
    worlds : HandleRow
        The loop's row of worlds.
    boxes : HandleRow
        The loop's row of mailboxes.
    world : Any
        Handle of any world, which stands for the first new one.
    box : Any
        Handle of any mailboxes.
    links : int
        Number of links between the organs.
    """
    next_worlds, next_boxes = row([world]), row([box])
    places = next_worlds.places, next_boxes.places, worlds.places, boxes.places
    return Exchange(ExchangeWords.new(), np.zeros(links), next_worlds, next_boxes, *places)


@kernel
def preload(world: World) -> None:
    """Compute the forces of new arrays once, so that the first tick with them finds them in the cache.

    Parameters
    ----------
    world : World
        The new arrays; their working memory is updated.
    """
    elastic_forces(world.model, world.state.position, world.settings.stiffness_scale, world.scratch.force)


@kernel
def take_exchange(
    worlds: Sequence[World], boxes: Sequence[Mailboxes], joined: CoupledOrgans | None, exchange: Exchange
) -> None:
    """Continue with the new arrays of an organ.

    Parameters
    ----------
    worlds : Sequence[World]
        Worlds of the organs; updated.
    boxes : Sequence[Mailboxes]
        Mailboxes of the organs; updated.
    joined : CoupledOrgans | None
        What joins them; updated.
    exchange : Exchange
        The new arrays.
    """
    organ = exchange.words.organ
    before, after, box = worlds[organ].state, exchange.worlds[0].state, exchange.boxes[0]
    carry(before.words, after.words, box.carry)
    exchange.worlds[0].scratch.stale[0] = 1
    box.shape.sequence[0] = boxes[organ].shape.sequence[0]  # readers compare it
    exchange.world_places[organ] = exchange.next_world[0]
    exchange.box_places[organ] = exchange.next_box[0]
    box.demand.moved = True
    if joined is not None:
        joined.coarse.square[organ] = exchange.words.coarse_square
        joined.links.added[0] = exchange.words.added
        renew_surface(joined.pairs, organ, exchange.words.version)
        for link in range(len(exchange.lightness)):
            joined.links.lightness[link] = exchange.lightness[link]
    exchange.words.tick = after.status.tick + 1
