"""The largest stable stiffness of a device in a loop: a known limit is found, and what is planted moves it."""

import json
from functools import partial

import numpy as np
import pytest

from tissue_sim.bench import haptics
from tissue_sim.bench.device_loop import (
    STIFFEST,
    Holder,
    Link,
    ObservedPort,
    Trial,
    Wall,
    hard_ball,
    stable_stiffness,
    tried,
)
from tissue_sim.bench.devices import DEVICES, NO_HAND, Device, Moving
from tissue_sim.bench.haptics import Bare, Cell, Row, as_json, coupled, dry_limit, text
from tissue_sim.bench.haptics_plot import drawn
from tissue_sim.cli import main
from tissue_sim.figures import png
from tissue_sim.model.contact.virtual_coupling import passive_stiffness

VISCOUS = Device("viscous", mass=0.1, damping=1.0, friction=0.0, quantum=0.0, most_force=1e3, source="test")
AT_ONCE = Link(transport=0.0, smoothed=False)  # sample and hold, and nothing else


def found_at_wall(device=VISCOUS, link=AT_ONCE):
    return stable_stiffness(Wall(is_held=True), Holder(device, link))


@pytest.mark.parametrize("damping", [0.5, 1.0, 2.0])
def test_sampled_wall_is_stable_up_to_twice_the_damping_over_the_period(damping):
    """Colgate and Schenkel's limit, to which a wall of a mass with little damping comes close."""
    found = found_at_wall(VISCOUS._replace(damping=damping))
    assert found == pytest.approx(2.0 * damping / 1e-3, rel=0.1)


@pytest.mark.parametrize(
    "link",
    [
        Link(500.0, transport=0.0, smoothed=False),
        Link(delay=0.002, transport=0.0, smoothed=False),
        Link(delay=0.010, transport=0.0, smoothed=False),
        Link(smoothed=False),
    ],
)
def test_period_and_delay_count_as_theory_says(link):
    expected = passive_stiffness(VISCOUS.damping, link.period, link.lag)
    assert found_at_wall(link=link) == pytest.approx(expected, rel=0.1)


def test_planted_delay_lowers_what_is_found_and_planted_damping_raises_it():
    as_it_is = found_at_wall()
    assert found_at_wall(link=AT_ONCE._replace(delay=0.001)) < 0.5 * as_it_is
    assert found_at_wall(VISCOUS._replace(damping=2.0)) == pytest.approx(2.0 * as_it_is, rel=0.12)
    assert found_at_wall(VISCOUS._replace(friction=0.05)) > 1.1 * as_it_is, "dry friction bears more"


def test_device_falls_as_its_data_say():
    """Pushed with 0.5 N, without tissue: the steady speed is what damping and dry friction leave."""
    device = VISCOUS._replace(friction=0.1, damping=4.0)
    moving = Moving(device, NO_HAND, 0.5, 0.0)
    before = 0.0
    for _ in range(400):
        before = moving.place
        moving.advance(0.0)
    assert (moving.place - before) / 1e-3 == pytest.approx(-(0.5 - 0.1) / 4.0, rel=1e-3)
    stuck = Moving(device._replace(friction=0.6), NO_HAND, 0.5, 0.0)
    stuck.advance(0.0)
    assert stuck.place == 0.0
    weak = Moving(device._replace(most_force=0.2), NO_HAND, 0.5, 0.0)
    weak.advance(100.0)
    assert weak.place < 0.0, "the actuator gives no more than it can"


def test_encoder_tells_whole_quanta():
    moving = Moving(VISCOUS._replace(quantum=1e-4), NO_HAND, 0.0, 2.7e-4)
    assert moving.measured == pytest.approx(2e-4)


def trial(places, device=VISCOUS):
    return Trial(np.asarray(places), np.ones(len(places)), device.finest)


def test_a_limit_cycle_is_reported_from_what_decays_and_from_the_encoders_own():
    time = np.linspace(0.0, 40.0 * np.pi, 800)
    assert trial(1e-3 * np.sin(time)).swings
    assert not trial(1e-3 * np.exp(-0.05 * time) * np.sin(time)).swings
    assert not trial(1e-6 * np.sin(time)).swings
    assert trial(np.append(np.zeros(100), 0.02)).swings, "thrown off"


def test_hard_ball_bears_what_theory_allows():
    """Of the tick that the node runs: well within theory at rest, well beyond it not."""
    holder = Holder(DEVICES[-1], Link(500.0, 0.005))
    theory = passive_stiffness(holder.damping, holder.link.period, holder.link.lag)
    ball = hard_ball()
    rests = tried(ball, holder, 0.8 * theory)
    assert not rests.swings
    assert rests.forces[-1] == pytest.approx(0.5, abs=0.05), "N: the hand's push"
    assert tried(ball, holder, 1.5 * theory).swings


@pytest.mark.extended
@pytest.mark.parametrize("rate", [1000.0, 250.0])
def test_textbook_device_is_found_where_theory_puts_it(rate):
    rows = [coupled(Cell(DEVICES[-1], Link(rate, delay), False, False)) for delay in (0.0, 0.010)]
    assert all(0.95 < row.ratio < 1.25 for row in rows)
    assert rows[0].found > 1.5 * rows[1].found


def row(found=1000.0, device="Touch", observed=None):
    return Row(device, 1000.0, 0.001, found, observed, 2000.0, 800.0)


def test_a_wrong_figure_misses_its_bound():
    uncoupled = [Bare("Touch", 100.0, 0.005), Bare("Premium 1.5", 100.0, None)]
    right = as_json([row(), row(device="textbook")], uncoupled)
    assert [bound["met"] for bound in right["bounds"]] == [True, True]
    too_soft = as_json([row(700.0), row(device="textbook")], uncoupled)
    assert [bound["met"] for bound in too_soft["bounds"]] == [False, True]
    blind = as_json([row(), row(STIFFEST, "textbook", observed=900.0)], uncoupled)
    assert [bound["met"] for bound in blind["bounds"]] == [True, False, False], "and an observer that does not help"
    lines = text(blind).splitlines()
    assert any(line.split() == ["Touch", "1000", "1", "1000", "2000", "800", "1.25", "-", "-"] for line in lines)
    assert ">= 20000" in text(blind)
    assert any(line.split() == ["Premium", "1.5", "100", "none"] for line in lines)
    assert png(drawn(blind), 140.0)


def test_dry_limit():
    assert dry_limit(DEVICES[0]) == pytest.approx(2.0 * 0.26 / 55e-6)
    assert dry_limit(VISCOUS) is None


def test_observer_raises_what_a_wall_bears_and_knows_the_delay():
    link = Link(delay=0.005, smoothed=False)
    holder = Holder(VISCOUS, link)
    without = stable_stiffness(Wall(is_held=True), holder)
    observed = stable_stiffness(Wall(is_held=True), holder._replace(port=partial(ObservedPort, holder)))
    assert observed > 1.25 * without
    blind = Holder(VISCOUS, link._replace(delay=0.0))
    assert stable_stiffness(Wall(is_held=True), holder._replace(port=partial(ObservedPort, blind))) < observed


@pytest.mark.extended
def test_short_run(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(haptics, "RATES", (1000.0,))
    monkeypatch.setattr(haptics, "DELAYS", (0.005,))
    file = tmp_path / "haptics.json"
    assert main(["bench", "haptics", "--json", str(file), "--out", str(tmp_path), "--check"]) == 0
    found = json.loads(file.read_text())
    assert len(found["rows"]) == 5
    assert len(found["uncoupled"]) == 3
    assert "haptics.png" in capsys.readouterr().err
