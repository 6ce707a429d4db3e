"""Blades in a slab: what they feel, what they cut, and what becomes of that."""

import numba
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.bars import bar
from helpers.slabs import MIDDLE, SIZE, slab
from tissue_sim.contact.edges import ALONG
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.scene_batch import SceneBatch
from tissue_sim.contact.tools import Tool, ToolSet
from tissue_sim.errors import UserError
from tissue_sim.model.contact.blade import find_blades
from tissue_sim.model.cutting.blade_path import BladePath
from tissue_sim.model.cutting.sheet import Coagulation
from tissue_sim.model.elasticity.cells import shapes_of
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ

TOUGHNESS = 20.0  # J/m^2
SPEED = 2e-5  # m a tick
# Its edge, -z of the tool, lies along y of the slab; it cuts, +x of the tool, downwards.
DOWN = Rotation.from_matrix(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])).as_quat()
UP = Rotation.from_matrix(np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])).as_quat()


def knife(**changes):
    return Tool("knife", **({"shape": "blade", "radius": 5e-4, "length": SIZE[1], "height": 0.01} | changes))


@numba.njit
def listed_places(world, step):
    """Number of places of blades that a substep resolves, which are then listed in scratch.blade_rows."""
    return find_blades(world, step)


class Cutting:
    """A blade above the middle of the slab, across its whole width."""

    def __init__(self, turn=DOWN, tool=None, toughness=TOUGHNESS, friction=0.0):
        self.scene = Scene(slab(), [tool or knife()])
        settings = self.scene.simulation.settings
        settings.toughness, settings.flank_friction, settings.friction = toughness, friction, 0.0
        self.height, self.turn, self.aside = SIZE[2] + 0.002, turn, 0.0
        self.work = self.damped = 0.0
        self.force = np.zeros(3)
        self.step(0.0, 2)

    @property
    def simulation(self):
        return self.scene.simulation

    @property
    def blades(self):
        return self.simulation.state.blades

    @property
    def is_cutting(self):
        return bool(self.simulation.state.bodies.cutting[0])

    @property
    def area(self):
        return float(self.blades.area.sum())

    def step(self, way, ticks):
        """Move by a way down in each tick; return the forces up on the hand."""
        forces = []
        for _ in range(ticks):
            before = self.force
            self.height -= way
            self.scene.move("knife", [MIDDLE + self.aside, 0.0, self.height], self.turn)
            self.scene.step()
            self.force = self.scene.wrench("knife")[:3]
            self.work += 0.5 * (before + self.force)[2] * way
            simulation = self.simulation
            speed = np.square(simulation.velocities).sum(axis=1)
            self.damped += float(simulation.organ.damping @ speed) / simulation.rate
            forces.append(self.force[2])
        return np.array(forces)

    def begin(self):
        """Press until the blade enters; return the largest force before."""
        largest = 0.0
        while not self.is_cutting:
            largest = max(largest, self.step(SPEED, 1)[0])
            assert self.height > 0.01, "it never enters"
        return largest


@pytest.fixture(scope="module")
def cut():
    """A blade that has cut 14 mm deep, with the forces of the last 8 mm."""
    made = Cutting()
    made.largest = made.begin()
    made.step(SPEED, 300)
    made.forces = made.step(SPEED, 400)
    return made


def test_tissue_sticks_until_the_load_reaches_the_toughness(cut):
    assert cut.largest == pytest.approx(TOUGHNESS * SIZE[1], rel=0.15)


def test_the_steady_force_is_toughness_times_width(cut):
    assert cut.forces.mean() == pytest.approx(TOUGHNESS * SIZE[1], rel=0.1)


def test_the_work_is_stored_dissipated_or_has_made_area(cut):
    stored = cut.simulation.energy.total
    assert cut.work == pytest.approx(stored + cut.damped + TOUGHNESS * cut.area, rel=0.05)


def test_what_is_swept_is_opened(cut):
    (report,) = cut.simulation.cuts
    assert report.area == pytest.approx(cut.area, rel=0.15)
    assert report.depth == pytest.approx(cut.blades.deepest[:ALONG].max(), abs=0.002)


