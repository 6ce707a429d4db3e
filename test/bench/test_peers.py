"""The peers: each gives way as its kind must, and stays where it is held."""

import sys
from functools import cache

import numpy as np
import pytest

from helpers.scenes import ball
from tissue_sim.bench.peers.engine import Answer, Load, settle_by_steps

pytest.importorskip("skfem", reason="the peers' meshes need the extra calibration")
pytest.importorskip("netgen", reason="the peers' meshes need the extra calibration")

from tissue_sim.bench.organs import patch_load
from tissue_sim.bench.peers.linear_fem import Compliance, LinearTetrahedra, QuadraticTetrahedra, compliance_table
from tissue_sim.bench.peers.ours import Ours
from tissue_sim.bench.peers.tetrahedra import tetrahedra_of, volumes
from tissue_sim.model.simulation import Simulation

ORGAN = ball(2)
SMALL = ball(1)  # for XPBD, which moves its nodes one by one in Python


@cache
def mesh(organ=ORGAN):
    return tetrahedra_of(organ)


@cache
def quadratic(organ=ORGAN):
    return QuadraticTetrahedra(organ)


@cache
def table():
    return compliance_table(quadratic().body)


def load(newton=0.02, organ=ORGAN):
    nodes, forces = patch_load(organ, newton)
    force = np.zeros((organ.n_surface, 3))
    force[nodes] = forces
    return Load(force, np.zeros_like(force))


def off(found, wanted):
    return np.linalg.norm(found - wanted) / np.linalg.norm(wanted)


def test_mesh_fills_the_organ_and_begins_with_its_surface():
    nodes, cells = mesh()
    np.testing.assert_allclose(nodes[: ORGAN.n_surface], ORGAN.surface_positions, rtol=1e-12)
    assert volumes(nodes, cells).min() > 0.0
    assert volumes(nodes, cells).sum() == pytest.approx(ORGAN.volume, rel=1e-9)
    assert mesh().masses(ORGAN.density).sum() == pytest.approx(ORGAN.density * ORGAN.volume, rel=1e-9)
    edges = mesh().edges
    assert len(np.unique(edges, axis=0)) == len(edges)
    assert len(nodes) - len(edges) + (len(ORGAN.surface_triangles) + 4 * len(cells)) // 2 - len(cells) == 1  # Euler


def test_linear_tetrahedra_are_linear_stiffer_than_quadratic_and_held():
    engine = LinearTetrahedra(ORGAN, mesh())
    one, two = (engine.settle(load(newton)).displacement for newton in (0.02, 0.04))
    np.testing.assert_allclose(two, 2.0 * one, rtol=1e-9, atol=1e-15)
    assert not one[ORGAN.fixed].any()
    soft = quadratic().settle(load()).displacement
    assert 0.4 < np.vdot(one, load().force) / np.vdot(soft, load().force) < 1.0, "they lock"
    assert np.median(engine.burst(load())(5)) > 0.0


def test_linear_tetrahedra_pass_the_patch_test():
    """A uniform strain imposed on the whole surface needs no force inside."""
    engine = LinearTetrahedra(ORGAN, mesh())
    strain = np.array([[0.01, 0.004, 0.0], [0.0, -0.005, 0.002], [0.0, 0.0, 0.003]])
    free, nodes = engine.free, mesh().nodes
    wanted = nodes @ strain
    inner = np.arange(len(nodes)) >= ORGAN.n_surface
    residual = np.zeros_like(nodes)
    residual[free] = (engine.stiffness @ wanted.ravel())[free.ravel()]
    assert np.abs(residual[inner]).max() < 1e-9 * np.abs(residual).max()


def test_compliance_is_the_quadratic_bodys():
    wanted = quadratic().settle(load()).displacement
    for one_patch in (False, True):
        engine = Compliance(ORGAN, table(), one_patch=one_patch)
        assert off(engine.settle(load()).displacement, wanted) < 1e-5
        assert np.median(engine.burst(load())(5)) > 0.0
    assert table().dtype == np.float32


def test_flex_settles_to_linear_tetrahedra_under_a_small_load():
    pytest.importorskip("mujoco", reason="needs the extra bench")
    from tissue_sim.bench.peers.mujoco import Mujoco

    small = load(1e-4)
    answer = Mujoco(ORGAN, mesh(), 0.02).settle(small)
    assert answer.settled
    assert answer.seconds > 0.0
    assert off(answer.displacement, LinearTetrahedra(ORGAN, mesh()).settle(small).displacement) < 0.02


