"""The Truth Cube and the beam: tables that are read, motions that are found again, and the command.

What needs the measured tables, which are no part of the project, is skipped without them.
"""

import csv
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tissue_sim.figures import png

pytest.importorskip("skfem")
pytest.importorskip("netgen")
pytest.importorskip("matplotlib")

from tissue_sim.bench.measured import beam, truth_cube
from tissue_sim.bench.measured.beam import MARKERS, Bent, Fitted
from tissue_sim.bench.measured.body import Rate
from tissue_sim.bench.measured.command import text
from tissue_sim.bench.measured.lattice import places, shell
from tissue_sim.bench.measured.plots import pictures_of
from tissue_sim.bench.measured.truth_cube import Compressed
from tissue_sim.bench.printing import Bound
from tissue_sim.calibration.stiffness import Settings, prepared
from tissue_sim.cli import main
from tissue_sim.errors import UserError
from tissue_sim.model.simulation import Simulation

DATA = Path(__file__).parents[4] / "shared" / "data" / "measured"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="no ../shared/data/measured beside the project")


# the cube --------------------------------------------------------------------------------------
def table_of_beads(path, squeeze=0.1):
    """Beads on a lattice of 10 mm, pressed evenly along z, k downwards as in the source."""
    rows = [["no table yet"]]
    for i, j, k in np.ndindex(7, 7, 7):
        at = 10.0 * np.array([i, j, 6 - k])
        states = [at * [1.0, 1.0, 1.0 - fraction * squeeze] for fraction in (0.0, 0.25, 0.6, 1.0)]
        rows.append([i + 1, j + 1, k + 1, *np.concatenate(states)])
    with path.open("w", newline="") as stream:
        csv.writer(stream).writerows(rows)
    return path


def test_beads_are_read_by_their_place(tmp_path):
    beads = truth_cube.read(table_of_beads(tmp_path / "beads.csv"))
    np.testing.assert_allclose(beads[2, 3, 4, 0], [0.02, 0.03, 0.04])
    np.testing.assert_allclose(beads[2, 3, 4, 3], [0.02, 0.03, 0.036])
    fine = truth_cube.between(beads)
    assert fine.shape == (13, 13, 13, 4, 3)
    np.testing.assert_allclose(fine[::2, ::2, ::2], beads)
    np.testing.assert_allclose(fine[5, 7, 1, 0], [0.025, 0.035, 0.005])


@pytest.mark.parametrize(
    ("content", "expected"),
    [("1,1,1,a\n", "is not the table"), ("1,1,1,1,2,3,4,5,6,7,8,9,10,11,12\n", "has no beads"), (None, "cannot read")],
)
def test_another_table_is_refused_in_one_line(tmp_path, content, expected):
    file = tmp_path / "beads.csv"
    if content is not None:
        file.write_text(content)
    with pytest.raises(UserError, match=expected):
        truth_cube.read(file)


@pytest.mark.extended
@needs_data
def test_cells_that_nobody_fitted_predict_the_inner_beads_already():
    """Nearly incompressible tissue between a surface that is led leaves little to fit."""
    beads = truth_cube.read(DATA / truth_cube.FILE)
    lattice = truth_cube.between(beads)
    index, triangles = shell((13, 13, 13))
    outer = lattice[tuple(index.T)]
    plain = truth_cube.built("cube", outer[:, 0], triangles, truth_cube.HELD, truth_cube.MATERIAL)
    organ = prepared(plain, Settings())
    inner = beads[1:-1, 1:-1, 1:-1].reshape(125, 4, 3)
    at = places(inner[:, 0], organ.rest_positions, organ.cell_nodes)
    simulation = Simulation(organ)
    simulation.prescribe(np.arange(organ.n_surface), outer[:, 3], truth_cube.LED)
    for _ in range(truth_cube.LED + truth_cube.STILL):
        simulation.step()
    off = 1e3 * np.linalg.norm(at @ simulation.positions - inner[:, 3], axis=1)
    assert off.mean() < truth_cube.MOST_OFF
    assert simulation.state.count.faults == 0


# the beam --------------------------------------------------------------------------------------
def swinging(travel=0.01, frames=400):
    """Markers of a run: at rest, then a damped swing about where they come to rest."""
    time = np.arange(frames) / beam.FRAMES - 0.5
    down = np.where(time > 0.0, travel * (1.0 - np.exp(-3.0 * time) * np.cos(30.0 * time)), 0.0)
    markers = np.repeat(MARKERS[None], frames, axis=0)
    markers[:, :3, 2] -= down[:, None]
    return markers