def test_the_hand_does_not_feel_that_the_cut_opens():
    made, before, forces, opened = Cutting(), 0, [], []
    made.begin()
    for tick in range(350):
        forces.append(made.step(SPEED, 1)[0])
        if made.simulation.cuts and made.simulation is not before:
            before = made.simulation
            opened.append(tick)
    falls = [1.0 - min(forces[tick + 1 : tick + 11]) / np.mean(forces[tick - 2 : tick + 1]) for tick in opened]
    assert len(falls) > 2
    assert max(falls) < 0.1


def test_a_place_that_was_left_behind_pays_for_what_it_cuts():
    """It ran after its blade at once, and cut on its way without a load: more energy was used than the hand gave."""
    made, ticks, behind = Cutting(), 5, 1e-3
    made.begin()
    made.step(SPEED, 200)
    place, width = 2, float(made.simulation.shapes.blades.width[2])
    made.blades.rest[place, 2] += behind
    before, force = float(made.blades.area[place]), float(made.blades.force[place, 0])
    made.step(SPEED, ticks)
    assert float(made.blades.area[place]) - before < 3.0 * ticks * SPEED * width < 0.5 * behind * width
    assert force < float(made.blades.force[place, 0]) < 2.2 * force
    made.step(SPEED, 150)
    lowest = np.delete(made.blades.rest[:ALONG, 2], place)
    assert made.blades.rest[place, 2] - lowest.mean() < 0.3 * behind


def test_a_place_that_is_beside_its_flank_throws_no_tissue():
    """As where it leaves what is between two lips: it was held at its flank at once, with the energy of that."""
    made, place, beside = Cutting(), 3, 1e-3
    made.begin()
    made.step(SPEED, 20)
    assert not made.simulation.cuts
    made.blades.rest[place, 0] += beside
    made.step(SPEED, 1)
    assert np.abs(made.blades.force[place, 2]) < 0.1
    made.step(0.0, 100)
    assert np.abs(made.blades.rest[place, 0] - np.delete(made.blades.rest[:ALONG, 0], place).mean()) < 0.2 * beside


@pytest.mark.extended
def test_nothing_goes_with_a_blade_that_leaves():
    """The last places held light copies of nodes, which went with it out of a kidney, and then jumped."""
    scene = Scene(Organ.shipped("kidney"), [knife(radius=0.0015, length=0.02, height=0.012)])
    scene.simulation.settings.toughness = 75.0
    turn = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]).as_quat()

    def move(depth):
        scene.move("knife", [0.0705, 0.0149 + depth, -0.011], turn)
        scene.step()
        return float(np.linalg.norm(scene.wrench("knife")[:3]))

    forces = [move(depth) for depth in np.arange(-0.002, 0.02, 4e-5)]
    assert max(forces) > 1.0
    forces = [move(depth) for depth in np.arange(0.02, -0.004, -4e-5)]
    assert not scene.simulation.state.bodies.cutting.any()
    assert max(forces[-75:]) < 0.1, "from 1 mm above the surface on"


def test_a_place_in_an_inverted_cell_takes_over_how_its_neighbours_move():
    """It stayed where it was, resisted, while the blade went on: of a kidney half of the width was not cut."""
    made = Cutting()
    made.begin()
    made.step(SPEED, 200)
    state, scratch = made.simulation.state, made.simulation.scratch
    cell = int(state.blades.cell[0])
    nodes = made.simulation.model.cut_cells.nodes[cell]
    state.position[nodes] = state.position[nodes].mean(axis=0)
    found = listed_places(made.simulation.world, 1e-3)
    rows = {int(row.sample): row for row in scratch.blade_rows[:found]}
    flat = [number for number in rows if state.blades.cell[number] == cell]
    assert 0 in flat
    assert all(rows[number].borrowed for number in flat)
    known = [number for number in rows if not rows[number].borrowed]
    at = made.scene.tools.shapes.blades.at
    nearest = known[int(np.argmin(np.linalg.norm(at[known] - at[0], axis=1)))]
    np.testing.assert_array_equal(rows[0].back, rows[nearest].back)
    assert np.any(rows[0].back != 0.0)


