"""Balls at nodes, on edges, in triangles, and sliding: what is measured, what the bounds say, and what moves them."""

import json

import numpy as np
import pytest

from helpers.scenes import RADIUS, ball_of_cells
from tissue_sim.bench import palpation_places
from tissue_sim.bench.palpation_places import (
    KINDS,
    SLAB,
    Pressed,
    Slid,
    as_json,
    by_elements,
    flat_places,
    parse_radii,
    presses,
    ripple,
    slab_as_built,
    slides,
    text,
    thickness,
    track_over,
)
from tissue_sim.cli import main
from tissue_sim.contact import finder
from tissue_sim.contact.local_compliance import OF_OTHERS
from tissue_sim.organ.fineness import mean_edge
from tissue_sim.organ.surfaces.surface_distance import distance_to_surface

SMALL = 0.8  # edges


@pytest.fixture(scope="module")
def organ():
    return ball_of_cells()


@pytest.fixture(scope="module")
def places(organ):
    return flat_places(organ, 1)


@pytest.fixture
def shallow(monkeypatch):
    """One depth, quickly."""
    monkeypatch.setattr(palpation_places, "DEPTHS", np.array([0.3]))


def one_newton(_organ, spots, _radius, depths):
    return np.ones((len(spots), len(depths)))


def beside(pressed):
    """A reference that pushes back as those presses did."""
    return lambda *_: np.array([one.ours for one in pressed])


def test_places_are_clear_of_the_clamp_and_of_each_other(organ):
    places = flat_places(organ, 3)
    assert [[spot.kind for spot in spots] for spots in places] == [list(KINDS)] * 3
    points = np.array([[spot.point for spot in spots] for spots in places])
    held, edge = organ.surface_positions[organ.fixed], mean_edge(organ)
    assert np.linalg.norm(points.reshape(-1, 1, 3) - held, axis=2).min() > 4.0 * edge
    assert min(np.linalg.norm(points[a] - points[b], axis=1).min() for a, b in ((0, 1), (0, 2), (1, 2))) > 4.0 * edge
    np.testing.assert_allclose(np.linalg.norm(points[:, 0], axis=1), RADIUS)
    assert (np.linalg.norm(points[:, 2], axis=1) < RADIUS - 1e-5).all(), "in a triangle the ball is chamfered"
    for spots in places:
        np.testing.assert_allclose(spots[0].way, -spots[2].point / np.linalg.norm(spots[2].point), atol=0.02)
        assert thickness(organ, spots[2]) == pytest.approx(2.0 * RADIUS, rel=0.02)


@pytest.mark.usefixtures("shallow")
def test_small_balls_are_worse_when_tissue_gives_way_to_them_as_to_jaws(organ, places, monkeypatch):
    good = list(presses(organ, [SMALL], places, one_newton))
    same = as_json(list(presses(organ, [SMALL], places, beside(good))), [])
    assert same["bounds"][1]["value"] == pytest.approx(0.0, abs=1e-6)
    monkeypatch.setattr(finder, "OF_BALLS", OF_OTHERS)
    poor = as_json(list(presses(organ, [SMALL], places, beside(good))), [])
    (row,) = poor["radii"]
    assert row["triangle"]["worst_percent"] > 15.0
    assert poor["bounds"][1]["met"] is False


@pytest.mark.usefixtures("shallow")
def test_a_force_that_is_a_tenth_too_large_shifts_all_of_them_by_ten_percent(organ, places, monkeypatch):
    good = list(presses(organ, [1.0], places, one_newton))
    plain = palpation_places.forces
    monkeypatch.setattr(palpation_places, "forces", lambda *given: 1.1 * plain(*given))
    found = as_json(list(presses(organ, [1.0], places, beside(good))), [])
    for kind in KINDS:
        assert found["radii"][0][kind]["median_percent"] == pytest.approx(10.0, abs=1e-3)
    assert found["bounds"][0]["met"] is False


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
    way = track.centres / np.linalg.norm(track.centres, axis=1)[:, None]
    np.testing.assert_allclose(track.normals, way, atol=0.05)


