"""Demiray's b: it comes back from presses of tissue that stiffens, and is not used for tissue that doesn't."""

import json
from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball, ball_of_cells
from tissue_sim.cli import main
from tissue_sim.errors import UserError
from tissue_sim.identification.force_curves import hertz, tabulated
from tissue_sim.identification.identify import EXPONENTIAL, NEO_HOOKEAN, Settings, identify
from tissue_sim.identification.law_curves import PRESSED, law_curves_of, place_of, stiffening_at
from tissue_sim.identification.measured import MeasuredPress, Measurement, Samples
from tissue_sim.identification.mixed_effects import Priors, fitted
from tissue_sim.identification.press_curves import curves_of
from tissue_sim.identification.stiffening import law_fit, line_of
from tissue_sim.identification.validation import held_out
from tissue_sim.organ.organ import Organ

FINGER, MODULUS, FACTOR = 0.007, 10e3, 0.63  # m, Pa
COUNT = 10
DEPTHS = np.tile(np.concatenate([np.linspace(-1e-3, -1e-4, 6), np.linspace(1e-4, 4e-3, 20)]), (COUNT, 1))
POINTS = 0.02 * np.stack([np.arange(COUNT), np.zeros(COUNT), np.zeros(COUNT)], axis=1)
PRIORS = Priors(offset=1e-4)


def stiffening_press(organ):
    """Hertz's force, and the exponential's factor for a strain of 0.4 of the contact's radius over the ball's."""
    depth, force = hertz(FINGER, MODULUS, 0.45, 6e-3)
    exponent = organ.stiffening * 0.16 * depth / FINGER
    return tabulated([depth], [force * np.exp(exponent)], np.zeros(COUNT, dtype=np.int64))


ORGAN = ball_of_cells(1, 20)
CURVES = law_curves_of(ORGAN, stiffening_press(ORGAN), stiffening_press)


def measured(b, random, noise=0.02):
    depths = DEPTHS + 1e-4 * random.normal(size=(COUNT, 1))
    force = FACTOR * stiffening_press(replace(ORGAN, stiffening=b)).at(depths)[0]
    force = force * np.exp(0.02 * random.normal(size=(COUNT, 1)))
    force = force * (1.0 + noise * random.normal(size=force.shape)) + 0.1 * noise * random.normal(size=force.shape)
    return Samples(DEPTHS, force + 0.01, np.ones_like(force))


def found_in(samples):
    plain = held_out(CURVES.plain, samples, POINTS, FINGER, PRIORS)
    return law_fit(CURVES, samples, PRIORS, POINTS, FINGER, plain)


def test_places_of_b_go_from_0_to_1_and_back():
    assert place_of(PRESSED)[[0, -1]] == pytest.approx([0.0, 1.0])
    np.testing.assert_allclose(stiffening_at(place_of(PRESSED)), PRESSED, atol=1e-12)


@pytest.mark.parametrize("b", [1.0, 7.0, 30.0])
def test_curves_between_the_values_that_were_pressed(b):
    found = CURVES.under(np.array([place_of(b)])).at(DEPTHS)[0]
    wanted = stiffening_press(replace(ORGAN, stiffening=b)).at(DEPTHS)[0]
    np.testing.assert_allclose(found, wanted, rtol=1e-2, atol=1e-6)
    near = CURVES.under(np.array([place_of(b) + 1e-4])).at(DEPTHS)[0]
    slope = CURVES.changes(np.array([place_of(b)]))[0].at(DEPTHS)[0]
    np.testing.assert_allclose(slope, (near - found) / 1e-4, rtol=2e-2, atol=1e-3)


def test_b_and_the_modulus_come_back_without_noise():
    samples = measured(12.0, np.random.default_rng(0), noise=0.0)
    fit = fitted(CURVES, samples, PRIORS)
    assert stiffening_at(fit.law[0]) == pytest.approx(12.0, rel=0.02)
    assert fit.factor == pytest.approx(FACTOR, rel=0.06)


