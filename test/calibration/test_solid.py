"""Quadratic elements against closed forms, linear, neo-Hookean and of Demiray's law."""

import numpy as np
import pytest
import skfem
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation
from skfem.helpers import ddot, eye, sym_grad, trace

from helpers.blocks import box, faces, pressed
from tissue_sim.calibration.fe_mesh import quadratic
from tissue_sim.calibration.solid import Material, Solid, shape_functions

E, NU = 10e3, 0.3


STIFFENING = 6.0


def small_box(bend=0.05, stiffening=0.0):
    cut = np.linspace(0.0, 1.0, 3)
    return box(cut, cut, cut, bend=bend, stiffening=stiffening)


def test_stiffness_is_that_of_skfem():
    """The same matrix from skfem's own forms, which share nothing with the kernel."""
    mesh = skfem.MeshTet.init_tensor(*[np.linspace(0.0, 1.0, 3)] * 3)
    nodes, elements = quadratic(mesh)
    solid = Solid(nodes, elements, np.zeros(nodes.shape, dtype=bool), Material(E, NU, 1000.0))
    basis = skfem.CellBasis(mesh, skfem.ElementVector(skfem.ElementTetP2()), intorder=2)

    @skfem.BilinearForm
    def elasticity(u, v, _):
        strain = sym_grad(u)
        stress = 2.0 * solid.moduli.mu * strain + solid.moduli.lam * eye(trace(strain), 3)
        return ddot(stress, sym_grad(v))

    order = np.empty((len(nodes), 3), dtype=int)  # where skfem keeps each axis of each node
    scalar = skfem.CellBasis(mesh, skfem.ElementTetP2(), intorder=2)
    for local in range(10):
        for axis in range(3):
            order[scalar.element_dofs[local], axis] = basis.element_dofs[3 * local + axis]
    wanted = elasticity.assemble(basis).tocsr()[order.ravel()][:, order.ravel()]
    difference = abs(solid.stiffness.tocsr() - wanted).max()
    assert difference < 1e-12 * abs(wanted).max()


def test_mass_is_that_of_the_box():
    solid = small_box()
    assert solid.mass.sum() == pytest.approx(1000.0, rel=1e-12)
    speed = np.array([1.0, 2.0, -1.0])
    turning = np.cross(speed, solid.nodes - 0.5)  # a rotation: linear, so that its energy is exact
    wanted = 0.5 * 1000.0 / 6.0 * (speed @ speed)
    assert 0.5 * np.vdot(turning, solid.mass @ turning) == pytest.approx(wanted, rel=1e-12)


def l2_error(solid, found, wanted):
    values, slopes, weights = shape_functions(4)
    det = np.abs(np.linalg.det(np.einsum("eax,qar->eqxr", solid.nodes[solid.elements], slopes)))
    where = np.einsum("eax,qa->eqx", solid.nodes[solid.elements], values)
    off = np.einsum("eax,qa->eqx", found[solid.elements], values) - wanted(where)
    return np.sqrt(np.sum((det * weights)[:, :, None] * off**2))


def test_manufactured_solution_converges_with_the_third_order():
    """u = a sin(pi x) sin(pi y) sin(pi z) in a box whose walls are held, under the body force that it takes."""
    a = np.array([1.0, -0.5, 2.0])
    errors = []
    for cells in (2, 4, 8):
        solid = box(*[np.linspace(0.0, 1.0, cells + 1)] * 3)
        solid.held[np.any((solid.nodes < 1e-9) | (solid.nodes > 1.0 - 1e-9), axis=1)] = True

        def wanted(x):
            return np.prod(np.sin(np.pi * x), axis=-1)[..., None] * a

        values, slopes, weights = shape_functions(7)
        det = np.abs(np.linalg.det(np.einsum("eax,qar->eqxr", solid.nodes[solid.elements], slopes)))
        x = np.einsum("eax,qa->eqx", solid.nodes[solid.elements], values)
        s, c = np.sin(np.pi * x), np.cos(np.pi * x)
        bulk = np.prod(s, axis=-1)
        second = np.empty((*bulk.shape, 3, 3))  # of the product of sines
        for i in range(3):
            for j in range(3):
                k = 3 - i - j
                second[..., i, j] = -(np.pi**2) * bulk if i == j else np.pi**2 * c[..., i] * c[..., j] * s[..., k]
        force = (
            3.0 * np.pi**2 * solid.moduli.mu * bulk[..., None] * a - (solid.moduli.lam + solid.moduli.mu) * second @ a
        )
        parts = np.einsum("eq,qa,eqx->eax", det * weights, values, force)
        load = np.zeros_like(solid.nodes)
        np.add.at(load, solid.elements, parts)
        errors.append(l2_error(solid, solid.solve(load[None])[0], wanted))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders[-1] == pytest.approx(3.0, abs=0.25), f"errors {errors}, orders {orders}"


