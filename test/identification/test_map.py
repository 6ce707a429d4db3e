"""A map of stiffness: between places, away from them, and on the cells of an organ."""

import numpy as np
import pytest

from helpers.scenes import ball
from tissue_sim.calibration.cases import surface_of
from tissue_sim.errors import UserError
from tissue_sim.identification.fitted_organ import with_stiffness
from tissue_sim.identification.identify import Settings, identify
from tissue_sim.identification.measured import MeasuredPress, Measurement
from tissue_sim.identification.mixed_effects import Priors
from tissue_sim.identification.press_curves import curves_of
from tissue_sim.identification.stiffness_map import decaying, interpolated, spacing_of
from tissue_sim.identification.validation import places_of

FINGER = 0.007  # m


def test_between_places_values_lie_between_theirs():
    points = np.array([[x, y, 0.0] for x in range(4) for y in range(4)], dtype=float)
    values = points[:, 0] + 2.0 * points[:, 1]
    at = interpolated(points, values, points, 1e-3)
    np.testing.assert_allclose(at, values, atol=1e-5)
    middle = interpolated(points, values, np.array([[1.5, 1.5, 0.0]]), 1e-3)
    assert middle[0] == pytest.approx(1.5 + 3.0)
    assert spacing_of(points) == pytest.approx(1.0)


def test_far_from_places_nothing_is_known():
    points = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]])
    near, far = decaying(points, np.ones(2), np.array([[0.0, 0.0, 1e-4], [0.0, 0.1, 0.0]]), 5e-3)
    assert near == pytest.approx(1.0, abs=1e-3)
    assert far < 1e-3


def test_presses_that_are_near_share_a_place():
    points = np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0005, 0.0, 0.0], [0.04, 0.0, 0.0]])
    place = places_of(points, 0.003)
    assert place[0] == place[2]
    assert sorted(set(place.tolist())) == [0, 1, 2]
    assert places_of(np.full((3, 3), np.nan), 0.003).tolist() == [0, 1, 2]


def test_springs_hold_no_map():
    with pytest.raises(UserError, match="no cells"):
        with_stiffness(ball(), 1.0, {}, np.ones(0))


@pytest.mark.extended
def test_an_organ_that_is_stiffer_on_one_side_is_mapped(organ):
    middle = organ.rest_positions[organ.cell_nodes].mean(axis=1)
    phantom = with_stiffness(organ, 1.0, {}, np.where(middle[:, 0] > 0.0, 2.0, 1.0))
    surface = surface_of(organ)
    turn = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    directions = np.stack([np.cos(turn), np.sin(turn), np.full(12, 0.5)], axis=1)
    nodes = [int(np.argmax(surface.normal @ direction)) for direction in directions]
    depths = np.linspace(1e-4, 1.5e-3, 8)
    presses = [
        MeasuredPress(
            str(node),
            depths,
            depths,
            surface.positions[node] + FINGER * surface.normal[node],
            -surface.normal[node],
            np.zeros((0, 3)),
        )
        for node in nodes
    ]
    measurement = Measurement("phantom", FINGER, presses, [], [], True)
    deep = np.tile(depths, (12, 1))
    force = curves_of(phantom, measurement, 0.6).at(deep)[0]
    made = [one._replace(forces=own) for one, own in zip(presses, force, strict=True)]
    found = identify(organ, measurement._replace(presses=made), Settings(Priors(offset=2e-5)))
    assert found.held_out.mapped < 0.7 * found.held_out.one
    assert found.of_cells is not None
    stiffer = found.of_cells[(middle[:, 0] > 0.008) & (np.linalg.norm(middle, axis=1) > 0.025) & (middle[:, 2] > 0.0)]
    softer = found.of_cells[(middle[:, 0] < -0.008) & (np.linalg.norm(middle, axis=1) > 0.025) & (middle[:, 2] > 0.0)]
    assert np.median(stiffer) > 1.5 * np.median(softer)
    fitted = curves_of(found.organ, measurement, 0.6).at(deep)[0]
    assert np.median(np.abs(fitted[:, -1] / force[:, -1] - 1.0)) < 0.05