def test_intervals_hold_b_and_the_law_is_used():
    random, held = np.random.default_rng(1), 0
    for _ in range(4):
        found = found_in(measured(12.0, random)).stiffening
        held += found.low < 12.0 < found.high
        assert found.pays
        assert found.high < 30.0
    assert held >= 3, "of a 95 % interval"
    assert "; used: " in line_of(found)
    assert "can't distinguish tissue that stiffens from a thin layer" in line_of(found)


def test_tissue_that_does_not_stiffen_keeps_its_law():
    random = np.random.default_rng(2)
    for _ in range(4):
        found = found_in(measured(0.0, random)).stiffening
        assert not found.pays
        assert found.low < 0.3
        assert found.as_json()["law"] == NEO_HOOKEAN
    assert "; not used: " in line_of(found)


def test_an_open_interval_is_reported():
    forces = measured(40.0, np.random.default_rng(3)).forces
    found = found_in(Samples(DEPTHS, forces * (1.0 + 100.0 * np.maximum(DEPTHS, 0.0)), np.ones_like(forces))).stiffening
    assert found.high == np.inf
    assert "or more" in line_of(found)
    assert json.loads(json.dumps(found.as_json()))["fitted_stiffening_interval_95_percent"][1] is None


def test_a_single_place_does_not_choose_a_law():
    samples = measured(20.0, np.random.default_rng(4))
    found = law_fit(CURVES, samples, PRIORS, np.zeros((COUNT, 3)), FINGER, None).stiffening
    assert not found.pays
    assert "single place" in line_of(found)


def test_an_organ_of_springs_is_refused():
    press = MeasuredPress("one", DEPTHS[0], DEPTHS[0], np.full(3, np.nan), np.full(3, np.nan), np.zeros((0, 3)))
    with pytest.raises(UserError, match="has no cells"):
        identify(ball(2), Measurement("", 0.02, [press], [], [], False), Settings(law=EXPONENTIAL))


# with the model --------------------------------------------------------------------------------
THUMB = 0.012  # m, radius


def table_of(organ, path):
    """Presses of an organ by the model, where it is flat, with noise, as a CSV."""
    depths, random = np.linspace(3e-4, 6e-3, 16), np.random.default_rng(5)
    nowhere = np.full(3, np.nan)
    press = MeasuredPress("", depths, depths, nowhere, nowhere, np.zeros((0, 3)))
    curves = curves_of(organ, Measurement("", THUMB, [press], [], [], False), 0.6)
    rows = ["press,depth,force"]
    for number in range(8):
        force = FACTOR * curves.at(depths[None] + 5e-5 * random.normal())[0][0] * np.exp(0.02 * random.normal())
        force = force * (1.0 + 0.01 * random.normal(size=len(depths)))
        rows += [f"{number},{depth},{one}" for depth, one in zip(depths, force, strict=True)]
    path.write_text("\n".join(rows))


@pytest.mark.extended
@pytest.mark.parametrize("b", [0.0, 15.0])
def test_the_command_fits_b_where_the_tissue_has_one(tmp_path, capsys, monkeypatch, b):
    monkeypatch.chdir(tmp_path)
    organ = ball_of_cells(2, 60)
    organ.save("ball.npz")
    table_of(replace(organ, stiffening=b), tmp_path / "presses.csv")
    given = ["identify", "ball.npz", "--csv", "presses.csv", "--radius", f"{THUMB}", "--out", "fitted.npz"]
    assert main([*given, "--law", "exponential", "--json", "found.json"]) == 0
    printed, found = capsys.readouterr().out, json.loads((tmp_path / "found.json").read_text())
    fitted_organ = Organ.load("fitted.npz")
    low, high = found["fitted_stiffening_interval_95_percent"]
    assert low - 0.2 <= b <= high
    assert fitted_organ.youngs_modulus == pytest.approx(FACTOR * organ.youngs_modulus, rel=0.06)
    if b:
        assert found["law"] == "exponential"
        assert fitted_organ.stiffening == pytest.approx(found["fitted_stiffening"])
        assert "; used: " in printed
    else:
        assert found["law"] == "neo-hookean"
        assert fitted_organ.stiffening == 0.0
        assert "; not used: " in printed
