"""The command `bench tick`: its rows, bounds, tables and exit codes."""

import json
import sys
from dataclasses import dataclass

import numpy as np
import pytest

from helpers.scenes import ball, kidney
from tissue_sim.bench import c_loop
from tissue_sim.bench import tick_rows as rows
from tissue_sim.bench import tick_times as tick
from tissue_sim.bench.organs import patch_load
from tissue_sim.bench.printing import aligned, noise_lines
from tissue_sim.bench.scaling import Grown
from tissue_sim.bench.timing import Timing
from tissue_sim.cli import main
from tissue_sim.model.data.settings import INTEGRATORS


def timing(us):
    return Timing(1e-6 * us, 1.5e-6 * us, 100)


GOOD = {
    rows.WHOLE: 200.0,
    rows.CELLS: 80.0,
    rows.GUARD: 3.0,
    rows.SUBSTEP: 60.0,
    rows.C_PLAIN: 55.0,
    rows.CELL_SUBSTEP: 40.0,
    rows.CELL_C: 44.0,
    rows.STIFFENING: 88.0,
    rows.STIFFENING_SUBSTEP: 44.0,
    rows.RELAXING_SUBSTEP: 43.0,
    rows.MODAL: 20.0,
    rows.MODAL_CELLS: 19.0,
    rows.ASLEEP: 2.0,
    rows.FLEX: 13_000.0,
    rows.PRODUCT: 30.0,
}


def measured(**changed):
    times = GOOD | changed
    lines = [tick.Line(name, timing(us) if us else None, "remark") for name, us in times.items()]
    grown = [Grown(n, timing(0.2 * n), 4, timing(20.0 + n / 1000.0), 4, 60, 144, 1.0, n > 1000) for n in (1000, 4000)]
    return tick.Figures(lines, 1.1, 0.5, True, 3.0, grown)


def verdicts(found):
    return {bound.name: bound.met for bound in tick.bounds(found)}


# bounds ----------------------------------------------------------------------------------------
def test_every_bound_is_met_by_good_figures():
    assert all(verdicts(measured()).values())


@pytest.mark.parametrize(
    ("name", "us", "bound"),
    [
        (rows.WHOLE, 301.0, "whole hybrid tick"),
        (rows.CELLS, 101.0, "whole tick of cells"),
        (rows.GUARD, 4.1, "guard, fraction"),
        (rows.SUBSTEP, 72.0, "substep relative to"),
        (rows.CELL_SUBSTEP, 45.0, "substep of cells"),
        (rows.STIFFENING, 112.1, "tick of cells that stiffen"),
        (rows.STIFFENING_SUBSTEP, 56.1, "substep of cells that stiffen"),
        (rows.RELAXING_SUBSTEP, 48.1, "substep of cells that relax"),
        (rows.MODAL, 25.1, "modal tick, 19-node"),
        (rows.MODAL_CELLS, 20.1, "modal tick of cells"),
        (rows.MODAL, 30.1, "modal tick relative to"),
        (rows.ASLEEP, 3.1, "asleep"),
        (rows.FLEX, 11_999.0, "MuJoCo"),
    ],
)
def test_each_bound_is_missed_by_a_bad_figure(name, us, bound):
    missed = {key for key, met in verdicts(measured(**{name: us})).items() if met is False}
    assert any(key.startswith(bound) for key in missed)


def test_bounds_without_their_figure_are_not_judged():
    found = verdicts(measured(**{rows.FLEX: None, rows.C_PLAIN: None}))
    assert found["MuJoCo flex relative to the whole tick of cells"] is None
    assert found["substep relative to the same in C, -O3"] is None


