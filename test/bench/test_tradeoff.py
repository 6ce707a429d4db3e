"""The command `bench tradeoff`: errors, the Pareto front, what is skipped, table, JSON and plot."""

import json
import sys
import types

import numpy as np
import pytest

from helpers.scenes import ball, kidney
from tissue_sim.bench.peers.engine import Answer
from tissue_sim.bench.sizes import sized
from tissue_sim.bench.timing import Timing
from tissue_sim.cli import main

pytest.importorskip("skfem", reason="the reference needs the extra calibration")
pytest.importorskip("netgen", reason="the reference needs the extra calibration")

from tissue_sim.bench import tradeoff
from tissue_sim.bench.peers.rows import CALIBRATED, rows_of
from tissue_sim.bench.tradeoff import Case, Error, Evaluated, Found, as_json, error_of, load_of, pareto, text
from tissue_sim.bench.variants import BALANCED, Variants
from tissue_sim.calibration.reference import finer_reference_body

ORGAN = ball(2)
NONE = Variants(ORGAN, "not calibrated", {BALANCED: "not calibrated"})


class Copy:
    """An engine that settles to a factor times the reference."""

    update = 0.001

    def __init__(self, organ, factor):
        self.organ, self.factor = organ, factor

    def settle(self, load):
        return Answer(self.factor * load.reached, 0.5, True)


def case(organ=ORGAN, kind="bump"):
    displacement = np.zeros((organ.n_surface, 3))
    displacement[:, 2] = 0.001 * organ.surface_positions[:, 0] / 0.03
    force = np.zeros_like(displacement)
    force[100] = [0.0, 0.0, 0.1]
    return Case(kind, force, displacement, 0.002)


def error(relative, kind="bump"):
    return Error(kind, relative, 1e-3 * relative, 0.5 * relative, -0.01, True, 0.04)


def both(percent):
    return [error(percent / 100.0), error(percent / 100.0, "sharp")]


def found():
    def row(name, ours, points, percent, us, simulated=0.001):
        errors = [error(percent / 100.0), error(2.0 * percent / 100.0, "sharp")]
        return Evaluated(name, ours, points, "a remark", errors, Timing(1e-6 * us, 2e-6 * us, 9), simulated)

    rows = [
        row("fast", True, 250, 20.0, 100.0),
        row("fast", True, 994, 5.0, 400.0),
        row("worse", True, 994, 6.0, 500.0),
        row("in large steps", False, 994, 1.0, 20_000.0, 0.02),
        Evaluated("absent", False, 994, "skipped: gone is not installed", [], None, 1.0),
    ]
    return Found(rows, [case(), case(kind="sharp")], 12_345, "linear 0.52 % mean", 1.1)


def test_error_of_the_reference_itself_is_none():
    size = sized(ORGAN, ORGAN)
    exact, larger = (error_of(Copy(ORGAN, factor), case(), size) for factor in (1.0, 1.1))
    assert exact.relative == 0.0
    assert larger.relative == pytest.approx(0.1)
    u = np.linalg.norm(case().displacement, axis=1)
    assert larger.rms == pytest.approx(0.1 * np.sqrt(np.mean(u**2)))
    assert larger.of_largest == pytest.approx(larger.rms / u.max())
    assert (larger.seconds, larger.settled, larger.kind) == (0.5, True, "bump")


def test_error_is_taken_at_the_references_points():
    """A coarse surface that follows the reference exactly at its own points is off between them by little."""
    fine = ball(3)
    size = sized(ORGAN, fine)
    assert 1e-4 < error_of(Copy(ORGAN, 1.0), case(fine), size).relative < 0.1
    assert load_of(case(fine), size).force.shape == (ORGAN.n_surface, 3)


def test_pareto_front_is_what_nothing_beats():
    costs = [(1.0, 5.0), (2.0, 3.0), (2.5, 3.0), (3.0, 4.0), (None, 1.0), (1.0, 6.0), (9.0, 1.0), (2.0, 3.0001)]
    assert pareto(costs) == [True, True, False, False, False, False, True, True]


