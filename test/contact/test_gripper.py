"""A gripper: where its jaws are, what its hand feels, and that it holds what it nips."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from tissue_sim.bench.grasp import FLAT, HINGE, Nip
from tissue_sim.contact.grasp import CLEARANCE, COMPRESSED, DEPTH, at_lower_pole
from tissue_sim.contact.gripper import WIDEST, Jaws, about, jaw_poses
from tissue_sim.contact.tools import Tool
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ

RADIUS, LENGTH = 0.003, 0.03
POSE = np.array([0.01, -0.02, 0.03, *Rotation.from_rotvec([0.3, -0.8, 0.5]).as_quat()])


def hinges_and_tips(poses):
    turns = Rotation.from_quat(poses[:, 3:])
    return poses[:, :3] + turns.apply([0.0, 0.0, -LENGTH]), poses[:, :3]


# where the jaws are ----------------------------------------------------------------------------
def test_closed_jaws_touch_each_other_along_their_length():
    hinges, tips = hinges_and_tips(jaw_poses(POSE, 0.0, RADIUS, LENGTH))
    np.testing.assert_allclose(np.linalg.norm(tips[0] - tips[1]), 2.0 * RADIUS, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(hinges[0] - hinges[1]), 2.0 * RADIUS, atol=1e-12)
    np.testing.assert_allclose(tips.mean(axis=0), POSE[:3], atol=1e-12)


@pytest.mark.parametrize("angle", [0.2, 1.0])
def test_jaws_open_by_their_angle_about_the_hinge(angle):
    poses = jaw_poses(POSE, angle, RADIUS, LENGTH)
    hinges, tips = hinges_and_tips(poses)
    along = (tips - hinges) / LENGTH
    assert np.arccos(along[0] @ along[1]) == pytest.approx(angle)
    hinge = POSE[:3] + Rotation.from_quat(POSE[3:]).apply([0.0, 0.0, -LENGTH])
    np.testing.assert_allclose(hinges.mean(axis=0), hinge, atol=RADIUS * angle)
    np.testing.assert_allclose(np.linalg.norm(poses[:, 3:], axis=1), 1.0, atol=1e-12)


def test_an_angle_has_bounds():
    np.testing.assert_array_equal(*(jaw_poses(POSE, angle, RADIUS, LENGTH) for angle in (-0.5, 0.0)))
    np.testing.assert_array_equal(*(jaw_poses(POSE, angle, RADIUS, LENGTH) for angle in (WIDEST, 90.0)))


@pytest.mark.parametrize("radius", [0.0, RADIUS])
def test_the_gap_between_the_tips_and_the_angle_agree(radius):
    jaws = Jaws(radius, LENGTH)
    for gap in (0.0, 0.004, 0.03):
        tips = hinges_and_tips(jaw_poses(POSE, jaws.angle(gap), radius, LENGTH))[1]
        assert np.linalg.norm(tips[0] - tips[1]) - 2.0 * radius == pytest.approx(gap, abs=1e-12)
        assert jaws.gap(jaws.angle(gap)) == pytest.approx(gap, abs=1e-12)
    with pytest.raises(ValueError, match="mm at most"):
        jaws.angle(0.06)


# where it takes hold ---------------------------------------------------------------------------
@pytest.mark.parametrize("subdivisions", [1, 4])
def test_a_grasp_lies_across_the_lower_pole(subdivisions):
    egg = trimesh.creation.icosphere(subdivisions, 1.0)
    lean = Rotation.from_euler("xyz", [0.3, -0.2, 0.4])
    vertices = lean.apply(np.asarray(egg.vertices) * (0.03, 0.02, 0.05))
    jaws = Jaws(0.0, HINGE)
    grasp = at_lower_pole(vertices, np.asarray(egg.faces), jaws)
    assert grasp.out == pytest.approx(lean.apply([0.0, 0.0, -1.0]), abs=2e-2)
    assert grasp.depth == DEPTH
    wide = 0.06 * np.sqrt(1.0 - ((0.05 - DEPTH) / 0.05) ** 2)  # of an ellipsoid
    assert grasp.width == pytest.approx(wide, rel=0.12 if subdivisions == 1 else 0.01)
    assert grasp.place == pytest.approx((0.05 - DEPTH) * grasp.out, abs=2e-3)
    x, _, z = Rotation.from_quat(grasp.turn).as_matrix().T
    assert z == pytest.approx(-grasp.out)
    assert abs(x @ lean.apply([1.0, 0.0, 0.0])) > 0.999
    assert jaws.gap(grasp.opened) == pytest.approx(grasp.width + CLEARANCE)
    assert jaws.gap(grasp.closed) == pytest.approx(COMPRESSED * grasp.width)


def test_a_gripper_that_is_too_small_is_reported():
    egg = trimesh.creation.icosphere(3, 0.05)
    with pytest.raises(ValueError, match=r"\d mm wide, and the tips open to 19 mm at most"):
        at_lower_pole(np.asarray(egg.vertices), np.asarray(egg.faces), Jaws(0.0, 0.01))


def test_wrenches_add_up_about_the_tools_origin():
    origins, forces = np.array([[0.1, 0.0, 0.0], [0.0, 0.2, 0.0]]), np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 2.0]])
    wrenches = np.hstack([forces, np.zeros((2, 3))])
    expected = np.cross(origins, forces).sum(axis=0)
    np.testing.assert_allclose(about(np.zeros(3), wrenches, origins), [0.0, 1.0, 2.0, *expected])


# what it holds ---------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def pads():
    """The gripper of config/gripper.yaml: two flat jaws."""
    return Tool("left", "gripper", length=HINGE, mesh=FLAT)


class Lifted(Nip):
    """A gripper at the kidney's lower pole, its jaws on either side."""

    def __init__(self, gripper, friction):
        super().__init__(gripper, friction, Organ.load(shipped_organ()))

    def lift(self, way=0.010):
        """Lift what the jaws hold; how far the median point that they held fell behind, m."""
        held = self.touched()
        before = self.points(held)
        self.lead(self.at + way * self.up, self.angle, 1000)
        self.lead(self.at, self.angle, 200)
        behind = np.linalg.norm(self.points(held) - before - way * self.up, axis=1)
        return float(np.median(behind))