def test_uniform_strain_is_kept_in_any_mesh():
    """Patch test: walls moved by a linear field, and the inside follows it."""
    solid = small_box(bend=0.08)
    solid.held[np.any((solid.nodes < 1e-9) | (solid.nodes > 1.0 - 1e-9), axis=1)] = True
    wanted = solid.nodes @ np.random.default_rng(5).normal(size=(3, 3)).T
    walls = np.where(solid.held, wanted, 0.0)
    load = -(solid.stiffness @ walls.ravel()).reshape(walls.shape)
    found = walls + solid.solve(load[None])[0]
    np.testing.assert_allclose(found, wanted, atol=1e-12)
    assert (~solid.held).any()


def pulled_bar(stiffening=0.0):
    across = np.linspace(0.0, 0.02, 3)
    solid = box(np.linspace(0.0, 0.1, 6), across, across, E, NU, stiffening=stiffening)
    for axis in range(3):
        solid.held[np.abs(solid.nodes[:, axis]) < 1e-12, axis] = True
    return solid


def test_bar_in_tension_linear():
    solid, traction = pulled_bar(), 800.0
    found = solid.solve(pressed(solid, faces(solid, 0, 0.1), [traction, 0.0, 0.0])[None])[0]
    strain = traction / E
    np.testing.assert_allclose(found, solid.nodes * [strain, -NU * strain, -NU * strain], atol=1e-12)


@pytest.mark.parametrize("traction", [6000.0, 800.0, -3000.0])
def test_bar_in_tension_neo_hookean(traction):
    solid = pulled_bar()
    settled = solid.settle(pressed(solid, faces(solid, 0, 0.1), [traction, 0.0, 0.0]))

    def stresses(stretch):
        along, across = stretch
        volume = solid.moduli.lam * np.log(along * across**2)
        pull = solid.moduli.mu * (along - 1.0 / along) + volume / along - traction
        return pull, solid.moduli.mu * (across - 1.0 / across) + volume / across

    along, across = fsolve(stresses, [1.0 + traction / E / 2.0, 1.0], xtol=1e-13)
    assert settled.converged
    assert abs(along - 1.0) > 0.05
    np.testing.assert_allclose(settled.displacement, solid.nodes * ([along, across, across] - np.ones(3)), atol=1e-8)


@pytest.mark.parametrize("traction", [6000.0, 800.0, -3000.0])
def test_bar_in_tension_that_stiffens(traction):
    solid = pulled_bar(STIFFENING)
    settled = solid.settle(pressed(solid, faces(solid, 0, 0.1), [traction, 0.0, 0.0]))
    mu, lam = solid.moduli.mu, solid.moduli.lam

    def density(stretch):
        along, across = stretch
        square, volume = along**2 + 2.0 * across**2, along * across**2
        z = square - 3.0 * volume ** (2.0 / 3.0)
        added = np.expm1(STIFFENING * z) / STIFFENING - z
        return 0.5 * mu * (square - 3.0 - 2.0 * np.log(volume) + added) + 0.5 * lam * np.log(volume) ** 2

    def stresses(stretch):
        step = 1e-6 * np.eye(2)
        slope = [(density(stretch + direction) - density(stretch - direction)) / 2e-6 for direction in step]
        return slope[0] - traction, slope[1]

    along, across = fsolve(stresses, [1.0 + traction / E / 2.0, 1.0], xtol=1e-12)
    assert settled.converged
    assert abs(along - 1.0) > 0.04
    np.testing.assert_allclose(settled.displacement, solid.nodes * ([along, across, across] - np.ones(3)), atol=1e-7)
    # It is neo-Hookean about rest, and stiffer under a load.
    assert abs(stiffness_of(pulled_bar(STIFFENING)) - stiffness_of(pulled_bar())).max() == 0.0
    soft = pulled_bar().settle(pressed(solid, faces(solid, 0, 0.1), [traction, 0.0, 0.0]))
    assert abs(along - 1.0) < 0.97 * np.abs(soft.displacement[:, 0]).max() / 0.1


def stiffness_of(solid):
    return solid.stiffness.tocsr()


