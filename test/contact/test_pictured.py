"""A scene as an array of pixels, and on a page, without ROS."""

import sys
import time
import urllib.error
import urllib.request

import numpy as np
import pytest

from helpers.drawing import require_drawing
from helpers.patience import wait_for
from helpers.scenes import ball_of_cells
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.scene_copy import copied_scene
from tissue_sim.contact.tools import Tool
from tissue_sim.errors import UserError
from tissue_sim.rendering.pinhole import Pinhole, look_at

STEEL_IS_GREY = 30  # of 255: red less blue of what is metal; tissue is redder
EYE, SIZE = [0.0, -0.2, 0.0], (160, 120)
EDGE = [[-0.012, -0.032, 0.0], [0.012, -0.032, 0.0]]  # m, in front


def scene_of(*tools):
    return Scene(ball_of_cells(), list(tools) or [Tool("left", radius=0.006)])


def view(scene, **named):
    return scene.render(*SIZE, pose=look_at(EYE, [0.0, 0.0, 0.0]), **named)


def grey(picture):
    """Where something bright without colour is."""
    red, blue = picture[..., 0].astype(int), picture[..., 2].astype(int)
    return (red - blue < STEEL_IS_GREY) & (red > 60)


def test_a_tool_is_where_the_camera_has_to_see_it():
    require_drawing()
    scene = scene_of()
    alone = view(scene)
    assert alone.shape == (120, 160, 3)
    assert alone.dtype == np.uint8
    at = np.array([0.045, -0.02, 0.03])
    scene.move("left", at)
    scene.step()
    seen = view(scene)
    rows, columns = np.nonzero(grey(seen) & np.any(seen != alone, axis=2))
    lens = Pinhole.of_view(*SIZE, 60.0)
    expected = lens.project(np.array([[at[0], -at[2], at[1] - EYE[1]]]))[0]  # looking along +y, with z up
    np.testing.assert_allclose([columns.mean(), rows.mean()], expected, atol=1.0)


def test_what_moves_is_seen_and_a_reset_brings_the_first_picture_back():
    require_drawing()
    scene = scene_of()
    before = view(scene)
    np.testing.assert_array_equal(view(scene), before)
    for step in range(60):
        scene.move("left", [0.0, 0.0, 0.037 - 1e-4 * step])
        scene.step()
    assert np.any(view(scene) != before)
    scene.reset()
    np.testing.assert_array_equal(view(scene), before)
    scene.cut(0, EDGE, [0.0, 1.0, 0.0], 0.018)
    assert np.any(view(scene) != before), "its triangles are others"
    scene.reset()
    np.testing.assert_array_equal(view(scene), before)


def test_the_whole_organ_is_in_the_picture_unless_a_camera_is_placed():
    require_drawing()
    scene = scene_of()
    red = scene.render(64, 64)[..., 0] > 100
    assert red[16:48, 16:48].mean() > 0.9
    assert red[[0, -1]].mean() < 0.2, "a ball just touches the edges"
    assert red[:, [0, -1]].mean() < 0.2
    other = copied_scene(scene)
    np.testing.assert_array_equal(other.render(64, 64), scene.render(64, 64))
    assert other._painter is not scene._painter


def test_without_the_library_that_draws_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "moderngl", None)
    for name in ("tissue_sim.rendering.bodies", "tissue_sim.rendering.offscreen"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    with pytest.raises(UserError, match=r"pictures need moderngl: pip install 'tissue_sim\[camera\]'"):
        scene_of().render()


def test_without_viser_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    for name in ("scene_page", "organ_view", "page_server"):
        for folder in ("contact", "rendering"):
            monkeypatch.delitem(sys.modules, f"tissue_sim.{folder}.{name}", raising=False)
    with pytest.raises(UserError, match=r"a page needs viser: pip install 'tissue_sim\[viewer\]'"):
        scene_of().show()
    with pytest.raises(UserError, match=r"port 70000 is outside 0\.\.65535"):
        scene_of().show(70000)


def positions_on(page, name):
    """Vertices of the surface that is seen."""
    import trimesh

    view = page._views.get(name, (None, None))[1]
    if view is None:
        return np.zeros((0, 3))
    loaded = trimesh.load(trimesh.util.wrap_as_stream(view._seen.glb_data), file_type="glb", process=False)
    return np.asarray(next(iter(loaded.geometry.values())).vertices)


def shows(page, name, points):
    seen = positions_on(page, name)
    return seen.shape == points.shape and np.allclose(seen, points, atol=1e-6)


def test_a_page_shows_the_scene_as_it_was_at_its_last_update():
    pytest.importorskip("viser")
    scene = scene_of(Tool("left", radius=0.006), Tool("jaws", "gripper", radius=0.003, length=0.02))
    name = scene.names[0]
    with scene.show() as page:
        with urllib.request.urlopen(page.address) as answer:
            assert answer.status == 200
            assert "http://localhost:*" in answer.headers["Content-Security-Policy"], "a notebook may frame it"
        assert page.address in page._repr_html_()
        wait_for(lambda: shows(page, name, scene.surface_positions()), "the organ isn't shown")
        assert [body.visible for body in page._bodies] == [False] * 3
        rest = scene.surface_positions()
        for step in range(60):
            scene.move("left", [0.0, 0.0, 0.037 - 1e-4 * step])
            scene.step()
        time.sleep(0.1)
        assert shows(page, name, rest), "steps alone show nothing"
        page.update()
        wait_for(lambda: shows(page, name, scene.surface_positions()), "the press isn't shown")
        assert np.abs(scene.surface_positions() - rest).max() > 1e-3
        assert [body.visible for body in page._bodies] == [True, False, False]
        np.testing.assert_allclose(page._bodies[0].position, scene.simulation.state.body_pose[0, :3], atol=1e-6)
        scene.cut(0, EDGE, [0.0, 1.0, 0.0], 0.018)
        page.update()
        surface = scene.simulation.cut_organ.surface
        wait_for(lambda: shows(page, name, surface.at(scene.simulation.positions)), "the walls aren't shown")
    assert "closed" in repr(page)
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(page.address, timeout=5.0)


def test_a_port_that_is_taken_is_refused():
    pytest.importorskip("viser")
    with scene_of().show() as page, pytest.raises(UserError, match=f"port {page.port} of 127.0.0.1 is taken"):
        scene_of().show(page.port)