def test_a_blade_that_jumps_in_tissue_catches_up_at_a_metre_per_second():
    made = Cutting()
    made.begin()
    made.step(SPEED, 100)
    before = float(made.simulation.state.body_pose[0, 2])
    made.step(0.003, 1)
    moved = [before - float(made.simulation.state.body_pose[0, 2])]
    for _ in range(4):
        made.step(0.0, 1)
        moved.append(before - float(made.simulation.state.body_pose[0, 2]))
    assert made.is_cutting
    assert 0.0 < moved[0] < 1.1e-3
    assert np.max(np.diff(moved)) < 1.1e-3
    assert moved[-1] == pytest.approx(0.003, abs=1e-5)


def test_twice_the_toughness_needs_twice_the_force():
    made = Cutting(toughness=2.0 * TOUGHNESS)
    assert made.begin() == pytest.approx(2.0 * TOUGHNESS * SIZE[1], rel=0.15)


def test_the_blunt_side_does_not_cut():
    made = Cutting(turn=UP)
    forces = made.step(SPEED, 500)
    assert forces[-1] > 2.0 * TOUGHNESS * SIZE[1]
    assert not made.is_cutting
    assert not made.simulation.cuts


def test_a_blade_that_is_drawn_out_feels_friction_alone_and_then_nothing():
    made = Cutting(friction=500.0)
    made.begin()
    made.step(SPEED, 300)
    forces = made.step(-5e-5, 100)
    in_tissue = made.blades.embedded
    flank = made.simulation.shapes.blades.flank[in_tissue].sum()
    assert -1.05 * 500.0 * flank <= forces[-1] <= 0.0
    area = made.area
    made.step(-5e-5, 400)
    assert not made.is_cutting
    assert not made.force.any()
    assert made.area == area > 1e-5, "what has been cut still counts"


def test_an_open_cut_resists_no_second_time(cut):
    again = Cutting()
    again.begin()
    again.step(SPEED, 300)
    again.step(-5e-5, 400)
    assert not again.is_cutting
    assert len(again.simulation.cuts) == 1
    depth, area = again.simulation.cuts[0].depth, again.simulation.cuts[0].area
    top = again.height
    forces = again.step(5e-5, round((top - (SIZE[2] - 0.5 * depth)) / 5e-5))
    assert again.is_cutting
    assert forces.max() < 0.3 * TOUGHNESS * SIZE[1]
    again.step(-5e-5, 600)
    assert again.simulation.cuts[0].area == pytest.approx(area, rel=0.1)
    assert len(again.simulation.cuts) == 1


def test_a_hand_that_moves_aside_takes_tissue_along(cut):
    made = Cutting()
    made.begin()
    made.step(SPEED, 200)
    for _ in range(100):
        made.aside += 2e-5
        made.step(0.0, 1)
    assert made.force[0] < -0.05
    assert np.isfinite(made.simulation.positions).all()


@pytest.mark.parametrize("stiffness", [0.0, 500.0])
def test_a_blade_stays_in_tissue_while_poses_pause(stiffness):
    """The hand feels nothing during the pause and the same force as before after it."""
    made = Cutting(friction=500.0)
    settings = made.simulation.settings
    settings.coupling_stiffness, settings.coupling_damping = stiffness, 1.0
    made.begin()
    made.step(SPEED, 300)
    made.step(0.0, 300)
    before, where = made.force.copy(), made.simulation.state.body_pose[0].copy()
    assert before[2] > 0.3
    for pause in (80, 900):
        made.scene.step(pause)
        assert made.is_cutting
        assert not made.scene.wrench("knife").any()
        np.testing.assert_allclose(made.simulation.state.body_pose[0], where, atol=1e-5)
        made.step(0.0, 300)
        np.testing.assert_allclose(made.force, before, atol=0.05 * before[2])
    deep = made.blades.deepest.max()
    made.step(SPEED, 100)
    assert made.blades.deepest.max() > deep + 50 * SPEED, "it goes on cutting"
    assert made.simulation.state.count.slips == 0


def test_a_blade_whose_hand_does_not_return_leaves_the_tissue():
    made = Cutting()
    made.begin()
    made.step(SPEED, 300)
    made.scene.step(1001)
    assert not made.is_cutting
    assert not made.blades.embedded.any()
    made.step(0.0, 50)
    assert not made.force.any(), "it appeared inside, and is held off until it is outside"


