"""Copies of a scene, which share everything that never changes: models, tools, and tables of the contact search."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from tissue_sim.array_types import Longs
from tissue_sim.contact.contact_organ import ContactOrgan
from tissue_sim.contact.scene import Scene
from tissue_sim.handles import handle, row
from tissue_sim.model.data.blocks import aligned
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.records import copy_of, words_of
from tissue_sim.model.data.state import state_like
from tissue_sim.model.joined import Joined
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.coupled_step import CoupledOrgans
from tissue_sim.model.stepping.scratch import make_scratch


def copied_scene(scene: Scene) -> Scene:
    """Return an independent scene in the same state.

    Parameters
    ----------
    scene : Scene
        The scene.

    Returns
    -------
    Scene
        The copy. All copies share the contact finders' buffers, so that only one may search at a time.
    """
    made = copy.copy(scene)
    made._painter = None
    made.organs = [_copied_organ(one) for one in scene.organs]
    made.joined = _copied_joined(scene.joined, made.simulations)
    made.pairs_finder = copy.deepcopy(scene.pairs_finder)
    made.origins = scene.origins.copy()
    return made


def _copied_organ(organ: ContactOrgan) -> ContactOrgan:
    return organ.with_simulation(copied_simulation(organ.simulation))


def copied_simulation(simulation: Simulation) -> Simulation:
    """Return an independent simulation in the same state; both share the model's constants.

    Parameters
    ----------
    simulation : Simulation
        The simulation.
    """
    made = copy.copy(simulation)
    made.settings = copy_of(simulation.settings)
    made.model = _with_own_memory(simulation.model)
    made.state = state_like(simulation.state)
    made.state.words[:] = simulation.state.words
    made.scratch = make_scratch(made.model, len(simulation.shapes.kind), len(simulation.shapes.blades.body))
    made.scratch.coarse[:] = simulation.scratch.coarse
    made.forget_scratch()
    made.refer()
    return made


def _with_own_memory(model: Model) -> Model:
    """Return a model with working memory of its own."""
    tissue = model.tissue
    if tissue is not None:
        tissue = tissue._replace(
            rows=aligned(tissue.rows),
            work=aligned(tissue.work),
            compressed_cells=tissue.compressed_cells.copy(),
            stiff=tissue.stiff.copy(),
            shortening=tissue.shortening.copy(),
        )
    return model._replace(work=aligned(model.work), tissue=tissue)


def _copied_joined(joined: Joined, simulations: list[Simulation]) -> Joined:
    made = copy.copy(joined)
    made.simulations = simulations
    made.worlds = row([one.world for one in simulations])
    made.links, made.pairs = _own_arrays(joined.links), _own_arrays(joined.pairs)
    breath = copy_of(joined.carried.breath)
    made.carried = _own_arrays(joined.carried)._replace(breath=breath, breath_words=words_of(breath))
    made.threshold, made.coarse = _own_arrays(joined.threshold), _own_arrays(joined.coarse)
    if not made.alone:
        awake = np.zeros(len(simulations), dtype=np.int64)
        made.handle = handle(CoupledOrgans(made.carried, made.links, made.pairs, made.threshold, made.coarse, awake))
    return made


def _own_arrays(values: Any) -> Any:
    """Return a NamedTuple of arrays and records with copies of them."""
    return type(values)(*(copy_of(one) if isinstance(one, np.record) else one.copy() for one in values))


def memory_of(scene: Scene) -> list[Longs]:
    """Return all words of a scene that change while it is stepped, as arrays that view them.

    Parameters
    ----------
    scene : Scene
        The scene.
    """
    words = [part for one in scene.simulations for part in (one.state.words, words_of(one.settings))]
    if scene.joined.alone:
        return words
    joined = scene.joined
    parts = [*joined.carried[2:], *joined.links, *joined.threshold, *joined.coarse]
    pairs = joined.pairs
    parts += [part for part in pairs[: pairs._fields.index("friction")] if isinstance(part, np.ndarray)]
    return [*words, words_of(joined.carried.breath), *(part.reshape(-1).view(np.int64) for part in parts)]