@pytest.fixture
def xpbd():
    pytest.importorskip("pypbd", reason="needs the extra bench")
    from tissue_sim.bench.peers import xpbd

    return xpbd


def test_xpbd_gives_way_in_proportion_and_is_held(xpbd):
    engine = xpbd.Xpbd(SMALL, mesh(SMALL), xpbd.Settings())
    assert engine.constraints == len(mesh(SMALL).cells), "none was left out as too small"
    one, two = (engine.settle(load(newton, SMALL)) for newton in (0.01, 0.02))
    assert one.settled
    assert two.settled
    worked = [np.vdot(found.displacement, load(organ=SMALL).force) for found in (one, two)]
    assert worked[1] / worked[0] == pytest.approx(2, rel=0.2)
    assert not one.displacement[SMALL.fixed].any()
    # One iteration of it is an explicit step of linear tetrahedra.
    assert off(two.displacement, LinearTetrahedra(SMALL, mesh(SMALL)).settle(load(0.02, SMALL)).displacement) < 0.4


def test_xpbd_feels_no_gravity(xpbd):
    engine = xpbd.Xpbd(SMALL, mesh(SMALL), xpbd.Settings())
    nothing = Load(np.zeros((SMALL.n_surface, 3)), np.zeros((SMALL.n_surface, 3)))
    engine.burst(nothing)(200)
    assert np.abs(engine.displacement).max() < 1e-7


def test_xpbd_is_tuned_towards_the_reference(xpbd):
    pushed = load(0.02, SMALL)
    wanted = Load(pushed.force, quadratic(SMALL).settle(pushed).displacement)
    settings = xpbd.tuned(SMALL, mesh(SMALL), [wanted])
    before, after = (
        off(xpbd.Xpbd(SMALL, mesh(SMALL), chosen).settle(wanted).displacement, wanted.reached)
        for chosen in (xpbd.Settings(), settings)
    )
    assert after <= before
    assert settings.stiffness < 1.0, "linear tetrahedra are too stiff"


@pytest.mark.parametrize("name", ["mujoco", "pypbd"])
def test_missing_package_is_named(monkeypatch, name):
    from tissue_sim.bench.peers import mujoco, xpbd

    monkeypatch.setitem(sys.modules, name, None)
    make = {
        "mujoco": lambda: mujoco.Mujoco(ORGAN, mesh(), 0.02),
        "pypbd": lambda: xpbd.Xpbd(ORGAN, mesh(), xpbd.Settings()),
    }
    with pytest.raises(ModuleNotFoundError, match=name):
        make[name]()


@pytest.mark.extended
def test_our_models_settle_as_the_simulation_does():
    engine = Ours(ORGAN)
    answer = engine.settle(load())
    assert answer.settled
    expected, _ = Simulation(ORGAN).settle(load().force)
    np.testing.assert_array_equal(answer.displacement, expected)
    assert engine.substeps >= 1
    assert np.median(engine.burst(load())(20)) > 0.0


@pytest.mark.extended
def test_local_region_is_kept_whatever_the_load():
    frozen = Ours(ORGAN, local_region="frozen")
    whole, local = (engine.settle(load(0.5)).displacement for engine in (Ours(ORGAN), frozen))
    assert np.count_nonzero(np.any(local != 0.0, axis=1)) < np.count_nonzero(np.any(whole != 0.0, axis=1))


# standing still ----------------------------------------------------------------------------------
def stepping(values):
    """An engine of one point whose displacement follows `values`, one a step of 0.1 s."""
    place, shown = iter(values), np.zeros((1, 3))

    def step():
        shown[0, 0] = next(place)
        return 0.25

    return step, lambda: shown


def test_settling_waits_until_nothing_moves():
    step, surface = stepping([1.0, 2.0, 2.5, 2.5005, 9.0])
    assert settle_by_steps(step, surface, 0.1, 10.0)[1:] == (1.0, True)


def test_settling_gives_up():
    step, surface = stepping(2.0 ** np.arange(100))
    assert settle_by_steps(step, surface, 0.1, 1.0)[1:] == (2.5, False)
    step, surface = stepping([1.0, np.nan, 1.0])
    answer = settle_by_steps(step, surface, 0.1, 1.0)
    assert isinstance(answer, Answer)
    assert not answer.settled
    assert np.all(np.isfinite(answer.displacement))
