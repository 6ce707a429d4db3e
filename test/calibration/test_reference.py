"""What the reference lacks is reported, and corrected."""

import numpy as np
import pytest

from helpers.scenes import ball, kidney
from tissue_sim.calibration.cases import AXES, fit_cases, held_out_cases
from tissue_sim.calibration.evaluation import errors
from tissue_sim.calibration.fe_mesh import Grading
from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.reference import FINER, LEFT, Refined, corrected, finer_reference_body, refined, samples_of


@pytest.mark.extended
def test_what_is_left_is_a_fraction_of_the_difference_to_a_finer_mesh():
    organ = ball(1)
    loads = np.zeros((2, organ.n_surface, 3))
    loads[[0, 1], np.argmax(organ.surface_positions[:, 2])] = [[0.0, 0.0, -0.01], [0.02, 0.0, 0.0]]
    coarse = Body(organ)
    finer = finer_reference_body(coarse, loads)
    assert finer.n_nodes == Body(organ, np.flatnonzero(loads.any(axis=(0, 2))), FINER).n_nodes > 2 * coarse.n_nodes
    answers, wanted = coarse.settle_linear(loads), finer.settle_linear(loads)
    found = refined(coarse, finer, answers, wanted)
    off = np.linalg.norm((answers - wanted).reshape(2, -1), axis=1) / np.linalg.norm(wanted.reshape(2, -1), axis=1)
    np.testing.assert_allclose(found.difference, 100.0 * off)
    assert found.worst == pytest.approx(100.0 * LEFT * off.max())


def test_line_names_the_meshes_and_says_when_the_bound_is_missed():
    good = Refined(100, 400, np.array([0.6, 1.2]))
    assert str(good) == (
        "reference of 100 nodes, corrected by one of 400 that differs by 0.90 % on average and 1.20 % at worst:"
        " the remaining error is at most 0.40 %"
    )
    assert "above 1 %" in str(good._replace(difference=np.array([3.3])))


def test_samples_are_whole_places_spread_over_all():
    some = samples_of(1602)
    assert len(some) % AXES == 0
    assert some.min() == 0
    assert some.max() == 1601
    np.testing.assert_array_equal(some.reshape(-1, AXES) % AXES, np.tile(np.arange(AXES), (len(some) // AXES, 1)))
    np.testing.assert_array_equal(samples_of(9), np.arange(9))


def test_what_few_shapes_differ_by_is_corrected():
    """A difference that follows the first shapes of every answer is found from samples, to rounding."""
    random = np.random.default_rng(4)
    shapes, change = random.normal(size=(5, 60)), random.normal(size=(5, 60))
    fractions = random.normal(size=(40, 5))
    coarse, fine = (fractions @ shapes).reshape(40, 20, 3), (fractions @ (shapes + 0.01 * change)).reshape(40, 20, 3)
    np.testing.assert_allclose(corrected(coarse, coarse[:10], fine[:10]), fine, atol=1e-9)


@pytest.mark.extended
def test_other_loads_of_a_ball_are_corrected_by_samples():
    organ = ball(2)
    pushes, others = fit_cases(organ, 90, 0), held_out_cases(organ, 6, 2).force
    coarse, finer = Body(organ, grading=Grading(clamp=0)), Body(organ)
    some = samples_of(len(pushes))
    samples, finer_samples = (body.settle_linear(pushes[some]) for body in (coarse, finer))
    before, wanted = coarse.settle_linear(others), finer.settle_linear(others)
    after = corrected(before, samples, finer_samples)
    assert errors(after, wanted).mean() < 0.35 * errors(before, wanted).mean()
    assert np.median(errors(after, wanted)) < 0.15 * np.median(errors(before, wanted))
    assert np.all(errors(after, wanted) < errors(before, wanted))


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_on_the_kidney_what_is_left_is_within_a_percent_and_nonlinear_shapes_are_corrected():
    organ = kidney()
    forces = held_out_cases(organ, 2, 0).force * 0.2
    coarse = Body(organ)
    finer = finer_reference_body(coarse, forces)
    linear, finer_linear = coarse.settle_linear(forces), finer.settle_linear(forces)
    assert refined(coarse, finer, linear, finer_linear).worst <= 1.0
    before = np.array([found.displacement for found in coarse.settle_many(forces)])
    wanted = np.array([found.displacement for found in finer.settle_many(forces)])
    off = errors(before + finer_linear - linear, wanted)
    assert off.max() < 0.003
    assert np.all(off < 0.6 * errors(before, wanted))
