"""What is given up when the machine is too slow, in which order, and how it comes back."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from helpers.patience import wait_for
from helpers.ros.clients import Client
from helpers.ros.processes import PUSHED, UNHURRIED, poke_path, start_node
from helpers.scenes import ball, ball_of_cells
from tissue_sim.model.joined import Joined
from tissue_sim.model.simulation import Simulation
from tissue_sim.ros.node.settings import degradation as degrade
from tissue_sim.ros.node.settings.coupling_ramp import RIGID
from tissue_sim.ros.node.settings.degradation import (
    HOLD,
    LOOK_EVERY,
    MARKERS,
    NONE,
    PATIENCE,
    RATE,
    REGION,
    DegradationLadder,
    Look,
)
from tissue_sim.ros.node.settings.live_settings import ANY_FORCE, LiveSettings
from tissue_sim.ros.node.shared.served_organ import ServedScene
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.physics import Physics
from tissue_sim.ros.shared.report import Report

STRAIN, MIDDLING, WELL = Look(0.95, 0.5, 0), Look(0.6, 0.0, 0), Look(0.1, 0.0, 0)


class Run:
    """A ladder that is looked at four times a second."""

    def __init__(self, helps=lambda level: True):
        self.ladder, self.helps, self.now = DegradationLadder(), helps, 100.0

    def look(self, look, seconds):
        """The levels that were taken within so many s."""
        taken = []
        for _ in range(round(seconds / LOOK_EVERY)):
            if self.ladder.look(self.now, look, self.helps):
                taken.append(self.ladder.level)
            self.now += LOOK_EVERY
        return taken


def test_a_look_tells_what_it_saw():
    assert Look(0.28, 0.4, 0).words == "ticks took 28 % of the time, 40 % of them were late"
    assert Look(0.95, 0.0, 7).words == "ticks took 95 % of the time, 0 % of them were late, 7 were dropped"


def test_steps_come_in_the_stated_order_and_go_back_in_reverse():
    run = Run()
    down = run.look(STRAIN, 20.0)
    assert down == [MARKERS, REGION, RATE, RATE + 1, RATE + 2]
    assert [degrade.name(level) for level in down] == ["markers", "region", "rate", "rate", "rate"]
    assert [degrade.halvings(level) for level in [NONE, *down]] == [0, 0, 0, 1, 2, 3]
    assert run.ladder.stuck
    assert run.look(WELL, 100.0) == [RATE + 1, RATE, REGION, MARKERS, NONE]
    assert not run.ladder.stuck


def test_one_hiccup_changes_nothing():
    run = Run()
    for _ in range(20):
        assert run.look(STRAIN, PATIENCE) == []
        assert run.look(WELL, LOOK_EVERY) == []


@pytest.mark.parametrize("strain", [Look(0.9, 0.0, 0), Look(0.1, 0.5, 0), Look(0.1, 0.0, 7)])
def test_each_sign_of_strain_counts(strain):
    assert Run().look(strain, 2.0) == [MARKERS]


def test_between_strained_and_well_nothing_changes():
    run = Run()
    run.look(STRAIN, 3.0)
    level = run.ladder.level
    assert run.look(MIDDLING, 1000.0) == []
    assert run.ladder.level == level > NONE


def test_hiccups_of_a_machine_that_is_well_delay_the_way_back_and_do_not_bar_it():
    ladder, now = DegradationLadder(), 0.0
    while ladder.level == NONE:
        ladder.look(now, Look(0.9, 0.5, 0), lambda _: True)
        now += LOOK_EVERY
    begun = now
    while ladder.level != NONE and now < begun + 10.0 * HOLD:
        hiccup = round(now / LOOK_EVERY) % 20 == 0  # one look in 5 s
        ladder.look(now, Look(0.1, 0.1 if hiccup else 0.0, 0), lambda _: True)
        now += LOOK_EVERY
    assert HOLD < now - begun < 2.0 * HOLD


def test_what_gives_nothing_up_is_left_out_both_ways():
    run = Run(lambda level: level in (MARKERS, RATE))
    assert run.look(STRAIN, 10.0) == [MARKERS, RATE]
    assert run.ladder.stuck
    assert run.look(WELL, 60.0) == [MARKERS, NONE]


def test_a_step_back_that_was_too_soon_is_tried_later_each_time():
    run = Run(lambda level: level == MARKERS)
    run.look(STRAIN, 2.0)
    waits = []
    for _ in range(6):
        before = run.now
        while run.ladder.level == MARKERS:
            run.look(WELL, LOOK_EVERY)
        waits.append(run.now - before)
        run.look(STRAIN, 2.0)
        assert run.ladder.level == MARKERS
    assert waits[0] == pytest.approx(HOLD, abs=1.0)
    assert waits == sorted(waits)
    assert waits[3] > 3.5 * waits[1]
    assert waits[-1] < 170.0


class Values(dict):
    """Stands for the node's parameters."""

    tools = ("left", "right")

    def apply(self, settings):
        settings.region_force = self["region_force"]
        settings.coupling_stiffness = self["coupling_stiffness"]


