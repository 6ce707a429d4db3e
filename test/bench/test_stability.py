"""The stability sweep: cells judged by what happens to them, and the command around it."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball, kidney
from tissue_sim.bench import stability
from tissue_sim.bench.organs import press_node
from tissue_sim.bench.sweeps.cells import AXES, SMALL_ORGAN, Cell, axes_named, cells_of
from tissue_sim.bench.sweeps.inversion_check import InversionCheck
from tissue_sim.bench.sweeps.loads import PATCH_NODES, PROBE, Line, Poke, far_node, patch_around, ten_points
from tissue_sim.bench.sweeps.trial import run_cell
from tissue_sim.bench.sweeps.trial_simulations import critical_step_of, organ_of, simulation_of, with_mass_ratio
from tissue_sim.cli import main
from tissue_sim.model.data.settings import INTEGRATORS, LOCAL_REGIONS
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import AS_BUILT, shipped_organ
from tissue_sim.organ.surface_checks import signed_volume


def cell(axis="force_patch", value=1.0, integrator="symplectic", region="off"):
    return Cell(axis, value, integrator, region, SMALL_ORGAN, quick=True)


# cells -----------------------------------------------------------------------------------------
def test_every_axis_is_crossed_with_every_integrator_and_region():
    cells = cells_of(list(AXES), SMALL_ORGAN, quick=False)
    values = sum(len(axis.values) + len(axis.quick) for axis in AXES.values())
    assert len(set(cells)) == len(cells) == len(LOCAL_REGIONS) * values
    assert {(c.integrator, c.local_region) for c in cells} == {(i, r) for i in INTEGRATORS for r in LOCAL_REGIONS}
    quick = {(c.axis, c.value) for c in cells_of(list(AXES), SMALL_ORGAN, quick=True)}
    assert quick < {(c.axis, c.value) for c in cells}


def test_auto_is_left_out_where_it_would_do_again_what_off_does():
    assert "auto" not in stability.regions_of(Organ.load(shipped_organ()))
    assert stability.regions_of(Organ.load(shipped_organ(AS_BUILT))) == LOCAL_REGIONS
    assert stability.regions_of(organ_of(SMALL_ORGAN)) == LOCAL_REGIONS


@pytest.mark.parametrize(
    ("axis", "least", "most"),
    [("step", 0.1, 30.0), ("stiffness", 1e-3, 1e4), ("rate", 100.0, 4000.0), ("force_ten", 1.0, 1000.0)],
)
def test_axes_reach_as_far_as_they_must(axis, least, most):
    values = AXES[axis].values
    assert min(values) <= least
    assert max(values) >= most


def test_force_names_every_kind_of_force():
    named = axes_named("force,depth")
    assert named == [axis for axis in AXES if axis.split("_")[0] in ("force", "depth")]
    assert axes_named("all") == list(AXES)
    assert axes_named("depth,depth,force_ten") == ["depth_side", "depth_far", "force_ten"]
    assert len(axes_named("force")) > 2


def test_what_is_expected_to_fail_is_not_judged():
    assert cell().judged
    assert not cell(integrator="explicit").judged
    assert not cell("step", 0.5).judged


# loads -----------------------------------------------------------------------------------------
def test_loads_act_where_they_say():
    organ = kidney()
    surface = organ.surface_positions
    patch = patch_around(organ, press_node(organ))
    assert len(set(patch)) == PATCH_NODES
    assert np.linalg.norm(surface[patch] - surface[patch[0]], axis=1).max() < 0.02
    ten = ten_points(organ)
    apart = np.linalg.norm(surface[ten, None] - surface[ten], axis=2) + np.eye(len(ten))
    assert apart.min() > 0.02
    assert not set(ten) & set(organ.fixed)
    held = surface[organ.fixed].mean(axis=0)
    assert np.linalg.norm(surface[far_node(organ)] - held) > 0.8 * np.linalg.norm(surface - held, axis=1).max()


def test_probe_goes_to_its_depth_and_away():
    organ = kidney()
    start, inward = np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.0, -1.0])
    path = Poke(organ, Line(start, inward, 0.02), 1e-3, hold=10, speed=0.15).path
    front = path @ inward + PROBE.radius - start @ inward
    assert front.max() == pytest.approx(0.02)
    assert front[0] < 0.0
    assert front[-1] < -0.02
    assert np.abs(np.diff(front)).max() < 0.0003


def test_mass_ratio_keeps_the_mass_and_the_damping_rate():
    organ = kidney()
    made = with_mass_ratio(organ, 10.0)
    assert made.mass.sum() == pytest.approx(organ.mass.sum())
    assert made.mass[: organ.n_surface].sum() == pytest.approx(10.0 * made.mass[organ.n_surface :].sum())
    np.testing.assert_allclose(made.damping / made.mass, organ.damping / organ.mass)


# inside and outside ----------------------------------------------------------------------------
def test_witness_sees_what_is_turned_over():
    organ = ball(2)
    witness, rest = InversionCheck(organ), organ.rest_positions
    assert witness.look(rest) == (0, 0, 1.0)
    mirrored = witness.look(rest * [1.0, 1.0, -1.0])
    assert mirrored.cells == len(organ.surface_triangles)
    assert mirrored.volume == pytest.approx(-1.0)
    pushed = rest.copy()
    top = np.argmax(rest[: organ.n_surface, 2])
    pushed[top, 2] = -0.5 * rest[top, 2]
    found = witness.look(pushed)
    around = np.count_nonzero(organ.surface_triangles == top)
    assert 0 < found.cells <= around
    assert 0.0 < found.volume < 1.0
    edge = organ.surface_triangles[0, :2]
    folded = rest.copy()
    folded[edge[1]] += 2.2 * (rest[edge[0]] - rest[edge[1]])
    assert witness.look(folded).folds > 0


# trials ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "region", [pytest.param(name, marks=[pytest.mark.extended] if name == "frozen" else []) for name in LOCAL_REGIONS]
)
def test_small_load_is_stable(region):
    record = run_cell(cell(region=region))
    assert (record.outcome, record.problems, record.faults, record.snaps) == ("stable", (), 0, 0)
    assert record.peak > 1e-4
    assert record.left < 0.01
    assert 0.0 < record.quiet_after < 1.5
    assert record.energy_gain < 1e-3
    assert record.newtons == pytest.approx(0.2)


def test_load_beyond_all_bounds_is_guarded():
    record = run_cell(cell("force_point", 1000.0))
    assert record.outcome == "guarded"
    assert record.faults > 0
    assert record.left < 0.01


def test_probe_through_a_part_of_the_organ_comes_back():
    record = run_cell(cell("depth_side", 0.1))
    assert record.outcome == "stable"
    assert record.peak > 0.04 * 0.05, "m, less what lies between nodes gives"
    assert record.newtons == 0.0


@pytest.mark.extended
def test_soft_organ_gains_no_energy_of_its_modal_region():
    """It creeps, and so must the region's surroundings."""
    record = run_cell(replace(cell("stiffness", 0.01, region="modal"), organ=str(shipped_organ(AS_BUILT))))
    assert record.problems == ()
    assert record.energy_gain < 1e-3


