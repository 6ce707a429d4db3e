"""Force kernels against naive twins, and against the gradient of the energy that they state."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.naive import angular_energy, naive_angular, naive_returns, naive_springs, return_energy, spring_energy
from helpers.scenes import ball, kidney
from tissue_sim.model.data.blocks import BLOCK, pack
from tissue_sim.model.elasticity import forces as module
from tissue_sim.model.elasticity.assembly import assemble, packed
from tissue_sim.model.elasticity.energy import energy_of
from tissue_sim.model.elasticity.forces import (
    SHORTEST,
    edge_forces,
    elastic_forces,
    return_forces,
    spring_forces,
    subtract_linear_edges,
    subtract_linear_springs,
)
from tissue_sim.model.elasticity.modes import stiffness_matrix
from tissue_sim.model.regions.reduction import reduce_model

MODEL = assemble(ball())
EDGE = 0.017  # m


def deformed(size=0.2, seed=0):
    """Positions of the ball, every node displaced by about `size` of an edge."""
    return MODEL.rest + size * EDGE * np.random.default_rng(seed).standard_normal(MODEL.rest.shape)


# kernels and their twins, N --------------------------------------------------------------------
def without_angular(model):
    none = {name: getattr(model, name)[:0] for name in model._fields if name.startswith("angular_")}
    return packed(model._replace(**none))


def without_springs(model):
    return packed(
        model._replace(**{name: getattr(model, name)[:0] for name in model._fields if name.startswith("spring_")})
    )


def springs(x, model=MODEL):
    force, links = np.zeros_like(x), without_angular(model).links
    spring_forces(x, links.nodes, links.constants, np.zeros(9 * BLOCK), force)
    return force


def angular(x, model=MODEL):
    force, edges = np.zeros_like(x), without_springs(model).edges
    edge_forces(x, edges.nodes, edges.constants, np.zeros(9 * BLOCK), force)
    return force


def everything(x, model=MODEL):
    """Both kinds on the same edges, as the tick has them."""
    force = np.zeros_like(x)
    elastic_forces(model, x, 1.0, force)
    return force


def returns(x, model=MODEL):
    force = np.zeros_like(x)
    return_forces(x, model.rest, model.return_nodes, model.return_stiffness, force)
    return force


CASES = {
    "springs": (springs, naive_springs, spring_energy),
    "angular": (angular, naive_angular, angular_energy),
    "return": (returns, naive_returns, return_energy),
    "everything": (
        everything,
        lambda x, model: naive_springs(x, model) + naive_angular(x, model) + naive_returns(x, model),
        lambda x, model: spring_energy(x, model) + angular_energy(x, model) + return_energy(x, model),
    ),
}
each_kernel = pytest.mark.parametrize("case", CASES)


@each_kernel
@pytest.mark.parametrize("size", [1e-3, 0.2, 2.0])
def test_kernel_equals_its_naive_twin(case, size):
    kernel, twin, _ = CASES[case]
    x = deformed(size)
    expected = twin(x, MODEL)
    assert np.abs(expected).max() > 1e-6
    assert np.abs(kernel(x) - expected).max() <= 1e-12 * np.abs(expected).max()


@each_kernel
def test_force_is_minus_the_gradient_of_the_energy(case):
    """The complex step gives the gradient to the last digits, without a difference."""
    kernel, _, energy = CASES[case]
    x = deformed()
    gradient = np.zeros_like(x)
    for index in np.ndindex(x.shape):
        moved = x.astype(complex)
        moved[index] += 1e-30j
        gradient[index] = energy(moved, MODEL).imag / 1e-30
    assert np.abs(kernel(x) + gradient).max() <= 1e-12 * np.abs(gradient).max()


@each_kernel
def test_force_is_the_difference_of_the_energy(case):
    kernel, _, energy = CASES[case]
    x = deformed()
    direction = np.random.default_rng(1).standard_normal(x.shape)
    direction *= 1e-7
    slope = (energy(x + direction, MODEL) - energy(x - direction, MODEL)) / 2.0
    assert -np.vdot(kernel(x), direction) == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize("case", ["springs", "angular"])
def test_internal_forces_have_no_resultant_and_no_moment(case):
    x = deformed()
    force = CASES[case][0](x)
    assert np.abs(force.sum(axis=0)).max() <= 1e-13 * np.abs(force).sum()
    assert np.abs(np.cross(x, force).sum(axis=0)).max() <= 1e-13 * np.linalg.norm(np.cross(x, force), axis=1).sum()


@each_kernel
@pytest.mark.parametrize("organ", [ball, kidney])
def test_rest_shape_has_no_force(case, organ):
    model = assemble(organ())
    rest = CASES[case][0](model.rest, model)
    bent = CASES[case][0](model.rest + 1e-3 * np.random.default_rng(0).standard_normal(model.rest.shape), model)
    assert np.abs(rest).max() <= 1e-12 * np.abs(bent).max()


@pytest.mark.parametrize("case", ["springs", "angular"])
def test_rigid_motion_gives_no_force(case):
    turned = Rotation.from_rotvec([0.7, -1.9, 0.4]).apply(MODEL.rest) + [0.2, -0.1, 0.05]
    scale = np.abs(CASES[case][0](deformed())).max()
    assert np.abs(CASES[case][0](turned)).max() <= 1e-11 * scale


@pytest.mark.parametrize("case", ["springs", "angular"])
def test_force_turns_with_the_shape(case):
    turn = Rotation.from_rotvec([0.7, -1.9, 0.4])
    x = deformed()
    force = CASES[case][0](x)
    assert np.abs(CASES[case][0](turn.apply(x)) - turn.apply(force)).max() <= 1e-12 * np.abs(force).max()


def test_angular_spring_bends_back_and_knows_inside_from_outside():
    """A ridge pressed flat pushes its edge outward again; one pressed inward does so harder."""
    i, j = MODEL.angular_nodes[0, :2]
    outward = MODEL.rest[[i, j]].sum(axis=0)
    outward /= np.linalg.norm(outward)
    pushes = []
    for depth in (0.0, 0.1 * EDGE, 0.3 * EDGE, 0.6 * EDGE):
        x = MODEL.rest.copy()
        x[[i, j]] -= depth * outward
        pushes.append(angular(x)[[i, j]].sum(axis=0) @ outward)
    assert pushes[0] == pytest.approx(0.0, abs=1e-12)
    assert np.all(np.diff(pushes) > 0.0)


def test_collapsed_pair_of_triangles_keeps_the_gradient_of_a_bounded_energy():
    least_area = 1e6 * MODEL.angular_least_area  # every pair counts as collapsed
    model = MODEL._replace(angular_least_area=least_area)
    x = deformed()
    gradient = np.zeros_like(x)
    for index in np.ndindex(x.shape):
        moved = x.astype(complex)
        moved[index] += 1e-30j
        gradient[index] = angular_energy(moved, model).imag / 1e-30
    force = angular(x, model)
    assert np.abs(gradient).max() > 0.0
    assert np.abs(force + gradient).max() <= 1e-12 * np.abs(gradient).max()


def test_triangles_without_area_give_finite_forces():
    i, j, k, m = MODEL.angular_nodes[0]
    x = MODEL.rest.copy()
    x[k] = x[m] = x[j] = x[i]
    assert np.all(np.isfinite(angular(x)))


def two_nodes(length, rest=0.01, stiffness=50.0):
    """Force on the second of two nodes that a spring joins, along it."""
    x, force = np.array([[0.0, 0.0, 0.0], [0.0, length, 0.0]]), np.zeros((2, 3))
    blocks = pack(np.array([[0, 1]]), np.array([[1.0 / rest, stiffness]]), np.array([1.0, 0.0]))
    spring_forces(x, blocks.nodes, blocks.constants, np.zeros(9 * BLOCK), force)
    assert np.array_equal(force[0], -force[1])
    return force[1, 1]


def test_spring_follows_equation_1_and_fades_where_its_ends_meet():
    for length in (0.002, 0.005, 0.01, 0.03):
        assert two_nodes(length) == pytest.approx(-50.0 * (length - 0.01), abs=1e-15)
    assert two_nodes(0.001) == pytest.approx(0.5 * two_nodes(0.002))
    assert two_nodes(0.0) == 0.0
    # Passing through itself it never jumps.
    path = [two_nodes(length) for length in np.linspace(-0.004, 0.004, 801)]
    assert np.abs(np.diff(path)).max() <= 50.0 * 1e-5 * (1.0 / SHORTEST - 1.0) * 1.001


def test_energy_of_a_state_is_that_of_the_twins():
    random = np.random.default_rng(3)
    x, v = deformed(2.0), random.standard_normal(MODEL.rest.shape)
    energy = energy_of(MODEL, x, v)
    elastic = spring_energy(x, MODEL) + angular_energy(x, MODEL) + return_energy(x, MODEL)
    assert energy.elastic == pytest.approx(elastic, rel=1e-12)
    kinetic = sum(0.5 / MODEL.inverse_mass[node] * v[node] @ v[node] for node in MODEL.moving)
    assert energy.kinetic == pytest.approx(kinetic, rel=1e-12)


def test_forces_times_a_factor_take_the_place_of_what_is_there():
    x = deformed()
    force = np.full_like(x, np.nan)
    elastic_forces(MODEL, x, 0.7, force)
    np.testing.assert_allclose(force, 0.7 * everything(x), rtol=1e-12)


def test_linear_forces_are_the_stiffness_matrix_times_the_displacement():
    x, force = deformed(), np.zeros_like(MODEL.rest)
    reduction, work = reduce_model(MODEL), np.zeros(9 * BLOCK)
    subtract_linear_edges(x, MODEL.edges.nodes, reduction.edge_slopes, work, force)
    subtract_linear_springs(x, MODEL.links.nodes, reduction.link_slopes, work, force)
    without_return = MODEL._replace(return_nodes=MODEL.return_nodes[:0])
    expected = stiffness_matrix(without_return) @ (x - MODEL.rest).ravel()
    assert np.abs(force.ravel() - expected).max() <= 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("count", [0, 1, BLOCK - 1, BLOCK, BLOCK + 1])
def test_blocks_hold_every_spring_once_and_fill_up_with_none(count):
    nodes = np.stack([np.zeros(count, dtype=int), np.ones(count, dtype=int)], axis=1)
    blocks = pack(nodes, np.tile([2.0, 2.0], (count, 1)), np.array([1.0, 0.0]))
    assert len(blocks.nodes) == -(-count // BLOCK)
    x, force = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.zeros((2, 3))
    spring_forces(x, blocks.nodes, blocks.constants, np.zeros(9 * BLOCK), force)
    assert force[0, 2] == pytest.approx(count * 2.0 * 0.5)


@each_kernel
def test_kernel_without_the_compiler_agrees(case, monkeypatch):
    compiled = CASES[case][0](deformed())
    for name, kernel in list(vars(module).items()):
        if hasattr(kernel, "py_func"):
            monkeypatch.setattr(module, name, kernel.py_func)
            if name in globals():
                monkeypatch.setitem(globals(), name, kernel.py_func)
    assert np.abs(CASES[case][0](deformed()) - compiled).max() <= 1e-12 * np.abs(compiled).max()
