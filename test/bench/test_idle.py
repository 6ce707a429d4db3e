"""The benchmark of an idle node: its bounds on made-up figures, and one short run with real processes."""

import json

import pytest

from tissue_sim.bench.idle import BARE, SENDING, SERVED, as_json, text
from tissue_sim.cli import main


def test_least_of_the_turns_is_held_against_the_bound():
    turns = [{SERVED: fraction, SENDING: 1.0, BARE: 0.1} for fraction in (9.0, 2.9, 4.0)]
    found = as_json(turns, 5.0)
    fraction, seen = found["bounds"]
    assert (fraction["value"], fraction["met"]) == (2.9, True)
    assert (seen["value"], seen["met"]) == (5.0, False)
    assert found["processor_load_percent"][SERVED] == {"least": 2.9, "median": 4.0, "most": 9.0}
    assert as_json(turns[:1], 0.1)["bounds"][0]["met"] is False
    lines = text(found).splitlines()
    assert "4 x" in next(line for line in lines if line.startswith(SENDING))
    assert "40 x" in next(line for line in lines if line.startswith(BARE))


@pytest.mark.extended
@pytest.mark.timeout(300)
def test_short_run_with_real_processes(tmp_path):
    file = tmp_path / "idle.json"
    assert main(["bench", "idle", "--seconds", "2", "--json", str(file)]) == 0
    found = json.loads(file.read_text())
    assert set(found["processor_load_percent"]) == {SERVED, SENDING, BARE}
    assert found["processor_load_percent"][SERVED]["least"] > 0.0


@pytest.mark.parametrize("benchmark", ["idle", "markers"])
def test_wrong_use_is_refused(benchmark, capsys):
    assert main(["bench", benchmark, "--seconds", "0"]) == 2
    assert "--seconds" in capsys.readouterr().err
    assert main(["bench", benchmark, "none.npz"]) == 2
    assert "none.npz" in capsys.readouterr().err