def test_figures_are_means_over_the_loads():
    rows = {(row["name"], row["points"]): row for row in as_json(kidney(), found(), 12.0)["rows"]}
    row = rows["fast", 994]
    assert row["mean_percent"] == pytest.approx(7.5)
    assert row["worst_percent"] == pytest.approx(10.0)
    assert (row["smooth_percent"], row["sharp_percent"]) == pytest.approx((5.0, 10.0))
    assert row["settle_ms"] == pytest.approx(40.0)
    assert row["volume_change_percent"] == pytest.approx(1.0)
    assert row["ms_per_ms"] == pytest.approx(0.4)
    assert rows["in large steps", 994]["ms_per_ms"] == pytest.approx(1.0)
    assert [key for key, row in rows.items() if row["pareto"]] == [
        ("fast", 250),
        ("fast", 994),
        ("in large steps", 994),
    ]


def test_table_tells_the_references_own_error_and_what_was_skipped():
    shown = text(as_json(kidney(), found(), 12.0))
    assert "its own error: linear 0.52 % mean" in shown
    assert "absent: skipped: gone is not installed" in shown
    assert "fast *" in shown
    assert "worse *" not in shown
    json.dumps(as_json(kidney(), found(), 12.0), allow_nan=False)


def test_growth_is_that_of_the_calibrated_organ():
    def sizes(*percent):
        rows = [
            Evaluated(
                CALIBRATED,
                True,
                n,
                "",
                [error(p / 100.0), error(p / 100.0, "sharp")],
                Timing(1e-7 * n**1.25, 1e-3, 9),
                0.001,
            )
            for n, p in zip((4000, 250, 1000), percent, strict=True)
        ]
        return as_json(kidney(), found()._replace(rows=[*found().rows, *rows]), 12.0)

    growth = sizes(2.0, 5.0, 2.0)["growth"]
    assert growth["points"] == [250, 4000]
    assert growth["time_exponent"] == pytest.approx(1.25)
    assert growth["error_falls"]
    worse = sizes(2.1, 5.0, 2.0)
    assert not worse["growth"]["error_falls"]
    assert "250 to 4000 points: time grows as n^1.25, the error does not decrease" in text(worse)
    assert as_json(kidney(), found(), 12.0)["growth"] is None


def test_every_model_and_peer_has_a_row():
    names = [row.name for row in rows_of(NONE, [], own=True, quick=False)]
    assert len(set(names)) == len(names)
    wanted = ("surface", "volume", "hybrid, uncalibrated", "hybrid, by groups", CALIBRATED)
    wanted += (
        "hybrid, by groups, frozen region",
        f"{CALIBRATED}, modal region",
        "linear FEM, linear tetrahedra",
        "ChainMail",
    )
    wanted += ("linear FEM, quadratic tetrahedra", "compliance, all points", "compliance, one patch", "pypbd, XPBD")
    wanted += ("MuJoCo flex, 20 ms step",)
    assert set(wanted) <= set(names)


def test_at_other_sizes_the_papers_springs_and_the_steps_are_left_out():
    own = {row.name for row in rows_of(NONE, [], own=True, quick=False)}
    other = {row.name for row in rows_of(NONE, [], own=False, quick=False)}
    assert other < own
    assert [row for row in other if "cells" in row or "hybrid" in row] == [CALIBRATED]


@pytest.mark.parametrize(
    "measured_row",
    # A tick is compiled again wherever it is timed.
    ["ChainMail", pytest.param("surface", marks=pytest.mark.extended)],
)
def test_row_that_cannot_be_made_is_skipped_with_the_extra_to_install(monkeypatch, measured_row):
    monkeypatch.setitem(sys.modules, "pypbd", None)
    rows = {row.name: row for row in rows_of(NONE, [], own=True, quick=True)}
    size = sized(ORGAN, ORGAN)
    chosen = [rows[name] for name in (measured_row, CALIBRATED, "pypbd, XPBD")]
    measured = tradeoff.measure_rows([(row, size) for row in chosen], [case()], 0.02)[0]
    assert [bool(row.errors) for row in measured] == [True, False, False]
    assert measured[0].update.median > 0.0
    assert measured[1].remark == "skipped: not calibrated"
    assert "tissue_sim[bench]" in measured[2].remark
    assert "pypbd" in measured[2].remark