def test_a_reset_heals_and_releases():
    made = Cutting()
    made.begin()
    made.step(SPEED, 300)
    assert made.simulation.cuts
    made.scene.reset()
    made.scene.step(10)
    assert not made.simulation.cuts
    assert not made.is_cutting
    assert not made.blades.embedded.any()
    assert made.area == 0.0
    assert made.simulation.energy.total == pytest.approx(0.0, abs=1e-12)


def test_a_cautery_hook_parts_tissue_without_force_at_its_speed():
    made = Cutting(tool=knife(cautery_speed=0.02), toughness=1e4)
    made.step(1e-5, 1200)
    assert made.is_cutting
    assert abs(made.force[2]) < 0.2 * TOUGHNESS * SIZE[1]
    deep = made.blades.deepest[:ALONG].max()
    made.step(1e-4, 50)  # five times its speed
    assert made.blades.deepest[:ALONG].max() - deep < 1.5 * 0.02 * 0.05
    assert made.force[2] > 0.1


def test_a_hot_hook_stiffens_the_walls_of_its_cut_until_the_reset():
    """By the volume within the spread of the area that it has cut, as the front is advanced a little more."""
    made = Cutting(tool=knife(cautery_speed=0.02, cautery_stiffening=4.0, cautery_spread=0.002))
    made.step(SPEED, 600)
    (report,) = made.simulation.cuts
    whole, hot = slab(), made.simulation.organ
    assert made.simulation.settings.substeps > Simulation(whole).settings.substeps
    volume = [shapes_of(one.rest_positions, one.cell_nodes)[1] @ one.cell_mu / whole.cell_mu[0] for one in (whole, hot)]
    stiffer = (volume[1] - volume[0]) / 3.0
    assert stiffer == pytest.approx(2.0 * 0.002 * report.area, rel=0.4)
    assert stiffer > 2.0 * 0.002 * 0.99 * report.area
    assert made.simulation.state.count.faults == 0
    made.scene.reset()
    assert made.simulation.organ.cell_mu is slab().cell_mu
    made.height = SIZE[2] + 0.002
    made.step(0.0, 2)
    assert made.simulation.settings.substeps == Simulation(whole).settings.substeps


def test_a_cold_knife_that_goes_on_with_a_hot_cut_leaves_its_walls_stiff():
    hot, cold = Coagulation(4.0, 0.002), Coagulation(1.0, 0.001)
    simulation = Simulation(slab(), shapes=ToolSet([knife()]).shapes)
    path = BladePath(slab(), 1)
    edge, ahead, along = np.linspace([MIDDLE, 0.0, 0.02], [MIDDLE, SIZE[1], 0.02], 9), [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]
    for heat, deep in ((cold, 0.0), (hot, 0.004), (cold, 0.008)):
        path.heat(heat)
        path.note(edge - [0.0, 0.0, deep], np.array(ahead), np.array(along))
        simulation = simulation.prepared_sheet(path.sheet())
        assert bool(simulation.cuts[-1].stiffer_cells) == (deep > 0.0)


def test_two_runs_have_the_same_bits():
    words = []
    for _ in range(2):
        made = Cutting()
        made.begin()
        made.step(SPEED, 200)
        words.append(made.simulation.state.words.copy())
    assert np.array_equal(*words)


def test_scissors_cut_what_is_between_their_blades_off():
    organ = bar(8, 0.005, 2)  # 40 x 10 x 10 mm, held at x = 0
    scene = Scene(organ, [Tool("scissors", shape="scissors", radius=5e-4, length=0.04, height=0.005)])
    settings = scene.simulation.settings
    settings.toughness, settings.friction, settings.flank_friction = 5.0, 0.0, 0.0
    place = [0.0215, 0.014, 0.005]
    turn = Rotation.from_matrix(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])).as_quat()
    jaws = scene.tools.tools[0].jaws
    for gap in np.arange(0.022, 0.0, -2e-5):
        scene.move("scissors", place, turn, angle=jaws.angle(gap))
        scene.step()
    scene.step(20)
    (report,) = scene.simulation.cuts
    assert report.pieces == 2
    assert report.free_pieces == 1
    assert report.area == pytest.approx(1e-4, rel=0.1)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"length": 0.0}, "length 0 m of its edge"),
        ({"height": 0.0}, "height 0 m"),
        ({"cautery_speed": 1.0}, "cautery_speed 1 m/s"),
        ({"cautery_speed": 0.02, "cautery_stiffening": 0.5}, "cautery_stiffening 0.5 is outside 1..20"),
        ({"cautery_speed": 0.02, "cautery_stiffening": float("nan")}, "cautery_stiffening nan is outside 1..20"),
        ({"cautery_speed": 0.02, "cautery_spread": 0.02}, "cautery_spread 0.02 m is outside 0..0.01"),
        ({"cautery_stiffening": 3.0}, "cautery_stiffening 3 needs a hot tool, and without a cautery_speed"),
    ],
)
def test_a_blade_out_of_range_is_refused(changes, said):
    with pytest.raises(UserError, match=f"tool 'knife': {said}"):
        Scene(slab(), [knife(**changes)])


