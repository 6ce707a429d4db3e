"""Hostile input: that cases repeat, that failures are seen and told, and that some of every kind hold."""

import json
import re
import subprocess
import sys

import pytest

from tissue_sim.bench.fuzz import command, pool
from tissue_sim.bench.fuzz.cases import FILES, KINDS, Case, Outcome
from tissue_sim.bench.fuzz.pool import run_cases
from tissue_sim.cli import main

# Two organs that tools drive through each other, one through itself, and one whose ligament is just taut.
CAUGHT = ((3, 1), (3, 2), (3, 7))
# Organs that ligaments, or they themselves, would hold in a false shape for good: after a fault; inside out or squeezed
# without one.
HELD = ((2226, 2), (2226, 5), (2226, 47), (9001, 90), (9002, 199), (9003, 217))


@pytest.mark.extended
def test_files_are_used_or_refused(tmp_path, capsys):
    out = tmp_path / "found.json"
    assert main(["bench", "fuzz", "--files", "6", "--seed", "3", "--jobs", "1", "--check", "--json", str(out)]) == 0
    found = json.loads(out.read_text())
    assert {case["kind"] for case in found["cases"]} == {kind for kind in FILES if not FILES[kind].missing}
    assert all(case["verdict"] in ("used", "refused") for case in found["cases"])
    assert any(case["verdict"] == "refused" for case in found["cases"])
    assert all("\n" not in case["line"] for case in found["cases"])


@pytest.mark.extended
@pytest.mark.skipif(FILES["bag"].missing, reason="no bag to mutate")
def test_workers_that_are_ended_leave_nothing_behind():
    """Of a case that replays, with a bar that would share a lock between processes."""
    words = ["bench", "fuzz", "--seed", "11", "--kinds", "bag", "--case", "1", "--jobs", "1"]
    done = subprocess.run([sys.executable, "-m", "tissue_sim", *words], capture_output=True, text=True, check=False)
    assert " used: " in done.stdout
    assert "leaked" not in done.stderr
    assert "Warning" not in done.stderr


@pytest.mark.extended
def test_a_worker_that_dies_between_two_cases_is_begun_anew(tmp_path):
    worker = pool._Worker(tmp_path)
    worker._process.kill()
    worker._process.join()
    worker.give(Case("organ", 5, 0))
    outcome = None
    while outcome is None:
        outcome = worker.outcome()
    worker.stop()
    assert outcome.verdict in ("used", "refused")


def test_who_stops_it_is_told_what_was_found_so_far(monkeypatch, capsys):
    def stopped(cases, jobs):
        yield Outcome(cases[0], "failed", "no")
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "run_cases", stopped)
    assert main(["bench", "fuzz", "--scenes", "3", "--kinds", "tick", "--check"]) == 130
    assert "1 cases in 0 s, 1 failed" in capsys.readouterr().out


def test_a_run_that_was_stopped_goes_on(monkeypatch, capsys):
    asked = []
    monkeypatch.setattr(command, "run_cases", lambda cases, jobs: asked.append(cases) or iter(()))
    for first in ([], ["--from", "2"]):
        assert main(["bench", "fuzz", "--scenes", "4", "--kinds", "tick", "--seed", "8", *first]) == 0
    whole, rest = asked
    assert [case.number for case in whole] == [0, 1, 2, 3]
    assert rest == whole[2:]


@pytest.mark.extended
@pytest.mark.parametrize(
    "cases",
    [
        [Case("tick", 5, number) for number in range(4)],
        [Case("joined", seed, number) for seed, number in ((5, 0), (5, 1), (5, 2), *CAUGHT, *HELD)],
    ],
)
def test_organs_are_as_before_after_hostile_ticks(cases):
    found = list(run_cases(cases, 1))
    assert not [f"{one.what}: {one.line}" for one in found if one.verdict != "used"]
    assert any(not re.match(r"to 0 mm", one.line) for one in found)


@pytest.mark.extended
@pytest.mark.parametrize("kind", ["node", "scene_node"])
def test_node_is_as_before_after_hostile_messages(kind):
    found = list(run_cases([Case(kind, 5, number) for number in range(6)], 1))
    assert not [f"{one.what}: {one.line}" for one in found if one.verdict != "used"]
    assert int(re.match(r"(\d+) wrenches", found[-1].line)[1]) > 0


def test_a_node_of_one_organ_is_not_begun_anew_for_each_case(monkeypatch, capsys):
    asked = []
    monkeypatch.setattr(command, "run_cases", lambda cases, jobs: asked.append(cases) or iter(()))
    assert main(["bench", "fuzz", "--scenes", "2", "--kinds", "scene_node", "node", "tick"]) == 0
    kinds = [case.kind for case in asked[0]]
    assert kinds == ["node", "tick", "node", "tick", "scene_node", "scene_node"]


@pytest.mark.parametrize("kind", ["organ", "mesh", "image"])
def test_case_follows_from_its_numbers_alone(tmp_path, kind):
    made = []
    for turn in range(2):
        for number in (7, 8):
            folder = tmp_path / f"{turn}{number}"
            folder.mkdir()
            what = KINDS[kind].prepare(Case(kind, 2, number), folder).what
            files = {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
            made.append((what, files))
    assert made[0] == made[2]
    assert made[1] == made[3]
    assert made[0][1] != made[1][1]


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--files", "0"], r"--files 0 is outside"),
        (["--scenes", "0"], r"--scenes 0 is outside"),
        (["--seed", "-1"], r"--seed -1 is negative"),
        (["--scenes", "3", "--kinds", "organ"], r"--kinds organ needs --files"),
        (["--jobs", "0"], r"--jobs 0"),
        (["--from", "-1"], r"--from -1 is outside"),
        (["--scenes", "3", "--from", "3"], r"--from 3 is beyond the last case, 2"),
    ],
)
def test_wrong_numbers_take_one_line(capsys, words, line):
    assert main(["bench", "fuzz", *words]) == 2
    assert re.fullmatch(rf"tissue_sim: error: {line}.*\n", capsys.readouterr().err)