def live(local_region="auto", integrator="symplectic", rate=1000.0, **settings):
    simulation = Simulation(ball(2), rate=rate, local_region=local_region, integrator=integrator)
    values = Values(rate=rate, marker_rate=60.0, local_region=local_region, region_force=0.3) | settings
    values = {"coupling_stiffness": 0.0, "left.device_damping": 0.0, "right.device_damping": 0.0} | values
    values = {"left.smoothing": 1.0, "right.smoothing": 1.0} | values
    posted, physics = [], Physics(Loop(Joined([simulation])))
    made = LiveSettings(
        ServedScene("ball", ("",), (1.0,), Joined([simulation])),
        Values(values),
        lambda _, one: posted.append((physics.post_settings(one), one)),
        [SimpleNamespace(period=period, delay=0.0, counts=True) for period in (1e-3, 4e-3)],
    )
    return made, posted


def eased(made):
    """Stiffnesses in the steps to the one that is wanted, N/m."""
    now, found = 0.0, []
    while (wait := made.ease(now)) < math.inf:
        found.append(made.coupling_stiffness)
        now += wait
    return found


@pytest.mark.parametrize(("before", "after"), [(200.0, 2000.0), (2000.0, 200.0), (200.0, 0.0), (0.0, 200.0)])
def test_a_coupling_changes_in_small_steps_and_rigid_is_the_stiffest(before, after):
    made, posted = live(coupling_stiffness=before)
    made.update()
    assert made.coupling_stiffness == before, "at the start at once"
    made._parameters["coupling_stiffness"] = after
    made.update()
    assert made.coupling_stiffness == before
    count = len(posted)
    steps = eased(made)
    assert [one.coupling_stiffness for _, one in posted[count:]] == steps
    assert steps[-1] == after == made.coupling_stiffness
    stiff = np.array([k or RIGID for k in (before, *steps)])
    factors = stiff[1:] / stiff[:-1]
    assert np.maximum(factors, 1.0 / factors).max() < 1.0471
    assert all(factors > 1.0) or all(factors < 1.0)
    assert made.ease(1e9) == math.inf


def test_a_coupling_that_is_changed_on_its_way_turns_round():
    made, _ = live(coupling_stiffness=200.0)
    made.update()
    made._parameters["coupling_stiffness"] = 2000.0
    made.update()
    for step in range(5):
        made.ease(float(step))
    made._parameters["coupling_stiffness"] = 200.0
    made.update()
    assert max(eased(made)) < 400.0
    assert made.coupling_stiffness == 200.0


def test_coupling_is_no_stiffer_than_the_devices_bear():
    made, posted = live(coupling_stiffness=2000.0)
    made.update()
    assert posted[-1][1].coupling_stiffness == made.coupling_stiffness == 2000.0, "unknown damping: no bound"
    made, posted = live(**{"coupling_stiffness": 2000.0, "left.device_damping": 2.0, "right.device_damping": 1.0})
    made.update()
    # Of the slower tool: half its period, the period until the next pose, and a tick.
    assert made.coupling_stiffness == pytest.approx(0.9 / (0.5 * 4e-3 + 4e-3 + 1e-3))
    made, _ = live(**{"coupling_stiffness": 100.0, "right.device_damping": 1.0})
    made.update()
    assert made.coupling_stiffness == 100.0


def test_settings_are_refined_before_a_stiffer_organ_comes_and_never_made_coarser():
    made, posted = live("off")
    own = int(made._served.simulations[0].settings.substeps)
    made.refine(0, own)
    assert not posted
    made.refine(0, own + 3)
    assert posted[-1][1].substeps == own + 3
    made.renew(0)
    assert posted[-1][1].substeps == own


BOUNDED = {"coupling_stiffness": 2000.0, "left.device_damping": 4.0}


def allowed(period, delay):
    """Of a device of 4 N s/m, ticks at 1 kHz."""
    return 4.0 / (1.5 * period + 1e-3 + 2.0 * delay)


def test_delay_counts_there_and_back():
    made, _ = live(**BOUNDED)
    made.poses[0].delay = 5e-3
    made.update()
    assert made.coupling_stiffness == pytest.approx(0.9 * allowed(1e-3, 5e-3))


def test_less_smoothing_bears_a_stiffer_coupling():
    made, _ = live(**BOUNDED, **{"left.smoothing": 0.5})
    made.poses[0].period = 10e-3
    made.update()
    assert made.coupling_stiffness == pytest.approx(0.9 * 4.0 / (0.5 * 10e-3 + 0.5 * 10e-3 + 1e-3))


