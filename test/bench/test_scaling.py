"""Growth of a tick with the organ."""

import numpy as np
import pytest

from tissue_sim.bench.organs import bean, patch_load
from tissue_sim.bench.scaling import as_json, carried_modes, exponent, measure, with_modes
from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.model.elasticity.modes import lowest_modes


def test_exponent_of_a_power():
    assert exponent([10, 100, 1000], [3.0, 3.0 * 10**1.3, 3.0 * 10**2.6]) == pytest.approx(1.3)


@pytest.fixture(scope="module")
def carried():
    coarse, fine = bean(300), bean(700)
    model = assemble(fine)
    return fine, model, carried_modes(coarse, lowest_modes(assemble(coarse), 24), fine, model)


def test_carried_modes_are_near_the_organs_own(carried):
    _, model, modes = carried
    own = lowest_modes(model, 12).frequency
    assert np.all(modes.frequency[:12] >= 0.999 * own), "from above, as Rayleigh-Ritz gives them"
    assert modes.frequency[:12] == pytest.approx(own, rel=0.2)


def test_carried_modes_are_orthonormal_and_held(carried):
    fine, model, modes = carried
    mass = np.zeros(len(model.rest))
    mass[model.moving] = 1.0 / model.inverse_mass[model.moving]
    product = np.einsum("nxi,n,nxj->ij", modes.shape, mass, modes.shape)
    np.testing.assert_allclose(product, np.eye(len(product)), atol=1e-9)
    assert not np.any(modes.shape[fine.fixed])


@pytest.mark.extended
def test_simulation_takes_the_modes_and_keeps_nothing(carried, monkeypatch, tmp_path):
    fine, _, modes = carried
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    simulation = with_modes(fine, modes)
    assert not list(tmp_path.rglob("*.npz"))
    assert len(simulation.state.mode_position) == len(modes.frequency)
    nodes, forces = patch_load(fine, 0.02)
    for _ in range(50):
        simulation.apply_force(nodes, forces)
        simulation.step()
    assert np.mean((simulation.positions - simulation.model.rest)[nodes] @ forces[0]) > 0.0


@pytest.mark.slow
def test_growth_is_measured_at_every_size():
    found = as_json(measure((300, 600), 0.05))
    assert [size["points"] for size in found["sizes"]] == [300, 600]
    for size in found["sizes"]:
        assert 0.0 < size["modal_us"] < 1e5
        assert size["substep_us"] == pytest.approx(size["whole_us"] / size["substeps"])
    small, large = found["sizes"]
    assert large["whole_us"] > small["whole_us"]
    assert found["modal_ratio"] == pytest.approx(large["modal_us"] / small["modal_us"])
