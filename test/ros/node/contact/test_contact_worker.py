"""The thread that finds contact sets, where the search itself fails."""

import copy
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from helpers.patience import wait_for
from helpers.scenes import ball
from tissue_sim.contact.finder import ContactFinder
from tissue_sim.contact.tools import Tool, ToolSet
from tissue_sim.model.contact.tool_motion import MAX_FAST_SLIPS
from tissue_sim.model.data.contact_set import Engaged
from tissue_sim.model.data.state import BodyStatus
from tissue_sim.model.joined import Joined
from tissue_sim.model.simulation import Simulation
from tissue_sim.ros.node.contact.contact_search import ContactSearch
from tissue_sim.ros.node.contact.contact_worker import ContactWorker
from tissue_sim.ros.node.shared.served_organ import ServedOrgan
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.physics import Physics
from tissue_sim.ros.shared.report import Report


class Port:
    """A tool above the organ; each pose is new."""

    name, bodies = "left", [0]
    pose_freshness, force_freshness = SimpleNamespace(counts=True), SimpleNamespace(counts=False)

    def __init__(self, position):
        self._sequence = 0
        self.held_off, self.slipped = [], []
        self.note_inactive, self.note_slipped = self.held_off.append, self.slipped.append
        self.move(position)

    def move(self, position):
        self._pose = np.append(position, (0.0, 0.0, 0.0, 1.0))

    @property
    def newest(self):
        self._sequence += 1
        return SimpleNamespace(sequence=self._sequence, placed=self._pose[None])


@pytest.fixture
def scene(monkeypatch):
    """A worker that isn't started, its finder, what the loop tells of the tool, and the lines that it warned with."""
    organ, tools = ball(1), ToolSet([Tool("left", "sphere", 0.005)])
    physics = Physics(Loop(Joined([Simulation(organ, shapes=tools.shapes)])))
    finder = ContactFinder(organ, tools)
    top = organ.surface_positions[np.argmax(organ.surface_positions[:, 2])]
    warned, port = [], Port(top + (0.0, 0.0, 0.006))
    places, bodies = port.newest.placed.copy(), BodyStatus.rows(np.zeros(BodyStatus.words(), dtype=np.int64))
    results = SimpleNamespace(bodies=bodies, body_pose=places, status=SimpleNamespace(tick=1))
    monkeypatch.setattr(physics, "results", lambda: copy.deepcopy(results))
    monkeypatch.setattr(physics, "positions", lambda out: (np.copyto(out, organ.rest_positions) or 1, np.zeros(3)))
    recorder = SimpleNamespace(contacts=lambda *_: None, lock=threading.RLock())
    search = ContactSearch(finder, ServedOrgan("", physics), [port], recorder)
    worker = ContactWorker([search], None, [port], threading.Event(), warned.append)
    middle = organ.surface_positions.mean(axis=0)
    made = SimpleNamespace(worker=worker, finder=finder, physics=physics, results=results, middle=middle, warned=warned)
    made.held_off, made.slipped = port.held_off, port.slipped
    yield made
    worker.stop()


def report_of(worker):
    report = Report()
    worker.report(report)
    return report


def test_a_tool_that_appears_inside_is_held_off_and_reported_each_time(scene, monkeypatch):
    """So is one that was released, and appears there again; but none that has pressed is taken for such a one."""
    body, places, taken = scene.results.bodies[0], scene.results.body_pose, []
    monkeypatch.setattr(scene.physics, "post_contacts", lambda found: taken.append(int(found.engaged[0])) or len(taken))
    scene.worker.start()
    wait_for(lambda: Engaged.YES in taken)
    body.engaged, places[0, :3] = True, scene.middle
    wait_for(lambda: taken[-1] == Engaged.SLIPPED)
    assert not scene.held_off
    body.engaged = False
    wait_for(lambda: taken[-1] == Engaged.HELD_OFF)
    seen = len(taken)
    wait_for(lambda: len(taken) > seen + 3)
    assert scene.held_off == ["the organ"], "once for each time"
    body.releases = 1  # poses stopped and came again, or the organ was reset
    wait_for(lambda: len(scene.held_off) == 2)
    seen = len(taken)
    wait_for(lambda: len(taken) > seen + 3)
    assert len(scene.held_off) == 2


def test_each_slip_is_reported_once_however_short_it_is(scene, monkeypatch):
    """A second between two reports was too long: one was free again before, or had slipped anew."""
    body, taken = scene.results.bodies[0], []
    monkeypatch.setattr(scene.physics, "post_contacts", lambda found: taken.append(found) or len(taken))
    scene.worker.start()

    def search_anew():
        seen = len(taken)
        wait_for(lambda: len(taken) > seen + 2)

    body.slips, body.bearable = MAX_FAST_SLIPS, 0.0
    search_anew()
    assert not scene.slipped, "those of a hasty tool: it may try again"
    for slips, bearable in ((MAX_FAST_SLIPS + 1, 0.7), (MAX_FAST_SLIPS + 2, 0.6), (0, 0.0), (MAX_FAST_SLIPS + 1, 0.5)):
        body.bearable = bearable
        body.slips = slips
        search_anew()
    assert scene.slipped == [0.7, 0.5]


def test_a_search_that_fails_is_reported_once_and_forgotten_when_one_succeeds(scene, monkeypatch):
    find, fails, calls = scene.finder.find, [True], []

    def sometimes(*words):
        calls.append(words)
        if fails[0]:
            raise RuntimeError("no such luck")
        return find(*words)

    monkeypatch.setattr(scene.finder, "find", sometimes)
    scene.worker.start()
    wait_for(lambda: len(calls) > 5)
    (line,) = scene.warned  # not one for every set
    assert line.startswith(
        "contact search failed: RuntimeError: no such luck (tissue_sim/ros/node/contact/contact_search.py:"
    )
    report = report_of(scene.worker)
    assert report.failures == [line]
    assert report.problems["contact_search_failures"] >= 5
    fails[0] = False
    wait_for(lambda: not report_of(scene.worker).failures)
    report = report_of(scene.worker)
    assert report.problems["contact_search_failures"] >= 5, "what happened is still counted"
    assert report.values["contact_sets"] > 0


def test_who_catches_up_waits_for_a_search_that_began_afterwards(scene, monkeypatch):
    """However long one takes: the one in progress has the pose from before."""
    find, posted, may_go, is_finding = scene.finder.find, [], threading.Event(), threading.Event()

    def when_allowed(*words):
        is_finding.set()
        assert may_go.wait(30.0)
        return find(*words)

    monkeypatch.setattr(scene.finder, "find", when_allowed)
    monkeypatch.setattr(scene.physics, "post_contacts", lambda found: posted.append(found) or len(posted))
    scene.worker.start()
    assert is_finding.wait(30.0)
    assert not scene.worker.catch_up(0.05), "none ended"
    threading.Timer(0.1, may_go.set).start()
    assert scene.worker.catch_up(30.0)
    assert len(posted) >= 2
