"""Cuts made in another process: the same as in this one, refused with the same words, and again after it was killed."""

import pickle
import threading
from contextlib import closing, nullcontext
from types import SimpleNamespace

import numba
import numpy as np
import pytest

from helpers.bars import bar
from tissue_sim.contact.touched_surface import TouchedSurface
from tissue_sim.errors import UserError
from tissue_sim.model.data.records import words_of
from tissue_sim.model.data.shapes import sphere_tools
from tissue_sim.model.simulation import Simulation
from tissue_sim.ros.node.services.cut_process import CutProcess, Ending
from tissue_sim.ros.node.services.cutting import OrganCutting

EDGE = np.array([[0.044, -0.01, 0.05], [0.046, 0.05, 0.05]])  # m
DOWN = np.array([0.0, 0.0, -1.0])
DEPTH = 0.03  # m


@pytest.fixture(scope="module")
def process():
    with closing(CutProcess()) as made:
        yield made


@pytest.fixture
def before():
    simulation = Simulation(bar(8, 0.01, 4), shapes=sphere_tools(0.005), rate=500.0)
    simulation.settings.friction = 0.3
    return simulation


def arrays_of(values, name=""):
    """All arrays in NamedTuples, by their path."""
    if isinstance(values, tuple):
        names = getattr(values, "_fields", range(len(values)))
        return {
            path: array
            for key, value in zip(names, values, strict=True)
            for path, array in arrays_of(value, f"{name}.{key}").items()
        }
    return {name: np.asarray(values)} if not isinstance(values, str | None) else {}


def test_it_is_the_simulation_that_this_process_would_make(process, before):
    expected = before.prepared_cut(EDGE, DOWN, DEPTH)
    made, surface, file = process.cut(before, (EDGE, DOWN, DEPTH))
    assert file == expected.organ.to_bytes()
    assert surface.organ is made.organ
    np.testing.assert_array_equal(surface.rest, TouchedSurface.of(expected).rest)
    assert made.shapes is before.shapes
    assert str(made.cuts[0]) == str(expected.cuts[0])
    for name, array in arrays_of(expected.model).items():
        if not name.startswith((".work", ".tissue.rows", ".tissue.work", ".tissue.compressed_cells")):  # room
            np.testing.assert_array_equal(arrays_of(made.model)[name], array, err_msg=name)
    np.testing.assert_array_equal(made.state.words, expected.state.words)
    np.testing.assert_array_equal(words_of(made.settings), words_of(expected.settings))
    np.testing.assert_array_equal(made.carry_plan.source, expected.carry_plan.source)
    assert made.frequency == expected.frequency
    assert numba.typeof(made.world) == numba.typeof(expected.world), "its kernels would be compiled once more"
    for one in (made, expected):
        one.continue_from(before)
        one.apply_force([3], [[0.0, 0.0, -0.5]])
        one.step(20)
    np.testing.assert_array_equal(made.positions, expected.positions)


def test_a_cut_continues_an_earlier_one(process, before):
    once = process.cut(before, (EDGE, DOWN, DEPTH)).simulation
    deeper = process.cut(once, (EDGE, DOWN, DEPTH + 0.005)).simulation
    assert len(deeper.cuts) == 1
    assert deeper.cuts[0].area > once.cuts[0].area


def test_what_is_refused_has_the_same_words(process, before):
    with pytest.raises(UserError) as expected:
        before.prepared_cut(EDGE, DOWN, -1.0)
    with pytest.raises(UserError) as found:
        process.cut(before, (EDGE, DOWN, -1.0))
    assert str(found.value) == str(expected.value)


def test_a_fault_in_it_is_reported_and_it_goes_on(process, before):
    frequency, before.frequency = before.frequency, None
    with pytest.raises(RuntimeError, match=r"the process that makes cuts failed: Traceback[^$]*TypeError"):
        process.cut(before, (EDGE, DOWN, DEPTH))
    before.frequency = frequency
    assert process.cut(before, (EDGE, DOWN, DEPTH)).simulation.cuts


def test_after_it_was_killed_one_is_reported_and_the_next_cut_starts_it_again(process, before, monkeypatch):
    child = process.start()
    child.kill()
    monkeypatch.setattr(process, "start", lambda: child)  # it was still there when it was asked
    with pytest.raises(UserError, match=r"by SIGKILL; call the service again"):
        process.cut(before, (EDGE, DOWN, DEPTH))
    monkeypatch.undo()
    assert process.cut(before, (EDGE, DOWN, DEPTH)).simulation.cuts
    assert process.start().pid != child.pid


def test_a_cut_that_is_made_when_the_node_ends_is_given_up_without_a_word_of_signals(before, monkeypatch):
    made = CutProcess()
    child = made.start()
    dump = pickle.dump

    def ask_and_close(*arguments):
        dump(*arguments)
        made.close()

    monkeypatch.setattr(pickle, "dump", ask_and_close)
    with pytest.raises(Ending, match=r"^the node is ending, and makes no more cuts$"):
        made.cut(before, (EDGE, DOWN, DEPTH))
    assert child.wait(60.0) != 0


def test_a_blades_cut_that_the_end_of_the_node_breaks_off_is_no_warning():
    def end(*_):
        raise Ending

    lines, noted = [], SimpleNamespace(noted=nullcontext)
    cutting = OrganCutting.__new__(OrganCutting)  # without a node
    cutting._node, cutting._log = SimpleNamespace(unexpected_errors=noted), SimpleNamespace(warning=lines.append)
    cutting._served = SimpleNamespace(physics=SimpleNamespace(simulation=None))
    cutting._parts = SimpleNamespace(process=SimpleNamespace(cut=end))
    cutting._name, cutting._blades = "the organ", SimpleNamespace(refuse=str)
    cutting._busy, cutting._heals = threading.Lock(), 0
    assert cutting._busy.acquire(blocking=False)
    cutting._open([None], 0)
    assert not lines
    assert not cutting._busy.locked()


def test_it_ends_with_its_input_and_starts_no_more(before):
    made = CutProcess()
    child = made.start()
    child.stdin.close()
    assert child.wait(60.0) == 0
    made.close()
    with pytest.raises(UserError, match="the node is ending"):
        made.cut(before, (EDGE, DOWN, DEPTH))
