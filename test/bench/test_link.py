"""The benchmark of a lossy link: its bound on made-up figures, what it refuses, and one short run."""

import json

import pytest

from tissue_sim.bench.link import SURFACES, as_json, text
from tissue_sim.cli import main
from tissue_sim.ros.probes.lossy_link import Unavailable, lossy_link


def test_bound_is_held_or_missed():
    node, sender = SURFACES
    assert as_json(0.05, {node: 20.0, sender: 40.0})["bounds"][0]["met"]
    found = as_json(0.05, {node: 19.9, sender: 40.0})
    assert not found["bounds"][0]["met"]
    assert "loses 5 %" in text(found)
    assert "0.497 x" in text(found)
    assert "-" in text(as_json(0.05, {node: 19.9, sender: 0.0}))


def test_share_out_of_range_is_refused(capsys):
    assert main(["bench", "markers", "--loss", "5"]) == 2
    assert "--loss 5 is outside" in capsys.readouterr().err


@pytest.mark.timeout(300)
def test_short_run_with_real_processes(tmp_path):
    try:
        with lossy_link(0.0, 0.0):
            pass
    except Unavailable as reason:
        pytest.skip(str(reason))
    file = tmp_path / "link.json"
    assert main(["bench", "markers", "--loss", "0.05", "--seconds", "1", "--json", str(file)]) == 0
    assert set(json.loads(file.read_text())["come_hz"]) == set(SURFACES)
