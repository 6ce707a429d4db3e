"""Motion of the finite-element body: frequencies, energy, order of the time step, damping."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.blocks import box
from helpers.scenes import ball
from tissue_sim.calibration.dynamics import Forces, Start, Steps, frequencies, lowest_frequencies, release, swing
from tissue_sim.calibration.fe_mesh import Grading
from tissue_sim.calibration.fem import Body
from tissue_sim.errors import UserError

LENGTH, WIDTH, E, DENSITY = 0.12, 0.01, 10e3, 1000.0


@pytest.fixture(scope="module")
def beam():
    solid = box(np.linspace(0.0, LENGTH, 9), [0.0, WIDTH], [0.0, 1.2 * WIDTH], E, 0.0, DENSITY)
    solid.held[solid.nodes[:, 0] == 0.0] = True
    return solid


def first_mode(solid, size=1e-3):
    """The first mode in y by inverse iteration, with so many m at the end."""
    shape = np.zeros_like(solid.nodes)
    shape[:, 1] = solid.nodes[:, 0] ** 2
    for _ in range(10):
        shape = solid.solve((solid.mass @ shape)[None])[0]
        shape *= size / np.linalg.norm(shape, axis=1).max()
    return shape


def tip(solid):
    return np.array([int(np.argmax(solid.nodes[:, 0]))])


def test_first_frequencies_of_a_beam(beam):
    """Euler-Bernoulli: f = (1.8751^2 / 2 pi) sqrt(E I / (rho A)) / L^2; shear and rotation take a percent off."""
    bending = 1.8751**2 / (2.0 * np.pi) * np.sqrt(E / DENSITY / 12.0) / LENGTH**2
    found = frequencies(beam, 2)
    np.testing.assert_allclose(found, [bending * WIDTH, bending * 1.2 * WIDTH], rtol=0.03)
    assert np.all(found < [bending * WIDTH, bending * 1.2 * WIDTH])


@pytest.mark.parametrize("linear", [True, False])
def test_energy_of_an_undamped_swing_is_kept(beam, linear):
    period = 1.0 / frequencies(beam, 1)[0]
    motion = swing(beam, Start(first_mode(beam)), Forces(0.0, linear), Steps(0.75 * period, period / 40.0), tip(beam))
    assert np.ptp(motion.displacement[:, 0, 1]) == pytest.approx(2e-3, rel=0.02)
    assert np.ptp(motion.energy) / motion.energy[0] < (1e-9 if linear else 1e-3)


@pytest.mark.parametrize(("linear", "smoothed"), [(True, 0), (False, 0), (True, 2)])
def test_second_order_in_the_step(beam, linear, smoothed):
    """Where the tip is fastest; the linear one against the closed form."""
    period, rate = 1.0 / frequencies(beam, 1)[0], 0.2
    start, forces, end = first_mode(beam), Forces(rate, linear), tip(beam)
    steps = [Steps(0.75 * period, period / count) for count in (12, 24, 48)]
    runs = [swing(beam, Start(start, smoothed=smoothed), forces, some, end) for some in steps]
    ends = np.array([run.displacement[-1, 0, 1] for run in runs])
    order = np.log2(abs(ends[0] - ends[1]) / abs(ends[1] - ends[2]))
    assert order == pytest.approx(2.0, abs=0.3 if smoothed else 0.2)
    omega, half = 2.0 * np.pi / period, 0.5 * rate
    damped, time = np.sqrt(omega**2 - half**2), runs[-1].time[-1]
    wanted = np.exp(-half * time) * (np.cos(damped * time) + half / damped * np.sin(damped * time))
    assert ends[-1] == pytest.approx(wanted * start[end[0], 1], abs=0.01 * 1e-3)


def test_swing_decays_with_half_the_damping_rate(beam):
    rate, period = 0.4, 1.0 / frequencies(beam, 1)[0]
    steps = Steps(3.2 * period, period / 50.0)
    motion = swing(beam, Start(first_mode(beam)), Forces(rate, linear=True), steps, tip(beam))
    around = [slice(50 * k - 10, 50 * k + 10) for k in (1, 2, 3)]
    y = motion.displacement[:, 0, 1]
    peaks, times = np.array([y[k].max() for k in around]), np.array([motion.time[k][y[k].argmax()] for k in around])
    np.testing.assert_allclose(-np.diff(np.log(peaks)) / np.diff(times), 0.5 * rate, rtol=0.05)
    np.testing.assert_allclose(np.diff(times), period, rtol=0.03)


@pytest.mark.parametrize("linear", [True, False])
def test_a_load_let_fall_swings_twice_as_far_as_it_holds(beam, linear):
    """Undamped, from rest: u(t) = u_rest (1 - cos w t) for a load of the first mode's shape."""
    period = 1.0 / frequencies(beam, 1)[0]
    held = first_mode(beam)
    load = (beam.stiffness @ held.ravel()).reshape(held.shape)
    steps, forces = Steps(period, period / 40.0), Forces(0.0, linear, load)
    motion = swing(beam, Start(np.zeros_like(held)), forces, steps, tip(beam))
    wanted = held[tip(beam)[0], 1] * (1.0 - np.cos(2.0 * np.pi * motion.time / period))
    np.testing.assert_allclose(motion.displacement[:, 0, 1], wanted, atol=0.03 * wanted.max())


