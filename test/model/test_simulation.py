"""The object that users touch: conservation, repeatability, refusals, the guard."""

import inspect
import os
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys
from scipy.sparse.linalg import LinearOperator, cg

from helpers.naive import angular_energy, return_energy, spring_energy
from helpers.pressing import poke, top_node
from helpers.scenes import ball, changed, free_ball, kidney
from helpers.states import assert_same, snapshot
from tissue_sim.errors import UserError
from tissue_sim.model.data.settings import LOCAL_REGIONS
from tissue_sim.model.data.shapes import sphere_tools
from tissue_sim.model.elasticity.forces import elastic_forces
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.rest_recovery import QUIET_TICKS

ROOT = Path(__file__).resolve().parents[2]


def organ_for(region):
    """A ball; a coarser one where finding its modes would take most of the time."""
    return ball() if region in ("modal", "auto") else ball(2)


def woken(organ, speed=0.0, **options):
    """A simulation awake, its moving nodes at random speeds, m/s."""
    simulation = Simulation(organ, **options)
    simulation.state.status.asleep = False
    nodes = simulation.model.moving
    simulation.velocities[nodes] = speed * np.random.default_rng(0).standard_normal((len(nodes), 3))
    return simulation


# rest ------------------------------------------------------------------------------------------
@pytest.mark.parametrize("organ", [ball(), kidney()], ids=["ball", "kidney"])
@pytest.mark.parametrize("region", ["off", "frozen"])
def test_rest_stays_rest_and_asleep(organ, region):
    simulation = Simulation(organ, local_region=region)
    for _ in range(50):
        simulation.step()
    assert simulation.asleep
    assert simulation.time == pytest.approx(0.05)
    assert simulation.state.status.active == 0
    assert simulation.state.count.asleep_ticks == 50
    np.testing.assert_array_equal(simulation.positions, organ.rest_positions)
    np.testing.assert_array_equal(simulation.velocities, 0.0)


def test_awake_organ_at_rest_falls_asleep_without_moving():
    simulation = woken(kidney())
    for _ in range(QUIET_TICKS - 1):
        simulation.step()
    assert not simulation.asleep
    simulation.step()
    assert simulation.asleep
    np.testing.assert_allclose(simulation.positions, simulation.model.rest, rtol=0.0, atol=1e-15)


def test_organ_returns_to_rest_and_sleeps_after_a_poke():
    simulation = Simulation(kidney())
    poke(simulation, 200)
    reach = np.abs(simulation.positions - simulation.model.rest).max()
    assert reach > 1e-3
    for _ in range(1500):
        simulation.step()
    assert simulation.asleep
    assert np.abs(simulation.positions - simulation.model.rest).max() < 0.01 * reach
    assert simulation.state.count.faults == 0


# conservation ----------------------------------------------------------------------------------
@pytest.mark.parametrize("variant", ["surface", "volume", "hybrid"])
def test_free_organ_keeps_its_momentum_and_angular_momentum(variant):
    organ = free_ball()
    simulation = woken(organ, speed=0.05, model=variant)
    nodes = simulation.model.moving
    mass = 1.0 / simulation.model.inverse_mass[nodes]

    def momenta():
        push = mass[:, None] * simulation.velocities[nodes]
        return push.sum(axis=0), np.cross(simulation.positions[nodes], push).sum(axis=0)

    first = momenta()
    stretched = []
    for _ in range(500):
        simulation.step()
        stretched.append(np.abs(simulation.positions - simulation.model.rest).max())
    last = momenta()
    assert max(stretched) > 1e-3
    size = np.linalg.norm(mass[:, None] * simulation.velocities[nodes], axis=1).sum()
    assert np.abs(last[0] - first[0]).max() <= 1e-10 * size
    assert np.abs(last[1] - first[1]).max() <= 1e-10 * size * 0.03


def test_free_organ_falls_by_the_closed_form():
    """A force on every node in proportion to its mass: x = g h^2 k (k + 1) / 2 after k substeps of h."""
    organ = free_ball()
    simulation = Simulation(organ)
    gravity = np.array([0.3, -0.2, -1.0])
    for _ in range(50):
        simulation.apply_force(np.arange(organ.n_nodes), organ.mass[:, None] * gravity)
        simulation.step()
    steps = 50 * int(simulation.state.status.substeps)
    step = 0.05 / steps
    fallen = gravity * step**2 * steps * (steps + 1) / 2.0
    moved = simulation.positions - organ.rest_positions
    np.testing.assert_allclose(moved, np.tile(fallen, (organ.n_nodes, 1)), rtol=1e-9)


