"""The viewer's picture: what is seen, and when."""

import numpy as np
import pytest
import trimesh

pytest.importorskip("viser")

from helpers.ros.picture import Server
from helpers.ros.stand_in import ball
from tissue_sim.rendering.appearance import SCALE, TISSUE
from tissue_sim.rendering.coloured_surface import light_of
from tissue_sim.rendering.organ_view import LABEL_GAP, LATER, VIEW, OrganView, label_place
from tissue_sim.ros.viewer.scene import InclusionView, LigamentView


def turn(view):
    """Turn until what was drawn last is shown."""
    for _ in range(LATER):
        view.turn()


def test_what_is_drawn_is_seen_some_turns_later_and_one_surface_at_any_time():
    server, (vertices, triangles) = Server(), ball()
    view = OrganView(server, vertices, triangles)
    before = server.seen()[0]
    np.testing.assert_allclose(before, vertices, atol=1e-7)
    for size in (0.004, 0.012, 0.0):
        moved = vertices + size * np.exp(-np.sum((vertices - vertices[0]) ** 2, axis=1) / 2e-4)[:, None]
        view.show(moved)
        for _ in range(LATER):
            np.testing.assert_array_equal(server.seen()[0], before)
            view.turn()
        before = server.seen()[0]
        np.testing.assert_allclose(before, moved, atol=1e-7)
        view.turn()
        np.testing.assert_array_equal(server.seen()[0], before)
    view.remove()
    assert all(handle.removed for handle in server.drawn.values())


@pytest.mark.parametrize("turns", [1, 2])  # pages of 40 and of 20 pictures a second
def test_an_organ_is_in_every_picture_of_a_browser_that_takes_several_turns_at_once(turns):
    """A browser shows nothing of a surface whose bytes are new to it: it reads them between two of its pictures."""
    server, (vertices, triangles) = Server(), ball()
    view, read, shown = OrganView(server, vertices, triangles), {}, []
    for number in range(12):
        for step in range(turns):
            view.turn()
            view.show(vertices + 1e-4 * (1 + number * turns + step))
        (name,) = (name for name, handle in server.drawn.items() if handle.visible)
        bytes_now = {name: handle.glb_data for name, handle in server.drawn.items()}
        assert number == 0 or read[name] == bytes_now[name], "it is not to be seen yet"
        read = bytes_now
        shown.append(server.seen()[0][0, 0])
    assert np.all(np.diff(shown[LATER - 1 :]) > 0.0), "and each picture is newer"


def test_colours_run_from_the_tissues_over_the_scale():
    server, (vertices, triangles) = Server(), ball()
    view = OrganView(server, vertices, triangles)
    moved = vertices.copy()
    moved[3, 2] += 0.004
    moved[5, 2] += 0.02
    view.show(moved)
    turn(view)
    _, colours = server.seen()
    np.testing.assert_allclose(colours[0], light_of(TISSUE), atol=0.005)
    np.testing.assert_allclose(colours[3], light_of(dict(SCALE)[4.0]), atol=0.02)
    np.testing.assert_allclose(colours[5], light_of(SCALE[-1][1]), atol=0.005)


def test_what_the_breath_carries_has_not_moved_in_itself():
    server, (vertices, triangles) = Server(), ball()
    view = OrganView(server, vertices, triangles, "liver")
    view.show(vertices + [0.0, 0.0, 0.02])
    turn(view)
    positions, colours = server.seen()
    np.testing.assert_allclose(positions, vertices + [0.0, 0.0, 0.02], atol=1e-7)
    assert np.ptp(colours, axis=0).max() == 0.0
    assert server.drawn["/organ/liver/name"].text == "liver"


def test_a_name_is_not_hidden_by_another_organ():
    """Two balls, one behind the other and higher up in the front: the name of the one behind goes below it."""
    vertices, _ = ball()
    away = VIEW / np.linalg.norm(VIEW)
    right = np.cross([0.0, 0.0, 1.0], away)
    up = np.cross(away, right / np.linalg.norm(right))
    size = np.ptp(vertices, axis=0).max()
    front = vertices + size * away + 0.5 * size * up
    np.testing.assert_allclose(label_place(front, vertices), front[np.argmax(front @ up)] + LABEL_GAP * up)
    np.testing.assert_allclose(label_place(vertices, front), vertices[np.argmin(vertices @ up)] - LABEL_GAP * up)


def test_ligaments_are_lines_that_follow():
    server = Server()
    view = LigamentView(server)
    ends = np.arange(12.0).reshape(2, 2, 3)
    view.show(ends)
    np.testing.assert_array_equal(server.drawn["/ligaments"].points, ends)
    view.show(ends + 1.0)
    np.testing.assert_array_equal(server.drawn["/ligaments"].points, ends + 1.0)
    view.show(ends[:0])
    assert server.drawn["/ligaments"].removed


def test_another_opacity_is_drawn_anew_once():
    server, (vertices, triangles) = Server(), ball()
    view = OrganView(server, vertices, triangles)
    assert not view.set_opacity(1.0)
    assert view.set_opacity(0.4)
    assert not view.set_opacity(0.4)
    view.show(vertices)
    turn(view)
    (one,) = (handle for handle in server.drawn.values() if handle.visible)
    assert b'"alphaMode": "BLEND"' in one.glb_data
    assert b"0.4]" in one.glb_data


def test_inclusions_go_along_with_their_organ():
    server, (vertices, triangles) = Server(), ball()
    inner = trimesh.creation.icosphere(1, 0.2 * np.abs(vertices).max())
    view = InclusionView(
        server, np.asarray(inner.vertices), np.asarray(inner.faces), OrganView(server, vertices, triangles)
    )
    view.show(1.2 * vertices + [0.0, 0.01, 0.0])
    mesh = server.drawn["/inclusions"]
    np.testing.assert_allclose(mesh.vertices, 1.2 * inner.vertices + [0.0, 0.01, 0.0], atol=1e-6)
    view.remove()
    assert mesh.removed
