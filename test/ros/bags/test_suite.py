"""The scenes that ship: each repeats, is small, and is summed up; an error that is planted makes them fail."""

import re

import numpy as np
import pytest

from helpers.paths import ROOT
from helpers.planting import most_moved, with_one_stiffer
from tissue_sim.cli import main
from tissue_sim.ros.bags.recording import Recording
from tissue_sim.ros.bags.suite.scenes import GLOBAL, SCENES, spread_over_front
from tissue_sim.ros.bags.suite.summary import as_text, figures

FOLDER = ROOT / "bags"
BAGS = sorted(path.parent for path in FOLDER.glob("*/metadata.yaml"))
MOST_BYTES = 300_000
AT_ONCE = ("poke", "bad_input")  # whose summaries are looked at each time; all bags are replayed each time
by_bag = pytest.mark.parametrize("path", BAGS, ids=lambda path: path.name)


def parts():
    """The summary by scene."""
    return {part.partition(":")[0]: part for part in (FOLDER / "summary.txt").read_text().split("\n\n")}


def test_every_scene_has_its_bag_and_is_summed_up():
    names = {scene.name for scene in SCENES}
    assert {path.name for path in BAGS} == names
    assert parts().keys() == names


@by_bag
def test_a_bag_is_small(path):
    assert sum(file.stat().st_size for file in path.iterdir()) < MOST_BYTES


def test_all_repeat_and_a_table_tells(capsys):
    assert main(["replay", *map(str, BAGS)]) == 0
    head, *rows = capsys.readouterr().out.splitlines()
    assert head.split()[:4] == ["bag", "ticks", "wrenches", "surfaces"]
    assert [row.split()[0] for row in rows] == list(map(str, BAGS))
    for row in rows:
        name, ticks, *_, force, torque, position, state = row.split()
        assert int(ticks) > 500, name
        assert float(force) == float(torque) == float(position) == 0.0, row
        assert state == "ok"


def test_a_planted_error_is_found(tmp_path, capsys):
    """One cell a percent stiffer; what doesn't come near it, repeats."""
    recording = Recording.read(FOLDER / "poke")
    organ = recording.organs[0].organ()
    with_one_stiffer(organ, most_moved(recording, organ)).save(tmp_path / "stiff.npz")
    assert main(["replay", str(FOLDER / "poke"), str(FOLDER / "nip"), "--organ", str(tmp_path / "stiff.npz")]) == 1
    out = capsys.readouterr().out
    assert f"{FOLDER / 'poke'}: organ: recorded" in out
    (row,) = (line for line in out.splitlines() if line.startswith(f"{FOLDER / 'poke'} "))
    tick = int(re.search(r"FAILED: deviation above .* from tick (\d+) on", row)[1])
    assert min(recording.shown().ticks) <= tick <= recording.last_tick


@pytest.mark.parametrize(
    "path",
    [pytest.param(path, marks=[] if path.name in AT_ONCE else pytest.mark.extended, id=path.name) for path in BAGS],
)
def test_the_summary_is_that_of_the_bag(path):
    """But for what was refused, which a bag lacks."""
    (scene,) = (scene for scene in SCENES if scene.name == path.name)
    found = as_text({scene.name: (scene.what, figures(Recording.read(path), {}))})
    expected = parts()[path.name]
    assert [line for line in found.splitlines() if "refused" not in line] == [
        line for line in expected.splitlines() if "refused" not in line
    ]


def test_bad_input_was_refused_for_every_reason():
    refused = re.search(r"refused: +(.*)", parts()["bad_input"])[1]
    for kind in ("malformed", "nan_pose", "zero_quaternion", "unknown_frame", "no_stamp", "backward_stamp", "far_pose"):
        assert f"left.refused.{kind} 1" in refused


def test_forces_alone_are_those_of_the_paper():
    recording = Recording.read(FOLDER / "global_force")
    most = [max(np.linalg.norm(force) for force in forces.values()) for forces in recording.forces]
    assert len(most) == 10
    assert sum(most) == pytest.approx(GLOBAL, rel=0.05)
    nodes, normal = spread_over_front(recording.organs[0].organ(), 10)
    assert len(set(nodes.tolist())) == 10
    assert np.linalg.norm(normal) == pytest.approx(1.0)


def test_the_organ_falls_asleep_and_wakes():
    asleep = int(re.search(r"ticks asleep: +(\d+)", parts()["sleep"])[1])
    assert asleep > 1000
    assert float(re.search(r"peak force: +([\d.]+)", parts()["sleep"])[1]) > 0.1


def test_a_picture_of_each_needs_a_folder(capsys):
    assert main(["replay", *map(str, BAGS[:2]), "--plot", "a.png"]) == 2
    assert "--plot must be a folder" in capsys.readouterr().err
    assert main(["replay", *map(str, BAGS[:2]), "--against", str(BAGS[0])]) == 2
    assert "--against needs exactly one BAG" in capsys.readouterr().err
