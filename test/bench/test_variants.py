"""The organs of one size: uncalibrated, calibrated by groups, calibrated spring by spring."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball, filled
from tissue_sim.model.simulation import Simulation

pytest.importorskip("skfem", reason="fits need the extra calibration")
pytest.importorskip("netgen", reason="fits need the extra calibration")

from tissue_sim.bench import variants
from tissue_sim.bench.organs import patch_load
from tissue_sim.bench.sizes import assembled_anew
from tissue_sim.bench.variants import Effort, effort_at, fitted, is_calibrated, variants_of
from tissue_sim.calibration.calibrate import HARDENING, Settings, prepared
from tissue_sim.calibration.fem import Body

ORGAN = filled(ball(1), 8)


@pytest.fixture(scope="module")
def fits():
    return {method: fitted(ORGAN, method, Effort(15, 20)) for method in ("groups", "springs")}


def test_every_spring_fits_better_than_groups_and_groups_better_than_none(fits):
    """Under a load that no fit has seen, small enough for linear elasticity."""
    nodes, forces = patch_load(ORGAN, 1e-3)
    force = np.zeros((ORGAN.n_surface, 3))
    force[nodes] = forces
    wanted = Body(ORGAN).settle_linear(force[None])[0]
    organs = {"none": ORGAN} | {method: replace(ORGAN, **made) for method, made in fits.items()}
    error = {
        name: np.linalg.norm(Simulation(organ).settle(force, 1e-5)[0] - wanted) / np.linalg.norm(wanted)
        for name, organ in organs.items()
    }
    assert error["springs"] < 0.5 * error["groups"]
    assert error["groups"] < 0.8 * error["none"]


def test_fit_keeps_the_mass_and_the_step(fits):
    for made in fits.values():
        assert made["mass"].sum() == pytest.approx(ORGAN.mass.sum(), rel=0.02)
        simulation = Simulation(replace(ORGAN, **made))
        assert simulation.critical_step > 2e-4


def test_fits_are_kept(monkeypatch, tmp_path, fits):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    made = []
    monkeypatch.setattr(variants, "fitted", lambda _organ, method, _effort: made.append(method) or fits[method])
    for _ in range(2):
        found = variants_of(ORGAN, ORGAN.n_surface, fits=True)
        assert made == ["groups", "springs"]
        np.testing.assert_array_equal(found.springs.spring_stiffness, fits["springs"]["spring_stiffness"])
        assert "linear loads" in found.springs.provenance["fit"]
    np.testing.assert_array_equal(found.plain.spring_stiffness, ORGAN.spring_stiffness)


def test_calibrated_organ_is_taken_as_it_is_at_its_own_size():
    own = replace(ORGAN, provenance={"calibration": {"method": "springs"}})
    assert is_calibrated(own)
    assert not is_calibrated(replace(ORGAN, provenance={"calibration": {"method": "groups"}}))
    quick = variants_of(own, own.n_surface, fits=False)
    assert quick.springs is own
    assert isinstance(quick.groups, str)
    assert "tissue_sim calibrate" in str(variants_of(ORGAN, ORGAN.n_surface, fits=False).springs)


def test_organ_without_interior_atoms_gets_those_that_calibrate_would_add():
    hollow = ball(2)
    wanted = round(0.15 * hollow.n_surface)
    assert assembled_anew(hollow, hollow.surface_positions, hollow.surface_triangles, wanted).n_interior == wanted
    assert prepared(hollow, Settings()).n_interior == wanted
    filled_one = prepared(ORGAN, Settings())
    np.testing.assert_array_equal(filled_one.spring_nodes, ORGAN.spring_nodes)
    assert filled_one.hardening == HARDENING


def test_larger_organs_get_fewer_cases():
    efforts = [effort_at(points) for points in (250, 994, 2000, 4000)]
    assert efforts[0] == efforts[1]
    assert [effort.cases for effort in efforts[1:]] == sorted((e.cases for e in efforts[1:]), reverse=True)