def test_a_ball_that_slides_feels_more_of_the_mesh_when_tissue_gives_way_as_to_jaws(organ, places, monkeypatch):
    monkeypatch.setattr(palpation_places, "FRICTIONS", (0.0,))
    monkeypatch.setattr(palpation_places, "SLIDING", 0.03)
    (good,) = slides(organ, [SMALL], places)
    monkeypatch.setattr(finder, "OF_BALLS", OF_OTHERS)
    (poor,) = slides(organ, [SMALL], places)
    assert 0.0 < good.force < poor.force
    assert poor.ripple > 1.2 * good.ripple


def pressed_of(radius, kind, *off):
    reference = np.array([0.1, 0.2, 0.4])
    return Pressed(radius, 0, kind, np.array([0.3, 0.5, 0.8]), (1.0 + 0.01 * np.array(off)) * reference, reference)


def test_bounds_take_the_worst_of_their_radii_and_leave_out_what_did_not_settle():
    pressed = [pressed_of(radius, kind, -9.0, 1.0, 2.0) for radius in (0.5, 2.0) for kind in KINDS]
    pressed[-1].reference[1:] = np.nan
    slid = [Slid(0.5, 0, 0.6, 0.1, 30.0), Slid(2.0, 0, 0.6, 0.1, 4.0), Slid(2.0, 1, 0.6, 0.1, 6.0)]
    found = as_json(pressed, slid)
    assert [bound["met"] for bound in found["bounds"]] == [False, True, False]
    assert [bound["value"] for bound in found["bounds"]] == pytest.approx([9.0, 9.0, 6.0])
    last = found["radii"][1]["triangle"]
    assert (last["compared"], last["unsettled"]) == (1, 2)
    told = text(found | {"organ": "egg", "edge_m": 0.004, "places": 2})
    assert "-9.0 %" in told
    assert "did not converge 2 times" in told
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert [bound["met"] for bound in as_json([], [])["bounds"]] == [None] * 3


@pytest.mark.parametrize(
    ("given", "what"),
    [
        (["--radii", "1"], "need --places"),
        (["--slab"], "need --places"),
        (["--places", "0"], "outside 1..100"),
        (["--places", "1", "--radii", "one"], "are not numbers"),
        (["--places", "1", "--radii", "0.01"], "outside 0.2..5"),
        (["organ.npz", "--places", "1", "--slab"], "choose one"),
    ],
)
def test_what_cannot_be_pressed_is_refused(given, what, capsys):
    assert main(["bench", "palpation", *given]) == 2
    assert what in capsys.readouterr().err


def test_radii_are_read():
    assert parse_radii("0.5,2") == (0.5, 2.0)
    assert parse_radii(None)[0] == 0.5


@pytest.mark.extended
def test_finite_elements_push_back_as_hertz_has_it_at_every_kind_of_place(organ, places):
    radius = 1.5 * mean_edge(organ)
    depths = radius * np.array([0.2, 0.4])
    found = by_elements(organ, places[0], radius, depths)
    stiffness = organ.youngs_modulus / (1.0 - organ.poisson_ratio**2)
    hertz = 4.0 / 3.0 * stiffness * np.sqrt(1.0 / (1.0 / radius + 1.0 / RADIUS)) * depths**1.5
    np.testing.assert_allclose(found, np.broadcast_to(hertz, (3, 2)), rtol=0.25)
    np.testing.assert_allclose(found, np.broadcast_to(found.mean(axis=0), (3, 2)), rtol=0.1)


@pytest.mark.extended
def test_the_whole_of_it_runs_on_an_organ(organ, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(palpation_places, "DEPTHS", np.array([0.4]))
    organ.save(tmp_path / "ball.npz")
    given = [str(tmp_path / "ball.npz"), "--places", "1", "--radii", "2", "--json", str(tmp_path / "found.json")]
    assert main(["bench", "palpation", *given]) == 0
    found = json.loads((tmp_path / "found.json").read_text())
    assert len(found["presses"]) == 3
    assert [one["friction"] for one in found["slides"]] == [0.6, 0.0]
    assert found["radii"][0]["node"]["unsettled"] == 0
    assert "bound" in capsys.readouterr().out


@pytest.mark.extended
def test_the_slab_has_its_size():
    organ = slab_as_built()
    np.testing.assert_allclose(np.ptp(organ.surface_positions, axis=0), SLAB, rtol=0.02)
    assert 0.003 < mean_edge(organ) < 0.005
