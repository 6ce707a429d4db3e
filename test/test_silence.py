"""No command is silent while its work takes long: each is slowed somewhere, and a line has to come meanwhile.

Time is a test's own. Work that takes long is a function that lets it pass, and looks whether a line is due where the
thread that reports would: not where none runs.
"""

import importlib
import inspect

import numpy as np
import pytest
import trimesh

from helpers.clock import clock_of
from helpers.paths import ROOT
from helpers.scenes import ball
from tissue_sim import progress
from tissue_sim.bench import timing
from tissue_sim.cli import main
from tissue_sim.progress_reporter import PERIOD

BAG = ROOT / "bags" / "poke"
SLOW = 11.0  # s: longer than from one line to the next


class Over(Exception):
    """What has been shown ends here."""


@pytest.fixture
def clock(monkeypatch):
    return clock_of(monkeypatch)


@pytest.fixture
def files(tmp_path, monkeypatch):
    """Small inputs in the current folder: a surface, an organ, loads."""
    monkeypatch.chdir(tmp_path)
    trimesh.creation.icosphere(subdivisions=3, radius=30.0).export("ball.stl")
    organ = ball(2)
    organ.save("ball.npz")
    np.savez("loads.npz", forces=np.zeros((1, organ.n_surface, 3)))


COMMANDS = {
    "build: before anything is read": (
        "build --surface ball.stl --unit mm --out o.npz",
        "organ.build.organ_from_mesh",
    ),
    "build: the report": (
        "build --surface ball.stl --unit mm --out o.npz --report",
        "organ.reporting.page.write_report",
    ),
    "calibrate: the first reference": ("calibrate ball.npz --out o.npz", "commands.calibrate.calibrate"),
    "solve: compiling": ("solve ball.npz --loads loads.npz --out o.npz", "model.simulation.Simulation.step"),
    "replay: a bag": ("replay ball.npz", "ros.bags.replay.replay_bag"),
    "bench tick: its process": ("bench tick ball.npz", "bench.tick_times.measure"),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_line_comes_while_a_command_works(name, clock, files, monkeypatch, capsys):
    words, slowed = COMMANDS[name]
    reported = []

    def work(*_, **__):
        capsys.readouterr()
        for _ in range(2):
            clock.pass_by(SLOW)
        reported.extend(capsys.readouterr().err.splitlines())
        raise Over

    def within(function, *given):
        """In place of a process of its own, which is handed the command's name."""
        return timing._measured(progress.name_of_all(), function, given)[0]

    monkeypatch.setattr("tissue_sim.bench.tick_times.in_one_thread", within)
    monkeypatch.setattr("tissue_sim.organ.build.organ_from_mesh", lambda *_, **__: ball(2))
    owner, _, attribute = slowed.rpartition(".")
    monkeypatch.setattr(found(owner), attribute, work)
    main(words.split())
    command = " ".join(words.split()[: 2 if words.startswith("bench") else 1])
    assert len(reported) == 2, reported
    assert all(line.startswith(command) for line in reported), reported


STAGES = {  # of a command, with the function that does its work, in the order in which they come
    "calibrate ball.npz --out o.npz": [
        ("organ.organ.Organ.load", "reading"),
        ("commands.calibrate.accuracy_warning", "looking for coarse places"),
        ("calibration.calibrate.check_coarseness", "preparing"),
        ("calibration.calibrate.prepared", "preparing"),
        ("calibration.calibrate.Body", "preparing"),
    ],
    f"replay {BAG}": [
        ("ros.bags.outcome.Recording.read", "poke, reading"),
        ("ros.bags.player.Player.__init__", "poke, making the model"),
        ("ros.bags.player.Player._take", "poke, ticks 0 of 1629"),
        ("ros.bags.outcome.compare", "poke, comparing"),
    ],
    f"replay {BAG} {BAG}": [("ros.bags.outcome.compare", "poke (1 of 2), comparing")],
}


@pytest.mark.parametrize("words", STAGES, ids=["calibrate", "replay", "replay two"])
def test_every_part_of_a_long_command_has_the_name_of_its_stage(words, files, monkeypatch, capsys):
    seen: dict[str, str] = {}

    def noting(name, work):
        def noted(*given, **named):
            first = name not in seen
            seen.setdefault(name, progress._reporter._path().partition(": ")[2])
            if first and len(seen) == len(STAGES[words]):
                raise Over
            return work(*given, **named)

        return noted

    for name, _ in STAGES[words]:
        place, _, attribute = name.rpartition(".")
        owner = found(place)
        work = noting(name, getattr(owner, attribute))
        is_class = inspect.isclass(owner) and inspect.ismethod(getattr(owner, attribute))
        monkeypatch.setattr(owner, attribute, staticmethod(work) if is_class else work)
    main(words.split())
    assert list(seen.items()) == STAGES[words]


def found(name):
    """A module of tissue_sim, or a class in one."""
    try:
        return importlib.import_module(f"tissue_sim.{name}")
    except ModuleNotFoundError:
        module, _, attribute = name.rpartition(".")
        return getattr(importlib.import_module(f"tissue_sim.{module}"), attribute)


def test_a_line_comes_between_the_rounds_of_what_is_timed(clock, capsys):
    """No thread runs beside these: the steps report, however short each is."""

    def burst(count):
        clock.pass_by(0.5)
        return np.full(count, 0.5)

    with progress.task("bench tick"):
        timing.interleave(timing.Phase({"ours": burst, "theirs": burst}, 60.0, "poked"))
    reported = [line for line in capsys.readouterr().err.splitlines() if line.startswith("bench tick: poked")]
    assert len(reported) >= (clock.now - 1000.0) // (PERIOD + 1.0) - 1, reported