def test_bound_follows_rate_and_delay_and_not_their_noise():
    made, posted = live(**BOUNDED)
    poses, rng = made.poses[0], np.random.default_rng(1)
    made.update()
    before, count = made.coupling_stiffness, len(posted)
    for _ in range(200):
        poses.period, poses.delay = 1e-3 * rng.uniform(0.95, 1.05), rng.uniform(0.0, 5e-5)
        made.update()
        assert made.coupling_stiffness <= allowed(poses.period, poses.delay)
    assert made.coupling_stiffness == before
    assert len(posted) == count, "nothing is posted while it only trembles"
    poses.period, poses.delay = 10e-3, 0.0
    made.update()
    eased(made)
    assert made.coupling_stiffness == pytest.approx(0.9 * allowed(10e-3, 0.0))
    poses.period = 1e-3
    made.update()
    eased(made)
    assert made.coupling_stiffness == pytest.approx(before), "and back"


def test_report_tells_rate_delay_bound_and_why():
    made, _ = live(**BOUNDED)
    made.poses[0].delay, made.poses[1].counts = 2e-3, False
    made.update()
    report = Report()
    made.report(report)
    stiffness = 0.9 * allowed(1e-3, 2e-3)
    assert report.values["coupling_stiffness"] == report.values["coupling_bound"] == pytest.approx(stiffness)
    values = report.whole().values
    assert values["left.pose_rate_hz"] == pytest.approx(1000.0)
    assert values["left.delay_ms"] == pytest.approx(2.0)
    assert values["right.pose_rate_hz"] == 0.0
    assert report.parts["tool left"].values["delay_ms"] == values["left.delay_ms"]
    assert report.warnings == [
        f"coupling_stiffness is {stiffness:.0f} instead of 2000 N/m: with left.device_damping 4 N s/m,"
        " poses at 1000 Hz and 2.0 ms old, a larger value may not be stable"
    ]
    made, _ = live(coupling_stiffness=2000.0)
    made.update()
    report = Report()
    made.report(report)
    assert report.values["coupling_bound"] == "none"
    assert report.warnings == []


def test_levels_become_settings_with_substeps_of_their_own():
    made, posted = live()
    made.update(MARKERS)
    assert made.marker_rate == 10.0
    assert posted == [], "the loop has nothing to do with it"
    made.update(REGION)
    assert posted[-1][1].region_force == ANY_FORCE
    made.update(RATE)
    sequence, settings = posted[-1]
    assert settings.tick_time == 2e-3
    substeps = Simulation(ball(2), rate=500.0, local_region="auto").settings.substeps
    assert settings.substeps == substeps
    assert made.describe() == "markers at 10 Hz, a modal region under any load, 500 Hz"
    made.update(NONE)
    assert posted[-1][0] > sequence
    assert posted[-1][1].tick_time == 1e-3
    assert posted[-1][1].region_force == 0.3
    assert made.marker_rate == 60.0
    count = len(posted)
    made.update()
    assert len(posted) == count, "nothing changed"


def test_a_region_needs_its_tables_from_the_start():
    assert live("auto")[0].helps(REGION)
    for other in ("off", "frozen", "modal"):
        assert not live(other)[0].helps(REGION)


def test_half_the_rate_is_worth_it_only_when_it_saves_substeps():
    fine = live("off", rate=4000.0)[0]
    assert fine.helps(RATE)
    explicit = live("off", integrator="explicit")[0]
    assert not explicit.helps(RATE), "the critical step asks for as many substeps a second"
    assert np.isfinite(explicit._work(1e-3))


def test_fewer_markers_help_only_where_there_are_more():
    assert not live(marker_rate=5.0)[0].helps(MARKERS)
    assert live(marker_rate=5.0)[0].marker_rate == 5.0


@pytest.fixture
def large():
    return ball_of_cells(4, 3000)


@pytest.fixture
def node(large, tmp_path):
    large.save(tmp_path / "large.npz")
    words = f"organ_file:={tmp_path / 'large.npz'}", "local_region:=off", "stiffness_scale:=0.05", "rate:=4000.0"
    process = start_node(tmp_path, *words, "tools:=[left]", UNHURRIED, PUSHED, "marker_rate:=30.0")
    yield process
    process.child.kill()


@pytest.fixture
def client(node):
    client = Client()
    client.meet()
    yield client
    client.close()


@pytest.mark.extended
def test_node_with_an_impossible_load_degrades_in_order(client, node, large):
    """4000 ticks a second of 15,000 soft cells are too many; their critical step allows fewer."""
    touch, inward = poke_path(large, radius=0.0)

    def push():
        client.send_pose(touch - 0.0055 * inward)  # the tip stays clear of the surface
        client.send_force(0.1 * inward)
        client.spin(0.02)

    def is_reported():
        push()
        return client.diagnostics["degraded"] == "rate" and "degraded: markers at 10 Hz, " in client.message

    assert client.spin_until(is_reported), node.text()
    assert client.level == DiagnosticStatus.WARN

    def so_far():
        return [line for line in node.text().splitlines() if "the machine is too slow" in line]

    wait_for(lambda: len(so_far()) >= 2, node.text)
    lines = so_far()
    assert "markers at 10 Hz (" in lines[0]
    assert "markers at 10 Hz, 2000 Hz (" in lines[1]
    assert node.stop() == 0, node.text()
