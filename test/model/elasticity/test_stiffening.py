"""Cells that stiffen: a naive twin, the gradient of the energy, closed forms, and the steps that stay stable."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from helpers.bars import bar
from helpers.naive import naive_cells
from helpers.scenes import RADIUS, ball, uneven
from tissue_sim.errors import UserError
from tissue_sim.model.data.blocks import BLOCK
from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.model.elasticity.cell_groups import cell_forces
from tissue_sim.model.elasticity.cells import cell_energy, cells_of, tissue_of
from tissue_sim.model.elasticity.frequency import largest_frequency
from tissue_sim.model.elasticity.stiffening import ALLOWED, MOST, ROWS, exponential, exponents_for, undistorted
from tissue_sim.model.simulation import Simulation

B = 8.0
EDGE = 0.009  # m


PLAIN = uneven(ball(2))
ORGAN = replace(PLAIN, stiffening=B)
MODEL = assemble(ORGAN)


def shaken(size, seed=1):
    return MODEL.rest + size * EDGE * np.random.default_rng(seed).standard_normal(MODEL.rest.shape)


def forces(x, model=MODEL):
    force = np.zeros_like(x)
    cell_forces(x, model.tissue, 1.0, force)
    return force


def energy(x, model=MODEL):
    return cell_energy(x, model.rest, model.tissue)


def naive_stiffening(x, model, b):
    """Forces, N, that a group adds: the stress of its mean distortion on the faces of each cell, one after the other.

    Also the exponents of all groups.
    """
    force, exponents = np.zeros_like(x), []
    cells, (mu, _), _ = cells_of(model.tissue)
    for members in (group[group >= 0] for group in model.tissue.groups.cells if group.max() >= 0):
        parts, whole, mean = [], 0.0, 0.0
        for c in members:
            nodes = cells[c]
            rest = (model.rest[nodes[1:]] - model.rest[nodes[0]]).T
            gradient = (x[nodes[1:]] - x[nodes[0]]).T @ np.linalg.inv(rest)
            weight, away = mu[c] * np.linalg.det(rest) / 6.0, np.linalg.det(gradient) - 1.0
            cofactor = np.stack([np.cross(gradient[(i + 1) % 3], gradient[(i + 2) % 3]) for i in range(3)])
            same, slope = 3.0 + 2.0 * away - away**2 / 3.0, 2.0 - 2.0 / 3.0 * away
            whole, mean = whole + weight, mean + weight * (np.sum(gradient**2) - same)
            parts.append((nodes, rest, weight * (2.0 * gradient - slope * cofactor)))
        exponents.append(np.clip(b * mean / whole, 0.0, MOST))
        for nodes, rest, stress in parts:
            push = 0.5 * np.expm1(exponents[-1]) * stress @ np.linalg.inv(rest).T
            force[nodes[1:]] -= push.T
            force[nodes[0]] += push.sum(axis=1)
    return force, np.array(exponents)


# the law ---------------------------------------------------------------------------------------
@pytest.mark.parametrize(("size", "most"), [(0.001, 1e-3), (0.05, 0.999 * MOST), (0.4, MOST)])
def test_forces_are_those_of_the_naive_twin(size, most):
    x = shaken(size)
    added, exponents = naive_stiffening(x, MODEL, B)
    assert exponents.max() <= most
    assert (exponents.max() == MOST) == (size > 0.1)
    wanted = naive_cells(x, MODEL) + added
    assert np.abs(forces(x) - wanted).max() < 1e-9 * np.abs(wanted).max()


@pytest.mark.parametrize("size", [0.02, 0.05, 0.15, 0.6])
def test_forces_are_the_slope_of_the_energy_squeezed_and_inside_out_too(size):
    x, way = shaken(size), np.random.default_rng(2).standard_normal(MODEL.rest.shape)
    step = 1e-7 * EDGE
    slope = (energy(x + step * way) - energy(x - step * way)) / (2.0 * step)
    assert -np.vdot(forces(x), way) == pytest.approx(slope, rel=1e-6)


def test_forces_have_no_sum_and_no_torque():
    x = shaken(0.1)
    force = forces(x)
    assert np.abs(force.sum(axis=0)).max() < 1e-12 * np.abs(force).sum()
    assert np.abs(np.cross(x, force).sum(axis=0)).max() < 1e-12 * np.abs(force).sum() * RADIUS


def test_the_exponential_is_right_to_nine_digits_and_one_below_zero():
    exponents = np.linspace(0.0, MOST, 1001)
    found = np.array([exponential(value) for value in exponents])
    np.testing.assert_allclose(found, np.exp(exponents), rtol=1e-9)
    assert found[0] == 1.0
    assert np.all(np.diff(found) > 0.0)
    below = -np.geomspace(1e-9, 1e60, 1001)
    np.testing.assert_array_equal([exponential(value) for value in below], 1.0)


def test_a_volume_without_distortion_is_that_of_the_closed_form():
    volume = np.linspace(0.8, 1.2, 41)
    found = np.array([undistorted(4.0 - v) for v in volume])
    np.testing.assert_allclose(found / 3.0, 3.0 * volume ** (2.0 / 3.0), atol=1.4e-3)


def test_compressed_cells_are_those_of_neo_hookean_tissue():
    """A squeeze of the volume alone needs no shorter substeps, and lists the cells nevertheless."""
    plain = assemble(PLAIN)
    for x, factor in ((0.77 * MODEL.rest, 1), (shaken(0.4), 4)):
        listed = []
        for model in (MODEL, plain):
            forces(x, model)
            cells = model.tissue.groups.cells.ravel()[model.tissue.compressed_cells[: model.tissue.stiff[0]]]
            listed.append(sorted(cells))
        assert listed[0] == listed[1]
        assert listed[0]
        assert MODEL.tissue.shortening[0] == factor


def test_a_change_of_volume_alone_does_not_stiffen():
    plain = assemble(PLAIN)
    for size in (0.97, 1.03):
        stiff, soft = forces(size * MODEL.rest), forces(size * MODEL.rest, plain)
        assert np.abs(stiff - soft).max() < 1e-3 * np.abs(soft).max()


def test_rest_and_its_tangent_are_neo_hookean():
    plain = assemble(PLAIN)
    assert np.abs(forces(MODEL.rest)).max() < 1e-12 * np.abs(forces(shaken(0.1))).max()
    assert largest_frequency(MODEL) == pytest.approx(largest_frequency(plain), rel=1e-6)
    x = shaken(1e-5)
    assert np.abs(forces(x) - forces(x, plain)).max() < 1e-3 * np.abs(forces(x, plain)).max()


def test_neo_hookean_cells_keep_their_bits_and_have_no_rows():
    plain, x = assemble(PLAIN), shaken(0.3)
    assert plain.tissue.groups.stiffening.shape == (0, ROWS * BLOCK)
    nothing = tissue_of(MODEL.rest, PLAIN.cell_nodes, PLAIN.cell_mu, PLAIN.cell_lambda, 0.0)
    found, again = np.zeros_like(x), np.zeros_like(x)
    cell_forces(x, nothing, 1.0, found)
    cell_forces(x, tissue_of(MODEL.rest, PLAIN.cell_nodes, PLAIN.cell_mu, PLAIN.cell_lambda), 1.0, again)
    np.testing.assert_array_equal(found, again)
    assert plain.tissue.shortening[0] == 1


# closed forms ----------------------------------------------------------------------------------
def density(stretches, b, organ):
    """Energy, Pa, of a cube of principal stretches, by Demiray's law with the exact root of the volume."""
    mu, lam = organ.lame_moduli
    square, volume = np.sum(np.square(stretches)), np.prod(stretches)
    found = 0.5 * mu * (square - 3.0 - 2.0 * np.log(volume))
    found += 0.25 * lam * (volume**2 - 1.0 - 2.0 * np.log(volume))
    z = square - 3.0 * volume ** (2.0 / 3.0)
    return found + 0.5 * mu * (np.expm1(b * z) / b - z)


