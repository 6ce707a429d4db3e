"""The benchmark of the identification: its figures move with the faults that they are to find."""

import json

import numpy as np
import pytest

from tissue_sim.bench.identify import coverage, palpation_sets, synthetic
from tissue_sim.bench.identify.command import _exact_bounds, _inclusion_bounds, _known_bounds, _set_bounds, text
from tissue_sim.bench.identify.inclusions import KNOWN, UNKNOWN, Around, found_around, without_inclusions
from tissue_sim.bench.identify.inclusions import as_rows as inclusion_rows
from tissue_sim.bench.identify.known_presses import ELSEWHERE, OVER, places_with
from tissue_sim.bench.identify.palpation_sets import as_rows, errors_of, repeat_errors
from tissue_sim.bench.identify.synthetic import CASES, MODULUS, Truth, recovered
from tissue_sim.cli import main
from tissue_sim.errors import UserError
from tissue_sim.identification.force_curves import bonded_layer, hertz, tabulated
from tissue_sim.identification.table import presses_of, read_columns
from tissue_sim.organ.inclusions import inclusions_of
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.organ.tool_resolution import mean_edge

BALL, THICK = 3.16e-3, 0.025
DEEP = np.linspace(0.0, 2e-3, 10)
SET = "probingRAL2018_T1"


def truth(own=1.0, count=8):
    """Finite elements that follow Hertz, and a model whose forces are some times as large, place by place."""
    which = np.arange(count)
    depth, force = hertz(0.007, MODULUS, 0.45, 5e-3)
    factors = np.broadcast_to(own, count)
    elements = tabulated([depth] * count, [force] * count, which)
    model = tabulated([depth] * count, [one * force * 10e3 / MODULUS for one in factors], which)
    return Truth(elements, model, 10e3, 0.03)


def test_a_model_without_error_finds_the_modulus_and_holds_it():
    name = "noise, bias and unknown offsets"
    found = recovered(name, truth(), np.random.default_rng(0), 12)
    assert np.abs(found.off).max() < 8.0
    assert found.held >= 11


def test_a_model_that_is_too_stiff_is_seen():
    found = recovered("noise", truth(1.25), np.random.default_rng(0), 6)
    assert np.median(found.off) == pytest.approx(-20.0, abs=2.0)
    assert found.held == 0


def test_an_organ_without_its_inclusion_is_as_soft_there_as_elsewhere():
    organ = Organ.load(shipped_organ("kidney_tumour"))
    plain = without_inclusions(organ)
    assert not len(plain.inclusion_stiffness)
    changed = organ.cell_mu != plain.cell_mu
    assert 0 < changed.sum() < 200
    middle = organ.rest_positions[organ.cell_nodes].mean(axis=1)[changed]
    centre = inclusions_of(organ)[0].positions.mean(axis=0)
    assert np.linalg.norm(middle - centre, axis=1).max() < 0.015
    assert (organ.cell_mu[changed] / plain.cell_mu[changed]).max() > 4.0


def around(effect=0.0, count=12):
    """Places in a row, over the first of which finite elements are stiffer than the model without the inclusion."""
    stiff = np.ones(count)
    stiff[0] += effect
    plain, one = truth(1.0, count), truth(1.0 / stiff, count)
    points = np.array([[0.02 * number, 0.0, 0.0] for number in range(count)])
    return Around({KNOWN: plain, UNKNOWN: one}, points)


def test_intervals_hold_the_truth_as_often_as_they_say():
    """The bound has two sides: intervals of half the width, or twice, leave it."""
    found = coverage.recovered(6, 0.05, np.random.default_rng(0), 20)
    assert 17 <= found.held <= 20
    assert np.abs(found.off).max() < 3.0 * 100.0 * found.width
    for fraction, is_met in ((0.8, [False, True]), (0.95, [True, True]), (1.0, [True, False])):
        rows = [{"intervals_that_hold": 100 * fraction, "runs": 100}]
        assert [bound.as_json()["met"] for bound in _exact_bounds(rows)] == is_met


