"""The benchmark of markers: its bounds on made-up figures, and one short run with real processes."""

import json

import pytest

from tissue_sim.bench import markers
from tissue_sim.bench.markers import SENDING, SERVED, as_json, text, turn
from tissue_sim.cli import main


def measured(percent, hz):
    one = {SERVED: {"percent": percent, "hz": hz}, SENDING: {"percent": 1.0, "hz": 60.0}}
    return {"plain": [one] * 3, "coloured": [one, one | {SERVED: {"percent": 99.0, "hz": hz}}, one]}


def test_bounds_are_held_or_missed():
    assert [bound["met"] for bound in as_json(measured(2.9, 60.0))["bounds"]] == [True] * 4
    assert [bound["met"] for bound in as_json(measured(3.1, 49.0))["bounds"]] == [False] * 4


def test_cost_is_that_of_the_rate_that_was_asked_for():
    """One percent of a core for 10 a second are 1 ms each, and six percent for 60."""
    (plain, _) = as_json(measured(1.0, 10.0))["rows"]
    assert plain[SERVED]["us_each"] == pytest.approx(1000.0)
    assert plain[SERVED]["percent_at_rate"] == pytest.approx(6.0)
    assert "6 x" in text(as_json(measured(1.0, 10.0)))


def test_turn_is_what_a_subscriber_adds(monkeypatch):
    monkeypatch.setattr(markers, "TURN", 0.1)
    spent = [0.0]

    class Both:
        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def look(self, seconds):
            self.count = dict.fromkeys(markers.MARKERS.values(), 6)
            spent[0] += seconds
            markers.time.sleep(seconds)

    monkeypatch.setattr(markers, "SETTLING", 0.01)
    found = turn({SERVED: lambda: spent[0], SENDING: lambda: 0.0}, Both())
    assert found[SERVED]["hz"] == pytest.approx(60.0)
    assert 0.0 < found[SERVED]["percent"] <= 100.0
    assert found[SENDING]["percent"] == 0.0


@pytest.mark.extended
@pytest.mark.timeout(300)
def test_short_run_with_real_processes(tmp_path, monkeypatch):
    monkeypatch.setattr(markers, "TURN", 0.5)
    monkeypatch.setattr(markers, "COLOURS", {"coloured": "displacement"})
    file = tmp_path / "markers.json"
    assert main(["bench", "markers", "--seconds", "1", "--json", str(file)]) == 0
    (row,) = json.loads(file.read_text())["rows"]
    assert row["turns"] == 1
    assert set(row) == {"colouring", "turns", SERVED, SENDING}
