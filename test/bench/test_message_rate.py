"""What arrives: its bound on made-up figures, what it refuses, and one short run."""

import json

import pytest

from helpers.ros.two_machines import link_or_skip
from tissue_sim.bench.message_rate import as_json, text
from tissue_sim.cli import main


def rates(node, sender):
    return {"/tissue_sim/surface": node, "/sender/surface": sender}


def test_bound_is_held_or_missed():
    assert as_json("", rates(20.0, 40.0), 20.0)["bounds"][0]["met"]
    found = as_json("a link", rates(19.9, 40.0), 20.0)
    assert not found["bounds"][0]["met"]
    assert "a link" in text(found)
    assert "0.497 x" in text(found)
    assert text(as_json("", rates(19.9, 0.0), 20.0)).splitlines()[3].endswith("-")


@pytest.mark.parametrize(("option", "value"), [("--loss", "5"), ("--points", "5")])
def test_what_is_out_of_range_is_refused(option, value, capsys):
    assert main(["bench", "markers", option, value]) == 2
    assert f"{option} {value} is outside" in capsys.readouterr().err


@pytest.mark.extended
@pytest.mark.timeout(300)
def test_short_run_of_a_larger_organ(tmp_path):
    file = tmp_path / "large.json"
    assert main(["bench", "markers", "--points", "2000", "--seconds", "1", "--json", str(file)]) == 0
    assert set(json.loads(file.read_text())["arriving"]) == {"markers", "surface"}


@pytest.mark.extended
@pytest.mark.timeout(300)
def test_short_run_behind_a_link(tmp_path):
    with link_or_skip():
        pass
    file = tmp_path / "link.json"
    assert main(["bench", "markers", "--loss", "0.05", "--seconds", "1", "--json", str(file)]) == 0
    assert set(json.loads(file.read_text())["arriving"]) == {"surface"}