# rows ------------------------------------------------------------------------------------------
def test_rows_that_cannot_be_measured_say_why(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    monkeypatch.setattr(c_loop, "COMPILER", "no-such-compiler")
    makers = rows.makers_of(ball(2))
    names = (rows.FLEX, rows.C_PLAIN, rows.C_NATIVE, rows.PRODUCT)
    bursts, remarks = rows.make_bursts({name: makers[name] for name in names})
    assert remarks[rows.FLEX] == "skipped: mujoco is not installed: pip install 'tissue_sim[bench]'"
    assert remarks[rows.C_PLAIN] == remarks[rows.C_NATIVE] == "skipped: no C compiler"
    assert list(bursts) == [rows.PRODUCT]


def test_a_module_of_our_own_that_is_missing_is_no_reason_to_skip():
    def broken():
        raise ModuleNotFoundError("gone", name="tissue_sim.bench.gone")

    with pytest.raises(ModuleNotFoundError):
        rows.make_bursts({"row": broken})


@pytest.mark.extended
def test_every_row_is_measured_with_a_positive_time():
    pytest.importorskip("mujoco")
    makers = rows.makers_of(ball(2))
    assert {f"hybrid, {name}" for name in INTEGRATORS} < set(makers)
    bursts, remarks = rows.make_bursts(makers)
    for name, burst in bursts.items():
        # What the clock itself costs is taken off: two ticks of a sleeping organ may be nothing beside it.
        count, typical = (2000, np.mean) if name == rows.ASLEEP else (2, np.median)
        times = burst(count)
        assert times.shape == (count,), name
        assert typical(times) > 0.0, name
    for name in set(makers) - set(bursts):
        assert remarks[name] == "skipped: no C compiler"
    assert "contact points touch" in remarks[rows.MODAL_TOOL]


@pytest.mark.extended
def test_pressed_tool_touches_about_as_many_points_as_the_patch():
    _, remark = rows._pressed_tool(kidney())
    assert 12 <= int(remark.split()[0]) <= 30


# printing --------------------------------------------------------------------------------------
def test_table_is_aligned():
    lines = aligned([["a", "figure"], ["long name", "1"], ["b", "10.5"]])
    assert lines == ["a          figure", "---------  ------", "long name       1", "b            10.5"]


def test_noise_is_remarked_only_when_it_is_high():
    assert noise_lines(1.1) == []
    assert "3.0 times" in noise_lines(3.0)[0]


def test_text_shows_rows_bounds_and_verdicts():
    found = measured(**{rows.WHOLE: 450.0, rows.FLEX: None})
    shown = tick.text(tick.as_json(kidney(), found))
    assert "994 surface points" in shown
    lines = {line.split("  ")[0]: line for line in shown.splitlines()}
    assert lines["whole hybrid tick"].endswith("missed")
    assert lines["asleep tick"].endswith("held")
    assert lines["MuJoCo flex relative to the whole tick of cells"].endswith("not measured")
    assert "450" in lines[rows.WHOLE]
    assert "compile time" in shown


# the command -----------------------------------------------------------------------------------
@pytest.fixture
def faked(monkeypatch):
    """The command with figures that are given instead of measured."""

    @dataclass
    class Faked:
        figures: tick.Figures

    given = Faked(measured())
    monkeypatch.setattr(tick, "in_one_thread", lambda *_: given.figures)
    return given


def test_exit_code_tells_missed_bounds_only_when_asked(faked, capsys):
    assert main(["bench", "tick", "--check"]) == 0
    faked.figures = measured(**{rows.WHOLE: 450.0})
    assert main(["bench", "tick"]) == 0
    assert main(["bench", "tick", "--check"]) == 1
    assert "missed" in capsys.readouterr().out


def test_json_goes_to_the_output_or_a_file(faked, capsys, tmp_path):
    assert main(["bench", "tick", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {row["name"] for row in found["rows"]} == set(GOOD)
    assert all(row["median_us"] > 0.0 for row in found["rows"])
    assert found["threads"] == 1
    assert main(["bench", "tick", "--json", str(tmp_path / "tick.json")]) == 0
    assert json.loads((tmp_path / "tick.json").read_text()) == found
    assert "whole hybrid tick" in capsys.readouterr().out


def test_plots_are_written(faked, tmp_path):
    image = pytest.importorskip("matplotlib.image")
    assert main(["bench", "tick", "--quick", "--out", str(tmp_path / "plots")]) == 0
    for name in ("tick.png", "growth.png"):
        pixels = image.imread(tmp_path / "plots" / name)
        assert pixels[..., :3].std() > 0.02


@pytest.mark.parametrize("option", ["--json", "--out"])
def test_place_that_cannot_be_written_is_named(faked, capsys, tmp_path, option):
    pytest.importorskip("matplotlib")
    (tmp_path / "file").write_text("")
    assert main(["bench", "tick", option, str(tmp_path / "file" / "x")]) == 2
    assert str(tmp_path / "file") in capsys.readouterr().err


@pytest.mark.parametrize("benchmark", ["tick", "table1"])
def test_organ_is_not_written_over(capsys, tmp_path, benchmark):
    """`--json kidney.npz` reads as the file for JSON."""
    organ = tmp_path / "kidney.npz"
    organ.write_bytes(b"kept")
    assert main(["bench", benchmark, "--json", str(organ)]) == 2
    assert str(organ) in capsys.readouterr().err
    assert organ.read_bytes() == b"kept"


def test_missing_organ_is_named(capsys):
    assert main(["bench", "tick", "no-such-organ.npz"]) == 2
    assert "no-such-organ.npz" in capsys.readouterr().err


def test_missing_matplotlib_is_named_before_the_work(monkeypatch, capsys, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr(tick, "in_one_thread", None)
    assert main(["bench", "tick", "--out", str(tmp_path)]) == 2
    assert "matplotlib" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_whole_benchmark_runs(capsys):
    assert main(["bench", "tick", "--quick", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    medians = {row["name"]: row["median_us"] for row in found["rows"]}
    assert set(medians) == set(rows.makers_of(ball(1)))
    assert medians[rows.ASLEEP] < medians[rows.MODAL] < medians["hybrid, explicit"]


def test_patch_load_is_the_same_for_all_rows():
    """The rows compare the same load: the patch that the header names."""
    nodes, forces = patch_load(kidney(), rows.FORCE)
    assert len(nodes) == 19
    assert np.linalg.norm(forces.sum(axis=0)) == pytest.approx(rows.FORCE)
