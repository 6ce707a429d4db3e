"""Load cases: two generators that share neither centres nor draws."""

import numpy as np
import pytest

from helpers.scenes import ball, kidney
from tissue_sim.calibration.cases import (
    DEPTH,
    MOST_TRACTION,
    fit_cases,
    held_out_cases,
    scale_to_depth,
    split_centres,
    surface_of,
)
from tissue_sim.errors import UserError


def test_centres_are_disjoint_and_clear_of_the_clamp():
    organ = kidney()
    fit, held = split_centres(organ)
    assert not set(fit) & set(held)
    assert not (set(fit) | set(held)) & set(organ.fixed)
    assert 0.25 < len(held) / (len(fit) + len(held)) < 0.35
    used = np.concatenate([centre for seed in (0, 1, 2) for centre in fit_cases(organ, 60, seed).centre])
    judged = np.concatenate(held_out_cases(organ, 30, 10).centre)
    assert set(used) <= set(fit)
    assert set(judged) <= set(held)


def test_the_same_seed_draws_the_same_and_another_others():
    organ = kidney()
    first, again, other, stream = (
        fit_cases(organ, 12, seed, stream) for seed, stream in ((3, 1), (3, 1), (4, 1), (3, 2))
    )
    np.testing.assert_array_equal(first.force, again.force)
    assert first.kind == again.kind
    assert not np.array_equal(first.force, other.force)
    assert not np.array_equal(first.force, stream.force)


def test_loads_are_of_every_kind_and_never_on_held_nodes():
    organ = kidney()
    fit, held = fit_cases(organ, 40, 0), held_out_cases(organ, 30, 10)
    assert set(fit.kind) == {"normal", "oblique", "tangential", "pulling", "many"}
    assert set(held.kind) == {"bump", "pulling bump", "two bumps", "sharp"}
    for cases in (fit, held):
        assert not np.any(cases.force[:, organ.fixed])
        assert np.all(np.any(cases.force != 0.0, axis=(1, 2)))


def test_directions_are_what_their_names_say():
    organ = kidney()
    cases, normal = fit_cases(organ, 60, 0), surface_of(organ).normal
    for case, kind in enumerate(cases.kind):
        if kind == "many":
            continue
        total = cases.force[case].sum(axis=0)
        assert np.linalg.norm(total) == pytest.approx(1.0)
        outward = normal[np.any(cases.force[case] != 0.0, axis=1)].mean(axis=0)
        inward = -float(total @ outward) / np.linalg.norm(outward)
        low, high = {"normal": (1.0, 1.0), "pulling": (-1.0, -1.0), "oblique": (0.5, 0.94), "tangential": (0.0, 0.0)}[
            kind
        ]
        assert low - 1e-9 <= inward <= high + 1e-9


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


@pytest.mark.parametrize("organ", [ball(1), ball(3), kidney()], ids=["coarse ball", "ball", "kidney"])
def test_no_smooth_load_is_narrower_than_a_node_and_its_neighbours(organ):
    held = held_out_cases(organ, 20, 0)
    assert np.count_nonzero(held.force.any(axis=2), axis=1).min() >= 4
