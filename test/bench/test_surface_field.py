"""The finite-element body at places between its nodes, and its answers for other surfaces of the same body."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from helpers.scenes import ball

pytest.importorskip("skfem", reason="the body needs the extra calibration")
pytest.importorskip("netgen", reason="the body needs the extra calibration")

from tissue_sim.bench.organs import patch_load
from tissue_sim.bench.peers.tetrahedra import UNGRADED
from tissue_sim.bench.sizes import divided, reassembled, sized
from tissue_sim.bench.surface_field import answers, sampling
from tissue_sim.calibration.fe_mesh import fill
from tissue_sim.calibration.fem import Body

ORGAN = ball(1)
POINTS, TRIANGLES = divided(ORGAN.surface_positions, ORGAN.surface_triangles, 500)


@pytest.fixture(scope="module")
def body():
    return Body(ORGAN)


def pushes():
    force = np.zeros((2, ORGAN.n_surface, 3))
    for number, case in enumerate(force):
        nodes, forces = patch_load(ORGAN, 0.01, 3 + number)
        case[nodes] = forces
    return force


def test_places_are_found_on_facets_with_quarter_points(body):
    corner, middle = body.filling.nodes[body.filling.facets[:, :3]], body.filling.nodes[body.filling.facets[:, 3]]
    assert np.linalg.norm(middle - corner[:, :2].mean(axis=1), axis=1).max() > 1e-4, "no quarter points"
    np.testing.assert_allclose(sampling(body.filling, POINTS) @ body.filling.nodes, POINTS, atol=1e-12)


def test_quadratic_fields_are_met_between_the_nodes():
    filling = fill(ORGAN, grading=UNGRADED)

    def field(x):
        return np.stack([x[:, 0] ** 2 - x[:, 1] * x[:, 2], 1.0 + x[:, 2] ** 2], axis=1)

    found = sampling(filling, POINTS) @ field(filling.nodes)
    edge = np.linalg.norm(np.diff(ORGAN.surface_positions[ORGAN.surface_triangles], axis=1), axis=2).max()
    clear = cKDTree(ORGAN.surface_positions[ORGAN.fixed]).query(POINTS)[0] > edge  # of quarter points
    assert clear.sum() > len(POINTS) / 2
    np.testing.assert_allclose(found[clear], field(POINTS[clear]), atol=1e-12)


def test_finer_surface_has_the_bodys_own_answer_at_its_points(body):
    wanted = body.settle_linear(pushes())
    own = answers(body, sized(ORGAN, ORGAN), pushes())
    np.testing.assert_allclose(own, wanted, atol=1e-12 * np.abs(wanted).max())
    finer = answers(body, sized(reassembled(ORGAN, POINTS, TRIANGLES, 0), ORGAN), pushes())
    np.testing.assert_allclose(finer[:, : ORGAN.n_surface], wanted, atol=1e-9 * np.abs(wanted).max())
    assert np.abs(finer[:, ORGAN.n_surface :]).max() < 1.1 * np.abs(wanted).max()


def test_coarser_surface_is_asked_for_what_comes_closest(body):
    coarse = ball(0)
    size = sized(coarse, ORGAN)
    wanted = body.settle_linear(pushes())
    found = answers(body, size, pushes())
    for case, target in zip(found, wanted, strict=True):
        off = np.linalg.norm(size.displacement(case) - target)
        assert off < np.linalg.norm(size.displacement(size.reached(target)) - target)
        for nudge in np.random.default_rng(0).standard_normal((5, *case.shape)):
            assert off < np.linalg.norm(size.displacement(case + 1e-3 * np.abs(case).max() * nudge) - target)
