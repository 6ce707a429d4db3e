"""A small organ's springs, from which fits begin, and what they answer by the dense matrix."""

import numpy as np

from tissue_sim.calibration.static import Springs
from tissue_sim.model.assembly import assemble

from ..scenes import ball, changed, filled

ORGAN = changed(filled(ball(2), 12), return_stiffness=0.02)
MODEL = assemble(ORGAN)
SPRINGS = Springs(MODEL)
START = SPRINGS.stiffness_of(MODEL)
TRUTH = START * np.exp(0.5 * np.random.default_rng(7).standard_normal(len(START)))


def linear_answers(stiffness, force):
    """Displacements of the surface under forces, by the dense matrix."""
    matrix = SPRINGS.rest_tangent(stiffness).toarray()
    load = np.zeros((len(force), MODEL.rest.size))
    load[:, : force[0].size] = force.reshape(len(force), -1)
    moved = np.zeros_like(load)
    moved[:, SPRINGS.free] = np.linalg.solve(matrix, load[:, SPRINGS.free].T).T
    return moved[:, : force[0].size].reshape(force.shape)
