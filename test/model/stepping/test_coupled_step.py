"""Several organs in one tick: links that pull, breath that carries, and each otherwise as it is alone."""

import numpy as np
import pytest

from helpers.scenes import ball, changed, free_ball
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.model.data.links import make_links
from tissue_sim.model.joined import Joined
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.breathing import Breath, inhaled_fraction
from tissue_sim.model.stepping.contact_pairs import make_organ_contacts
from tissue_sim.model.stepping.ligament_links import compute_link_bounds

TOP, TOP_OF_FINE = (int(np.argmax(one.surface_positions[:, 2])) for one in (ball(), ball(2)))


class Organs:
    """Simulations that are joined. links: rows of two ends, a slack, a stiffness and a damping; an end is an organ and
    its node, or a point. wake_displacement: m that an organ may lack of what they do."""

    def __init__(self, simulations, links=(), breath=None, moves=None, wake_displacement=0.0):
        self.simulations = simulations
        self.links = make_links(len(links))
        for number, (ends, slack, stiffness, damping) in enumerate(links):
            for side, end in enumerate(ends):
                if len(end) == 2:
                    self.links.organ[number, side], self.links.node[number, side] = end
                else:
                    self.links.point[number, side] = end
            self.links.slack[number] = slack
            self.links.stiffness[number], self.links.damping[number] = stiffness, damping
        compute_link_bounds(self.links, [one.model.inverse_mass for one in simulations])
        self.joined = Joined(
            simulations, self.links, make_organ_contacts(), breath or Breath.new(), moves or (), wake_displacement
        )
        self.carried, self.threshold = self.joined.carried, self.joined.threshold
        self.least = simulations[0].settings.least_substeps

    def step(self, ticks=1):
        for _ in range(ticks):
            self.joined.step()

    @property
    def momentum(self):
        return sum(one.organ.mass @ one.velocities for one in self.simulations)


def a_breath(period=4.0, way=(0.0, 0.0, 0.015)):
    breath = Breath.new()
    breath.period = period
    breath.x, breath.y, breath.z = way
    return breath


def poked(simulation, step):
    """Shapes under a load that comes and goes."""
    shapes = []
    for tick in range(120):
        if 10 <= tick < 60:
            simulation.apply_force([TOP], [[0.01, 0.0, -0.05]])
        step()
        shapes.append(simulation.positions.copy())
    return np.array(shapes)


def test_organs_that_nothing_joins_are_each_as_alone():
    alone = Simulation(ball())
    organs = Organs([Simulation(ball()), Simulation(ball())])
    first, second = organs.simulations
    np.testing.assert_array_equal(poked(first, organs.step), poked(alone, alone.step))
    assert second.state.count.asleep_ticks == 120, "nobody has touched the other one"


def test_one_organ_that_nothing_joins_is_alone():
    """Its kernels are compiled without links, pairs and breath, and its wrench is its own."""
    simulation, same = Simulation(ball()), Simulation(ball())
    alone = Joined([same])
    assert alone.alone
    assert alone.handle is None
    alone.set_substeps()
    np.testing.assert_array_equal(poked(simulation, simulation.step), poked(same, alone.step))
    assert alone.wrench is same.state.wrench
    alone.take_settings(0, same.settings)
    alone.set_breathing(1.0)
    same.reset()
    alone.reset()
    alone.step()
    assert not same.state.carried.any()


def test_what_is_joined_is_not_alone():
    assert not Joined([Simulation(ball()), Simulation(ball())]).alone
    for what in ({"links": make_links(1)}, {"pairs": make_organ_contacts()}, {"breath": a_breath()}):
        assert not Joined([Simulation(ball())], **what).alone


@pytest.mark.parametrize("damping", [0.0, 0.02, 50.0])
def test_links_leave_momentum_as_it_was(damping):
    """Of two free balls, of which one flies away from the other."""
    pair = [Simulation(free_ball(), integrator="symplectic") for _ in range(2)]
    links = [(((0, node), (1, node)), 0.0, 5.0, damping) for node in range(4)]
    organs = Organs(pair, links)
    pair[0].apply_force([TOP], [[0.3, 0.1, 0.0]])
    organs.step()
    before = organs.momentum
    assert np.linalg.norm(before) > 1e-5
    organs.step(400)
    np.testing.assert_allclose(organs.momentum, before, atol=1e-9 * np.linalg.norm(before))
    speeds = [np.linalg.norm(one.organ.mass @ one.velocities) for one in pair]
    assert min(speeds) > 0.2 * max(speeds), "the other one was taken along"


