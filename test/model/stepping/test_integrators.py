"""Time stepping against its written recurrence and against closed forms."""

import math

import numpy as np
import pytest

from helpers.scenes import assembled, ball
from tissue_sim.model.data.settings import INTEGRATORS
from tissue_sim.model.elasticity.assembly import packed
from tissue_sim.model.elasticity.forces import elastic_forces, return_forces
from tissue_sim.model.elasticity.frequency import largest_frequency
from tissue_sim.model.stepping.critical_step import critical_step, model_step
from tissue_sim.model.stepping.integrators import (
    explicit_euler,
    symplectic_euler,
    symplectic_euler_whole,
)

ONE = np.array([0], dtype=np.int32)


@pytest.mark.parametrize("inertia", [1.0, 7.0])
def test_step_is_the_written_recurrence(inertia):
    random = np.random.default_rng(0)
    n, step, scale = 9, 3e-4, 1.7
    x, v, force = random.standard_normal((3, n, 3))
    mass, damping = random.uniform(0.1, 2.0, n), random.uniform(0.0, 50.0, n)
    moving = np.array([0, 2, 3, 7], dtype=np.int32)
    expected_x, expected_v = x.copy(), v.copy()
    for i in moving:
        heavy = inertia * mass[i]
        expected_v[i] = (v[i] + step * force[i] / heavy) / (1.0 + step * scale * damping[i] / heavy)
        expected_x[i] = x[i] + step * expected_v[i]
    held = np.setdiff1d(np.arange(n), moving)
    before = x[held].copy(), v[held].copy()
    symplectic_euler(x, v, force, moving, 1.0 / mass, damping, scale, step, inertia)
    np.testing.assert_allclose(v, expected_v, rtol=1e-13)
    np.testing.assert_allclose(x, expected_x, rtol=1e-13)
    assert np.array_equal(x[held], before[0])
    assert np.array_equal(v[held], before[1])


def test_all_coordinates_at_once_are_the_same_to_the_last_bit():
    random = np.random.default_rng(1)
    n, step, scale, inertia = 9, 3e-4, 1.7, 7.0
    x, v, force = random.standard_normal((3, n, 3))
    inverse_mass, damping = 1.0 / random.uniform(0.1, 2.0, n), random.uniform(0.0, 50.0, n)
    moving = np.array([0, 2, 3, 7], dtype=np.int32)
    held = np.setdiff1d(np.arange(n), moving)
    v[held] = inverse_mass[held] = 0.0
    push = step / inertia * inverse_mass
    shrink = 1.0 / (1.0 + push * scale * damping)
    flat = x.ravel().copy(), v.ravel().copy()
    symplectic_euler_whole(*flat, force.ravel(), push.repeat(3), shrink.repeat(3), step)
    symplectic_euler(x, v, force, moving, inverse_mass, damping, scale, step, inertia)
    np.testing.assert_array_equal(flat[0], x.ravel())
    np.testing.assert_array_equal(flat[1], v.ravel())


def oscillate(frequency, step, steps, damping=0.0):
    """Positions of a mass of 0.3 kg on a return spring, let go 1 m from its rest, after each step."""
    mass, x = 0.3, np.array([[1.0, 0.0, 0.0]])
    v, rest, stiffness = np.zeros((1, 3)), np.zeros((1, 3)), np.array([mass * frequency**2])
    path = []
    for _ in range(steps):
        force = np.zeros((1, 3))
        return_forces(x, rest, ONE, stiffness, force)
        symplectic_euler(x, v, force, ONE, np.array([1.0 / mass]), np.array([damping]), 1.0, step)
        path.append(x[0, 0])
    return np.array(path)


@pytest.mark.parametrize("reduced", [0.05, 0.7, 1.9])
def test_mass_on_a_spring_follows_the_exact_solution_of_the_recurrence(reduced):
    """x_k = cos((k + 1/2) a) / cos(a/2) with sin(a/2) = wh/2: the discrete oscillation, near the critical step too."""
    angle = 2.0 * math.asin(reduced / 2.0)
    path = oscillate(20.0, reduced / 20.0, 400)
    k = np.arange(1, 401)
    np.testing.assert_allclose(path, np.cos((k + 0.5) * angle) / math.cos(angle / 2.0), atol=1e-9)


def measured_frequency(path, step):
    """Angular frequency from the first and the last upward zero crossing, linear between samples."""
    rising = np.flatnonzero((path[:-1] < 0.0) & (path[1:] >= 0.0))
    crossing = rising - path[rising] / (path[rising + 1] - path[rising])
    return 2.0 * math.pi * (len(crossing) - 1) / ((crossing[-1] - crossing[0]) * step)


def test_frequency_is_the_closed_form_and_its_error_quarters_with_the_step():
    frequency, errors = 20.0, []
    for step in (8e-3, 4e-3, 2e-3):
        measured = measured_frequency(oscillate(frequency, step, round(20.0 / step)), step)
        errors.append(measured / frequency - 1.0)
        assert errors[-1] == pytest.approx((frequency * step) ** 2 / 24.0, rel=0.05)
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.1)