def test_node_on_a_return_spring_alone_oscillates_at_its_closed_form():
    """Through the whole tick with all its substeps: the discrete solution of a single mass."""
    organ = changed(ball(held=False), spring_stiffness=0.0, angular_stiffness=0.0, damping=0.0, return_stiffness=40.0)
    simulation = woken(organ)
    node = top_node(organ)
    simulation.positions[node, 0] += 0.004
    path = []
    for _ in range(200):
        simulation.step()
        path.append(simulation.positions[node, 0] - organ.rest_positions[node, 0])
    substeps = int(simulation.state.status.substeps)
    frequency = np.sqrt(organ.return_stiffness[node] / organ.mass[node])
    angle = 2.0 * np.arcsin(frequency * 1e-3 / substeps / 2.0)
    k = substeps * np.arange(1, 201)
    np.testing.assert_allclose(path, 0.004 * np.cos((k + 0.5) * angle) / np.cos(angle / 2.0), atol=1e-10)
    assert np.ptp(path) > 0.007


def energy_of(simulation):
    """Energy that symplectic Euler keeps (to second order in the substep) where nothing is damped, J."""
    model, x, v = simulation.model, simulation.positions, simulation.velocities
    nodes = model.moving
    kinetic = 0.5 * np.sum(v[nodes] ** 2 / model.inverse_mass[nodes, None])
    force = np.zeros_like(x)
    elastic_forces(model, x, 1.0, force)
    step = 1e-3 / simulation.state.status.substeps
    return (
        kinetic
        + spring_energy(x, model)
        + angular_energy(x, model)
        + return_energy(x, model)
        + 0.5 * step * np.vdot(v[nodes], force[nodes])
    )


@pytest.mark.parametrize("organ", [ball(), pytest.param(kidney(), marks=pytest.mark.extended)], ids=["ball", "kidney"])
@pytest.mark.parametrize("size", [0.5, 2.5, 5.0])
def test_energy_never_grows_with_damping_and_no_input(organ, size):
    simulation = Simulation(organ)
    poke(simulation, 100, force=(0.02 * size, 0.0, -0.1 * size))
    assert np.abs(simulation.positions - simulation.model.rest).max() > 1e-4
    energies = []
    for _ in range(400):
        simulation.step()
        energies.append(energy_of(simulation))
    assert energies[0] > 1e-6
    assert np.diff(energies).max() <= 1e-9 * energies[0]
    assert energies[-1] < 1e-3 * energies[0]


def test_energy_of_an_undamped_organ_stays():
    simulation = Simulation(changed(ball(), damping=0.0))
    poke(simulation, 60, force=(0.0, 0.0, -0.05))
    energies = []
    for tick in range(3000):
        simulation.step()
        if tick < 500 or tick >= 2500:
            energies.append(energy_of(simulation))
    assert np.mean(energies[500:]) == pytest.approx(np.mean(energies[:500]), rel=1e-3)


# repeatability ---------------------------------------------------------------------------------
@pytest.mark.parametrize("region", LOCAL_REGIONS)
def test_two_runs_are_bit_identical(region):
    runs = []
    for _ in range(2):
        simulation = Simulation(organ_for(region), local_region=region)
        poke(simulation, 60)
        for _ in range(60):
            simulation.step()
        runs.append(simulation.state.words.copy())
    np.testing.assert_array_equal(*runs)
    assert np.any(simulation.positions != simulation.model.rest)


@pytest.mark.parametrize("region", LOCAL_REGIONS)
def test_restored_snapshot_continues_bit_identically(region):
    simulation = Simulation(organ_for(region), local_region=region)
    poke(simulation, 30)
    taken = snapshot(simulation)
    other = Simulation(organ_for(region), local_region=region)
    poke(other, 11, force=(-0.3, 0.2, 0.0))
    other.restore(taken)
    assert other.state.status.tick == 30
    for one in (simulation, other):
        poke(one, 30)
        for _ in range(30):
            one.step()
    assert_same(simulation, other)