def test_a_taut_link_pulls_by_its_stretch_and_a_slack_one_not_at_all():
    at = ball().surface_positions[TOP]
    up = at + [0.0, 0.0, 0.05]
    organs = Organs([Simulation(ball())], [(((0, TOP), up), 0.04, 2.0, 0.0)])
    organs.step(3000)
    organ = organs.simulations[0]
    length = np.linalg.norm(up - organ.positions[TOP])
    tension = np.linalg.norm(organs.links.force[0])
    assert 0.001 < tension < 0.02
    assert tension == pytest.approx(2.0 * (length - 0.04), rel=1e-9)
    by_force = Simulation(ball())
    settled, _ = by_force.settle(np.eye(1, by_force.organ.n_surface, TOP).T * organs.links.force[0])
    moved = organ.positions[: organ.organ.n_surface] - organ.model.rest[: organ.organ.n_surface]
    np.testing.assert_allclose(moved, settled, atol=0.01 * np.abs(settled).max())

    slack = Organs([Simulation(ball())], [(((0, TOP), up), 0.06, 2.0, 0.0)])
    slack.step(10)
    assert slack.simulations[0].asleep
    assert not slack.links.force.any()


def test_a_link_that_is_taut_by_rounding_lets_organs_sleep():
    at = ball().surface_positions[TOP]
    organs = Organs([Simulation(ball())], [(((0, TOP), at + [0.0, 0.0, 0.05]), 0.05 * (1.0 - 1e-12), 2.0, 0.0)])
    organs.step(10)
    assert organs.simulations[0].asleep
    assert not organs.links.force.any()


def test_an_organ_that_hangs_is_let_go_once_after_a_fault_when_no_hand_is_left():
    """So that what pulls it doesn't hold it for good in the false shape that the fault may have left."""
    up = ball().surface_positions[TOP] + [0.0, 0.0, 0.05]
    organs = Organs([Simulation(ball()), Simulation(ball())], [(((0, TOP), up), 0.04, 20.0, 0.0)])
    hanging, other = organs.simulations
    status, count = hanging.state.status, hanging.state.count
    organs.step(3000)
    pulled = organs.links.force.copy()
    assert np.linalg.norm(pulled) > 1e-3
    assert count.snaps == 0, "a sound one hangs as it hangs"

    status.faulted = True
    for _ in range(1000):
        other.apply_force([TOP], [[0.0, 0.0, 1e-6]])
        organs.step()
    assert count.snaps == 0, "a hand is on one of the organs"
    for _ in range(2000):
        organs.step()
        if status.snapped:
            break
    assert status.snapped
    organs.step()
    assert not organs.links.force.any()
    organs.step(4000)
    assert count.snaps == 1
    assert not status.snapped
    np.testing.assert_allclose(organs.links.force, pulled, rtol=1e-4, atol=1e-7)