def test_an_unknown_inclusion_is_reported_and_a_known_one_is_not():
    given = around(0.3)
    random = np.random.default_rng(0)
    unknown, known = (found_around(case, given, random, 10) for case in (UNKNOWN, KNOWN))
    assert unknown.reported == 10
    assert known.reported == known.elsewhere == unknown.elsewhere == 0
    assert np.abs(unknown.recovered.off).max() < 8.0
    rows = inclusion_rows([known, unknown])
    assert all(bound.as_json()["met"] for bound in _inclusion_bounds(rows) if "reported" in bound.name)
    assert "10 of 10" in text(
        {"known": [], "exact": [], "inclusions": rows, "sets": [], "repeat_percent": [], "bounds": []}
    )


def test_an_inclusion_that_is_hardly_stiffer_is_missed_and_the_bound_says_so():
    missed = found_around(UNKNOWN, around(0.02), np.random.default_rng(0), 6)
    assert missed.reported < 3
    (bound,) = [one for one in _inclusion_bounds(inclusion_rows([missed])) if one.name.endswith("reported over it")]
    assert not bound.as_json()["met"]


def test_pressing_each_place_again_finds_a_weak_inclusion():
    """What limits the warning is noise, which the mean of a place has less of."""
    once, often = (found_around(UNKNOWN, around(0.16), np.random.default_rng(3), 8, times) for times in (1, 5))
    assert (once.presses, often.presses) == (10, 50)
    assert "each place 5 times" in often.recovered.name
    assert often.reported > once.reported
    assert often.elsewhere == 0
    rows = inclusion_rows([once, often])
    assert sum(bound.name.endswith("reported over it") for bound in _inclusion_bounds(rows)) == 2


def test_places_over_the_inclusion_come_first_and_are_clear_of_the_clamp():
    organ = Organ.load(shipped_organ("kidney_tumour"))
    spots = places_with(organ)
    middle = inclusions_of(organ)[0].positions.mean(axis=0)
    apart = [np.linalg.norm(spot.point - middle) for spot in spots]
    assert len(spots) == OVER + ELSEWHERE
    assert np.argmin(apart) == 0
    assert max(apart[:OVER]) < min(apart[OVER:])
    clamp = organ.surface_positions[organ.fixed]
    assert min(np.linalg.norm(clamp - spot.point, axis=1).min() for spot in spots) > 3.5 * mean_edge(organ)
    with pytest.raises(UserError, match="no inclusion"):
        places_with(Organ.load(shipped_organ("kidney")))