def test_snapshot_of_another_organ_is_refused():
    simulation, other = Simulation(ball()), Simulation(ball(2))
    before = simulation.state.words.copy()
    with pytest.raises(UserError, match="belongs to another organ"):
        simulation.restore(snapshot(other))
    np.testing.assert_array_equal(simulation.state.words, before)


UNCOMPILED = """
import sys
import numpy as np
from tissue_sim.model import Simulation
from tissue_sim.organ.organ import Organ
simulation = Simulation(Organ.load(sys.argv[1]))
for _ in range(4):
    simulation.apply_force(int(sys.argv[2]), [0.1, 0.0, -0.5])
    simulation.step()
np.save(sys.argv[3], simulation.positions)
"""


def test_positions_without_the_compiler_agree(tmp_path):
    organ = ball()
    organ.save(tmp_path / "ball.npz")
    simulation = Simulation(organ)
    poke(simulation, 4)
    subprocess.run(
        [sys.executable, "-c", UNCOMPILED, tmp_path / "ball.npz", str(top_node(organ)), tmp_path / "positions.npy"],
        cwd=ROOT,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        check=True,
    )
    assert np.abs(simulation.positions - organ.rest_positions).max() > 1e-5
    np.testing.assert_allclose(np.load(tmp_path / "positions.npy"), simulation.positions, rtol=0.0, atol=1e-12 * 0.03)


def test_reset_brings_the_rest_shape_back_and_the_counters_go_on():
    simulation = Simulation(kidney(), shapes=sphere_tools(0.01))
    poke(simulation, 20)
    simulation.velocities[simulation.model.moving[0]] = np.nan
    simulation.step()
    assert simulation.state.count.faults == 1
    simulation.reset()
    np.testing.assert_array_equal(simulation.positions, simulation.model.rest)
    np.testing.assert_array_equal(simulation.velocities, 0.0)
    assert simulation.asleep
    assert simulation.state.status.tick == 21
    assert simulation.state.count.faults == 1
    fresh = Simulation(kidney(), shapes=sphere_tools(0.01))
    poke(fresh, 20)
    poke(simulation, 20)
    np.testing.assert_array_equal(simulation.positions, fresh.positions)


def test_reset_forgets_a_force_that_was_not_yet_used():
    simulation = Simulation(ball())
    simulation.apply_force(top_node(ball()), [0.0, 0.0, 1.0])
    simulation.reset()
    simulation.step()
    assert simulation.asleep


# refusals --------------------------------------------------------------------------------------
def test_force_lasts_one_tick_and_adds_up():
    organ = free_ball()
    simulation = Simulation(organ)
    node = top_node(organ)
    simulation.apply_force([node, node], [[0.0, 0.0, 0.1], [0.2, 0.0, 0.0]])
    simulation.apply_force(node, [0.0, 0.3, 0.0])
    simulation.step()
    expected = 1e-3 * np.array([0.2, 0.3, 0.1])
    np.testing.assert_allclose(organ.mass @ simulation.velocities, expected, rtol=1e-9)
    simulation.step()
    np.testing.assert_allclose(organ.mass @ simulation.velocities, expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("nodes", "forces", "message"),
    [
        ([3], [[np.nan, 0.0, 0.0]], "finite"),
        ([3], [[0.0, np.inf, 0.0]], "finite"),
        ([-1], [[1.0, 0.0, 0.0]], r"0\.\.46"),
        ([2, 47], np.ones((2, 3)), r"0\.\.46"),
        ([1, 2], np.ones((3, 3)), "forces"),
        ([1, 2], np.ones((3, 2)), "forces"),
    ],
)
def test_bad_force_is_refused_and_leaves_the_organ_alone(nodes, forces, message):
    simulation = Simulation(ball())
    with pytest.raises(UserError, match=message):
        simulation.apply_force(nodes, forces)
    simulation.step()
    assert simulation.asleep
    assert np.array_equal(simulation.positions, simulation.model.rest)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"model": "jelly"}, "jelly"),
        ({"local_region": "melted"}, "melted.*off, frozen"),
        ({"rate": 0.0}, "rate 0 Hz"),
        ({"rate": 1e6}, "rate 1e\\+06 Hz"),
        ({"rate": float("nan")}, "rate nan"),
    ],
)
def test_wrong_options_are_refused_by_name(options, message):
    with pytest.raises(UserError, match=message):
        Simulation(ball(), **options)


