"""`tissue_sim calibrate`, as users run it: on a small ball, stopped and gone on with, and used wrongly."""

import sys

import numpy as np
import pytest

from helpers.exit_codes import exit_code_of
from helpers.scenes import ball
from tissue_sim.calibration import calibrate as pipeline
from tissue_sim.cli import main
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ

SMALL = ("--cases=30", "--evaluations=25", "--smooth=4", "--sharp=2", "--interior=60")
needs_finite_elements = pytest.mark.usefixtures("_finite_elements")


@pytest.fixture
def _finite_elements():
    pytest.importorskip("skfem")
    pytest.importorskip("netgen")


def interrupted(*_, **__):
    raise KeyboardInterrupt


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("calibrate")
    ball(2).save(folder / "ball.npz")
    return folder


@pytest.fixture(scope="module")
def calibrated(folder):
    """The ball, calibrated with the report's pictures; what was printed lies beside it."""
    pytest.importorskip("skfem")
    pytest.importorskip("netgen")
    assert main(["calibrate", str(folder / "ball.npz"), "--out", str(folder / "out.npz"), *SMALL]) == 0
    return folder / "out.npz"


@pytest.mark.slow
@needs_finite_elements
def test_the_organ_is_better_and_says_so(calibrated, folder, capsys):
    made = Organ.load(calibrated)
    figures = made.provenance["calibration"]
    assert made.n_interior == 60
    assert Simulation(made).variant == "cells"
    assert figures["held_out"]["smooth"]["cases"] == 4
    assert figures["held_out"]["smooth"]["mean_percent"] < 8.0
    assert figures["held_out"]["sharp"]["settled"] == 2
    assert all(0.0 < least < 1.0 for least in figures["held_out"]["smooth"]["least_volume"].values())
    assert figures["motion"]["release_percent"] < 15.0
    np.testing.assert_allclose(figures["motion"]["frequencies_hz"], figures["motion"]["reference_hz"], rtol=0.1)
    assert made.mass.sum() == pytest.approx(made.density * made.volume)
    assert not list(folder.glob(".out.npz*"))
    assert main(["info", str(calibrated)]) == 0
    assert "mean percent" in capsys.readouterr().out


@pytest.mark.slow
@needs_finite_elements
def test_tissue_that_stiffens_is_fitted_too(folder, capsys):
    out = folder / "stiffens.npz"
    options = (*SMALL, "--stiffening=8", "--relaxation=0.3,1.5")
    assert main(["calibrate", str(folder / "ball.npz"), "--out", str(out), *options]) == 0
    made = Organ.load(out)
    assert (made.stiffening, made.relaxation_fraction) == (8.0, 0.3)
    assert 1.2 < made.cell_stiffening < 3.0
    assert made.provenance["calibration"]["held_out"]["smooth"]["mean_percent"] < 8.0
    assert f"the cells' b is {made.cell_stiffening:.2f} times the tissue's" in capsys.readouterr().out


@pytest.mark.slow
@needs_finite_elements
def test_a_run_that_was_stopped_ends_as_one_that_was_not(calibrated, folder, monkeypatch, capsys):
    out = folder / "again.npz"
    command = ["calibrate", str(folder / "ball.npz"), "--out", str(out), *SMALL]
    for stage in ("fit", "fit_mass", "settled_answers"):
        with monkeypatch.context() as patch:
            patch.setattr(pipeline, stage, interrupted)
            assert main(command) == 130
        assert not out.exists()
        assert "continues from" in capsys.readouterr().err
    assert main(command) == 0
    assert "continuing from" in capsys.readouterr().out
    assert Organ.load(out).digest() == Organ.load(calibrated).digest()
    assert Organ.load(out).provenance == Organ.load(calibrated).provenance


@pytest.mark.slow
@needs_finite_elements
def test_an_organ_for_speed_takes_one_substep_and_moves_as_it_should(folder, calibrated):
    out = folder / "fast.npz"
    command = ["calibrate", str(folder / "ball.npz"), "--out", str(out), *SMALL, "--for", "fast", "--evaluations=90"]
    assert main(command) == 0
    usual, fast = (Organ.load(path).provenance["calibration"] for path in (calibrated, out))
    assert usual["step"]["substeps_a_ms"] > 1
    assert fast["step"]["substeps_a_ms"] == 1
    np.testing.assert_allclose(fast["motion"]["frequencies_hz"], fast["motion"]["reference_hz"], rtol=0.02)
    assert fast["held_out"]["smooth"]["mean_percent"] < 2.0 * usual["held_out"]["smooth"]["mean_percent"]
    assert Simulation(Organ.load(out)).settings.substeps == 1


@pytest.mark.slow
@needs_finite_elements
def test_groups_are_the_baseline(calibrated, folder, capsys):
    out = folder / "groups.npz"
    command = ["calibrate", str(folder / "ball.npz"), "--out", str(out), "--method", "groups", "--cases=20"]
    assert main([*command, "--evaluations=12", "--smooth=4", "--sharp=2", "--check"]) == 1
    assert "missed: " in capsys.readouterr().out
    figures = [Organ.load(path).provenance["calibration"]["held_out"]["smooth"] for path in (calibrated, out)]
    assert figures[0]["mean_percent"] < figures[1]["mean_percent"] < 60.0
    assert Organ.load(out).n_interior == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--out", "x.txt"), "must end in .npz"),
        (("--out", "missing/x.npz"), "does not exist"),
        (("--out", "x.npz", "--cases=2"), "outside 8..10000"),
        (("--out", "x.npz", "--interior=-1"), "is negative"),
        (("--out", "x.npz", "--method=best"), "invalid choice"),
    ],
)
def test_wrong_use_takes_one_line(folder, monkeypatch, capsys, words, message):
    monkeypatch.chdir(folder)
    assert exit_code_of("calibrate", "ball.npz", *words) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@needs_finite_elements
def test_an_organ_without_a_clamp_is_refused(folder, capsys):
    ball(2, held=False).save(folder / "free.npz")
    assert main(["calibrate", str(folder / "free.npz"), "--out", str(folder / "x.npz"), *SMALL]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.extended
@needs_finite_elements
def test_an_organ_that_does_not_come_to_rest_is_no_calibrated_organ(folder, monkeypatch, capsys):
    out = folder / "restless.npz"
    command = ["calibrate", str(folder / "ball.npz"), "--out", str(out), *SMALL]
    monkeypatch.setattr("tissue_sim.calibration.evaluation.LONGEST", 0.01)
    assert main(command) == 2
    assert "error: organ 'ball' is held so loosely that" in capsys.readouterr().err
    monkeypatch.setattr(pipeline, "check_pace", lambda *_: None)
    assert main(command) == 2
    assert "error: organ 'ball' came to rest under 0 of 6 held-out loads only" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize("module", ["skfem", "netgen", "joblib", "threadpoolctl"])
def test_a_missing_library_is_named(folder, monkeypatch, capsys, module):
    monkeypatch.setitem(sys.modules, module, None)
    assert main(["calibrate", str(folder / "ball.npz"), "--out", str(folder / "x.npz"), *SMALL]) == 2
    assert "pip install 'tissue_sim[calibration]'" in capsys.readouterr().err
