"""What a modal region knows of the rest of the organ, against dense inverses and the eigenvalue problem."""

import numpy as np
import pytest

from helpers.scenes import assembled, ball, free_ball, kidney
from tissue_sim.errors import UserError
from tissue_sim.model.data.state import Region
from tissue_sim.model.elasticity.diagonal import diagonal
from tissue_sim.model.elasticity.modes import N_MODES, stiffness_matrix
from tissue_sim.model.regions import reduction
from tissue_sim.model.regions.reduction import MODES_BESIDE_TABLE, compliance, reduce_model
from tissue_sim.model.simulation import Simulation


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path):
    """Made anew, whatever an earlier run has left in the user's cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


def free_of(model):
    return (3 * model.moving[:, None] + np.arange(3)).ravel()


@pytest.mark.parametrize("variant", ["surface", "volume", "hybrid"])
def test_compliance_is_the_inverse_of_the_stiffness(variant):
    model = assembled(ball(2), variant)
    free, table = free_of(model), compliance(model)
    expected = np.linalg.inv(stiffness_matrix(model)[free][:, free].toarray())
    assert table.dtype == np.float32
    assert np.abs(table[np.ix_(free, free)] - expected).max() <= 2e-7 * np.abs(expected).max()
    np.testing.assert_array_equal(table, table.T)
    held = np.setdiff1d(np.arange(len(table)), free)
    assert len(held)
    np.testing.assert_array_equal(table[held], 0.0)


@pytest.mark.parametrize("organ", [ball(2), pytest.param(kidney(), marks=pytest.mark.slow)], ids=["ball", "kidney"])
def test_modes_are_orthonormal_and_bear_their_frequencies(organ):
    model = assembled(organ)
    made = reduce_model(model)
    assert made.shape.shape == (organ.n_nodes, 3, MODES_BESIDE_TABLE)
    mass = np.divide(1.0, model.inverse_mass, where=model.inverse_mass > 0.0, out=np.zeros(organ.n_nodes))
    shape = made.shape.reshape(-1, MODES_BESIDE_TABLE)
    gram = shape.T @ diagonal(np.repeat(mass, 3)) @ shape
    np.testing.assert_allclose(gram, np.eye(MODES_BESIDE_TABLE), atol=1e-9)
    stiff = shape.T @ (stiffness_matrix(model) @ shape)
    largest = made.frequency[-1] ** 2
    np.testing.assert_allclose(stiff, np.diag(made.frequency**2), atol=1e-8 * largest)
    assert np.all(np.diff(made.frequency) >= 0.0)
    np.testing.assert_array_equal(made.peak, np.abs(shape).max(axis=0))


def test_organ_too_large_for_a_table_has_more_modes_and_settles_near(monkeypatch):
    monkeypatch.setattr(reduction, "LARGEST_TABLE", 10)
    monkeypatch.setattr(reduction.reduce_model, "__defaults__", (10,))
    organ = ball(3)
    simulation = Simulation(organ, local_region="modal")
    made = simulation.model.reduction
    assert made.compliance.shape == (0, 0)
    assert len(made.frequency) == N_MODES
    node = int(np.argmax(organ.surface_positions[:, 2]))
    near = np.argsort(np.linalg.norm(organ.surface_positions - organ.surface_positions[node], axis=1))[:19]
    forces = np.zeros((organ.n_surface, 3))
    forces[near, 2] = -0.2 / 19
    found, settled = simulation.settle(forces)
    assert settled
    assert simulation.state.status.region == Region.MODAL
    expected, _ = Simulation(organ).settle(forces)
    # Modes alone know little of a load's own neighbourhood.
    assert np.linalg.norm(found - expected) <= 0.2 * np.linalg.norm(expected)


def test_second_reduction_is_remembered_and_another_stiffness_is_not(monkeypatch):
    model = assembled(ball(2))
    first = reduce_model(model)
    made = []
    monkeypatch.setattr(reduction, "_make", lambda *given: made.append(given) or pytest.fail("made again"))
    second = reduce_model(model)
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)
    with pytest.raises(pytest.fail.Exception):
        reduce_model(model._replace(spring_stiffness=2.0 * model.spring_stiffness))
    with pytest.raises(pytest.fail.Exception):
        reduce_model(model, largest=10)
    assert len(made) == 2


def test_organ_that_nothing_holds_is_refused():
    with pytest.raises(UserError, match="nothing holds"):
        compliance(assembled(free_ball()))
    with pytest.raises(UserError, match="nothing holds"):
        reduce_model(assembled(free_ball()))
