"""All data of a tick as one argument, which is passed at no cost."""

from __future__ import annotations

from typing import NamedTuple

from tissue_sim.array_types import Longs
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.records import words_of
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.data.shapes import Shapes
from tissue_sim.model.data.state import State


class World(NamedTuple):
    """Arguments of the kernels; passed by reference (tissue_sim.handles.handle)."""

    model: Model
    state: State
    shapes: Shapes
    settings: Settings
    settings_words: Longs  # memory of the settings
    scratch: Scratch


def make_world(model: Model, state: State, shapes: Shapes, settings: Settings, scratch: Scratch) -> World:
    """Return the data of a tick as one argument.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    shapes : Shapes
        Shapes of the bodies.
    settings : Settings
        Settings of the simulation.
    scratch : Scratch
        Working memory; updated.
    """
    return World(model, state, shapes, settings, words_of(settings), scratch)
