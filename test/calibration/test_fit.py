"""The fit: slopes against finite differences, a known model recovered, caps and repeatability."""

import numpy as np
import pytest

from tissue_sim.calibration.cases import fit_cases, held_out_cases
from tissue_sim.calibration.fit import BOUNDS, LinearMisfit, NonlinearMisfit, SharedMisfit, fit
from tissue_sim.calibration.judge import errors
from tissue_sim.calibration.static import Springs, settle
from tissue_sim.model.assembly import assemble

from ..scenes import ball, changed, filled

ORGAN = changed(filled(ball(2), 12), return_stiffness=0.02)
MODEL = assemble(ORGAN)
SPRINGS = Springs(MODEL)
START = SPRINGS.stiffness_of(MODEL)
TRUTH = START * np.exp(0.5 * np.random.default_rng(7).standard_normal(len(START)))


def linear_answers(stiffness, force):
    """Displacements of the surface under forces, by the dense matrix."""
    matrix = SPRINGS.rest_tangent(stiffness).toarray()
    load = np.zeros((len(force), MODEL.rest.size))
    load[:, : force[0].size] = force.reshape(len(force), -1)
    moved = np.zeros_like(load)
    moved[:, SPRINGS.free] = np.linalg.solve(matrix, load[:, SPRINGS.free].T).T
    return moved[:, : force[0].size].reshape(force.shape)


def settled_answers(stiffness, force):
    shapes = [settle(SPRINGS, stiffness, one)[0].position for one in force]
    return np.array(shapes)[:, : ORGAN.n_surface] - MODEL.rest[: ORGAN.n_surface]


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
    first, second = SPRINGS.counts[0], sum(SPRINGS.counts[:2])
    kinds = (range(first), range(first, second), range(second, len(slope)))
    return [int(kind[int(np.argsort(-weight[kind.start : kind.stop])[k])]) for kind in kinds for k in (0, 5)]


def test_linear_slope_is_that_by_finite_differences():
    force = fit_cases(ORGAN, 12, 0).force
    misfit = LinearMisfit(SPRINGS, force, linear_answers(TRUTH, force))
    slope = misfit.evaluate(START).slope
    chosen = springs_that_count(slope, START)
    np.testing.assert_allclose(slope[chosen], list(slope_by_differences(misfit, START, chosen, 1e-4)), rtol=1e-4)


def test_overlapping_linear_cases_are_combined_and_tell_what_they_told_apart():
    force = fit_cases(ORGAN, 600, 0).force
    wanted = linear_answers(TRUTH, force)
    misfit, found = LinearMisfit(SPRINGS, force, wanted), linear_answers(START, force)
    assert misfit.combinations.shape[1] < 0.5 * len(force)
    evaluation = misfit.evaluate(START)
    apart = errors(found, wanted)
    assert evaluation.loss == pytest.approx(np.mean(apart**2), rel=0.01)
    np.testing.assert_allclose(evaluation.error, apart, atol=0.02)
    chosen = springs_that_count(evaluation.slope, START)
    slopes = slope_by_differences(misfit, START, chosen, 1e-4)
    np.testing.assert_allclose(evaluation.slope[chosen], list(slopes), rtol=1e-4)


def test_nonlinear_slope_is_that_by_finite_differences():
    force = 0.6 * fit_cases(ORGAN, 3, 0).force
    wanted = settled_answers(TRUTH, force)
    assert np.abs(wanted).max() > 2e-3
    misfit = NonlinearMisfit(SPRINGS, force, wanted, tolerance=1e-10)
    found = misfit.evaluate(START)
    np.testing.assert_allclose(found.error, errors(settled_answers(START, force), wanted), rtol=1e-6)
    chosen = springs_that_count(found.slope, START)
    np.testing.assert_allclose(found.slope[chosen], list(slope_by_differences(misfit, START, chosen, 1e-3)), rtol=1e-3)


