"""What the node reads of its running loop."""

import time

import numpy as np
import pytest

from helpers.scenes import ball
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.model.joined import Joined
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.physics import Physics


def test_contact_forces_are_of_whole_ticks():
    """Whenever they are read, an organ that is pressed shows who presses it: no frame of a viewer goes dark."""
    organ = ball(2)
    scene = Scene(organ, [Tool("left", "sphere", 0.005)])
    scene.simulation.settings.stale_time = 1e9  # a busy machine is no stale hand
    top = organ.surface_positions[np.argmax(organ.surface_positions[:, 2])]
    for height in np.linspace(0.008, 0.003, 300):
        scene.move(0, top + (0.0, 0.0, height))
        scene.step()
    held = np.append(top + (0.0, 0.0, 0.003), (0.0, 0.0, 0.0, 1.0))
    physics = Physics(Loop(Joined([scene.simulation])))
    physics.post_contacts(scene.contacts)
    physics.post_pose(0, held)
    physics.loop.start()
    try:
        while physics.results().status.touching == 0:
            time.sleep(1e-3)
        for _ in range(300):
            physics.post_pose(0, held)
            _, wrenches = physics.wrenches()
            forces = physics.contact_forces()
            assert forces.sum() == pytest.approx(np.linalg.norm(wrenches[0, :3]), rel=0.3)
            time.sleep(3e-4)  # at other phases of a tick
    finally:
        physics.loop.stop()
    assert wrenches[0, 2] > 0.01, "N, in the hand"
