"""Balls that slide over an organ: their tracks, and the ripple of their force."""

import numpy as np
import pytest

from helpers.scenes import RADIUS
from tissue_sim.bench.palpation import slides
from tissue_sim.bench.palpation.slides import ripple, track_over
from tissue_sim.contact import finder
from tissue_sim.contact.local_compliance import OF_OTHERS
from tissue_sim.organ.surfaces.surface_distance import distance_to_surface
from tissue_sim.organ.tool_resolution import mean_edge

SMALL = 0.8  # edges


def test_ripple_is_half_the_range_about_a_parabola():
    along = np.linspace(0.0, 1.0, 2000)
    smooth = 2.0 + 0.4 * along - 0.3 * along**2
    assert ripple(smooth) == pytest.approx(0.0, abs=1e-9)
    assert ripple(smooth + 0.1 * np.sin(80.0 * np.pi * along)) == pytest.approx(100.0 * 0.1 / smooth.mean(), rel=0.05)


def test_a_track_keeps_its_distance_from_the_facets(organ, places):
    track = track_over(organ, places[0][2], 0.004)
    edge = mean_edge(organ)
    np.testing.assert_allclose(track.along[[0, -1]], [-2.5 * edge, 1.5 * edge])
    distance = distance_to_surface(track.centres, organ.surface_positions, organ.surface_triangles)
    np.testing.assert_allclose(distance, 0.002, atol=2e-6)
    np.testing.assert_allclose(np.linalg.norm(track.centres, axis=1), RADIUS + 0.002, rtol=0.01)
    direction = track.centres / np.linalg.norm(track.centres, axis=1)[:, None]
    np.testing.assert_allclose(track.normals, direction, atol=0.05)


def test_a_ball_that_slides_feels_more_of_the_mesh_when_tissue_gives_way_as_to_jaws(organ, places, monkeypatch):
    monkeypatch.setattr(slides, "FRICTIONS", (0.0,))
    monkeypatch.setattr(slides, "SLIDING", 0.03)
    (good,) = slides.slides(organ, [SMALL], places)
    monkeypatch.setattr(finder, "OF_BALLS", OF_OTHERS)
    (poor,) = slides.slides(organ, [SMALL], places)
    assert 0.0 < good.force < poor.force
    assert poor.ripple > 1.2 * good.ripple


def test_friction_carries_the_surface_along(organ, places, monkeypatch):
    monkeypatch.setattr(slides, "SLIDING", 0.03)
    held, free = slides.slides(organ, [1.0], places)
    assert held.friction > free.friction == 0.0
    assert free.carried < 0.3 * held.carried
    assert 1e-4 < held.carried < mean_edge(organ)