def test_path_error_halves_with_the_step():
    frequency, errors = 20.0, []
    for step in (2e-3, 1e-3, 5e-4):
        path = oscillate(frequency, step, round(0.5 / step))
        time = step * np.arange(1, len(path) + 1)
        errors.append(np.abs(path - np.cos(frequency * time)).max())
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.1)


def test_amplitude_of_an_undamped_mass_neither_grows_nor_decays():
    path = oscillate(20.0, 2e-3, 20_000)
    assert np.abs(path[:2000]).max() == pytest.approx(np.abs(path[-2000:]).max(), rel=1e-4)


@pytest.mark.parametrize("step", [1e-4, 1e-2, 10.0])
def test_damping_decays_a_free_mass_by_its_recurrence_at_any_step(step):
    mass, damping = 0.3, 4.0
    x, v = np.zeros((1, 3)), np.array([[1.0, -2.0, 3.0]])
    for k in range(1, 50):
        symplectic_euler(x, v, np.zeros((1, 3)), ONE, np.array([1.0 / mass]), np.array([damping]), 1.0, step)
        expected = np.array([1.0, -2.0, 3.0]) * (1.0 + step * damping / mass) ** -k
        np.testing.assert_allclose(v[0], expected, rtol=1e-12)


# the other integrators -------------------------------------------------------------------------
def test_explicit_step_is_the_written_recurrence():
    random = np.random.default_rng(1)
    n, step, scale = 9, 3e-4, 1.7
    x, v, force = random.standard_normal((3, n, 3))
    mass, damping = random.uniform(0.1, 2.0, n), random.uniform(0.0, 50.0, n)
    moving = np.array([0, 2, 3, 7], dtype=np.int32)
    expected_x, expected_v = x.copy(), v.copy()
    for i in moving:
        expected_x[i] = x[i] + step * v[i]
        expected_v[i] = v[i] + step * (force[i] - scale * damping[i] * v[i]) / mass[i]
    explicit_euler(x, v, force, moving, 1.0 / mass, damping, scale, step)
    np.testing.assert_allclose(v, expected_v, rtol=1e-13)
    np.testing.assert_allclose(x, expected_x, rtol=1e-13)
    held = np.setdiff1d(np.arange(n), moving)
    assert np.array_equal(v[held], expected_v[held])
    assert np.array_equal(x[held], expected_x[held])


MASS = 0.3  # kg
KERNELS = {"explicit": explicit_euler, "symplectic": symplectic_euler}


def swing(integrator, frequency, step, steps, damping=0.0):
    """As oscillate, by any integrator; positions and speeds over the frequency, (steps, 2)."""
    x, v, rest = np.array([[1.0, 0.0, 0.0]]), np.zeros((1, 3)), np.zeros((1, 3))
    stiffness, inverse, drag = np.array([MASS * frequency**2]), np.array([1.0 / MASS]), np.array([damping])
    kernel, path = KERNELS[integrator], []
    for _ in range(steps):
        force = np.zeros((1, 3))
        return_forces(x, rest, ONE, stiffness, force)
        kernel(x, v, force, ONE, inverse, drag, 1.0, step)
        path.append((x[0, 0], v[0, 0] / frequency))
    return np.array(path)


@pytest.mark.parametrize("reduced", [0.01, 0.3, 1.5])
def test_explicit_mass_on_a_spring_follows_the_closed_form_of_the_recurrence(reduced):
    """x_k = (1 + (wh)^2)^(k/2) cos(k atan(wh)): forward Euler grows, at one frequency."""
    k = np.arange(1, 41)
    expected = (1.0 + reduced**2) ** (0.5 * k) * np.cos(k * math.atan(reduced))
    path = swing("explicit", 20.0, reduced / 20.0, 40)[:, 0]
    np.testing.assert_allclose(path / np.abs(expected).max(), expected / np.abs(expected).max(), atol=1e-12)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_frequency_and_path_converge_to_the_oscillator_with_order_one(integrator):
    """The damped oscillator e^(-ct/2) cos(Wt + ...); undamped, the frequency's own error is of second order."""
    frequency, paths, rates = 20.0, [], []
    for step in (1e-3, 5e-4, 2.5e-4):
        path = swing(integrator, frequency, step, round(0.5 / step), damping=2.0 * MASS)[:, 0]
        turn, time = math.sqrt(frequency**2 - 1.0), step * np.arange(1, len(path) + 1)
        exact = np.exp(-time) * (np.cos(turn * time) + np.sin(turn * time) / turn)
        paths.append(np.abs(path - exact).max())
        rates.append(abs(measured_frequency(swing(integrator, frequency, step, round(8.0 / step))[:, 0], step) - 20.0))
    assert paths[0] < 0.2
    for error, order in ((paths, 1.0), (rates, 2.0)):
        observed = np.log2(np.divide(error[:-1], error[1:]))
        np.testing.assert_allclose(observed, order, atol=0.12)
    factor = 1.0 / 24.0 if integrator == "symplectic" else -1.0 / 3.0  # of the recurrence: asin, atan
    assert rates[0] == pytest.approx(abs(factor) * frequency * (frequency * 1e-3) ** 2, rel=0.05)


