"""An organ somewhere else is the same organ."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.scenes import ball, kidney
from tissue_sim.errors import UserError
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.placement import placed

TURN = Rotation.from_rotvec([0.4, -1.1, 0.7])


def test_every_node_is_turned_and_moved():
    organ = placed(kidney(), [0.1, -0.2, 0.05], TURN.as_quat())
    wanted = TURN.apply(kidney().rest_positions) + [0.1, -0.2, 0.05]
    np.testing.assert_allclose(organ.rest_positions, wanted, atol=1e-15)
    assert organ.volume == pytest.approx(kidney().volume, rel=1e-12)
    np.testing.assert_array_equal(placed(kidney()).rest_positions, kidney().rest_positions)


def test_it_answers_a_load_that_is_turned_with_it_as_before():
    force = np.zeros((ball().n_surface, 3))
    force[int(np.argmax(ball().surface_positions[:, 2]))] = [0.02, 0.01, -0.05]
    settled, _ = Simulation(ball()).settle(force)
    there, _ = Simulation(placed(ball(), [0.0, 0.1, 0.0], TURN.as_quat())).settle(TURN.apply(force))
    np.testing.assert_allclose(there, TURN.apply(settled), atol=1e-3 * np.abs(settled).max())


@pytest.mark.parametrize(
    ("position", "quaternion"),
    [((0, 0), (0, 0, 0, 1)), ((0, 0, np.nan), (0, 0, 0, 1)), ((0, 0, 0), (0, 0, 0, 2)), ((0, 0, 0), (0, 0, 1))],
)
def test_numbers_that_are_no_pose_are_refused(position, quaternion):
    with pytest.raises(UserError, match="organ's"):
        placed(ball(), position, quaternion)
