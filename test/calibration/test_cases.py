"""Load cases: two generators that share neither centres nor draws."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball, kidney
from tissue_sim.calibration import cases
from tissue_sim.calibration.cases import (
    DEPTH,
    MANY,
    MOST_TRACTION,
    fit_cases,
    held_out_cases,
    principal,
    scale_to_depth,
    split_centres,
    surface_of,
)
from tissue_sim.errors import UserError
from tissue_sim.organ.refined import refined
from tissue_sim.organ.refinement import Ball, Refinement


def test_centres_are_disjoint_and_clear_of_the_clamp(monkeypatch):
    organ = kidney()
    fit, held = split_centres(organ)
    assert not set(fit) & set(held)
    assert not (set(fit) | set(held)) & set(organ.fixed)
    assert 0.25 < len(held) / (len(fit) + len(held)) < 0.35
    judged = np.concatenate(held_out_cases(organ, 30, 10).centre)
    assert set(judged) <= set(held)
    used, patch = [], cases._patch
    monkeypatch.setattr(
        cases, "_patch", lambda surface, node, radius: used.append(node) or patch(surface, node, radius)
    )
    for seed in (0, 1, 2):
        fit_cases(organ, 60, seed)
    assert len(used) >= 60
    assert set(used) <= set(fit)


def test_the_same_seed_draws_the_same_and_another_others():
    organ = kidney()
    first, again, other = (fit_cases(organ, 12, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_loads_are_of_every_kind_and_never_on_held_nodes():
    organ = kidney()
    fit, held = fit_cases(organ, 40, 0), held_out_cases(organ, 30, 10)
    assert set(held.kind) == {"bump", "pulling bump", "two bumps", "sharp"}
    for force in (fit, held.force):
        assert not np.any(force[:, organ.fixed])
        assert np.all(np.any(force != 0.0, axis=(1, 2)))


def test_a_place_is_loaded_along_every_axis():
    force = fit_cases(kidney(), 40, 0)
    assert len(force) == 42
    total = force.sum(axis=1).reshape(-1, 3, 3)
    one = total[np.arange(len(total)) % MANY != 0]
    np.testing.assert_allclose(one, np.broadcast_to(np.eye(3), one.shape), atol=1e-12)
    assert (total[::MANY, 0, 0] > 1.0).any()
    for axis in range(3):
        np.testing.assert_array_equal(force[axis::3, :, axis], force[::3, :, 0])
        assert not np.delete(force[axis::3], axis, axis=2).any()


def test_principal_cases_are_the_same_loads_whose_answers_have_nothing_in_common():
    """Against the singular value decomposition of each place's three answers."""
    random = np.random.default_rng(0)
    force = fit_cases(kidney(), 9, 0)
    tensor = random.standard_normal((force.shape[1] * 3, 3)) @ np.diag([1.0, 0.3, 0.01])
    answer = np.einsum("ab,cnb->ca", tensor, force).reshape(force.shape)
    forces, answers = principal(force, answer)
    for place in range(0, len(force), 3):
        part = slice(place, place + 3)
        flat = answers[part].reshape(3, -1)
        gram = flat @ flat.T
        size = np.linalg.svd(answer[part].reshape(3, -1), compute_uv=False)
        np.testing.assert_allclose(np.sqrt(np.diag(gram)), size, rtol=1e-6)
        assert np.abs(gram - np.diag(np.diag(gram))).max() < 1e-9 * gram.max()
        turned = np.linalg.lstsq(force[part].reshape(3, -1).T, forces[part].reshape(3, -1).T, rcond=None)[0].T
        np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-9)
        np.testing.assert_allclose(turned @ answer[part].reshape(3, -1), flat, atol=1e-9 * size[0])


def test_scaling_reaches_the_depth_but_for_the_traction():
    organ = kidney()
    cases = held_out_cases(organ, 30, 10)
    compliance = np.random.default_rng(0).uniform(0.001, 0.1, cases.force.shape)
    scaled = scale_to_depth(cases, compliance, organ, 5)
    factor = np.linalg.norm(scaled.force, axis=(1, 2)) / np.linalg.norm(cases.force, axis=(1, 2))
    depth = factor * np.linalg.norm(compliance, axis=2).max(axis=1)
    traction = (np.linalg.norm(scaled.force, axis=2) / surface_of(organ).area).max(axis=1) / organ.youngs_modulus
    smooth = np.array(cases.kind) != "sharp"
    assert np.all(depth <= DEPTH[1] * (1.0 + 1e-12))
    assert np.all(traction <= MOST_TRACTION * (1.0 + 1e-12))
    assert np.all((depth >= DEPTH[0])[smooth] | np.isclose(traction, MOST_TRACTION)[smooth])
    np.testing.assert_array_equal(scaled.force, scale_to_depth(cases, compliance, organ, 5).force)


def test_an_organ_of_few_nodes_is_refused():
    with pytest.raises(UserError, match="needs 20"):
        split_centres(ball(0))


def test_lengths_shrink_with_a_small_organ():
    assert surface_of(kidney()).size == pytest.approx(1.0, abs=0.01)
    assert surface_of(ball(2)).size < 1.0


def graded():
    """A large ball, most of whose points are in one half."""
    large = replace(
        ball(2), surface_positions=3.0 * ball(2).surface_positions, atom_positions=3.0 * ball(2).atom_positions
    )
    return refined(large, Refinement(places=(Ball(np.array([0.09, 0.0, 0.0]), 0.09, 0.009),)))


@pytest.mark.parametrize(
    "organ", [ball(1), ball(3), kidney(), graded()], ids=["coarse ball", "ball", "kidney", "graded ball"]
)
def test_no_smooth_load_is_narrower_than_a_node_and_its_neighbours(organ):
    held = held_out_cases(organ, 20, 0)
    assert np.count_nonzero(held.force.any(axis=2), axis=1).min() >= 4