def test_a_velocity_to_begin_with(beam):
    period = 1.0 / frequencies(beam, 1)[0]
    shape = first_mode(beam)
    omega, end = 2.0 * np.pi / period, tip(beam)
    start, steps = Start(0.0 * shape, omega * shape), Steps(period, period / 40.0)
    motion = swing(beam, start, Forces(0.0, linear=True), steps, end)
    wanted = shape[end[0], 1] * np.sin(omega * motion.time)
    np.testing.assert_allclose(motion.displacement[:, 0, 1], wanted, atol=0.02 * wanted.max())


def test_a_weight_on_the_end_slows_a_beam_down():
    """Rayleigh: with a weight of m on the end of a beam of 33/140 of its mass there, f^2 falls as the sum of both."""
    solid = box(np.linspace(0.0, LENGTH, 9), [0.0, WIDTH], [0.0, 1.2 * WIDTH], E, 0.0, DENSITY)
    solid.held[solid.nodes[:, 0] == 0.0] = True
    alone, beam = frequencies(solid, 1)[0], DENSITY * LENGTH * 1.2 * WIDTH**2
    ends = np.flatnonzero(solid.nodes[:, 0] == LENGTH)
    weight = np.zeros(len(solid.nodes))
    weight[ends] = beam / len(ends)
    solid.add_masses(weight)
    assert solid.mass.sum() == pytest.approx(2.0 * beam)
    fraction = 33.0 / 140.0
    assert frequencies(solid, 1)[0] == pytest.approx(alone * np.sqrt(fraction / (fraction + 1.0)), rel=0.03)


def test_released_organ_starts_where_it_settled_and_comes_to_rest():
    organ = ball(1)
    body = Body(organ, grading=Grading(clamp=0))
    force = np.zeros((organ.n_surface, 3))
    top = int(np.argmax(organ.surface_positions[:, 2]))
    force[top] = [0.02, 0.0, -0.05]
    motion = release(body, force, Steps(0.6, 1.5e-2), 20.0, [top])
    assert motion.displacement.shape == (41, 1, 3)
    np.testing.assert_allclose(motion.displacement[0, 0], body.settle(force).displacement[top], atol=1e-9)
    size = np.linalg.norm(motion.displacement[:, 0], axis=1)
    assert size[0] > 5e-4
    assert size[-5:].max() < 0.03 * size[0]
    assert motion.energy[-1] < 3e-3 * motion.energy[0]
    assert np.all(np.diff(motion.energy) < 1e-6 * motion.energy[0])
    np.testing.assert_allclose(motion.time[[0, 1, -1]], [0.0, 1.5e-2, 0.6], atol=1e-12)
    straight = release(body, 1e-3 * force, Steps(0.02, 5e-3), 60.0, linear=True)
    bent = release(body, 1e-3 * force, Steps(0.02, 5e-3), 60.0)
    assert straight.displacement.shape == (5, organ.n_surface, 3)
    off = np.linalg.norm(straight.displacement - bent.displacement) / np.linalg.norm(bent.displacement)
    assert off < 2e-3


@pytest.mark.parametrize("step", [5e-3, 1e-2, 2e-2])
def test_a_nearly_incompressible_solid_is_released_from_far(step):
    """Whole steps about the linear solid's matrix lead up there, and never arrive."""
    sides = np.linspace(0.0, 0.02, 3)
    solid = box(np.linspace(0.0, 0.04, 5), sides, sides, E, 0.49, DENSITY)
    along = solid.nodes[:, 0]
    solid.held[along == 0.0] = True
    start = np.zeros_like(solid.nodes)
    start[:, 0] = 0.2 * along
    start[:, 1:] = -0.1 * (solid.nodes[:, 1:] - 0.01) * np.minimum(1.0, along / 0.01)[:, None]
    start[:, 1] += 0.2 * along**2 / 0.04
    motion = swing(solid, Start(start, smoothed=2), Forces(40.0), Steps(2.0 * step, step), np.arange(len(along)))
    assert np.all(np.diff(motion.energy) < 0.0)
    assert np.linalg.norm(motion.displacement[-1]) < np.linalg.norm(start)


def test_frequencies_go_with_the_root_of_the_stiffness():
    organ = ball(1)
    grading = Grading(clamp=0)
    body = Body(organ, grading=grading)
    found = lowest_frequencies(body, 4)
    stiff = lowest_frequencies(
        Body(replace(organ, youngs_modulus=4.0 * organ.youngs_modulus), grading=Grading(clamp=0)), 4
    )
    assert np.all(np.diff(found) >= 0.0)
    np.testing.assert_allclose(stiff, 2.0 * found, rtol=1e-6)
    with pytest.raises(UserError, match="frequencies were requested"):
        lowest_frequencies(body, 0)


@pytest.mark.parametrize(("seconds", "step"), [(0.1, 0.0), (0.1, -1e-3), (1e-3, 1e-2), (float("nan"), 1e-3)])
def test_motion_that_is_none_is_refused(beam, seconds, step):
    with pytest.raises(UserError, match="give a shorter step"):
        swing(beam, Start(first_mode(beam)), Forces(0.0), Steps(seconds, step), tip(beam))