# guard -----------------------------------------------------------------------------------------
def checked_steps(simulation, ticks):
    """Step, and let no position leave that is not finite or out of bounds."""
    span = simulation.settings.runaway_span
    for _ in range(ticks):
        simulation.step()
        assert np.all(np.isfinite(simulation.positions))
        assert np.all(np.isfinite(simulation.velocities))
        assert np.all(np.isfinite(simulation.state.wrench))
        assert np.linalg.norm(simulation.positions - simulation.model.rest, axis=1).max() <= span


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("region", LOCAL_REGIONS)
def test_velocity_that_is_not_finite_never_shows(bad, region):
    simulation = Simulation(organ_for(region), local_region=region)
    poke(simulation, 20, force=(0.0, 0.0, -0.05))
    before = simulation.positions.copy()
    simulation.velocities[top_node(simulation.organ), 1] = bad
    checked_steps(simulation, 1)
    assert simulation.state.count.faults == 1
    # Around a modal region the last good tick's edge is a micrometre from where it was shown.
    np.testing.assert_allclose(
        simulation.positions, before, rtol=0.0, atol=1e-6 if region in ("modal", "auto") else 0.0
    )
    assert np.abs(simulation.velocities).max() == 0.0
    checked_steps(simulation, 1000)
    assert simulation.state.count.faults == 1
    assert simulation.asleep


@pytest.mark.parametrize("region", LOCAL_REGIONS)
def test_runaway_force_never_shows_and_the_organ_goes_on(region):
    simulation = Simulation(organ_for(region), local_region=region)
    poke(simulation, 20, force=(0.0, 0.0, -0.05))
    normal = simulation.state.status.substeps
    simulation.apply_force(top_node(simulation.organ), [0.0, 0.0, 1e9])
    checked_steps(simulation, 1)
    assert simulation.state.count.faults == 1
    checked_steps(simulation, 1)
    assert simulation.state.status.substeps == 2 * normal
    checked_steps(simulation, 1500)
    assert simulation.asleep
    poke(simulation, 1)
    assert simulation.state.status.substeps == normal
    assert simulation.state.count.faults == 1


def test_force_that_runs_away_tick_after_tick_is_counted_each_time():
    simulation = Simulation(ball())
    for _ in range(10):
        simulation.apply_force(top_node(ball()), [1e9, 0.0, 0.0])
        checked_steps(simulation, 1)
    assert simulation.state.count.faults == 10
    assert simulation.state.status.substeps <= 8 * simulation.settings.substeps
    np.testing.assert_array_equal(simulation.positions, simulation.model.rest)


# false rest shapes -----------------------------------------------------------------------------
@pytest.mark.parametrize(
    "organ",
    [ball(2), *(pytest.param(organ, marks=pytest.mark.extended) for organ in (ball(3), kidney()))],
    ids=["ball", "fine ball", "kidney"],
)
@pytest.mark.parametrize("force", [1.0, 4.0, 16.0])
def test_organ_is_back_at_rest_after_any_load(organ, force):
    """Nodes pulled through the organ can stay there, springs at peace, inside out: the model must not leave them."""
    simulation = Simulation(organ)
    poke(simulation, 150, force=(0.1 * force, 0.0, -force))
    reach = np.abs(simulation.positions - simulation.model.rest).max()
    # Sixteen newtons on the tenth of a gram of one node are more than the guard lets through.
    assert reach > 0.005 or simulation.state.count.faults > 0
    checked_steps(simulation, 1500)
    assert simulation.asleep
    assert np.abs(simulation.positions - simulation.model.rest).max() <= 0.01 * reach


def on_the_way_back():
    """A ball that was found still in a shape that is not its own: its upper half 10 mm aside."""
    simulation = Simulation(ball(2))
    state = simulation.state
    simulation.positions[(simulation.model.rest[:, 2] > 0.0) & (simulation.model.inverse_mass > 0.0), 0] += 0.01
    state.good_position[:] = simulation.positions
    state.status.asleep, state.status.snapped = False, 1
    return simulation


