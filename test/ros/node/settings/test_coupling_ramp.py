"""A coupling whose stiffness changes while the tool presses: the force goes to its new value, and not beyond."""

import numpy as np
import pytest

from helpers.ros.processes import poke_path, shipped
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.ros.node.settings.coupling_ramp import EASE_EVERY, nearer

TICKS = 1000  # a second


def press(stiffness):
    """A scene with a tool 5 mm deep in the default kidney, at rest."""
    scene, (touch, inward) = Scene([shipped()], [Tool("left")]), poke_path(shipped())
    scene.simulation.settings.coupling_stiffness = stiffness
    for depth in [*np.linspace(-0.002, 0.005, 350), *[0.005] * 300]:
        scene.move("left", touch + depth * inward)
        scene.step(1)
    return scene, touch + 0.005 * inward


def forces(before, after, in_steps):
    """N, at each tick after the stiffness began to change."""
    scene, place = press(before)
    settings, found = scene.simulation.settings, []
    for tick in range(TICKS):
        if tick % round(1e3 * EASE_EVERY) == 0:
            settings.coupling_stiffness = nearer(float(settings.coupling_stiffness), after) if in_steps else after
        scene.move("left", place)
        scene.step(1)
        found.append(np.linalg.norm(scene.wrenches[0, :3]))
    return np.array(found)


@pytest.mark.parametrize(("before", "after"), [(200.0, 0.0), (200.0, 2000.0), (2000.0, 200.0)])
def test_the_force_does_not_overshoot(before, after):
    eased, at_once = forces(before, after, True), forces(before, after, False)
    assert eased[-1] == pytest.approx(at_once[-1], rel=0.02), "to the same force"
    assert np.abs(np.diff(eased)).max() < 0.25 * np.abs(np.diff(at_once)).max()
    assert beyond(eased) < 0.04
    assert beyond(at_once) > 0.15, "what is measured here can be seen"


def beyond(found):
    """How far forces go beyond the last one, seen from the first of them, as a fraction of the last one."""
    is_rise = found[-1] > 0.2
    return (found.max() - found[-1] if is_rise else found[-1] - found.min()) / found[-1]


@pytest.mark.parametrize(("before", "after"), [(200.0, 0.0), (0.0, 200.0), (0.0, 3e5), (3e5, 1.0), (50.0, 50.0)])
def test_every_way_ends(before, after):
    now, steps = before, 0
    while now != after:
        now, steps = nearer(now, after), steps + 1
        assert steps < 400
