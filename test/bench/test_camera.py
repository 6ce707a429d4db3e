"""The benchmark of the camera: its bounds on made-up figures, and one short run with real processes."""

import json

import pytest

from tissue_sim.bench import camera
from tissue_sim.bench.camera import ALONE, BESIDE, as_json, text
from tissue_sim.cli import main

TURN = {
    "late_percent": 1.0,
    "tick_p99_us": 200.0,
    "late_p99_us": 90.0,
    "ticks_per_second": 1000.0,
    "bare_late_percent": 0.5,
    "picture_ms": float("nan"),
}


def measured(late, pictures, bare=0.5):
    """A node without a camera whose ticks are late in 1 %, and the same beside one."""
    beside = TURN | {"late_percent": late, "bare_late_percent": bare, "pictures_hz": pictures, "picture_ms": 12.0}
    turns = {ALONE: [TURN] * 3, BESIDE: [beside, beside | {"late_percent": 90.0}, beside]}
    return as_json([{"realtime_priority": 0, "turns": turns}], [])


def test_bounds_are_held_or_missed():
    assert [bound["met"] for bound in measured(2.1, 29.5)["bounds"]] == [True, True]
    assert [bound["met"] for bound in measured(2.3, 28.0)["bounds"]] == [False, False]


def test_what_a_bare_loop_meets_there_is_not_the_nodes():
    assert measured(5.0, 30.0, bare=3.0)["bounds"][0]["met"]
    assert not measured(6.5, 30.0, bare=3.0)["bounds"][0]["met"]


def test_table_has_a_picture_only_beside_a_camera():
    without, beside = text(measured(1.0, 30.0)).splitlines()[3:5]
    assert without.split()[-1] == "-"
    assert beside.endswith("30.0 Hz    12.0 ms")


@pytest.mark.extended
@pytest.mark.timeout(300)
def test_short_run_with_real_processes(tmp_path, monkeypatch):
    pytest.importorskip("moderngl")
    monkeypatch.setattr(camera, "is_allowed", lambda _: False)
    monkeypatch.setattr(camera, "WARMING_UP", 4.0)
    monkeypatch.setattr(camera, "BARE", 0.2)
    file = tmp_path / "camera.json"
    assert main(["bench", "camera", "--seconds", "4", "--nice", "0", "--json", str(file)]) == 0
    without, beside = json.loads(file.read_text())["rows"]
    assert (without["camera"], beside["camera"]) == (ALONE, BESIDE)
    assert beside["pictures_hz"] > 0.0
    assert beside["picture_ms"] > 0.0
