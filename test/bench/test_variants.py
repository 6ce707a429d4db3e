"""The organs of one size: uncalibrated, calibrated by groups, calibrated cell by cell."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball, filled
from tissue_sim.model.simulation import Simulation

pytest.importorskip("skfem", reason="fits need the extra calibration")
pytest.importorskip("netgen", reason="fits need the extra calibration")

from tissue_sim.bench import variants
from tissue_sim.bench.organs import patch_load
from tissue_sim.bench.sizes import sized
from tissue_sim.bench.variants import Effort, effort_at, fitted, is_calibrated, variants_of
from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.reference import finer_reference_body
from tissue_sim.calibration.stiffness import INTERIOR_FRACTION, Settings, prepared

ORGAN = filled(ball(1), 8)
FILLED = {"groups": ORGAN} | {aim: prepared(ORGAN, Settings(aim=aim)) for aim in ("balanced", "fast")}


@pytest.fixture(scope="module")
def fits():
    body = Body(ORGAN)
    return {method: fitted(body, organ, method, Effort(15, 40)) for method, organ in FILLED.items()}


def organ_of(method, made):
    return replace(FILLED[method], **{name: values for name, values in made.items() if name != "modes_off"})


@pytest.mark.extended
def test_cells_fit_better_than_groups_and_groups_better_than_none(fits):
    """Under a load that no fit has seen, small enough for linear elasticity."""
    nodes, forces = patch_load(ORGAN, 1e-3)
    force = np.zeros((ORGAN.n_surface, 3))
    force[nodes] = forces
    wanted = finer_reference_body(Body(ORGAN), force[None]).settle_linear(force[None])[0]
    organs = {"none": ORGAN} | {method: organ_of(method, made) for method, made in fits.items()}
    error = {
        name: np.linalg.norm(Simulation(organ).settle(force, 1e-5)[0] - wanted) / np.linalg.norm(wanted)
        for name, organ in organs.items()
    }
    assert error["balanced"] < 0.5 * error["groups"]
    assert error["fast"] < 0.7 * error["groups"]
    assert error["groups"] < 0.8 * error["none"]


@pytest.mark.extended
def test_fit_keeps_the_mass_and_the_step(fits):
    for method, made in fits.items():
        assert made["modes_off"].max() < 0.5
        assert made["mass"].sum() == pytest.approx(ORGAN.mass.sum(), rel=0.02 if method == "fast" else 0.003)
        simulation = Simulation(organ_of(method, made))
        assert simulation.critical_step > 2e-4


def test_fits_are_kept(monkeypatch, tmp_path):
    """However good they are: these are made up."""
    cells, springs = FILLED["balanced"], FILLED["groups"]
    fits = {
        "balanced": {"cell_mu": 1.5 * cells.cell_mu, "mass": 2.0 * cells.mass, "modes_off": np.array([0.01, 0.02])},
        "groups": {"spring_stiffness": 1.5 * springs.spring_stiffness, "modes_off": np.array([0.03, 0.04])},
    }
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    made = []
    monkeypatch.setattr(variants, "fitted", lambda _body, _organ, kind, _effort: made.append(kind) or fits[kind])
    for _ in range(2):
        found = variants_of(Body(ORGAN), ORGAN.n_surface, fits=True)
        assert made == ["balanced", "groups"]
        np.testing.assert_array_equal(found.cells["balanced"].cell_mu, fits["balanced"]["cell_mu"])
        assert "linear loads" in found.cells["balanced"].provenance["fit"]
    np.testing.assert_array_equal(found.plain.spring_stiffness, ORGAN.spring_stiffness)


@pytest.mark.slow
def test_a_clusters_fits_are_kept_as_if_made_here(monkeypatch, tmp_path, cluster):
    """Whose workers have no say in how much effort a fit is given: so at full effort, of a small organ."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    variants.fit_on_cluster(ORGAN, [ORGAN.n_surface], cluster[0])
    monkeypatch.setattr(variants, "fitted", None)
    found = variants_of(Body(ORGAN), ORGAN.n_surface, fits=True, every_aim=True)
    assert set(found.cells) == set(INTERIOR_FRACTION)
    assert all(is_fitted(organ) for organ in (*found.cells.values(), found.groups))


def is_fitted(organ):
    return "linear loads" in organ.provenance["fit"]


def test_calibrated_organ_is_taken_as_it_is_at_its_own_size():
    own = replace(ORGAN, provenance={"calibration": {"method": "cells"}})
    assert is_calibrated(own)
    assert not is_calibrated(replace(ORGAN, provenance={"calibration": {"method": "groups"}}))
    quick = variants_of(Body(own), own.n_surface, fits=False)
    assert quick.cells["balanced"] is own
    assert isinstance(quick.groups, str)
    missing = variants_of(Body(ORGAN), ORGAN.n_surface, fits=False).cells["balanced"]
    assert "tissue_sim calibrate" in str(missing)


def test_an_organ_gets_the_interior_atoms_that_calibrate_would_give_it():
    assert FILLED["balanced"].n_interior == round(INTERIOR_FRACTION["balanced"] * ORGAN.n_surface)


@pytest.mark.extended
def test_finer_organ_learns_from_the_references_body(monkeypatch, tmp_path, fits):
    """Fitted at twice the points it meets a load that no fit has seen better than the organ does at its own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(variants, "effort_at", lambda _points: Effort(15, 40))
    body = Body(ORGAN)
    force = np.zeros((ORGAN.n_surface, 3))
    nodes, forces = patch_load(ORGAN, 1e-3)
    force[nodes] = forces
    wanted = finer_reference_body(body, force[None]).settle_linear(force[None])[0]

    def error(organ):
        size = sized(organ, ORGAN)
        found = size.displacement(Simulation(organ).settle(size.forces(force), 1e-5)[0])
        return np.linalg.norm(found - wanted) / np.linalg.norm(wanted)

    finer = variants_of(body, 2 * ORGAN.n_surface, fits=True)
    assert isinstance(finer.groups, str)
    made = finer.cells["balanced"]
    assert made.n_surface == 2 * ORGAN.n_surface
    assert made.n_interior == round(INTERIOR_FRACTION["balanced"] * made.n_surface)
    assert error(made) < 0.1
    assert error(made) < 1.2 * error(organ_of("balanced", fits["balanced"]))


def test_larger_organs_get_fewer_cases():
    efforts = [effort_at(points) for points in (250, 994, 2000, 4000, 16_000)]
    assert efforts[0] == efforts[1]
    for larger, smaller in zip(efforts[2:], efforts[1:], strict=False):
        assert larger.cases * larger.steps < smaller.cases * smaller.steps
