"""The sheet of a blade, from the places where it has been."""

import numpy as np
import pytest

from helpers.slabs import MIDDLE, SIZE, slab
from tissue_sim.errors import UserError
from tissue_sim.model.cutting.blade_path import BladePath

FORWARD, ALONG = np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0])
Y = np.linspace(0.0, SIZE[1], 9)


def line(depth, x=MIDDLE, y=Y):
    return np.stack([np.full(len(y), x), y, np.full(len(y), SIZE[2]) - depth], axis=1)


def pressed(*depths):
    """Path of an edge across the slab that is pressed down."""
    path = BladePath(slab(), 1)
    for depth in depths:
        path.note(line(depth), FORWARD, ALONG)
    return path


def test_an_edge_that_is_pressed_down_sweeps_a_rectangle():
    sheet = pressed(0.0, 0.004, 0.012).sheet()
    assert np.allclose(sheet.direction, FORWARD)
    assert sheet.reached == pytest.approx(0.012, abs=1e-6)
    assert np.ptp(sheet.polyline[:, 1]) == pytest.approx(SIZE[1], abs=1e-6)
    places = sheet.place(np.array([[MIDDLE, 0.01, SIZE[2] - 0.011], [MIDDLE, 0.01, SIZE[2] - 0.013]]))
    assert sheet.covers(places).tolist() == [True, False]


def test_an_inclined_edge_is_deeper_at_one_end():
    path = BladePath(slab(), 1)
    for deep in np.linspace(0.0, 1.0, 20):
        path.note(line(deep * np.linspace(0.004, 0.016, len(Y))), FORWARD, ALONG)
    sheet = path.sheet()
    order = np.argsort(sheet.polyline[:, 1])
    assert np.allclose(
        np.interp([0.006, 0.024], sheet.polyline[order, 1], sheet.depths[order]), [0.0064, 0.0136], atol=0.0015
    )


def test_an_edge_that_is_drawn_sweeps_what_its_tip_has_passed():
    """A scalpel: its edge stands upright and cuts along y, while x changes."""
    path = BladePath(slab(), 1)
    upright, ahead = np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0])
    for y in np.linspace(0.012, 0.024, 61):
        place = np.stack(
            [np.full(5, MIDDLE + 0.2 * (y - 0.012)), np.full(5, y), SIZE[2] - np.linspace(0.0, 0.01, 5)], axis=1
        )
        path.note(place, ahead, upright)
    sheet = path.sheet()
    assert sheet.direction[2] < -0.97
    ends = sheet.polyline[np.argsort(sheet.polyline[:, 1])][[0, -1]]
    assert np.allclose(ends[:, 1], [0.012, 0.024], atol=2e-3)
    assert ends[1, 0] - ends[0, 0] == pytest.approx(0.0024, abs=1e-3)
    assert sheet.reached == pytest.approx(0.01, abs=1.5e-3)


def test_it_is_opened_again_when_it_has_grown():
    path = pressed(0.004)
    assert path.has_grown
    first = path.sheet()
    path.note_opened()
    assert not path.has_grown
    assert path.is_open
    path.note(line(0.0045), FORWARD, ALONG)
    assert not path.has_grown
    path.note(line(0.009), FORWARD, ALONG)
    assert path.has_grown
    assert not path.is_open
    assert path.sheet().deepens(first)


def test_a_sheet_along_which_nothing_was_cut_is_not_open():
    path = pressed(0.004)
    path.sheet()
    assert not path.has_grown, "it is tried again when it has grown"
    assert not path.is_open
    path.note_opened()
    path.note(line(0.009), FORWARD, ALONG)
    path.sheet()
    assert not path.is_open


def test_blades_of_other_cuts_do_not_take_its_place():
    other = BladePath(slab(), 2)
    other.note(line(0.012), FORWARD, ALONG)
    assert not other.sheet().deepens(pressed(0.004).sheet())


def test_a_scratch_is_refused():
    with pytest.raises(UserError, match="too shallow"):
        pressed(0.0005).sheet()


def test_an_edge_that_returns_goes_on_with_its_cut():
    path = pressed(0.0, 0.01)
    assert path.continues(line(0.003), FORWARD, ALONG)
    assert not path.continues(line(0.003, x=MIDDLE + 0.012), FORWARD, ALONG)
    assert not path.continues(line(0.003), FORWARD, np.array([1.0, 0.0, 0.0]))


def test_blades_of_scissors_that_have_met_have_cut_through():
    path = pressed(0.0, 0.016)
    path.sheet()
    path.meet(line(0.024))
    assert not path.has_grown
    path.meet(line(0.0161))
    assert path.has_grown
    assert path.sheet().covers(path.sheet().place(np.array([[MIDDLE, 0.015, 0.001]]))).all()