def written(folder, soft=0.3, noise=0.01, seed=0):
    """A set like those of the measured presses: a phantom by Hertz, softer towards one side."""
    random, lines = np.random.default_rng(seed), []
    names = [f"d{i}" for i in range(10)] + [f"fn{i}" for i in range(10)]
    lines.append(",".join(["x", "y", "z", "nx", "ny", "nz", *names]))
    for number in range(64):
        x, y = 4e-3 * (number % 8), 4e-3 * (number // 8)
        depth, force = hertz(BALL, 60e3 * np.exp(soft * (x - 0.014) / 0.014), 0.45, 4e-3)
        measured = np.interp(DEEP + 3e-4, depth, force) * (1.0 + noise * random.normal(size=10))
        lines.append(",".join(f"{value:.6g}" for value in [x, y, 0.0, 0.0, 0.0, 1.0, *DEEP, *measured]))
    folder.mkdir(exist_ok=True)
    for name in palpation_sets.SETS:
        (folder / f"{name}.csv").write_text("\n".join(lines))
    return folder


def errors(folder, **laws):
    presses = presses_of(read_columns(folder / f"{SET}.csv"), BALL, SET)
    curves = {law: tabulated([one[0]], [one[1]], np.zeros(len(presses), dtype=np.int64)) for law, one in laws.items()}
    return errors_of(SET, presses, curves, 10e3)


def test_a_wrong_law_and_an_uneven_phantom_cost_accuracy(tmp_path):
    right, layer = hertz(BALL, 10e3, 0.45, 4e-3), bonded_layer(BALL, 10e3, 0.45, 4e-3, THICK)
    straight = right[0], right[0] * 100.0
    even = errors(written(tmp_path / "even", soft=0.0), model=right, hertz=straight, linear=layer)
    assert even.errors["model"].one < 0.02 < even.errors["hertz"].one
    assert even.modulus == pytest.approx(60e3, rel=0.05)
    assert not even.diagnosis.stiffens
    uneven = errors(written(tmp_path / "uneven"), model=right).errors["model"]
    assert uneven.one > 0.08
    assert uneven.mapped < 0.5 * uneven.one
    assert uneven.map_pays


def test_a_phantom_on_a_hard_support_is_reported(tmp_path):
    folder = written(tmp_path / "data", soft=0.0)
    path = folder / f"{SET}.csv"
    rows = [line.split(",") for line in path.read_text().splitlines()]
    for row in rows[1:]:
        row[16:] = [f"{1.2 * ((deep + 2e-4) / 2.2e-3) ** 3:.6g}" for deep in DEEP]
    path.write_text("\n".join(map(",".join, rows)))
    found = errors(folder, model=hertz(BALL, 10e3, 0.45, 4e-3))
    assert found.diagnosis.stiffens
    assert as_rows([found])[0]["exponent"] == pytest.approx(3.0, abs=0.2)


def test_repeats_differ_by_their_noise(tmp_path):
    folder = written(tmp_path / "data", noise=0.05)
    assert repeat_errors(folder) == pytest.approx([0.0, 0.0])
    other = written(tmp_path / "other", noise=0.05, seed=1)
    (folder / f"{SET}.csv").write_text((other / f"{SET}.csv").read_text())
    assert repeat_errors(folder) == pytest.approx([0.048, 0.048], abs=0.015), "0.67 sqrt(2) of 5 %"


def test_a_repeat_that_is_less_deep_says_nothing_of_what_lies_deeper(tmp_path):
    """Its last force would stand for all that is deeper, and the error would seem large."""
    folder = written(tmp_path / "data", noise=0.001)
    path = folder / f"{SET}.csv"
    rows = [line.split(",") for line in path.read_text().splitlines()]
    for row in rows[1:]:
        row[6:16] = [f"{0.5 * deep:.6g}" for deep in DEEP]
        row[16:] = [f"{value:.6g}" for value in np.interp(0.5 * DEEP, DEEP, np.array(row[16:], dtype=float))]
    path.write_text("\n".join(map(",".join, rows)))
    assert max(repeat_errors(folder)) < 0.05


def test_figures_become_tables_and_bounds(tmp_path):
    law = hertz(BALL, 10e3, 0.45, 4e-3)
    found = errors(written(tmp_path / "data"), model=law, hertz=law, linear=law)
    sets = as_rows([found])
    known = synthetic.as_rows([recovered(name, truth(), np.random.default_rng(0), 2) for name in list(CASES)[:3]])
    bounds = [one.as_json() for one in [*_known_bounds(known), *_set_bounds(sets)]]
    found = {
        "known": known,
        "exact": [],
        "inclusions": [],
        "sets": sets,
        "repeat_percent": [5.0, 6.0],
        "bounds": bounds,
    }
    assert len(bounds) == 8
    assert [bound["met"] for bound in bounds if "with one modulus" in bound["name"]] == [False]
    assert json.loads(json.dumps(found)) == found
    assert SET in text(found)
    assert "2 of 2" in text(found)


def test_data_that_are_missing_are_named(tmp_path, capsys):
    assert main(["bench", "identify", "--data", str(tmp_path)]) == 2
    assert "whole_region_model_v2.csv does not exist" in capsys.readouterr().err
