"""A cut simulation as parts that can be sent to another process, and put together there without computing anything."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.contact.touched_surface import TouchedSurface
from tissue_sim.model.cutting.sheet import Sheet
from tissue_sim.model.data.blocks import aligned
from tissue_sim.model.data.records import words_of
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.data.state import make_state
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.scratch import make_scratch

Parts = dict[str, object]  # of a simulation, by the names of its attributes
SomeCut = tuple[Floats, Floats, float] | tuple[Sheet]  # arguments of Simulation.prepared_cut, or of prepared_sheet


class Prepared(NamedTuple):
    """A simulation that a loop is to go on with, and what else takes a while to make of it."""

    simulation: Simulation
    surface: TouchedSurface  # that tools touch
    file: bytes  # of its organ

    @classmethod
    def of(cls, simulation: Simulation) -> Self:
        """Return what goes with a simulation."""
        return cls(simulation, TouchedSurface.of(simulation), simulation.organ.to_bytes())


_MEMORY = ("settings", "state", "scratch", "world")  # that kernels share


def parts_of(simulation: Simulation) -> Parts:
    """Return what a simulation consists of, without its memory: its state, which may be changing, is left out.

    Returns values by name, which `pickle` takes.
    """
    kept = {name: value for name, value in vars(simulation).items() if name not in _MEMORY}
    return kept | {"settings": words_of(simulation.settings).copy()}


def simulation_of(parts: Parts) -> Simulation:
    """Return a simulation at rest. parts: what it consists of, as parts_of has it."""
    made = Simulation.__new__(Simulation)
    vars(made).update(parts)
    made.settings = Settings.new()
    words_of(made.settings)[:] = np.asarray(parts["settings"])
    made.model = _in_lines(made.model)
    model, n_bodies = made.model, len(made.shapes.kind)
    samples, relaxes = len(made.shapes.blades.body), len(model.relaxation) > 0
    sizes = len(model.reduction.frequency), len(model.cells), samples
    made.state = make_state(len(model.rest), n_bodies, *sizes, relaxes)
    made.scratch = make_scratch(model, n_bodies, samples)
    made.refer()
    made.reset()
    return made


def _in_lines[Values: tuple](values: Values) -> Values:
    """Return a NamedTuple whose arrays, and those of NamedTuples in it, begin at lines of the cache."""
    parts = (_in_lines(one) if isinstance(one, tuple) else one for one in values)
    return type(values)(*(aligned(one) if type(one) is np.ndarray else one for one in parts))
