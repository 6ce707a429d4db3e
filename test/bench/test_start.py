"""The benchmark of starting: its parts, its bounds, and real starts with the kernels on disk."""

import json
import os
from types import SimpleNamespace

import pytest

from helpers.ros.processes import LATE_NODE, Process
from tissue_sim.bench import start
from tissue_sim.bench.first_tick import by_kernel
from tissue_sim.bench.start import ON_DISK, TO_COMPILE, Start, as_json, first_start, text
from tissue_sim.cli import main
from tissue_sim.errors import UserError
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ

PARTS = ("interpreter", "imports", "organ", "assembling", "compiling", "first tick")


def result(wall, compiled):
    return {"parts": dict.fromkeys(PARTS, wall / 6.0), "compiled": compiled, "wall": wall, "processor": 0.8 * wall}


def found(wall, to_end=0.2, to_find=0.3):
    starts = {TO_COMPILE: result(10.0 * wall, {"model.tick": 5.0, "model.guard": 2.0}), ON_DISK: result(wall, {})}
    node = {"to_first_tick": 2.0, "to_first_answer": 2.5, "to_end": to_end, "to_find": to_find}
    peers = {name: Start(1.0, 0.4) for name in start.PEERS}
    return as_json(starts, {TO_COMPILE: None, ON_DISK: node}, peers, "skipped: no node")


def test_compiling_is_reported_by_module_and_without_what_is_called():
    def event(module, is_start):
        dispatcher = SimpleNamespace(py_func=SimpleNamespace(__module__=module))
        return SimpleNamespace(is_start=is_start, data={"dispatcher": dispatcher})

    outer, inner = "tissue_sim.model.stepping.tick", "tissue_sim.contact.grid"
    events = [(1.0, event(outer, True)), (3.0, event(inner, True)), (7.0, event(inner, False))]
    assert by_kernel([*events, (10.0, event(outer, False))]) == [("contact.grid", 4.0), ("model.stepping.tick", 5.0)]


def test_bounds_are_held_or_missed():
    assert [bound["met"] for bound in found(1.0)["bounds"]] == [True] * 4
    assert [bound["met"] for bound in found(2.5, to_end=1.5, to_find=2.6)["bounds"]] == [False] * 4
    alone = as_json({ON_DISK: result(1.0, {})}, {ON_DISK: None}, {}, "skipped")
    assert [bound["met"] for bound in alone["bounds"]] == [True, None, None]


def test_text_has_every_part_and_what_stands_beside_it():
    lines = text(found(2.0))
    for words in (*PARTS, "model.tick", "skipped: no node", "missed"):
        assert words in lines
    assert "4 x" in lines, "0.8 of 2 s are four times a peer's 0.4"


def test_a_node_that_is_announced_later_moves_the_figure(tmp_path, monkeypatch):
    monkeypatch.setattr(start, "FINDERS", 1)
    monkeypatch.setattr(start, "APART", 0.0)
    looking = tmp_path / "looking"  # made once the program's time runs: on a busy machine others see it before
    monkeypatch.setattr(start, "FINDER", start.FINDER.replace("while ", f"open({str(looking)!r}, 'w').close()\nwhile "))
    late = Process([LATE_NODE, str(looking), "1.0"], tmp_path / "late.log")
    late.wait_for("up")
    seconds = start.to_find(os.environ)
    late.child.kill()
    assert seconds >= 1.0
    assert found(1.0, to_find=seconds)["bounds"][-1]["met"] is False


@pytest.mark.extended
def test_peers_run():
    for code in start.PEERS.values():
        assert start.peer_start(code, os.environ).processor > 0.0


@pytest.mark.extended
def test_parts_of_a_first_start_make_up_all_of_it():
    Simulation(Organ.load(shipped_organ())).step()  # the kernels are on disk now
    one = first_start(shipped_organ(), os.environ)
    assert tuple(one["parts"]) == PARTS
    assert sum(one["parts"].values()) == pytest.approx(one["wall"])
    assert all(seconds >= 0.0 for seconds in one["parts"].values())
    assert one["processor"] > 0.0


def test_organ_that_can_not_be_read_is_reported(tmp_path, capsys):
    with pytest.raises(UserError, match="first tick"):
        first_start(tmp_path / "none.npz", {})
    assert main(["bench", "start", str(tmp_path / "none.npz")]) == 2
    assert "none.npz" in capsys.readouterr().err


@pytest.mark.extended
@pytest.mark.timeout(400)
def test_command_runs_with_real_processes(capsys, monkeypatch):
    monkeypatch.setattr(start, "TIMES", 1)
    assert main(["bench", "start", "--quick", "--json", "-"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert set(result["starts"]) == {ON_DISK}
    assert result["nodes"][ON_DISK]["to_find"] > 0.0
    assert result["nodes"][ON_DISK]["to_first_answer"] >= result["nodes"][ON_DISK]["to_first_tick"] > 0.0
