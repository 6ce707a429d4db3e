"""The fit: slopes against finite differences, a known model recovered, caps and repeatability."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball
from helpers.springs_of_ball import MODEL, ORGAN, SPRINGS, START, linear_answers
from tissue_sim.calibration import fit as fitting
from tissue_sim.calibration.cases import fit_cases, held_out_cases, principal
from tissue_sim.calibration.elastic import Elastic
from tissue_sim.calibration.evaluation import errors
from tissue_sim.calibration.fit import BOUNDS, Misfit, Penalties, fit
from tissue_sim.calibration.stiffness import Settings, first_stiffness, prepared
from tissue_sim.calibration.tissue_fit import CELL_BOUNDS
from tissue_sim.model.elasticity.assembly import assemble

TRUTH = START * np.exp(0.5 * np.random.default_rng(7).standard_normal(len(START)))


def settled(elastic, stiffness, force):
    """Linear answers (c, n_surface, 3) m of a model of cells."""
    load = np.zeros((len(force), elastic.n_nodes, 3))
    load[:, : elastic.n_surface] = force
    found = np.zeros((len(force), 3 * elastic.n_nodes))
    factor = elastic.factor(elastic.tangent(stiffness))
    found[:, elastic.free] = factor.solve(np.ascontiguousarray(load.reshape(len(force), -1)[:, elastic.free].T)).T
    return found.reshape(load.shape)[:, : elastic.n_surface]


def slope_by_differences(misfit, stiffness, chosen, step):
    for spring in chosen:
        ahead, behind = stiffness.copy(), stiffness.copy()
        ahead[spring] *= 1.0 + step
        behind[spring] *= 1.0 - step
        change = misfit.evaluate(ahead).loss - misfit.evaluate(behind).loss
        yield change / (2.0 * step * stiffness[spring])


def springs_that_count(slope, stiffness):
    """Springs of each kind whose stiffness makes a difference."""
    weight = np.abs(slope * stiffness)
    first, second = np.cumsum([len(MODEL.spring_first), len(MODEL.angular_nodes)])
    kinds = (range(first), range(first, second), range(second, len(slope)))
    return [int(kind[int(np.argsort(-weight[kind.start : kind.stop])[k])]) for kind in kinds for k in (0, 5)]


def test_linear_slope_is_that_by_finite_differences():
    force = fit_cases(ORGAN, 12, 0)
    misfit = Misfit(SPRINGS, force, linear_answers(TRUTH, force))
    slope = misfit.evaluate(START).slope
    chosen = springs_that_count(slope, START)
    np.testing.assert_allclose(slope[chosen], list(slope_by_differences(misfit, START, chosen, 1e-4)), rtol=1e-4)


def test_overlapping_linear_cases_are_combined_and_tell_what_they_distinguished():
    force = fit_cases(ORGAN, 600, 0)
    wanted = linear_answers(TRUTH, force)
    misfit, found = Misfit(SPRINGS, force, wanted), linear_answers(START, force)
    assert misfit.combinations.shape[1] < 0.5 * len(force)
    evaluation = misfit.evaluate(START)
    apart = errors(found, wanted)
    assert evaluation.loss == pytest.approx(np.mean(apart**2), rel=0.01)
    np.testing.assert_allclose(evaluation.error, apart, atol=0.02)
    chosen = springs_that_count(evaluation.slope, START)
    slopes = slope_by_differences(misfit, START, chosen, 1e-4)
    np.testing.assert_allclose(evaluation.slope[chosen], list(slopes), rtol=1e-4)


def test_curvature_is_that_of_gauss_and_newton(monkeypatch):
    """Against displacements by finite differences; the estimate is off by the root of two over the draws."""
    monkeypatch.setattr(fitting, "PROBES", 400)
    force = fit_cases(ORGAN, 12, 0)
    wanted = linear_answers(TRUTH, force)
    misfit = Misfit(SPRINGS, force, wanted)
    curvature = misfit.curvature(START)
    size = np.linalg.norm(wanted, axis=(1, 2))[:, None, None]
    for spring in springs_that_count(misfit.evaluate(START).slope, START):
        ahead, behind = START.copy(), START.copy()
        ahead[spring] *= 1.0 + 1e-4
        behind[spring] *= 1.0 - 1e-4
        change = (linear_answers(ahead, force) - linear_answers(behind, force)) / (2e-4 * size)
        assert curvature[spring] == pytest.approx(2.0 * np.sum(change**2) / len(force), rel=0.3)


def test_curvature_takes_the_fit_of_an_organ_on_a_small_clamp_further(monkeypatch):
    """In as many evaluations: without it, and with all of it, the misfit stays higher."""
    body = ball(2)
    heights = body.surface_positions[body.surface_triangles][:, :, 2].mean(axis=1)
    clamp = np.sort(body.surface_triangles[np.argmin(heights)])
    organ = prepared(replace(body, fixed=clamp), Settings(interior=20))
    model = assemble(organ)
    elastic, even = Elastic(model), first_stiffness(organ, model)
    moduli = even * np.exp(0.5 * np.random.default_rng(1).normal(size=len(even)))
    force = fit_cases(organ, 60, 0)
    misfit = Misfit(elastic, *principal(force, settled(elastic, moduli, force)))
    curvature = misfit.curvature(even)
    assert curvature.max() > 1e5 * np.median(curvature)

    def left() -> float:
        return misfit.evaluate(fit(misfit, even, 60, bounds=CELL_BOUNDS)).loss

    found = left()
    for power in (0.0, 0.5):
        monkeypatch.setattr(fitting, "EVENED", power)
        assert found < 0.7 * left()


def test_a_known_model_is_recovered_in_what_it_does():
    force, judged = fit_cases(ORGAN, 60, 0), held_out_cases(ORGAN, 10, 4).force
    misfit = Misfit(SPRINGS, force, linear_answers(TRUTH, force))
    wanted = linear_answers(TRUTH, judged)
    before = errors(linear_answers(START, judged), wanted).mean()
    found = fit(misfit, START, 90, penalties=Penalties(shrink=1e-7, soften=0.0))
    after = errors(linear_answers(found, judged), wanted).mean()
    assert before > 0.08
    assert after < 0.1 * before


def test_the_same_fit_gives_the_same_bits_and_stays_within_its_bounds():
    force = fit_cases(ORGAN, 20, 0)
    wanted = linear_answers(TRUTH, force)
    first, again = (fit(Misfit(SPRINGS, force, wanted), START, 12) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert np.all(np.abs(np.log(first / START)) <= np.abs(BOUNDS[0]) + 1e-12)
    assert np.all(np.log(first / START) <= BOUNDS[1] + 1e-12)


def test_softening_lowers_the_trace():
    force = fit_cases(ORGAN, 20, 0)
    misfit = Misfit(SPRINGS, force, linear_answers(TRUTH, force))
    hard, soft = (fit(misfit, START, 25, penalties=Penalties(soften=soften)) for soften in (0.0, 0.01))
    assert SPRINGS.trace() @ soft < 0.95 * (SPRINGS.trace() @ hard)


def test_cells_are_found_by_the_same_fit_within_their_bounds():
    organ = prepared(ball(2), Settings(interior=20))
    model = assemble(organ)
    elastic, even = Elastic(model), first_stiffness(organ, model)
    moduli = even * np.exp(0.5 * np.random.default_rng(0).normal(size=len(even)))
    force = fit_cases(organ, 42, 0)
    misfit = Misfit(elastic, force, settled(elastic, moduli, force))
    assert misfit.evaluate(moduli).error.max() < 0.02
    found = fit(misfit, even, 60, bounds=CELL_BOUNDS)
    assert misfit.evaluate(found).error.mean() < 0.25 * misfit.evaluate(even).error.mean()
    logarithm = np.log(found / even)
    assert CELL_BOUNDS[0] - 1e-12 <= logarithm.min() < logarithm.max() <= CELL_BOUNDS[1] + 1e-12