def test_any_even_deformation_is_kept_by_tissue_that_stiffens():
    """Patch test: walls moved by a large linear field, and the inside follows it."""
    solid = small_box(0.08, STIFFENING)
    solid.held[np.any((solid.nodes < 1e-9) | (solid.nodes > 1.0 - 1e-9), axis=1)] = True
    moved = solid.nodes @ (0.1 * np.random.default_rng(5).normal(size=(3, 3))).T
    _, forces, _ = solid.energy(moved)
    assert np.abs(np.where(solid.held, 0.0, forces)).max() < 1e-12 * np.abs(forces).max()
    assert np.linalg.norm(forces) > 1.02 * np.linalg.norm(small_box(0.08).energy(moved)[1])


def test_bar_hanging_by_its_own_weight():
    """Without lateral strain the displacement is quadratic, which the elements hold exactly."""
    solid = box(np.linspace(0.0, 0.3, 4), [0.0, 0.05], [0.0, 0.05], E, 0.0, 1060.0)
    solid.held[np.abs(solid.nodes[:, 0]) < 1e-12] = True
    weight = np.asarray(solid.mass.sum(axis=1)).ravel()[:, None] * [9.81, 0.0, 0.0]
    x = solid.nodes[:, 0]
    found = solid.solve(weight[None])[0]
    np.testing.assert_allclose(found[:, 0], 1060.0 * 9.81 / E * (0.3 * x - 0.5 * x**2), atol=1e-10)
    np.testing.assert_allclose(found[:, 1:], 0.0, atol=1e-10)


def test_half_space_under_a_square_is_boussinesqs():
    """A quarter of a half-space by symmetry, its far walls moved as Boussinesq says, pressed on a unit square.

    Compared away from the edge of the square (Johnson, Contact Mechanics 1985, equation 3.25).
    """
    cut = np.concatenate([[0.0, 0.5, 1.0, 1.5, 2.0, 2.7], np.geomspace(3.6, 24.0, 7)])
    solid = box(cut, cut, cut, E, NU)
    x, far = solid.nodes, np.any(solid.nodes > cut[-1] - 1e-9, axis=1)
    pressure, size = 100.0, 1.0
    force = pressure * (2.0 * size) ** 2
    r, depth, rho = np.hypot(x[:, 0], x[:, 1]), x[:, 2], np.maximum(np.linalg.norm(x, axis=1), 1e-9)
    scale = (1.0 + NU) * force / (2.0 * np.pi * E)
    outward = scale * (r * depth / rho**3 - (1.0 - 2.0 * NU) * r / (rho * (rho + depth)))
    direction = x[:, :2] / np.maximum(r, 1e-9)[:, None]
    sunk = scale * (depth**2 / rho**3 + 2.0 * (1.0 - NU) / rho)
    exact = np.column_stack([outward[:, None] * direction, sunk])
    solid.held[x[:, 0] < 1e-12, 0] = solid.held[x[:, 1] < 1e-12, 1] = True
    solid.held[far] = True
    walls = np.where(far[:, None], exact, 0.0)
    top = faces(solid, 2, 0.0)
    under = top[np.all(x[top[:, :3]][:, :, :2] < size + 1e-9, axis=(1, 2))]
    load = pressed(solid, under, [0.0, 0.0, pressure])
    assert load.sum() == pytest.approx(pressure * size**2)
    load -= (solid.stiffness @ walls.ravel()).reshape(load.shape)
    found = walls + solid.solve(load[None])[0]

    def sinking(px, py):
        total = 0.0
        for sx, sy in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            u, v = px + sx * size, py + sy * size
            corner = u * np.arcsinh(v / np.abs(u)) + v * np.arcsinh(u / np.abs(v))
            total = total + sx * sy * corner
        return (1.0 - NU**2) * pressure / (np.pi * E) * total

    away = (x[:, 2] < 1e-9) & (r > 2.2) & (r < 6.0) & (np.abs(x[:, 0] - size) > 0.1) & (np.abs(x[:, 1] - size) > 0.1)
    wanted = sinking(x[away, 0], x[away, 1])
    assert away.sum() > 30
    np.testing.assert_allclose(found[away, 2], wanted, rtol=0.015)


def test_rigid_motion_costs_no_force():
    solid = small_box()
    turn = Rotation.from_rotvec([0.9, -1.4, 0.3]).as_matrix()
    moved = solid.nodes @ turn.T + [0.1, 0.2, -0.3] - solid.nodes
    energy, forces, least = solid.energy(moved)
    assert abs(energy) < 1e-10
    assert np.abs(forces).max() < 1e-9 * E
    assert least == pytest.approx(1.0, rel=1e-12)


