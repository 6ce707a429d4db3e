"""What the node reads of its running loop."""

import time

import numpy as np
import pytest

from helpers.scenes import ball
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.model.mailboxes import JOURNAL_ROWS
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.physics import Physics, unread_rows


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
    physics = Physics(Loop(scene.joined))
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


def test_rows_of_a_journal_are_read_once_and_none_that_the_loop_may_write_meanwhile():
    assert unread_rows(3, 7).tolist() == [3, 4, 5, 6]
    assert len(unread_rows(7, 7)) == 0
    late = unread_rows(10, 2 * JOURNAL_ROWS)
    assert (len(late), late[0], late[-1]) == (JOURNAL_ROWS - 64, 64, JOURNAL_ROWS - 1)
