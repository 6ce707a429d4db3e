"""Time stepping against its written recurrence and against closed forms."""

import math

import numpy as np
import pytest

from tissue_sim.model.forces import return_forces
from tissue_sim.model.integrators import symplectic_euler

ONE = np.array([0], dtype=np.int32)


def test_step_is_the_written_recurrence():
    random = np.random.default_rng(0)
    n, step, scale = 9, 3e-4, 1.7
    x, v, force = random.standard_normal((3, n, 3))
    mass, damping = random.uniform(0.1, 2.0, n), random.uniform(0.0, 50.0, n)
    moving = np.array([0, 2, 3, 7], dtype=np.int32)
    expected_x, expected_v = x.copy(), v.copy()
    for i in moving:
        expected_v[i] = (v[i] + step * force[i] / mass[i]) / (1.0 + step * scale * damping[i] / mass[i])
        expected_x[i] = x[i] + step * expected_v[i]
    held = np.setdiff1d(np.arange(n), moving)
    before = x[held].copy(), v[held].copy()
    symplectic_euler(x, v, force, moving, 1.0 / mass, damping, scale, step)
    np.testing.assert_allclose(v, expected_v, rtol=1e-13)
    np.testing.assert_allclose(x, expected_x, rtol=1e-13)
    assert np.array_equal(x[held], before[0])
    assert np.array_equal(v[held], before[1])


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