def test_a_known_model_is_recovered_in_what_it_does():
    force, judged = fit_cases(ORGAN, 60, 0).force, held_out_cases(ORGAN, 10, 4).force
    misfit = LinearMisfit(SPRINGS, force, linear_answers(TRUTH, force))
    wanted = linear_answers(TRUTH, judged)
    before = errors(linear_answers(START, judged), wanted).mean()
    found = fit(START, SPRINGS.trace(), [(1.0, misfit)], 90, shrink=1e-7, soften=0.0)
    after = errors(linear_answers(found, judged), wanted).mean()
    assert before > 0.08
    assert after < 0.1 * before


def test_nonlinear_cases_correct_what_linear_ones_cannot_tell():
    force = 0.4 * fit_cases(ORGAN, 4, 0).force
    wanted = settled_answers(TRUTH, force)
    misfit = NonlinearMisfit(SPRINGS, force, wanted)
    before = misfit.evaluate(START).error.mean()
    found = fit(START, SPRINGS.trace(), [(1.0, misfit)], 15, shrink=1e-6, soften=0.0)
    assert errors(settled_answers(found, force), wanted).mean() < 0.5 * before


def test_the_same_fit_gives_the_same_bits_and_stays_within_its_bounds():
    force = fit_cases(ORGAN, 20, 0).force
    wanted = linear_answers(TRUTH, force)
    first, again = (fit(START, SPRINGS.trace(), [(1.0, LinearMisfit(SPRINGS, force, wanted))], 12) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert np.all(np.abs(np.log(first / START)) <= np.abs(BOUNDS[0]) + 1e-12)
    assert np.all(np.log(first / START) <= BOUNDS[1] + 1e-12)


def test_softening_lowers_the_trace():
    force = fit_cases(ORGAN, 20, 0).force
    misfit = LinearMisfit(SPRINGS, force, linear_answers(TRUTH, force))
    hard, soft = (fit(START, SPRINGS.trace(), [(1.0, misfit)], 25, soften=soften) for soften in (0.0, 0.01))
    assert SPRINGS.trace() @ soft < 0.95 * (SPRINGS.trace() @ hard)


def test_a_case_without_rest_keeps_the_search_away():
    force = np.zeros((1, ORGAN.n_surface, 3))
    force[0, np.argmax(ORGAN.surface_positions[:, 2])] = [0.0, 0.0, -1e4]
    found = NonlinearMisfit(SPRINGS, force, np.full((1, ORGAN.n_surface, 3), 1e-3)).evaluate(START)
    assert found.loss == 1.0  # more than any case that comes to rest, however far off
    assert not np.any(found.slope)


def test_restored_shapes_give_the_same_evaluation():
    force = 0.4 * fit_cases(ORGAN, 3, 0).force
    wanted = settled_answers(TRUTH, force)
    straight, resumed = (NonlinearMisfit(SPRINGS, force, wanted) for _ in range(2))
    straight.evaluate(START)
    resumed.restore(straight.position, straight.stiffness)
    a, b = (misfit.evaluate(1.02 * START) for misfit in (straight, resumed))
    assert a.loss == b.loss
    np.testing.assert_array_equal(a.slope, b.slope)


def test_cases_shared_out_among_processes_say_the_same():
    force = 0.4 * fit_cases(ORGAN, 5, 0).force
    wanted = settled_answers(TRUTH, force)
    shared, alone = SharedMisfit(SPRINGS, force, wanted), NonlinearMisfit(SPRINGS, force, wanted)
    try:
        for stiffness in (START, 1.05 * START):
            a, b = shared.evaluate(stiffness), alone.evaluate(stiffness)
            assert a.loss == pytest.approx(b.loss, rel=1e-9)
            np.testing.assert_allclose(a.slope, b.slope, rtol=1e-9, atol=1e-12 * np.abs(b.slope).max())
            np.testing.assert_allclose(a.error, b.error, rtol=1e-9)
            np.testing.assert_allclose(shared.position, alone.position, atol=1e-12)
    finally:
        shared.close()