def test_false_rest_shape_is_left_without_a_jump():
    simulation = on_the_way_back()
    for _ in range(1000):
        before = simulation.positions.copy()
        simulation.step()
        assert np.abs(simulation.positions - before).max() <= 3e-4
        if simulation.asleep:
            break
    assert simulation.asleep
    assert not simulation.state.status.snapped
    assert np.abs(simulation.positions - simulation.model.rest).max() < 1e-5


def test_touch_on_the_way_back_gives_the_organ_to_the_springs_again():
    simulation = on_the_way_back()
    checked_steps(simulation, 10)
    poke(simulation, 1, force=(0.0, 0.0, -0.01))
    assert not simulation.state.status.snapped
    assert np.abs(simulation.velocities).max() > 1e-3


def test_fault_on_the_way_back_does_not_return_to_the_false_shape():
    simulation = on_the_way_back()
    checked_steps(simulation, 100)
    here = simulation.positions.copy()
    assert np.abs(here - simulation.model.rest).max() < 0.002
    simulation.apply_force(top_node(simulation.organ), [0.0, 0.0, 1e9])
    checked_steps(simulation, 1)
    assert simulation.state.count.faults == 1
    np.testing.assert_array_equal(simulation.positions, here)


# allocation ------------------------------------------------------------------------------------
def test_step_allocates_no_python_memory():
    simulation = Simulation(kidney())
    poke(simulation, 2)

    def run(steps):
        for _ in range(steps):
            simulation.state.status.quiet = 0  # stay awake
            simulation.step()

    run(500)  # until Numba's caches of argument types are full
    before = sys.getallocatedblocks()
    run(500)
    assert sys.getallocatedblocks() - before < 100
    tracemalloc.start()
    try:
        peaks = []
        for _ in range(100):
            size, _ = tracemalloc.get_traced_memory()
            tracemalloc.reset_peak()
            run(1)
            peaks.append(tracemalloc.get_traced_memory()[1] - size)
    finally:
        tracemalloc.stop()
    assert not simulation.asleep
    # Not even for a moment: one array of the nodes' size would show.
    assert max(peaks) < 0.2 * simulation.positions.nbytes


def test_kernels_of_a_step_allocate_no_arrays():
    """What Numba allocates in a tick awake is what it takes to pass the arguments: as much as for a tick asleep."""
    _nrt_python.memsys_enable_stats()
    simulation = Simulation(kidney(), shapes=sphere_tools(0.01))
    simulation.step()

    def allocations():
        before = rtsys.get_allocation_stats().alloc
        for _ in range(10):
            simulation.step()
        return rtsys.get_allocation_stats().alloc - before

    asleep = allocations()
    assert simulation.asleep
    poke(simulation, 2)
    awake = allocations()
    assert not simulation.asleep
    assert awake == asleep


# settle ----------------------------------------------------------------------------------------
def loads_of(organ, size):
    forces = np.zeros((organ.n_surface, 3))
    forces[top_node(organ)] = size * np.array([0.2, 0.1, -1.0])
    return forces


def linear_answer(simulation, forces):
    """Displacements K^-1 f of the model about its rest shape, by conjugate gradients."""
    model = simulation.model
    nodes = model.moving

    def product(vector):
        step = np.zeros_like(model.rest)
        step[nodes] = 1e-8 * vector.reshape(-1, 3) / np.abs(vector).max()
        ahead, behind = np.zeros_like(step), np.zeros_like(step)
        elastic_forces(model, model.rest + step, 1.0, ahead)
        elastic_forces(model, model.rest - step, 1.0, behind)
        return ((behind - ahead)[nodes] * np.abs(vector).max() / 2e-8).ravel()

    size = 3 * len(nodes)
    load = np.zeros_like(model.rest)
    load[: len(forces)] = forces
    tolerance = "rtol" if "rtol" in inspect.signature(cg).parameters else "tol"  # before SciPy 1.12
    operator = LinearOperator((size, size), matvec=product, dtype=float)
    answer, failed = cg(operator, load[nodes].ravel(), **{tolerance: 1e-8})
    assert not failed
    displacement = np.zeros_like(model.rest)
    displacement[nodes] = answer.reshape(-1, 3)
    return displacement[: len(forces)]


