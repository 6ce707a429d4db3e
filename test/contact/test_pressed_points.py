"""Points that press on the tissue, and the normals of a ball there, against closed forms."""

import numpy as np

from helpers.slabs import MIDDLE, SIZE, slab
from tissue_sim.contact.pressed_points import pressed_points
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool

RADIUS = 0.004


def test_normals_of_a_ball_point_from_its_middle_and_what_is_away_does_not_press():
    scene = Scene(slab(), [Tool("left", radius=RADIUS)])
    for depth in np.linspace(-0.001, 0.002, 40):
        scene.move("left", [MIDDLE, 0.5 * SIZE[1], SIZE[2] + RADIUS - depth])
        scene.step()
    state = scene.simulation.state
    found = pressed_points(state, scene.simulation.shapes)
    assert len(found.entries) > 3
    assert np.all(state.contact_pressed[0, found.entries] > 0.0)
    away = found.places - state.body_pose[found.bodies, :3]
    np.testing.assert_allclose(found.normals, away / np.linalg.norm(away, axis=1, keepdims=True), atol=1e-12)
    assert np.all(found.normals[:, 2] < 0.0)
    scene.move("left", [MIDDLE, 0.5 * SIZE[1], SIZE[2] + 0.05])
    scene.step(50)
    assert not len(pressed_points(state, scene.simulation.shapes).entries)