def test_a_blade_needs_cells_that_move_as_a_whole():
    for changes in ({"model": "hybrid"}, {"local_region": "modal"}):
        with pytest.raises(UserError, match="a blade cuts model cells with local_region off"):
            Scene(slab(), [knife()], **changes)


def test_a_batch_takes_no_blades():
    with pytest.raises(UserError, match="a batch supports no blades"):
        SceneBatch(Scene(slab(), [knife()]), 2)


def test_a_touch_elsewhere_begins_anew():
    made = Cutting()
    while made.step(SPEED, 1)[0] < 0.9 * TOUGHNESS * SIZE[1]:
        assert not made.is_cutting
    made.step(-1e-4, 150)
    made.aside = 0.008
    assert made.begin() == pytest.approx(TOUGHNESS * SIZE[1], rel=0.2)


def test_tissue_without_toughness_is_cut():
    made = Cutting(toughness=0.0)
    made.step(SPEED, 600)
    assert made.area > 1e-4
    assert made.simulation.cuts


class Refusing:
    """A blade that has cut without that anything was opened."""

    def __init__(self, patch):
        def refuse(*_):
            raise UserError("no cut now")

        self.made = Cutting()
        self.made.begin()
        patch.setattr(Simulation, "prepared_sheet", refuse)
        with pytest.warns(
            UserWarning, match="not opened: no cut now; it is tried again when the blade has cut farther"
        ):
            self.made.step(SPEED, 300)
        assert self.counted > 0
        assert not self.made.simulation.cuts

    @property
    def counted(self):
        return self.made.scene.organs[0].blade_cuts.refused

    def leave(self):
        self.made.step(-5e-5, 400)
        assert not self.made.is_cutting


def test_a_stage_that_is_refused_is_tried_again_when_the_blade_leaves(monkeypatch):
    with monkeypatch.context() as patch:
        refusing = Refusing(patch)
    counted, area = refusing.counted, refusing.made.area
    refusing.leave()
    (report,) = refusing.made.simulation.cuts
    assert report.area == pytest.approx(area, rel=0.3)
    assert refusing.counted == counted


def test_a_stage_that_is_refused_when_the_blade_has_left_is_told(monkeypatch):
    refusing = Refusing(monkeypatch)
    counted = refusing.counted
    with pytest.warns(UserWarning, match="it stays closed, as the blade has left; cut there again"):
        refusing.leave()
    assert refusing.counted == counted + 1


def test_a_scratch_is_counted_as_one_and_not_as_a_refused_cut():
    made = Cutting(tool=knife(cautery_speed=0.02), toughness=1e4)
    while not made.is_cutting or made.blades.deepest.max() < 1e-3:
        made.step(1e-5, 1)
    made.step(-5e-5, 400)
    assert not made.is_cutting
    stages = made.scene.organs[0].blade_cuts
    assert not made.simulation.cuts
    assert (stages.scratches, stages.refused) == (1, 0)


def test_a_hook_moves_freely_in_its_own_cut():
    made = Cutting(tool=knife(cautery_speed=0.02), toughness=1e4)
    made.step(1e-5, 1200)
    made.step(-5e-5, 400)
    assert not made.is_cutting
    forces = made.step(1e-4, 120)
    assert forces.max() < 0.3 * TOUGHNESS * SIZE[1]
