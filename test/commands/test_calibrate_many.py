"""`tissue_sim calibrate` of several organs, here and on a Dask cluster of real processes."""

import json
import os
import signal
import subprocess
import sys

import pytest

from helpers.jobs import ends, slowly
from helpers.patience import wait_for
from helpers.scenes import ball, changed
from tissue_sim.calibration.cohort import on_cluster, spread
from tissue_sim.cli import main
from tissue_sim.organ.organ import Organ

SMALL = ("--cases=30", "--evaluations=10", "--smooth=2", "--sharp=1", "--interior=60")


@pytest.fixture
def organs(tmp_path):
    """Two balls that can be calibrated, one without a clamp, and a file that is none."""
    folder = tmp_path / "organs"
    folder.mkdir()
    ball(2).save(folder / "one.npz")
    changed(ball(2), damping=2.0).save(folder / "two.npz")
    ball(2, held=False).save(folder / "free.npz")
    (folder / "broken.npz").write_bytes(b"none")
    return folder


@pytest.fixture(autouse=True)
def _jobs(helpers_on_path):
    """Other processes find the helpers' jobs."""


def test_results_come_as_they_are_ready_and_a_lost_one_takes_no_other_with_it():
    found = dict(spread(ends, ["killed", "fine", "refused", "wrong"], jobs=2))
    assert found[1] == "fine"
    assert [str(found[number]) for number in (0, 2, 3)] == [
        "its process was ended by SIGKILL; it may need more memory",
        "not this one",
        "its process failed: KeyError: 'no such thing'",
    ]


def test_more_items_than_jobs_are_taken_as_there_is_room(tmp_path):
    taken = []

    def items():
        for number in range(1, 5):
            taken.append(number)
            yield number, tmp_path

    results = spread(slowly, items(), jobs=1)
    assert next(results) == (0, 1)
    assert taken == [1]
    assert sorted(results) == [(1, 4), (2, 9), (3, 16)]


@pytest.mark.extended
def test_a_worker_that_is_killed_in_the_middle_costs_nothing_but_time(cluster, tmp_path):
    address, client = cluster
    pid_of = client.run(os.getpid)
    results = on_cluster(slowly, [(number, tmp_path) for number in range(6)], address)
    first = next(results)
    at_work = wait_for(lambda: [int(file.name.split("-")[1]) for file in tmp_path.glob("0-*")])[0]
    assert at_work in pid_of.values()
    os.kill(at_work, signal.SIGKILL)
    assert sorted([first, *results]) == [(number, number**2) for number in range(6)]
    assert len(list(tmp_path.glob("0-*"))) == 2, "the other worker began it again"


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_a_cohort_is_the_same_bits_here_and_on_a_cluster_that_loses_a_worker(organs, cluster, tmp_path, capsys):
    pytest.importorskip("skfem")
    pytest.importorskip("netgen")
    address, client = cluster
    files = sorted(str(file) for file in organs.glob("*.npz"))
    here, there, table = tmp_path / "here", tmp_path / "there", tmp_path / "table.json"
    assert main(["calibrate", *files, "--out", str(here), "--jobs", "2", "--json", str(table), *SMALL]) == 1
    shown = capsys.readouterr().out
    assert "2 organs calibrated, 2 not" in shown
    assert "no triangle has all its nodes fixed" in shown
    assert "broken.npz is damaged or not an organ file" in shown
    figures = json.loads(table.read_text())
    assert [isinstance(figures[name], str) for name in ("broken", "free", "one", "two")] == [True, True, False, False]

    pids = client.run(os.getpid)
    command = [sys.executable, "-m", "tissue_sim", "calibrate", *files, "--out", str(there), *SMALL]
    with subprocess.Popen([*command, "--scheduler", address], stdout=subprocess.PIPE, text=True) as process:

        def busy():
            return [worker for worker, tasks in client.processing().items() if tasks]

        os.kill(pids[wait_for(busy, "no worker took an organ up")[0]], signal.SIGKILL)
        output = process.communicate(timeout=1000)[0]
    assert process.returncode == 1
    assert "2 organs calibrated, 2 not" in output
    for name in ("one", "two"):
        assert Organ.load(there / f"{name}.npz").digest() == Organ.load(here / f"{name}.npz").digest()

    before = {file: file.stat().st_mtime_ns for file in here.glob("*.npz")}
    assert main(["calibrate", *files, "--out", str(here), *SMALL]) == 1
    assert capsys.readouterr().out.count("kept") == 2
    assert {file: file.stat().st_mtime_ns for file in here.glob("*.npz")} == before
    assert not list(here.glob(".*"))


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--jobs", "0"), "--jobs 0 is less than 1"),
        (("--jobs", "2", "--scheduler", "tcp://127.0.0.1:1"), "--jobs is for this machine"),
        (("--json", "figures.txt"), "--json figures.txt must end in .json"),
        (("--jobs", "2", "--report", "folder"), "--report is for a single organ"),
        (("--scheduler", "tcp://127.0.0.1:1"), "no Dask scheduler answers at tcp://127.0.0.1:1"),
    ],
)
def test_wrong_use_is_one_line(organs, tmp_path, capsys, monkeypatch, words, expected):
    monkeypatch.setattr("tissue_sim.calibration.cohort.CONNECT", 1.0)
    if expected.startswith("no Dask"):
        pytest.importorskip("distributed")
    assert main(["calibrate", str(organs / "one.npz"), "--out", str(tmp_path / "out"), *words]) == 2
    error = capsys.readouterr().err
    assert expected in error
    assert error.count("\n") == 1


def test_no_organ_is_written_over(organs, tmp_path, capsys):
    again = tmp_path / "one.npz"
    again.write_bytes((organs / "one.npz").read_bytes())
    one, two = str(organs / "one.npz"), str(organs / "two.npz")
    assert main(["calibrate", one, two, "--out", str(organs)]) == 2
    assert "contains" in capsys.readouterr().err
    assert main(["calibrate", one, str(again), "--out", str(tmp_path / "out")]) == 2
    assert "have the same name" in capsys.readouterr().err
    assert main(["calibrate", one, two, "--out", str(tmp_path / "out.npz")]) == 2
    assert "must be a folder" in capsys.readouterr().err
