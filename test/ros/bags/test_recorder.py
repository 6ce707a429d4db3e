"""An organ's part of a bag."""

import threading
from math import inf
from types import SimpleNamespace

import pytest

from helpers.scenes import ball
from tissue_sim.model.simulation import Simulation
from tissue_sim.ros.bags import organ_recorder
from tissue_sim.ros.bags.organ_recorder import OrganRecorder, _Notes


@pytest.mark.parametrize("rows", [0, 2])
@pytest.mark.parametrize("bodies", [0, 1, 3])
def test_a_journal_has_one_row_for_each_body_of_each_contact_set(rows, bodies):
    """Without tools there are none, and a surface is noted before any contact set."""
    notes = _Notes(contacts=[(1, 2, 3)] * rows, body_contacts=[[(0.5, 1, False)] * bodies] * rows, surfaces=[(7,)])
    found = notes.arrays(bodies)
    assert found["contacts"].shape == (rows,)
    assert found["body_contacts"].shape == (rows, bodies)
    assert found["surfaces"].shape == (1,)
    assert all((row[0], row[1]) == (0.5, 1) for row in found["body_contacts"].ravel())


@pytest.mark.parametrize("ends_by", ["its state", "its end"])
def test_an_organ_is_exchanged_only_once_a_bag_that_began_has_its_state(ends_by, monkeypatch):
    """Else the bag holds one organ, and the state of the next one: it could not be replayed."""
    monkeypatch.setattr(organ_recorder, "STATE_WAIT", inf)
    simulation = Simulation(ball(1))
    messages = SimpleNamespace(lock=threading.Lock(), active=False, packed=lambda *_: None)
    physics = SimpleNamespace(simulation=simulation, box=SimpleNamespace(snapshot=simulation.state.words.copy()))
    recorder = OrganRecorder(messages, "organ", physics)
    recorder.wait_for_state()  # no bag
    messages.active = True
    exchanged = threading.Event()

    def exchange():
        recorder.wait_for_state()
        exchanged.set()

    threading.Thread(target=exchange, daemon=True).start()
    assert not exchanged.wait(0.1)
    if ends_by == "its state":
        recorder.state()
    else:
        messages.active = False
    assert exchanged.wait(60.0)
    recorder.wait_for_state()
