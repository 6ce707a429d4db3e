"""Benchmark of batches: its bounds, and that it notices copies that feel nothing, or not what a scene feels."""

import json

import numpy as np
import pytest

from helpers.scenes import ball_of_cells
from tissue_sim import cli
from tissue_sim.bench import batch
from tissue_sim.bench.batch import Measured, as_json, differing, of_batch, pressed_scene, presses_on
from tissue_sim.bench.pressed_flex import PressedFlex
from tissue_sim.contact.batch_copies import CompiledCopies
from tissue_sim.contact.scene_batch import SceneBatch


def bounds_of(found):
    return {bound["name"]: bound["met"] for bound in found["bounds"]}


def measured_bounds(organ):
    presses, scene = presses_on(organ, 4), pressed_scene(organ)
    copies = SceneBatch(scene, 4, threads=1)
    one = of_batch(copies, presses, 0.0)
    return bounds_of(as_json(organ, [one], [], copies.bytes_a_copy, differing(scene, presses)))


PRESSED, SAME = "copies pressed with 0.02 N or more", "numbers that differ from those of the scene alone"


def test_every_copy_feels_its_press_and_what_the_scene_feels():
    met = measured_bounds(ball_of_cells())
    assert met[PRESSED]
    assert met[SAME]
    assert met["memory of a copy"]


def test_a_batch_without_contact_is_noticed(monkeypatch):
    advance = CompiledCopies.advance

    def without_contact(self, copies, ticks):
        self._course.is_found[copies] = 1  # the search before the first of the 20 ticks is left out
        advance(self, copies, ticks)

    monkeypatch.setattr(CompiledCopies, "advance", without_contact)
    met = measured_bounds(ball_of_cells())
    assert not met[PRESSED]
    assert not met[SAME]


def test_a_batch_whose_tools_lag_is_noticed(monkeypatch):
    move = CompiledCopies.move
    monkeypatch.setattr(
        CompiledCopies, "move", lambda self, copies, poses, angles: move(self, copies, 0.999 * poses, angles)
    )
    assert not measured_bounds(ball_of_cells())[SAME]


@pytest.mark.parametrize(
    ("rates", "cores", "speedup", "serial"),
    [((600.0, 1140.0), 1.0, 1.9, 1.0 / 19.0), ((600.0, 700.0), 0.6, None, None)],
)
def test_two_threads_are_compared_with_one_on_free_cores_alone(rates, cores, speedup, serial):
    rows = [Measured(f"{k + 1}", k + 1, rate, rate, (k + 1) * cores, np.ones(4)) for k, rate in enumerate(rates)]
    found = as_json(ball_of_cells(), rows, [], 1_000_000, 0)
    assert found["speedup_of_two"] == (None if speedup is None else pytest.approx(speedup))
    assert found["serial_fraction"] == (None if serial is None else pytest.approx(2.0 / 1.9 - 1.0))
    assert ("computed, not measured" in batch.text(found)) is (speedup is not None)
    if speedup:  # Amdahl's law at 64 cores
        assert found["computed_for_64_cores"] == pytest.approx(600.0 / (0.05263 + 0.94737 / 64.0), rel=1e-3)


@pytest.mark.extended
def test_mujoco_is_pressed_too(tmp_path, monkeypatch):
    pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)
    organ = ball_of_cells()
    presses = presses_on(organ, 2)
    flex = PressedFlex(organ, 0.008, 0.02, 2)
    for depth in np.linspace(0.0, 0.004, 10):
        flex.step([0, 1], presses.place + [[0.008 - depth], [0.03]] * presses.outward, 1)
    assert flex.forces[0] > 0.005
    assert flex.forces[1] == 0.0
    assert not list(tmp_path.iterdir()), "MuJoCo writes no log"


@pytest.mark.extended
def test_the_command_prints_and_checks(tmp_path, capsys):
    ball_of_cells().save(tmp_path / "ball.npz")
    code = cli.main(["bench", "batch", str(tmp_path / "ball.npz"), "--copies", "4", "--seconds", "1", "--no-peers"])
    assert code == 0
    printed = capsys.readouterr().out
    assert "4 copies, each pressed by a ball" in printed
    assert PRESSED in printed
    cli.main(["bench", "batch", str(tmp_path / "ball.npz"), "--copies", "4", "--seconds", "1", "--no-peers", "--json"])
    assert {row["threads"] for row in json.loads(capsys.readouterr().out)["rows"]} >= {1, 2}