@pytest.fixture
def faked(monkeypatch):
    monkeypatch.setattr(tradeoff, "in_one_thread", lambda *_: found())


@pytest.mark.extended
@pytest.mark.usefixtures("faked")
def test_command_prints_json_and_draws(capsys, tmp_path):
    image = pytest.importorskip("matplotlib.image")
    assert main(["bench", "tradeoff", "--quick", "--json", "--out", str(tmp_path / "plots")]) == 0
    assert json.loads(capsys.readouterr().out)["surface_points"] == 994
    assert image.imread(tmp_path / "plots" / "tradeoff.png")[..., :3].std() > 0.02


def test_names_in_the_plot_cover_neither_one_another_nor_marks():
    pytest.importorskip("matplotlib")
    from tissue_sim.bench.tradeoff_plot import drawn

    crowd = [
        Evaluated(f"engine number {n}", n < 6, 994, "", both(5.0 + 0.1 * n), Timing(1e-4 + 2e-5 * n, 1e-3, 9), 0.001)
        for n in range(12)
    ]
    figure = drawn(as_json(kidney(), found()._replace(rows=[*found().rows, *crowd]), 12.0))
    figure.draw_without_rendering()
    axis = figure.axes[0]
    names = {text.get_text(): text.get_window_extent() for text in axis.texts if text.get_text().startswith("engine")}
    assert len(names) == len(crowd)
    marks = axis.transData.transform([point for line in axis.lines[:-1] for point in line.get_xydata()])
    for name, box in names.items():
        assert not any(box.overlaps(other) for one, other in names.items() if one != name), name
        assert not any(box.contains(*mark) for mark in marks), name


@pytest.mark.parametrize("points", ["12", "many", "250,"])
def test_wrong_points_are_named(capsys, points):
    assert main(["bench", "tradeoff", "--points", points]) == 2
    assert f"--points {points.split(',')[0]}" in capsys.readouterr().err


def test_missing_finite_elements_are_named(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "skfem", None)
    monkeypatch.setattr(tradeoff, "in_one_thread", lambda function, *arguments: function(*arguments))
    assert main(["bench", "tradeoff", "--quick"]) == 2
    shown = capsys.readouterr().err
    assert "tissue_sim[calibration]" in shown
    assert "Traceback" not in shown


@pytest.mark.extended
def test_reference_hands_out_loads_for_tuning_apart_from_the_others():
    body, cases, tuning, accuracy = tradeoff.reference(ball(1), 1, 1)
    assert [case.kind == "sharp" for case in cases] == [False, True]
    assert len(tuning) == tradeoff.TUNING
    for one in tuning:
        assert not any(np.array_equal(one.force, other.force) for other in cases)
    deep = [np.linalg.norm(case.displacement, axis=1).max() for case in (*cases, *tuning)]
    assert min(deep) > 0.001
    assert max(deep) < 0.02
    assert body.n_nodes > 200
    assert accuracy.finer_nodes > 2 * body.n_nodes
    linear = finer_reference_body(body, np.stack([case.force for case in (*cases, *tuning)])).n_nodes
    assert linear == accuracy.finer_nodes, "for all loads at once"


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_whole_benchmark_runs(capsys):
    assert main(["bench", "tradeoff", "--quick", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    rows = types.SimpleNamespace(**{row["name"].replace(" ", "_").replace(",", ""): row for row in shown["rows"]})
    assert rows.linear_FEM_quadratic_tetrahedra["mean_percent"] < rows.linear_FEM_linear_tetrahedra["mean_percent"]
    assert rows.compliance_one_patch["ms_per_ms"] < rows.compliance_all_points["ms_per_ms"]
    assert all(row["settled"] or row["remark"] for row in shown["rows"])