@pytest.mark.parametrize("stretch", [0.85, 1.2])
def test_a_bar_in_tension_pulls_as_the_closed_form_says(stretch):
    """Uniaxial stress: the sides are free, so that their stretch minimises the energy."""
    organ = replace(bar(4, 0.01), stiffening=B)
    model = assemble(organ)

    def slope(side):
        return (
            density([stretch, side + 1e-6, side + 1e-6], B, organ) - density([stretch, side, side], B, organ)
        ) / 1e-6

    side = brentq(slope, 0.8, 1.3)
    stress = (density([stretch + 1e-6, side, side], B, organ) - density([stretch, side, side], B, organ)) / 1e-6
    x = model.rest * [stretch, side, side]
    found = forces(x, model)
    end = model.rest[:, 0] > model.rest[:, 0].max() - 1e-9
    area = np.prod(np.ptp(model.rest, axis=0)[1:])
    assert -found[end, 0].sum() == pytest.approx(stress * area, rel=5e-4)
    between = (model.rest[:, 0] > 1e-9) & ~end
    assert np.abs(found[between]).max() < 1e-3 * stress * area if stretch > 1.0 else True
    softer = 0.5 * (1.0 + stretch)  # a little pull is neo-Hookean, a large one isn't
    assert abs(stress) > 1.1 * abs(_neo_hookean_stress(stretch, organ))
    assert softer != stretch


def _neo_hookean_stress(stretch, organ):
    def slope(side):
        return (
            density([stretch, side + 1e-6, side + 1e-6], 1e-9, organ) - density([stretch, side, side], 1e-9, organ)
        ) / 1e-6

    side = brentq(slope, 0.8, 1.3)
    return (density([stretch + 1e-6, side, side], 1e-9, organ) - density([stretch, side, side], 1e-9, organ)) / 1e-6