@pytest.mark.parametrize("seconds", [1.0, pytest.param(30.0, marks=[pytest.mark.slow, pytest.mark.timeout(900)])])
def test_jaws_lift_the_kidney_by_a_centimetre_and_hold_it_without_slip(pads, seconds):
    nip = Lifted(pads, 0.6)
    behind = nip.lift()
    held = nip.touched()
    before = nip.points(held)
    nip.lead(nip.at, nip.angle, round(1e3 * seconds))
    slip = float(np.linalg.norm(nip.points(held) - before, axis=1).max())
    pull = -float(nip.scene.wrenches[0, :3] @ nip.up)
    print(f"lifted 10 mm, {1e3 * behind:.2f} mm behind; {seconds:g} s: slip {1e3 * slip:.4f} mm under {pull:.2f} N")
    assert len(held[0]) > 10
    assert behind < 3e-3, "points slide from under the jaws' edges"
    assert slip < 1e-4
    assert pull > 0.2, "the hand feels the pull"
    nip.lead(nip.at, nip.grasp.opened, 300)
    nip.lead(nip.at + 0.05 * nip.up, nip.grasp.opened, 3000)
    simulation = nip.scene.simulation
    assert np.abs(nip.scene.wrenches).max() == 0.0, "released"
    assert simulation.asleep
    assert np.abs(simulation.positions - simulation.model.rest).max() < 1e-5


def test_slippery_jaws_do_not_lift_it(pads):
    assert Lifted(pads, 0.05).lift() > 5e-3


def test_hand_of_a_gripper_feels_the_sum_and_no_more_than_the_clamp(pads):
    nip = Lifted(pads, 0.6)
    nip.lead(nip.at + 0.005 * nip.up, nip.angle, 300)
    bodies = nip.scene.simulation.state.wrench[:, :3]
    np.testing.assert_allclose(nip.scene.wrenches[0, :3], bodies.sum(axis=0), atol=1e-12)
    assert np.linalg.norm(bodies, axis=1).min() > 0.3
    nip.scene.simulation.settings.force_clamp = 0.01
    nip.lead(nip.at, nip.angle, 3)
    assert np.linalg.norm(nip.scene.wrenches[0, :3]) == pytest.approx(0.01)
    assert np.linalg.norm(nip.scene.simulation.state.wrench[:, :3].sum(axis=0)) <= 0.01 + 1e-12