def two_masses(stiffness, masses, drag, direction):
    """A spring of 20 mm between two free nodes along a unit direction."""
    model, none = assembled(ball()), np.zeros(0, dtype=np.int32)
    return packed(
        model._replace(
            rest=np.stack([np.zeros(3), 0.02 * np.asarray(direction)]),
            inverse_mass=1.0 / np.array(masses),
            damping=np.array(drag),
            moving=np.array([0, 1], dtype=np.int32),
            spring_first=np.array([0], dtype=np.int32),
            spring_second=np.array([1], dtype=np.int32),
            spring_rest_length=np.array([0.02]),
            spring_stiffness=np.array([stiffness]),
            angular_nodes=model.angular_nodes[:0],
            angular_weight=model.angular_weight[:0],
            angular_rest=model.angular_rest[:0],
            angular_stiffness=model.angular_stiffness[:0],
            angular_least_area=model.angular_least_area[:0],
            return_nodes=none,
            return_stiffness=np.zeros(2),
        )
    )


def advance(model, integrator, x, v, step, steps):
    """Step a model's nodes by the kernels alone; the positions after each step."""
    kernel, path = KERNELS[integrator], []
    for _ in range(steps):
        force = np.zeros_like(x)
        elastic_forces(model, x, 1.0, force)
        kernel(x, v, force, model.moving, model.inverse_mass, model.damping, 1.0, step)
        path.append(x.copy())
    return np.array(path)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_one_spring_between_two_masses_follows_its_discrete_recurrence(integrator):
    """Along its own line the spring is linear, so two numbers a mass tell all; the line is askew to the axes."""
    direction = np.array([2.0, -3.0, 6.0]) / 7.0
    k, masses, drag, step = 50.0, np.array([0.1, 0.25]), np.array([0.3, 0.1]), 3e-3
    model = two_masses(k, masses, drag, direction)
    place, speed = np.array([-0.003, 0.024]), np.array([0.05, -0.02])
    x, v = np.outer(place, direction), np.outer(speed, direction)
    path = advance(model, integrator, x, v, step, 200)
    grip = np.array([1.0, -1.0])
    for k_th in range(200):
        stretch = place[1] - place[0] - 0.02
        if integrator == "symplectic":
            speed = (speed + step * k * stretch * grip / masses) / (1.0 + step * drag / masses)
            place = place + step * speed
        else:
            place, speed = place + step * speed, speed + step * (k * stretch * grip - drag * speed) / masses
        np.testing.assert_allclose(path[k_th], np.outer(place, direction), rtol=0.0, atol=1e-13)
    assert np.ptp(np.linalg.norm(path[:, 1] - path[:, 0], axis=1)) > 0.004


@pytest.mark.parametrize("ratio", [0.05, 0.5, 1.0, 2.0])
def test_explicit_mass_is_bounded_just_under_its_critical_step_and_grows_just_above(ratio):
    frequency = 20.0
    step, damping = critical_step(frequency, ratio, "explicit"), 2.0 * ratio * frequency * MASS
    if ratio < 1.0:
        assert step == pytest.approx(2.0 * ratio / frequency)
    under = swing("explicit", frequency, 0.98 * step, 4000, damping)
    above = swing("explicit", frequency, 1.02 * step, 4000, damping)
    # The amplitude changes by (1 -+ 0.04 z^2 ...) a step: slowly where hardly damped.
    assert np.abs(under[-100:]).max() < 0.8
    assert np.abs(above[-100:]).max() > 1.4


@pytest.mark.parametrize("variant", ["surface", "hybrid"])
def test_explicit_organ_is_bounded_just_under_its_critical_step_and_grows_above(variant):
    model = assembled(ball(), variant)
    frequency = largest_frequency(model)
    mass = np.divide(1.0, model.inverse_mass, where=model.inverse_mass > 0.0, out=np.zeros(len(model.rest)))
    model = model._replace(damping=0.4 * frequency * mass)  # damping ratio 0.2
    step = model_step(model, frequency, integrator="explicit")
    assert step == pytest.approx(0.4 / frequency)
    push = 1e-9 * np.random.default_rng(3).standard_normal((len(model.moving), 3))
    reached = []
    for factor in (0.95, 1.05):
        x, v = model.rest.copy(), np.zeros_like(model.rest)
        x[model.moving] += push
        path = advance(model, "explicit", x, v, factor * step, 1500)
        reached.append(np.abs(path[-100:] - model.rest).max() / 1e-9)
    assert reached[0] < 4.0
    assert reached[1] > 100.0