@pytest.mark.parametrize("shear", [0.1, 0.4])
def test_simple_shear_is_resisted_as_the_closed_form_says(shear):
    """F = 1 + shear e_x e_z: z = shear^2, and the shear stress is mu shear exp(b shear^2)."""
    organ = replace(bar(4, 0.01), stiffening=B)
    model = assemble(organ)
    x = model.rest.copy()
    x[:, 0] += shear * model.rest[:, 2]
    found = forces(x, model)
    top = model.rest[:, 2] > model.rest[:, 2].max() - 1e-9
    inner = top & (model.rest[:, 0] > 0.015) & (model.rest[:, 0] < 0.025)
    whole = np.ptp(model.rest, axis=0)
    # The sum over all nodes of x forces times z is the volume times the stress.
    work = -np.sum(found[:, 0] * model.rest[:, 2])
    mu = organ.lame_moduli[0]
    assert work == pytest.approx(np.prod(whole) * mu * shear * np.exp(B * shear**2), rel=1e-9)
    assert inner.any()


def test_beyond_the_largest_exponent_the_stiffness_no_longer_grows():
    organ = replace(bar(4, 0.01), stiffening=40.0)
    model, mu = assemble(organ), organ.lame_moduli[0]
    for shear in (0.4, 0.8):
        x = model.rest.copy()
        x[:, 0] += shear * model.rest[:, 2]
        work = -np.sum(forces(x, model)[:, 0] * model.rest[:, 2])
        assert work == pytest.approx(np.prod(np.ptp(model.rest, axis=0)) * mu * shear * np.exp(MOST), rel=1e-9)


# steps -----------------------------------------------------------------------------------------
def stretched(exponent, b=B):
    """The bar in simple shear with an exponent everywhere."""
    organ = replace(bar(4, 0.01), stiffening=b)
    model = assemble(organ)
    x = model.rest.copy()
    x[:, 0] += np.sqrt(exponent / b) * model.rest[:, 2]
    return organ, model, x


def limits_of(model):
    """The least exponents from which on any group needs substeps half and a quarter as long."""
    rows = model.tissue.groups.stiffening.reshape(-1, ROWS, BLOCK)[:, 4:]
    return rows.transpose(0, 2, 1).reshape(-1, 2)[(model.tissue.groups.cells >= 0).any(axis=1)].min(axis=0)


def test_a_tick_takes_the_substeps_that_its_strain_requires():
    _, model, _ = stretched(0.1)
    half, quarter = limits_of(model)
    assert np.all(exponents_for(np.array(ALLOWED)) <= [half, quarter])
    for exponent, factor in ((0.9 * half, 1), (1.1 * half, 2), (1.05 * quarter, 4), (2.0 * MOST, 4)):
        _, model, x = stretched(exponent)
        forces(x, model)
        assert model.tissue.shortening[0] == factor
        forces(model.rest, model)
        assert model.tissue.shortening[0] == 1


@pytest.mark.parametrize("b", [4.0, 8.0, 40.0])
def test_strained_tissue_is_stable_in_the_substeps_that_it_takes(b):
    """The stiffest mode about a strained shape is slower than the shortened step allows, as far as stiffening goes."""
    _, model, _ = stretched(0.1)
    half, quarter = limits_of(model)
    for exponent, factor in ((half, 1), (quarter, 2), (MOST, 4)):
        _, model, x = stretched(0.999 * exponent, b)
        forces(x, model)
        assert model.tissue.shortening[0] == factor
        frequency = [
            largest_frequency(one._replace(rest=np.ascontiguousarray(x)))
            for one in (model, assemble(replace(bar(4, 0.01), stiffening=0.0)))
        ]
        assert frequency[0] < factor / 0.9 * frequency[1]


def test_an_organ_under_large_loads_settles_sooner_and_returns():
    soft, stiff = (Simulation(replace(PLAIN, stiffening=b)) for b in (0.0, B))
    force = np.zeros((PLAIN.n_surface, 3))
    force[np.argsort(-PLAIN.surface_positions[:, 2])[:7], 2] = -0.4
    depth = []
    for simulation in (soft, stiff):
        displacement, settled = simulation.settle(force, 1e-4)
        assert settled
        depth.append(-displacement[:, 2].min())
        left = forces(simulation.positions, simulation.model)
        left[: PLAIN.n_surface] += force
        assert np.linalg.norm(left[MODEL.moving]) <= 1e-3 * np.linalg.norm(force)
        assert simulation.energy.elastic == pytest.approx(energy(simulation.positions, simulation.model), rel=1e-12)
        simulation.step(3000)
        assert simulation.asleep
        assert simulation.state.count.faults == 0
    assert depth[1] < 0.9 * depth[0]


def test_what_needs_neo_hookean_cells_is_refused():
    with pytest.raises(UserError, match="moves as a whole; use local_region off or auto"):
        Simulation(ORGAN, local_region="modal")
    assert Simulation(ORGAN, local_region="auto").local_region == "off"
    with pytest.raises(UserError, match="springs have no such law; use model cells"):
        Simulation(ORGAN, model="hybrid")
    with pytest.raises(UserError, match=r"its unloaded shape is not computed; use gravity 0, or shape_is_unloaded"):
        Simulation(ORGAN, gravity=(0.0, 0.0, -9.81))
    Simulation(ORGAN, gravity=(0.0, 0.0, -9.81), shape_gravity=(0.0, 0.0, 0.0))
