"""The gradient at a region's edge against displacements that have one."""

import numpy as np
import pytest

from helpers.kernels import by_reference
from helpers.scenes import ball, ball_of_cells, near
from tissue_sim.model.regions.edge_gradient import edge_gradient
from tissue_sim.model.simulation import Simulation

UP = (0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    "organ", [ball(3), pytest.param(ball_of_cells(), marks=pytest.mark.extended)], ids=["springs", "cells"]
)
def test_gradient_at_the_edge_is_that_of_the_best_fit(organ):
    simulation = Simulation(organ, local_region="modal")
    model, state, scratch = simulation.model, simulation.state, simulation.scratch
    simulation.apply_force(near(organ, UP)[0], [0.0, 0.0, -0.01])
    simulation.step()
    world = by_reference(simulation)
    edge = model.rest[scratch.boundary_node[: state.status.region_boundary]]
    gradient = 0.03 * np.random.default_rng(1).standard_normal((3, 3))
    scratch.edge_move[: edge.size] = (edge @ gradient.T + [0.001, 0.002, -0.004]).ravel()
    assert edge_gradient(world.model, world.state, world.scratch) == pytest.approx(np.linalg.norm(gradient), rel=0.02)
    state.status.region_boundary = 0
    assert edge_gradient(world.model, world.state, world.scratch) == 0.0
