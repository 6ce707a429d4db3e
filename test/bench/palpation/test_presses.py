"""Balls that are pressed in, beside finite elements: what is measured, and what moves it."""

import numpy as np
import pytest

from helpers.scenes import RADIUS
from tissue_sim.bench.palpation import presses
from tissue_sim.bench.palpation.balls import as_json
from tissue_sim.contact import finder
from tissue_sim.contact.local_compliance import OF_OTHERS
from tissue_sim.identification.places import KINDS
from tissue_sim.organ.tool_resolution import mean_edge

SMALL = 0.8  # edges


@pytest.fixture
def shallow(monkeypatch):
    """One depth, quickly."""
    monkeypatch.setattr(presses, "DEPTHS", np.array([0.3]))


def one_newton(_organ, spots, _radius, depths):
    return np.ones((len(spots), len(depths)))


def beside(pressed):
    """A reference that pushes back as those presses did."""
    return lambda *_: np.array([one.ours for one in pressed])


@pytest.mark.extended
@pytest.mark.usefixtures("shallow")
def test_small_balls_are_worse_when_tissue_gives_way_to_them_as_to_jaws(organ, places, monkeypatch):
    good = list(presses.presses(organ, [SMALL], places, one_newton))
    same = as_json(list(presses.presses(organ, [SMALL], places, beside(good))), [])
    assert same["bounds"][1]["value"] == pytest.approx(0.0, abs=1e-6)
    monkeypatch.setattr(finder, "OF_BALLS", OF_OTHERS)
    poor = as_json(list(presses.presses(organ, [SMALL], places, beside(good))), [])
    (row,) = poor["radii"]
    assert row["triangle"]["worst_percent"] > 15.0
    assert poor["bounds"][1]["met"] is False


@pytest.mark.usefixtures("shallow")
def test_a_force_that_is_a_tenth_too_large_shifts_all_of_them_by_ten_percent(organ, places, monkeypatch):
    good = list(presses.presses(organ, [1.0], places, one_newton))
    plain = presses.forces
    monkeypatch.setattr(presses, "forces", lambda *given: 1.1 * plain(*given))
    found = as_json(list(presses.presses(organ, [1.0], places, beside(good))), [])
    for kind in KINDS:
        assert found["radii"][0][kind]["median_percent"] == pytest.approx(10.0, abs=1e-3)
    assert found["bounds"][0]["met"] is False


@pytest.mark.extended
def test_finite_elements_push_back_as_hertz_has_it_at_every_kind_of_place(organ, places):
    radius = 1.5 * mean_edge(organ)
    depths = radius * np.array([0.2, 0.4])
    found = presses.by_elements(organ, places[0], radius, depths)
    stiffness = organ.youngs_modulus / (1.0 - organ.poisson_ratio**2)
    hertz = 4.0 / 3.0 * stiffness * np.sqrt(1.0 / (1.0 / radius + 1.0 / RADIUS)) * depths**1.5
    np.testing.assert_allclose(found, np.broadcast_to(hertz, (3, 2)), rtol=0.25)
    np.testing.assert_allclose(found, np.broadcast_to(found.mean(axis=0), (3, 2)), rtol=0.1)
