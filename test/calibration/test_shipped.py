"""The calibrated organ that ships, against the finite-element body that it was fitted to."""

import numpy as np
import pytest

from helpers.scenes import assembled
from tissue_sim.calibration.elastic import Elastic
from tissue_sim.calibration.evaluation import errors
from tissue_sim.calibration.fem import Body
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import AS_BUILT, shipped_organ

GRAVITY = 9.81  # m/s^2


@pytest.fixture(scope="module")
def organ():
    return Organ.load(shipped_organ())


def test_it_is_the_organ_as_built_with_cells_and_says_how_good_they_are(organ):
    built = Organ.load(shipped_organ(AS_BUILT))
    np.testing.assert_array_equal(organ.surface_positions, built.surface_positions)
    np.testing.assert_array_equal(organ.surface_triangles, built.surface_triangles)
    np.testing.assert_array_equal(organ.fixed, built.fixed)
    assert "calibration" not in built.provenance
    smooth = organ.provenance["calibration"]["held_out"]["smooth"]
    assert smooth["settled"] == smooth["cases"] >= 30
    assert 0.0 < smooth["mean_percent"] < smooth["worst_percent"]


@pytest.mark.extended
def test_it_sags_under_gravity_as_finite_elements_do(organ):
    """A load that no case of the fit is like: it acts on every node, by its mass."""
    for module in ("skfem", "netgen"):
        pytest.importorskip(module)
    model = assembled(organ)
    elastic = Elastic(model)
    factor = elastic.factor(elastic.tangent(elastic.stiffness))
    body = Body(organ)
    for direction in np.eye(3):
        wanted = body.settle_linear(np.zeros((1, organ.n_surface, 3)), GRAVITY * direction)
        found = np.zeros(model.rest.size)
        found[elastic.free] = factor.solve((GRAVITY * organ.mass[:, None] * direction).ravel()[elastic.free])
        found = found.reshape(-1, 3)[: organ.n_surface]
        assert found.mean(axis=0) @ direction > 1e-3
        assert errors(found[None], wanted)[0] < 0.05
