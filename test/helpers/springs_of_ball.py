"""A filled ball whose springs the tests of the calibration fit."""

import numpy as np

from helpers.scenes import ball, changed, filled
from tissue_sim.calibration.elastic import Elastic
from tissue_sim.model.elasticity.assembly import assemble

ORGAN = changed(filled(ball(2), 12), return_stiffness=0.02)
MODEL = assemble(ORGAN)
SPRINGS = Elastic(MODEL)
START = SPRINGS.stiffness


def linear_answers(stiffness, force):
    """Displacements of the surface under forces, by the dense matrix."""
    matrix = SPRINGS.tangent(stiffness).toarray()
    load = np.zeros((len(force), MODEL.rest.size))
    load[:, : force[0].size] = force.reshape(len(force), -1)
    moved = np.zeros_like(load)
    moved[:, SPRINGS.free] = np.linalg.solve(matrix, load[:, SPRINGS.free].T).T
    return moved[:, : force[0].size].reshape(force.shape)
