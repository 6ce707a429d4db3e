"""Scenes in a file: what they say is what comes of it, and what is wrong is reported in one line."""

import re

import numpy as np
import pytest

from helpers.scenes import ball
from tissue_sim.cli import main
from tissue_sim.contact.scene_file import SceneFile
from tissue_sim.contact.tools import Tool
from tissue_sim.errors import UserError

SCENE = """
format: 1
organs:
  - {name: left, file: ball.npz, breathes: 1.0}
  - {name: right, file: ball.npz, position: [0.062, 0.0, 0.0], quaternion: [0.0, 0.0, 1.0, 0.0], stiffness: 2.0}
attachments:
  - {between: [left, right], within: 0.01, stiffness: 50.0, damping: 0.1}
  - {of: right, point: [0.062, 0.0, 0.05], nodes: [0, 3], stiffness: 5.0, slack: 0.1, moves: 0.5}
breathing: {rate: 15, way: [0.0, 0.0, 0.012]}
"""


@pytest.fixture
def scene(tmp_path):
    ball(2).save(tmp_path / "ball.npz")
    path = tmp_path / "scene.yaml"

    def write(text=SCENE):
        path.write_text(text)
        return path

    return write


def test_a_scene_is_what_its_file_says(scene):
    said = SceneFile.read(scene())
    assert said.names == ("left", "right")
    assert (said.stiffness, said.breathes) == ((1.0, 2.0), (1.0, 0.0))
    turned = ball(2).surface_positions * [-1.0, -1.0, 1.0] + [0.062, 0.0, 0.0]
    np.testing.assert_allclose(said.organs[1].surface_positions, turned, atol=1e-15)
    made = said.scene([Tool("left", "sphere", radius=0.005)], rate=500.0)
    assert [one.settings.stiffness_scale for one in made.simulations] == [1.0, 2.0]
    for _ in range(1000):
        made.step()
    np.testing.assert_allclose(made.offsets, [[0.0, 0.0, 0.012], [0.0, 0.0, 0.0]], atol=1e-6)
    assert made.simulations[1].state.count.faults == 0
    assert not made.simulations[1].asleep, "the other one draws at it"


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("format: 1", "format: 2", "format is 2"),
        ("name: right", "name: left", "two organs have the name 'left'"),
        ("name: right", "name: 7right", r"organs\[1\].name"),
        ("file: ball.npz, position", "file: none.npz, position", "does not exist"),
        ("position: [0.062, 0.0, 0.0]", "position: [0.062, 0.0]", r"organs\[1\].position .* 3 numbers"),
        ("position: [0.062, 0.0, 0.0]", "position: [.nan, 0.0, 0.0]", r"organs\[1\].position\[0\]"),
        ("[0.0, 0.0, 1.0, 0.0]", "[0.0, 0.0, 0.5, 0.0]", "not have length 1"),
        ("stiffness: 2.0", "stifness: 2.0", "did you mean 'stiffness'"),
        ("stiffness: 2.0", "stiffness: soft", r"organs\[1\].stiffness is 'soft'"),
        ("between: [left, right]", "between: [left, liver]", "organ 'liver', which doesn't exist"),
        ("between: [left, right]", "between: left", "expected: a list"),
        ("within: 0.01, ", "", "either 'within'"),
        ("of: right, point", "of: right, pint", "did you mean 'point'"),
        ("of: right, point: [0.062, 0.0, 0.05], ", "of: right, ", "needs a 'point'"),
        ("nodes: [0, 3]", "nodes: [0, -3]", "a list of nodes"),
        ("rate: 15", "rate: 0", "breathing.rate is 0"),
        ("breathing:", "- breathing:", "is not valid YAML"),
        ("breathing:", "breathes:", "did you mean 'breathing'"),
    ],
)
def test_what_is_wrong_is_reported_in_one_line(scene, capsys, old, new, expected):
    assert old in SCENE
    assert main(["info", str(scene(SCENE.replace(old, new, 1)))]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert re.search(expected, line), line


@pytest.mark.parametrize("text", ["", "7", "[1, 2]", "a: &a [*a]", "\x00", "!!python/object:os.system {}"])
def test_what_is_no_scene_at_all_is_refused(scene, text):
    with pytest.raises(UserError, match=r"scene .*scene\.yaml"):
        SceneFile.read(scene(text))


def test_info_tells_a_scene(scene, capsys):
    assert main(["info", str(scene())]) == 0
    output = capsys.readouterr().out
    assert "scene scene.yaml: 2 organs" in output
    assert re.search(r"left to right: \d+ links, 50 N/m in total, slack \d+\.\d to \d+\.\d mm", output)
    assert "right to a point: 2 links, 5 N/m in total, slack 100.0 mm" in output
    assert "breathing: 15 a minute, 0, 0, 12 mm" in output