def test_step_axis_sets_the_substep_to_a_fraction_of_the_critical_one():
    simulation = simulation_of(cell("step", 0.5))
    simulation.apply_force([0], [[0.0, 0.0, 0.01]])
    simulation.step()
    substep = 1.0 / simulation.rate / simulation.state.status.substeps
    assert substep == pytest.approx(0.5 * Simulation(organ_of(SMALL_ORGAN)).critical_step)
    explicit = Simulation(organ_of(SMALL_ORGAN), integrator="explicit").critical_step
    assert critical_step_of(SMALL_ORGAN, "explicit") == explicit


def test_step_beyond_the_critical_one_is_not_stable():
    assert run_cell(cell("step", 0.9)).outcome == "stable"
    assert run_cell(cell("step", 30.0)).outcome != "stable"


def test_record_depends_on_the_cell_alone():
    first = run_cell(cell("stiffness", 100.0))
    run_cell(cell("damping", 0.0))
    again = run_cell(cell("stiffness", 100.0))
    assert replace(first, seconds=0.0) == replace(again, seconds=0.0)
    assert run_cell(cell("stiffness", 1.0)) != first


def go_wrong(monkeypatch, fault, after=120):
    """Make every simulation go wrong after some ticks."""
    step = Simulation.step

    def faulty(simulation):
        step(simulation)
        if simulation.state.status.tick > after:
            fault(simulation)

    monkeypatch.setattr(Simulation, "step", faulty)


def blow_up(simulation):
    simulation.positions[3, 1] = math.nan


def pump(simulation):
    simulation.velocities[:] *= 1.1