def test_markers_come_back_to_the_beams_frame(tmp_path):
    turn, shift = Rotation.from_rotvec([0.4, 1.0, -0.7]).as_matrix(), np.array([0.1, -0.2, 0.3])
    markers = swinging()
    rows = [["run", "frame"]]
    for run in (f"{load}_{repeat}" for load in beam.WEIGHTS for repeat in beam.REPEATS):
        rows += [[run, frame, *(at @ turn.T + shift).ravel()] for frame, at in enumerate(markers)]
    with (tmp_path / "beam.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows(rows)
    found = beam.read(tmp_path / "beam.csv")
    assert len(found) == 6
    np.testing.assert_allclose(found["load52_b"], markers, atol=1e-9)


def test_a_run_begins_where_it_moves_and_is_led_until_it_passes_its_rest():
    run = beam.run_of("load52_a", swinging())
    assert run.rest == pytest.approx(0.01, rel=0.01)
    assert len(run.moved) == beam.SECOND + 1
    travel = -run.moved[:, :, 2].mean(axis=1)
    assert travel[0] == pytest.approx(0.0, abs=1e-12)
    assert travel[5] > 0.0
    assert travel[run.led - 1] <= run.rest < travel[run.led]


def test_other_tables_are_refused_in_one_line(tmp_path):
    (tmp_path / "beam.csv").write_text("run,frame\ngravity_a,0,1\n")
    with pytest.raises(UserError, match="is not the table of the beam's markers"):
        beam.read(tmp_path / "beam.csv")
    with pytest.raises(UserError, match="name its folder with --data"):
        beam.read(tmp_path / "none.csv")


@pytest.mark.extended
def test_markers_on_sticks_move_with_the_end():
    organ = beam.plain(1e5)
    assert organ.n_surface == 994
    end = organ.surface_positions[organ.surface_positions[:, 0] > -1e-6]
    turn, shift = Rotation.from_rotvec([0.0, 0.2, 0.0]).as_matrix(), np.array([0.0, 0.0, -0.01])
    moved = beam.tip_markers(end, end @ turn.T + shift)
    np.testing.assert_allclose(moved, MARKERS[:3] @ turn.T + shift - MARKERS[:3], atol=1e-12)


@pytest.mark.extended
def test_a_weight_weighs_and_slows_the_model_down():
    made = beam.Beam(prepared(beam.plain(3e5), Settings(interior=100)))
    light, heavy = made.simulation(0.0), made.simulation(0.5, 1.1, 0.05)
    assert heavy.organ.mass.sum() - light.organ.mass.sum() == pytest.approx(0.5 / 9.81)
    assert made.lowest(heavy.organ.mass, 1.0) < 0.8 * made.lowest(light.organ.mass, 1.0)
    assert made.lowest(light.organ.mass, 4.0) == pytest.approx(2.0 * made.lowest(light.organ.mass, 1.0))
    rate = heavy.organ.damping / heavy.organ.mass
    np.testing.assert_allclose(rate, 4.0 * np.pi * 0.05 * made.lowest(heavy.organ.mass, 1.1))


@pytest.mark.extended
def test_the_end_is_led_along_the_measured_path_and_then_released():
    made = beam.Beam(prepared(beam.plain(3e5), Settings(interior=100)))
    run = beam.run_of("gravity_a", swinging(0.005))
    short = run._replace(moved=run.moved[: run.led + 4])
    found, start, speed, rate = made.follow(short, 1.0, 0.05)
    np.testing.assert_allclose(found[: run.led + 1], short.moved[: run.led + 1], atol=1e-6)
    assert np.abs(found[run.led + 1 :] - short.moved[run.led + 1 :]).max() > 1e-5
    assert np.abs(start - made.organ.rest_positions).max() > 0.004
    assert np.abs(speed).max() > 0.05
    assert rate.faults == 0


# what is shown ---------------------------------------------------------------------------------
def made_up():
    """Predictions that are off by known amounts."""
    rate = Rate(1e-4, 2e-4, 0)
    beads = np.random.default_rng(3).normal(size=(5, 5, 5, 3))
    aside = np.array([0.0, 3e-4, 4e-4])
    cube = [Compressed(strain, beads, beads + 0.5 * aside, beads + aside, rate, 1.0) for strain in truth_cube.STRAINS]
    time = np.arange(5) / beam.FRAMES
    moved = np.ones((5, 3, 3))
    elements = np.where(np.arange(5)[:, None, None] < 2, np.nan, 0.9 * moved)
    runs = (f"{load}_{repeat}" for load in beam.WEIGHTS for repeat in beam.REPEATS)
    rest = np.array([0.01, 0.0105, 0.0096])
    bent = [Bent(run, 0.5, rest, time, moved, elements, 1.2 * moved, rate) for run in runs]
    return cube, Fitted(2.8e5, 3e5, 0.056), bent


def test_figures_are_what_they_say():
    cube, fit, bent = made_up()
    last = truth_cube.as_json(cube)[-1]
    assert last["model_mean_mm"] == pytest.approx(0.5)
    assert last["elements_worst_mm"] == pytest.approx(0.25)
    run = beam.as_json(fit, bent)["runs"][0]
    assert run["rest_off_percent"] == pytest.approx({"elements": 5.0, "model": -4.0})
    assert run["motion_off_percent"] == pytest.approx({"elements": 10.0, "model": 20.0}), "from where it is released"


@pytest.mark.extended
def test_text_and_pictures_show_all():
    cube, fit, bent = made_up()
    found = {"truth_cube": truth_cube.as_json(cube), "beam": beam.as_json(fit, bent)}
    shown = text(found | {"bounds": [Bound("beads", 0.5, 0.4, "mm").as_json()]})
    assert "18.25 0.250 0.250 0.500 0.500 100 0" in " ".join(shown.split())
    assert "280 kPa at rest, 300 kPa within a second, damping ratio 0.056" in shown
    assert "missed" in shown
    pictures = pictures_of(cube, bent)
    assert list(pictures) == ["truth_cube.png", "beam.png"]
    assert all(len(png(draw(), 140.0)) > 10_000 for draw in pictures.values())


def test_a_missing_table_is_reported_before_any_work(tmp_path, capsys):
    assert main(["bench", "measured", "--data", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert "truth_cube_uniaxial.csv does not exist" in capsys.readouterr().err


@needs_data
@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_the_cube_holds_what_is_asked(tmp_path, capsys):
    command = ["bench", "measured", "--data", str(DATA), "--out", str(tmp_path), "--bodies", "cube", "--check"]
    assert main(command) == 0
    assert "held" in capsys.readouterr().out
    assert (tmp_path / "truth_cube.png").is_file()
