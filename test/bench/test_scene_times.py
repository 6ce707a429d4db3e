"""The command `bench scene`: its rows, bounds, tables and exit codes."""

import json

import numpy as np
import pytest

from helpers.scenes import ball
from tissue_sim.bench import scene_times as bench
from tissue_sim.bench.timing import Timing
from tissue_sim.cli import main
from tissue_sim.contact.attachments import Attachment
from tissue_sim.contact.scene_file import SceneFile
from tissue_sim.model.stepping.wake_threshold import WAKE_DISPLACEMENT, WAKE_FORCE
from tissue_sim.organ.placement import placed

COPIES = {bench.ALONE: 100.0, bench.BESIDE: 104.0, bench.ASLEEP: 2.0, bench.AWAKE: 420.0}
OF_SCENE = {bench.one_poked("one"): 110.0, bench.one_poked("two"): 220.0, bench.SCENE: 400.0, bench.TOUCHED: 330.0}
GOOD = COPIES | OF_SCENE


LITTLE = bench.WakeThresholdError(6e-5, 2e-4, 1.4, 2.0)


def measured(lacking=LITTLE, **changed):
    times = GOOD | changed
    rows = [bench.Row(name, 4, Timing(1e-6 * us, 1.5e-6 * us, 100)) for name, us in times.items()]
    return bench.Figures(rows, 1.1, lacking)


BAD = [
    ("", 0.0),
    (bench.BESIDE, 106.0),
    (bench.ASLEEP, 4.1),
    (bench.one_poked("one"), 230.0),
    (bench.TOUCHED, 350.0),
]


@pytest.mark.parametrize(("name", "us"), BAD)
def test_each_bound_is_missed_by_a_bad_figure_alone(name, us):
    changed = {name: us} if name else {}
    assert [bound.met for bound in bench.bounds(measured(**changed))].count(False) == len(changed)


@pytest.mark.parametrize(
    "bad", [bench.WakeThresholdError(1.1e-4, 0.0, 1.0, 2.0), bench.WakeThresholdError(0.0, 1.1e-3, 1.0, 2.0)]
)
def test_a_scene_that_lacks_too_much_is_reported(bad):
    assert [bound.met for bound in bench.bounds(measured(bad))].count(False) == 1


def test_an_organ_that_is_kept_awake_shows_in_the_rows_of_a_scene():
    """By what is counted: the row's time follows."""
    counts = []
    for kept in (False, True):
        ticks = bench.scene_ticks(hanging_pair(), [0])
        if kept:
            ticks.joined.threshold.limits[:] = 0.0
        ticks(100)
        counts.append([one.state.count.asleep_ticks for one in ticks.joined.simulations])
    (poked, other), (_, kept_awake) = counts
    assert poked < 10
    assert other > 100
    assert kept_awake < 10


def hanging_pair():
    """Two balls that hardly pull at each other."""
    first, second = ball(), placed(ball(), (0.2, 0.0, 0.0))
    top = int(np.argmax(first.surface_positions[:, 2]))
    ligament = Attachment((0, 1), 0.05, nodes=[[top, top]], slack=0.19)
    return SceneFile(("one", "two"), (first, second), (1.0, 1.0), (0.0, 0.0), (ligament,), None, 0.0, (0.0, 0.0, 0.0))


def test_a_scene_that_a_core_cannot_keep_up_with_is_reported(monkeypatch, capsys):
    monkeypatch.setattr(bench, "in_one_thread", lambda *_: measured(**{bench.AWAKE: 1200.0, bench.ASLEEP: 9.0}))
    assert main(["bench", "scene"]) == 0
    assert main(["bench", "scene", "--check"]) == 1
    lines = {line.split("  ")[0]: line for line in capsys.readouterr().out.splitlines()}
    assert "more than one core can compute" in lines[bench.AWAKE]
    assert "10 % of a core" in lines[bench.ALONE]
    assert lines["an organ that sleeps"].endswith("missed")


@pytest.mark.extended
def test_only_what_is_poked_is_advanced():
    joined = bench.apart(ball(), 2)
    bench.JoinedTicks(joined, [0])(20)
    poked, other = joined.simulations
    assert poked.state.count.asleep_ticks <= 1
    assert other.state.count.asleep_ticks == 22
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
    assert [row["name"] for row in found["rows"]] == [*COPIES, *OF_SCENE]
    assert all(row["median_us"] > 0.0 for row in found["rows"] if row["name"] != bench.ASLEEP)
    assert found["scene"] == ["one", "two"]
    assert found["organs_awake"] < found["organs_awake_without_threshold"] + 1e-9


@pytest.mark.extended
def test_the_abdomen_that_ships_lacks_nothing_perceptible():
    """A breath with a tool on the liver: organs sleep for most of it, all are awake without the wake threshold."""
    found = bench.lacking(SceneFile.read(bench.shipped_scene()))
    assert found.moved < WAKE_DISPLACEMENT
    assert found.force < WAKE_FORCE
    assert found.awake < 2.0
    assert found.awake_of_all > 3.0


def test_what_is_no_scene_is_named(tmp_path, capsys):
    assert main(["bench", "scene", "--scene", str(tmp_path / "none.yaml")]) == 2
    assert "none.yaml" in capsys.readouterr().err
