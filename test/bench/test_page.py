"""The benchmark of the page: its bound on made-up figures, what a picture is, and one short run with real processes."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from helpers.ros.two_machines import link_or_skip
from helpers.scenes import ball
from tissue_sim.bench import page
from tissue_sim.bench.page import as_json, text
from tissue_sim.cli import main
from tissue_sim.errors import UserError
from tissue_sim.organ.placement import placed

ORGANS = [ball(1), placed(ball(1), [0.2, 0.0, 0.0])]
SCENE = SimpleNamespace(names=("left", "right"), organs=ORGANS)


def found(hz):
    """Four seconds, in the last of which nothing moves."""
    times = {name: (100.0 + (np.arange(4 * rate) + 0.5) / rate).tolist() for name, rate in hz.items()}
    sent = 100.0 + (np.arange(180) + 0.5) / 60.0
    arrivals = {"began": 100.0, "came": {f"/organ/{name}": came for name, came in times.items()}, "bytes": 8_000_000}
    return as_json(SCENE, arrivals, sent.tolist(), {"the page": 20.0}, 4.0)


def test_least_of_the_organs_is_held_against_the_bound():
    result = found({"left": 40, "right": 31})
    assert result["bounds"][0]["value"] == pytest.approx(31.0)
    assert result["bounds"][0]["met"] is True
    assert (result["seconds"], result["megabytes_a_second"]) == (3, 2.0)
    assert found({"left": 40, "right": 29})["bounds"][0]["met"] is False
    assert found({"left": 40})["bounds"][0]["met"] is False, "one that never came"
    assert "31.0" in next(line for line in text(result).splitlines() if line.startswith("right"))


def test_a_node_that_sends_too_little_is_reported():
    with pytest.raises(UserError, match="never sent 50 surfaces in a second"):
        as_json(SCENE, {"began": 0.0, "came": {}, "bytes": 0}, [0.5], {}, 4.0)


def test_wrong_use_is_refused(capsys):
    assert main(["bench", "page", "--seconds", "0"]) == 2
    assert "--seconds" in capsys.readouterr().err
    assert main(["bench", "page", "--delay", "2"]) == 2
    assert "--delay 2 is outside 0..1" in capsys.readouterr().err
    assert main(["bench", "page", "--scene", "none.yaml"]) == 2
    assert "none.yaml" in capsys.readouterr().err


@pytest.mark.extended
@pytest.mark.timeout(600)
@pytest.mark.parametrize("place", [[], ["--delay", "0.01"]], ids=["here", "far"])
def test_short_run_with_real_processes(tmp_path, monkeypatch, place):
    pytest.importorskip("viser")
    if place:
        with link_or_skip():
            pass
    monkeypatch.setattr(page, "MOVING", 1)  # on a machine of any speed
    lines = ["format: 1", "organs:"]
    for name, organ in zip(SCENE.names, ORGANS, strict=True):
        organ.save(tmp_path / f"{name}.npz")
        lines.append(f"  - {{name: {name}, file: {name}.npz}}")
    scene, file = tmp_path / "balls.yaml", tmp_path / "page.json"
    scene.write_text("\n".join(lines))
    assert main(["bench", "page", "--seconds", "8", "--scene", str(scene), "--json", str(file), *place]) == 0
    result = json.loads(file.read_text())
    assert [row["organ"] for row in result["organs"]] == ["left", "right"]
    assert min(row["pictures_hz"] for row in result["organs"]) > 0.0
    assert result["megabytes_a_second"] > 0.0
    assert set(result["processor_load_percent"]) == {"the page", "the node", "a bare loop"}