@pytest.mark.parametrize("variant", ["surface", "volume", "hybrid"])
def test_settled_displacements_under_a_small_load_are_those_of_the_linear_model(variant):
    organ = ball()
    simulation = Simulation(organ, model=variant)
    forces = loads_of(organ, 1e-4)
    found, settled = simulation.settle(forces, tolerance=1e-5)
    expected = linear_answer(simulation, forces)
    assert settled
    assert np.abs(expected).max() > 1e-7
    assert np.abs(found - expected).max() <= 2e-3 * np.abs(expected).max()


def test_settled_displacements_double_with_a_small_load():
    simulation = Simulation(kidney())
    one, first = simulation.settle(loads_of(kidney(), 1e-3))
    two, second = simulation.settle(loads_of(kidney(), 2e-3))
    assert first
    assert second
    assert np.abs(one).max() > 1e-5
    assert np.abs(two - 2.0 * one).max() <= 0.01 * np.abs(two).max()


def test_settled_forces_balance():
    simulation = Simulation(kidney())
    forces = loads_of(kidney(), 0.2)
    displacements, settled = simulation.settle(forces, tolerance=1e-3)
    assert settled
    assert simulation.positions[: kidney().n_surface] == pytest.approx(kidney().surface_positions + displacements)
    force = np.zeros_like(simulation.positions)
    elastic_forces(simulation.model, simulation.positions, 1.0, force)
    force[: len(forces)] += forces
    assert np.linalg.norm(force[simulation.model.moving]) <= 1e-3 * np.linalg.norm(forces)


def test_settle_starts_from_rest_each_time():
    simulation = Simulation(kidney())
    first = simulation.settle(loads_of(kidney(), 0.3))[0]
    simulation.settle(-loads_of(kidney(), 0.6))
    np.testing.assert_array_equal(simulation.settle(loads_of(kidney(), 0.3))[0], first)


def test_forces_raised_slowly_lead_to_the_same_rest_without_a_swing():
    reached = []
    for ramp in (0.0, 0.3):
        simulation, peak = Simulation(ball()), 0.0
        step = simulation.step

        def watched(simulation=simulation, step=step):
            nonlocal peak
            step()
            peak = max(peak, float(np.abs(simulation.positions - simulation.model.rest).max()))

        simulation.step = watched
        displacement, settled = simulation.settle(loads_of(ball(), 0.05), tolerance=1e-5, ramp=ramp)
        assert settled
        assert simulation.state.status.tick >= 1000 * ramp
        reached.append((displacement, peak / np.abs(displacement).max()))
    (at_once, swing), (raised, little) = reached
    np.testing.assert_allclose(raised, at_once, atol=1e-4 * np.abs(at_once).max())
    assert little < 1.0 + 0.5 * (swing - 1.0) + 1e-3


def test_settle_says_when_it_ran_out_of_time():
    simulation = Simulation(kidney())
    _, settled = simulation.settle(loads_of(kidney(), 0.5), longest=0.02)
    assert settled is False


def test_settle_without_a_load_is_rest():
    displacements, settled = Simulation(ball()).settle(np.zeros((42, 3)))
    assert settled is True
    np.testing.assert_array_equal(displacements, np.zeros((42, 3)))


def test_runaway_load_does_not_settle_and_spoils_nothing_after_it():
    organ = ball()
    simulation = Simulation(organ)
    displacements, settled = simulation.settle(loads_of(organ, 1e9), longest=0.1)
    assert not settled
    assert np.all(np.isfinite(displacements))
    expected, _ = Simulation(organ).settle(loads_of(organ, 0.1))
    found, settled = simulation.settle(loads_of(organ, 0.1))
    assert settled
    np.testing.assert_array_equal(found, expected)


def test_load_on_held_nodes_alone_is_rest_also_after_a_fault():
    organ = ball()
    simulation = Simulation(organ)
    simulation.settle(loads_of(organ, 1e9), longest=0.02)
    forces = np.zeros((organ.n_surface, 3))
    forces[organ.fixed] = 1.0
    displacements, settled = simulation.settle(forces, longest=0.2)
    assert settled
    assert np.abs(displacements).max() < 1e-12