def bent(solid, size=0.04):
    return size * np.sin(3.0 * solid.nodes[:, [1, 2, 0]] + [0.0, 1.0, 2.0])


@pytest.mark.parametrize("stiffening", [0.0, STIFFENING, 60.0])
def test_forces_are_the_slope_of_the_energy(stiffening):
    solid = small_box(stiffening=stiffening)
    moved, direction = bent(solid), np.random.default_rng(0).normal(size=solid.nodes.shape)
    h = 1e-6
    ahead, behind = (solid.energy(moved + sign * h * direction)[0] for sign in (1.0, -1.0))
    assert (ahead - behind) / (2.0 * h) == pytest.approx(np.vdot(solid.energy(moved)[1], direction), rel=1e-7)


@pytest.mark.parametrize("stiffening", [0.0, STIFFENING, 60.0])
def test_tangent_is_the_slope_of_the_forces(stiffening):
    solid = small_box(stiffening=stiffening)
    moved, direction = bent(solid), np.random.default_rng(0).normal(size=solid.nodes.shape)
    h = 1e-6
    ahead, behind = (solid.energy(moved + sign * h * direction)[1] for sign in (1.0, -1.0))
    matrix = solid.tangent(moved)
    wanted = (matrix @ direction.ravel()).reshape(direction.shape)
    np.testing.assert_allclose((ahead - behind) / (2.0 * h), wanted, atol=1e-6 * np.abs(wanted).max())
    symmetric = matrix.tocsr()
    assert abs(symmetric - symmetric.T).max() < 1e-12 * abs(symmetric).max()


def test_element_turned_over_has_infinite_energy():
    solid = small_box()
    energy, _, least = solid.energy(-2.5 * solid.nodes)
    assert energy == np.inf
    assert least < 0.0


def cantilever():
    solid = box(np.linspace(0.0, 0.1, 7), np.linspace(0.0, 0.02, 3), np.linspace(0.0, 0.02, 3), E, 0.45)
    solid.held[np.abs(solid.nodes[:, 0]) < 1e-12] = True
    return solid, pressed(solid, faces(solid, 0, 0.1), [0.0, 0.0, 1.0])


def test_small_loads_are_linear_and_large_ones_are_in_equilibrium():
    solid, unit = cantilever()
    small = solid.settle(1e-3 * unit)
    linear = solid.solve(1e-3 * unit[None])[0]
    assert small.converged
    assert np.linalg.norm(small.displacement - linear) < 1e-3 * np.linalg.norm(linear)
    large = solid.settle(60.0 * unit)
    assert large.converged
    assert np.linalg.norm(large.displacement, axis=1).max() > 0.03, "a third of the length"
    residual = np.where(solid.held, 0.0, 60.0 * unit - solid.energy(large.displacement)[1])
    assert np.abs(residual).max() < 1e-4 * np.abs(60.0 * unit).max()


def test_loads_that_settle_in_step_settle_as_alone():
    solid, unit = cantilever()
    loads = [scale * unit for scale in (5.0, -20.0, 0.0, 60.0)]
    together = list(solid.settle_many(loads))
    assert len(together) == 4
    for load, found in zip(loads, together, strict=True):
        alone = solid.settle(load)
        assert found.converged
        np.testing.assert_allclose(found.displacement, alone.displacement, atol=1e-7)
    assert not together[2].displacement.any()


def test_parts_of_another_stiffness_are_in_series():
    """A bar of two halves, one five times as stiff, pulled at its end; it doesn't contract (Poisson's ratio 0)."""
    along, across = np.linspace(0.0, 1.0, 5), np.linspace(0.0, 0.2, 2)

    def stiffness(x):
        return np.where(x[..., 0] < 0.5, 5.0, 1.0)

    solid = box(along, across, across, youngs_modulus=E, poisson_ratio=0.0, stiffness=stiffness)
    solid.held[solid.nodes[:, 0] < 1e-9] = True
    load = pressed(solid, faces(solid, 0, 1.0), [100.0, 0.0, 0.0])
    found = solid.solve(load[None])[0]
    np.testing.assert_allclose(found[solid.nodes[:, 0] > 1.0 - 1e-9, 0], 100.0 / E * (0.5 / 5.0 + 0.5), rtol=1e-9)
    settled = solid.settle(1e-3 * load)
    assert settled.converged
    np.testing.assert_allclose(settled.displacement, 1e-3 * found, rtol=1e-3, atol=1e-9)