def hold_in_a_false_shape(simulation):
    simulation.positions[:] = simulation.model.rest + [0.001, 0.0, 0.0]
    simulation.velocities[:] = 0.0
    simulation.state.status.quiet = 0


def shake(simulation):
    simulation.positions[:] = simulation.model.rest
    simulation.velocities[5] = 0.01
    simulation.state.status.quiet = 0


@pytest.mark.parametrize(
    ("fault", "problem"),
    [
        (blow_up, "not finite"),
        (pump, "energy gained without work"),
        (hold_in_a_false_shape, "false rest shape"),
        (shake, "still moving"),
    ],
)
def test_constructed_fault_is_named(monkeypatch, fault, problem):
    go_wrong(monkeypatch, fault)
    record = run_cell(cell())
    assert record.outcome == "diverged"
    assert any(found.startswith(problem) for found in record.problems)
    assert stability.violations([record]) == [record]
    json.dumps(record.as_json(), allow_nan=False)


def test_inside_out_organ_is_named(monkeypatch):
    def mirror(simulation):
        simulation.positions[:] = simulation.model.rest * [1.0, 1.0, -1.0]

    go_wrong(monkeypatch, mirror)
    assert any("inverted" in problem for problem in run_cell(cell()).problems)
    assert signed_volume(organ_of(SMALL_ORGAN).surface_positions, organ_of(SMALL_ORGAN).surface_triangles) > 0.0


def test_undamped_organ_is_not_expected_to_come_to_rest():
    record = run_cell(cell("damping", 0.0))
    assert not record.settled
    assert record.outcome == "stable"
    assert record.left > 0.01


# command ---------------------------------------------------------------------------------------
def bench(*words):
    return main(["bench", "stability", *words])


@pytest.mark.extended
def test_quick_sweep_of_one_axis_writes_map_and_records(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(AXES, "rate", AXES["rate"]._replace(quick=(100.0, 1000.0)))  # 4 kHz takes longest by far
    assert bench("--quick", "--axes", "rate", "--jobs", "2", "--out", str(tmp_path), "--json", "-") == 0
    report = json.loads(capsys.readouterr().out)
    assert len(report["cells"]) == len(cells_of(["rate"], SMALL_ORGAN, quick=True))
    assert report == json.loads((tmp_path / "stability.json").read_text())
    counted = report["summary"]
    assert counted["stable"] + counted["guarded"] + counted["diverged"] == len(report["cells"])
    assert counted["stable"] > 0
    assert (tmp_path / "stability.png").read_bytes().startswith(b"\x89PNG")


@pytest.fixture
def one_fault(monkeypatch):
    good = run_cell(cell())
    bad = replace(good, value=2.0, outcome="diverged", problems=("false rest shape (40 % of the peak remains)",))
    forgiven = replace(bad, integrator="explicit", judged=False)
    monkeypatch.setattr(stability, "sweep", lambda *_: [good, bad, forgiven])


@pytest.mark.extended
def test_a_cluster_finds_what_this_machine_does(cluster):
    cells = [cell(), cell(value=2.0)]
    here, there = stability.sweep(cells, 1), stability.sweep(cells, 1, cluster[0])
    assert [replace(record, seconds=0.0) for record in there] == [replace(record, seconds=0.0) for record in here]


@pytest.mark.usefixtures("one_fault")
def test_check_fails_where_a_default_cell_diverged(capsys):
    assert bench("--quick", "--check") == 1
    shown = capsys.readouterr().out
    assert "force_patch 2, symplectic, region off: false rest shape (40 % of the peak remains)" in shown
    assert "explicit" not in shown
    assert bench("--quick") == 0


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--axes", "colour"], "--axes: unknown axis 'colour'"),
        (["--jobs", "0"], "--jobs 0"),
        pytest.param(
            ["--axes", "rate", "--scheduler", "abacus"],
            "no Dask scheduler answers at abacus",
            marks=pytest.mark.extended,
        ),
        (["no_such_organ.npz"], "no_such_organ.npz does not exist"),
    ],
)
def test_wrong_use_takes_one_line(words, expected, capsys):
    assert bench("--quick", *words) == 2
    shown = capsys.readouterr().err.strip().splitlines()
    assert expected in shown[-1]
    assert not any("Traceback" in line for line in shown)


def test_folder_that_cannot_be_made_is_named_before_the_sweep(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert bench("--quick", "--out", str(tmp_path / "file" / "folder")) == 2
    assert "cannot make folder" in capsys.readouterr().err
