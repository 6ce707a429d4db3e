"""The thread that lets forces fade and shows the organ, where showing fails."""

import math
import time
from types import SimpleNamespace

import numpy as np
import pytest

from helpers.patience import wait_for
from helpers.scenes import ball
from tissue_sim.model.joined import Joined
from tissue_sim.model.simulation import Simulation
from tissue_sim.ros.node.output import publishing_thread as outlet
from tissue_sim.ros.node.output.publishing_thread import PublishingThread
from tissue_sim.ros.node.shared.backlog import Backlog
from tissue_sim.ros.node.shared.shared_parts import SharedParts
from tissue_sim.ros.shared.cdr import check_force, check_position
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.organs import Organs
from tissue_sim.ros.shared.report import Report


class Logger:
    def __init__(self):
        self.warned = []

    def info(self, message):
        pass

    def warning(self, message):
        self.warned.append(message)


class Output:
    """A tool's, whose force fades; counts how often it was published."""

    turns = 0

    def keep_publishing(self, silence):
        self.turns += 1
        return True


class Presenter:
    """Fails in two ways at every turn."""

    fails = True

    def present(self):
        if self.fails:
            check_position(np.full(3, 1e9))

    def present_tools(self):
        if self.fails:
            check_force(np.full(3, 1e12))


@pytest.fixture(params=[60.0, 240.0])
def scene(request, monkeypatch):
    """An outlet that isn't started, with what it serves; the reports it made."""
    monkeypatch.setattr(outlet, "REPORT_EVERY", 0.1)
    parts = SimpleNamespace(output=Output(), presenter=Presenter(), logger=Logger(), reports=[])
    live = SimpleNamespace(marker_rate=request.param, helps=lambda _: False, level=0, ease=lambda _: math.inf)

    def tell():
        report = Report()
        parts.outlet.report(report)
        parts.reports.append(report)

    parts.outlet = PublishingThread(
        SharedParts(
            node=SimpleNamespace(get_logger=lambda: parts.logger),
            organs=Organs(Loop(Joined([Simulation(ball(1))]))),
            recorder=None,
            clock=SimpleNamespace(watch=lambda: None),
            backlog=Backlog(lambda task: task()),
        ),
        [SimpleNamespace(input=SimpleNamespace(poses=0), output=parts.output)],
        [parts.presenter.present, parts.presenter.present_tools],
        live,
        tell,
    )
    yield parts
    parts.outlet.stop()


def test_forces_fade_on_although_pictures_fail(scene):
    scene.outlet.start()
    wait_for(lambda: len(scene.reports) >= 2)
    turns = scene.output.turns
    wait_for(lambda: scene.output.turns > turns + 50)
    lines = [
        "outlet failed: ValueError: its position is 1e+09 m away; positions are in metres",
        "outlet failed: ValueError: its force is 1e+12 N; forces are in newtons",
    ]
    assert [line.partition(" (")[0] for line in scene.reports[-1].failures] == lines
    assert scene.reports[-1].problems["outlet_failures"] > scene.reports[0].problems["outlet_failures"] >= 1
    assert {line.partition(" (")[0] for line in scene.logger.warned} == set(lines)
    assert all("(tissue_sim/ros/shared/cdr.py:" in line for line in scene.logger.warned), "where that was"
    wait_for(lambda: len(scene.reports) >= 4)
    assert len(scene.logger.warned) == 2, "not one for every picture, nor for every report"
    scene.presenter.fails = False
    count = len(scene.reports)
    wait_for(lambda: len(scene.reports) >= count + 3)
    assert scene.reports[-1].failures == []


def test_nothing_fails_in_a_report_of_what_works(scene):
    report = Report()
    scene.outlet.report(report)
    assert report.failures == []
    assert report.problems == {"outlet_failures": 0}


def test_room_that_was_freed_is_given_back_now_and_then(scene, monkeypatch):
    given = []
    monkeypatch.setattr(outlet, "GIVE_BACK_EVERY", 0.05)
    monkeypatch.setattr(outlet, "give_back", lambda: given.append(time.monotonic()))
    started = time.monotonic()
    scene.outlet.start()
    wait_for(lambda: len(given) >= 4)
    assert all(np.array(given) - started >= 0.05 * np.arange(len(given))), "s: not at every turn"
