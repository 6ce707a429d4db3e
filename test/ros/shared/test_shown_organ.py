"""Rows that stand for an organ: its nodes, and the points of its walls."""

import numpy as np
import pytest

from helpers.ros.processes import shipped
from tissue_sim.model.simulation import Simulation
from tissue_sim.ros.shared.shown_organ import ShownOrgan


@pytest.fixture(scope="module")
def cut():
    return Simulation(shipped()).cut([[0.055, 0.0, 0.0], [0.075, 0.0, 0.0]], [0.0, 1.0, 0.0], 0.03)


def test_an_uncut_organ_is_its_nodes():
    organ = shipped()
    shown = ShownOrgan(organ)
    assert shown.n_rows == organ.n_nodes
    np.testing.assert_array_equal(shown.rest, organ.rest_positions)
    np.testing.assert_array_equal(shown.triangle_rows, organ.surface_triangles)


def test_a_cut_organ_is_shown_with_its_walls_as_its_nodes_move(cut):
    shown, surface = ShownOrgan.of(cut), cut.cut_organ.surface
    assert shown.n_rows == shipped().n_nodes + len(surface.nodes) - shipped().n_surface
    moved = cut.organ.rest_positions + np.random.default_rng(2).normal(scale=1e-3, size=(cut.organ.n_nodes, 3))
    rows = np.zeros((shown.n_rows, 3))
    shown.fill(rows, moved)
    np.testing.assert_allclose(shown.points(rows), surface.at(moved), atol=1e-15)
    np.testing.assert_allclose(rows[shown.triangle_rows], surface.at(moved)[surface.triangles], atol=1e-15)
    np.testing.assert_array_equal(rows[: shipped().n_nodes], moved[: shipped().n_nodes])


def test_places_on_a_scale_are_between_those_of_the_nodes(cut):
    shown = ShownOrgan.of(cut)
    fraction, rows = np.random.default_rng(3).uniform(size=cut.organ.n_nodes), np.zeros(shown.n_rows)
    shown.fill(rows, fraction)
    assert 0.0 <= rows.min() <= rows.max() <= 1.0