def test_an_organ_that_breathes_in_its_ligaments_is_as_if_nothing_had_been_some_time_after_faults():
    """Beside one that was left alone: the guard steps in for forces that throw it out of its shape."""
    up = ball().surface_positions[TOP] + [0.0, 0.0, 0.05]
    thrown, alone = (
        Organs(
            [Simulation(ball()), Simulation(ball())],
            [(((0, TOP), up), 0.04, 20.0, 0.01), (((0, TOP - 1), (1, TOP)), 0.0, 5.0, 0.01)],
            breath=a_breath(1.0, (0.0, 0.0, 0.005)),
            moves=[1.0, 0.5],
        )
        for _ in range(2)
    )
    organ = thrown.simulations[0]
    nodes = np.arange(0, 40, 2)
    for tick in range(60):
        organ.apply_force(nodes, np.tile([30.0 * (-1.0) ** (tick // 10), 20.0, -40.0], (len(nodes), 1)))
        thrown.step()
        alone.step()
    assert organ.state.count.faults > 3
    thrown.step(4000)
    alone.step(4000)
    assert organ.state.count.snaps > 0
    for one, other in zip(thrown.simulations, alone.simulations, strict=True):
        assert np.abs(other.positions - other.model.rest).max() > 1e-4
        np.testing.assert_allclose(one.positions, other.positions, atol=1e-8)


@pytest.mark.parametrize("stiffness", [1.0, 30.0, 1000.0])
def test_stiff_links_take_shorter_steps_and_come_to_rest(stiffness):
    at = ball().surface_positions[TOP]
    organs = Organs([Simulation(ball())], [(((0, TOP), at + [0.0, 0.0, 0.004]), 0.0, stiffness, 0.01)])
    organ = organs.simulations[0]
    organs.step(1500)
    before = organ.positions.copy()
    organs.step(50)
    assert organ.state.count.faults == 0
    assert np.abs(organ.positions - before).max() < 1e-6
    assert organ.state.status.substeps >= organs.least


def test_organs_that_links_join_take_as_many_substeps():
    soft, stiff = Simulation(ball()), Simulation(ball())
    stiff.settings.stiffness_scale = 40.0
    stiff.set_substeps()
    assert stiff.settings.substeps > soft.settings.substeps
    organs = Organs([soft, stiff], [(((0, TOP), (1, TOP)), 0.0, 1.0, 0.0)])
    soft.apply_force([TOP], [[0.0, 0.0, -0.02]])
    organs.step(3)  # then they are apart, and the other one is awake
    assert soft.state.status.substeps == stiff.state.status.substeps == stiff.settings.substeps


# breath ------------------------------------------------------------------------------------------
def test_a_breath_is_out_at_first_and_in_after_half_its_period():
    for time, share in ((0.0, 0.0), (1.0, 0.25), (2.0, 1.0), (3.0, 0.25), (4.0, 0.0)):
        assert inhaled_fraction(time, 4.0)[0] == pytest.approx(share, abs=1e-12)
    step = 1e-5
    for time in (0.3, 1.1, 2.0, 3.7):
        before, (_, speed, change), after = (inhaled_fraction(time + d, 4.0) for d in (-step, 0.0, step))
        assert speed == pytest.approx((after[0] - before[0]) / (2.0 * step), abs=1e-6)
        assert change == pytest.approx((after[1] - before[1]) / (2.0 * step), abs=1e-6)


def test_an_organ_that_sleeps_is_carried_asleep():
    organs = Organs(
        [Simulation(ball()), Simulation(ball())], breath=a_breath(), moves=[1.0, 0.5], wake_displacement=1e-3
    )
    organs.step(2000)
    carried = [one.state.carried[2] for one in organs.simulations]
    np.testing.assert_allclose(carried, [0.015, 0.0075], rtol=1e-9)
    assert all(one.asleep for one in organs.simulations)


def test_an_organ_in_its_moving_frame_is_as_one_whose_clamp_is_led():
    """A breath of half a second, which bends it. Without what holds nodes to the room: damping and return springs."""
    organ, way = changed(ball(), damping=0.0, return_stiffness=0.0), np.array([0.004, 0.0, 0.002])
    framed = Organs([Simulation(organ)], breath=a_breath(0.5, way), moves=[1.0])
    led, held = Simulation(organ), np.asarray(organ.fixed)
    off = most = 0.0
    for tick in range(1, 400):
        framed.step()
        share, _, _ = inhaled_fraction(1e-3 * tick, 0.5)
        led.prescribe(held, led.model.rest[held] + share * way)
        led.step()
        bent = framed.simulations[0].positions - framed.simulations[0].model.rest
        there = led.positions - led.model.rest - share * way
        most, off = max(most, np.abs(there).max()), max(off, np.abs(bent - there).max())
    assert most > 1e-4
    assert off < 0.05 * most


def test_a_tool_that_stands_still_is_pressed_by_an_organ_that_comes():
    """As one that goes to the organ by the same way: the force that it feels."""
    tool = [Tool("ball", "sphere", radius=0.005)]
    felt = []
    for breathes in (False, True):
        scene = Scene(ball(2), tool)
        top = scene.simulation.organ.surface_positions[TOP_OF_FINE]
        start = top + [0.0, 0.0, 0.0055]
        organs = Organs([scene.simulation], breath=a_breath(1.0, (0.0, 0.0, 0.003)), moves=[float(breathes)])
        scene.simulation.step = organs.step
        forces = []
        for tick in range(500):
            share = 0.0 if breathes else inhaled_fraction(1e-3 * tick, 1.0)[0]
            scene.move(0, start - [0.0, 0.0, 0.003 * share])
            scene.step()
            forces.append(scene.wrenches[0, :3].copy())
        felt.append(np.array(forces))
    assert np.abs(felt[0]).max() > 0.02
    np.testing.assert_allclose(felt[1], felt[0], atol=0.05 * np.abs(felt[0]).max())
