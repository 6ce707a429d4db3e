"""The command `bench scene`: its rows, bounds, tables and exit codes."""

import json

import pytest

from helpers.scenes import ball
from tissue_sim.bench import scene_times as bench
from tissue_sim.bench.timing import Timing
from tissue_sim.cli import main

GOOD = {bench.ALONE: 100.0, bench.BESIDE: 105.0, bench.ASLEEP: 2.0, bench.AWAKE: 420.0}


def measured(**changed):
    times = GOOD | changed
    rows = [bench.Row(name, 4, Timing(1e-6 * us, 1.5e-6 * us, 100)) for name, us in times.items()]
    return bench.Figures(rows, 1.1)


@pytest.mark.parametrize(("name", "us", "missed"), [("", 0.0, 0), (bench.BESIDE, 111.0, 1), (bench.ASLEEP, 4.1, 1)])
def test_each_bound_is_missed_by_a_bad_figure_alone(name, us, missed):
    changed = {name: us} if name else {}
    assert [bound.met for bound in bench.bounds(measured(**changed))].count(False) == missed


def test_a_scene_that_a_core_cannot_keep_up_with_is_told(monkeypatch, capsys):
    monkeypatch.setattr(bench, "in_one_thread", lambda *_: measured(**{bench.AWAKE: 1200.0, bench.ASLEEP: 9.0}))
    assert main(["bench", "scene"]) == 0
    assert main(["bench", "scene", "--check"]) == 1
    lines = {line.split("  ")[0]: line for line in capsys.readouterr().out.splitlines()}
    assert "more than a core keeps up with" in lines[bench.AWAKE]
    assert "10 % of a core" in lines[bench.ALONE]
    assert lines["an organ that sleeps"].endswith("missed")


@pytest.mark.extended
def test_only_what_is_poked_is_advanced():
    joined = bench.apart(ball(), 2)
    bench.JoinedTicks(joined, poked=1)(50)
    poked, other = joined.simulations
    assert poked.state.count.asleep_ticks <= 1
    assert other.state.count.asleep_ticks == 52
    assert abs(poked.positions - poked.model.rest).max() > 1e-6


@pytest.mark.extended
def test_a_scene_is_timed_beside_copies_of_an_organ(monkeypatch, tmp_path):
    """Two organs, for which other tests have compiled the tick."""
    monkeypatch.setattr(bench, "ORGANS", 2)
    monkeypatch.setattr(bench, "in_one_thread", lambda function, organ, scene, _: function(organ, scene, 0.02))
    ball().save(tmp_path / "ball.npz")
    scene, out = tmp_path / "scene.yaml", tmp_path / "found.json"
    second = "  - {name: two, file: ball.npz, position: [0.2, 0, 0]}\n"
    scene.write_text("format: 1\norgans:\n  - {name: one, file: ball.npz}\n" + second)
    words = ["bench", "scene", str(tmp_path / "ball.npz"), "--scene", str(scene), "--json", str(out)]
    assert main(words) == 0
    found = json.loads(out.read_text())
    assert [row["name"] for row in found["rows"]] == [*GOOD, bench.SCENE]
    assert all(row["median_us"] > 0.0 for row in found["rows"] if row["name"] != bench.ASLEEP)
    assert found["scene"] == ["one", "two"]


def test_what_is_no_scene_is_named(tmp_path, capsys):
    assert main(["bench", "scene", "--scene", str(tmp_path / "none.yaml")]) == 2
    assert "none.yaml" in capsys.readouterr().err
