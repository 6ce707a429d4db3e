"""Instruments from a URDF: where links and jaws are, which bodies they give, and what is refused."""

import numpy as np
import pytest
import trimesh
from ruamel.yaml import YAML
from scipy.spatial.transform import Rotation

from helpers.paths import CONFIG
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import MAX_DECIMATION_ERROR, MAX_FACES, Tool, ToolSet, simplified
from tissue_sim.contact.urdf import read_instrument
from tissue_sim.errors import UserError
from tissue_sim.model.contact.shapes import signed_distance
from tissue_sim.model.data.shapes import CONVEX, GRID, SPHERE
from tissue_sim.organ.organ import Organ

TWO_FINGER = "config/instruments/two_finger.urdf"

# A wrist with two jaws that turn about x by half the joint's angle each, as a PSM's: a mesh and a ball.
WRIST = """
<robot name="wrist">
  <link name="base"/>
  <link name="wrist"><collision><geometry><cylinder radius="0.004" length="0.02"/></geometry></collision></link>
  <link name="jaw_1"><collision><origin xyz="0 0 0.005" rpy="0.1 -0.4 0.7"/>
    <geometry><mesh filename="jaw.stl" scale="0.001 0.001 0.002"/></geometry></collision></link>
  <link name="jaw_2"><collision><origin xyz="0 0.001 0.01"/>
    <geometry><sphere radius="0.002"/></geometry></collision></link>
  <link name="tip"/>
  <joint name="roll" type="revolute"><parent link="base"/><child link="wrist"/><axis xyz="0 0 2"/>
    <origin xyz="0.01 0.02 0.03" rpy="0.3 0.2 -0.5"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="jaw" type="revolute"><parent link="wrist"/><child link="hub"/><axis xyz="1 0 0"/>
    <limit lower="-0.1" upper="1.2" effort="1" velocity="1"/></joint>
  <link name="hub"/>
  <joint name="first" type="revolute"><parent link="wrist"/><child link="jaw_1"/><axis xyz="1 0 0"/>
    <origin xyz="0 0 0.009"/><limit lower="-2" upper="2" effort="1" velocity="1"/>
    <mimic joint="jaw" multiplier="0.5"/></joint>
  <joint name="second" type="continuous"><parent link="wrist"/><child link="jaw_2"/><axis xyz="1 0 0"/>
    <origin xyz="0 0 0.009"/><mimic joint="jaw" multiplier="-0.5" offset="0.01"/></joint>
  <joint name="end" type="fixed"><parent link="wrist"/><child link="tip"/>
    <origin xyz="0 0 0.02" rpy="0 0 1.5707963267948966"/></joint>
</robot>
"""
JAWS = ("jaw_1", "jaw_2")
POSE = np.array([0.01, -0.02, 0.03, *Rotation.from_rotvec([0.3, -0.8, 0.5]).as_quat()])


@pytest.fixture
def wrist(tmp_path):
    """Writes the wrist's URDF, with words in it replaced by others, and gives its path."""
    trimesh.creation.box((2.0, 3.0, 10.0)).export(tmp_path / "jaw.stl")

    def written(**replaced):
        text = WRIST
        for old, new in replaced.items():
            assert old in text
            text = text.replace(old, new)
        file = tmp_path / "wrist.urdf"
        file.write_text(text)
        read_instrument.cache_clear()
        return str(file)

    return written


def matrix(turn=None, at=(0.0, 0.0, 0.0)):
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = (turn or Rotation.identity()).as_matrix(), at
    return made


def as_matrix(pose):
    return matrix(Rotation.from_quat(pose[3:]), pose[:3])


@pytest.mark.parametrize(("angle", "used"), [(0.6, 0.6), (5.0, 1.2), (-1.0, -0.1)])
def test_jaws_are_where_the_chain_of_joints_puts_them(wrist, angle, used):
    tool = Tool("left", "urdf", mesh=wrist(), links=JAWS, tip_link="tip", jaw_joint="jaw")
    tools = ToolSet([tool])
    on_wrist = np.linalg.inv(matrix(Rotation.from_euler("xyz", [0.0, 0.0, 0.5 * np.pi]), [0.0, 0.0, 0.02]))
    hinge = matrix(at=[0.0, 0.0, 0.009])
    first = matrix(Rotation.from_euler("xyz", [0.1, -0.4, 0.7]), [0.0, 0.0, 0.005])
    second = matrix(at=[0.0, 0.001, 0.01])
    expected = [
        as_matrix(POSE) @ on_wrist @ hinge @ matrix(Rotation.from_rotvec([turned, 0.0, 0.0])) @ origin
        for turned, origin in ((0.5 * used, first), (-0.5 * used + 0.01, second))
    ]
    for pose, wanted in zip(tools.poses(0, POSE, angle), expected, strict=True):
        assert as_matrix(pose) == pytest.approx(wanted, abs=1e-12)


def test_bodies_are_the_collision_elements(wrist):
    whole = ToolSet([Tool("left", "urdf", mesh=wrist())])
    assert whole.shapes.kind.tolist() == [CONVEX, CONVEX, SPHERE]  # the wrist, too
    jaws = ToolSet([Tool("left", "urdf", mesh=wrist(), links=JAWS, tip_link="tip", jaw_joint="jaw")])
    assert jaws.bodies == [[0, 1]]
    assert jaws.shapes.size[1, 0] == 0.002
    points = np.random.default_rng(0).uniform(-0.02, 0.02, (100, 3))
    inward = np.array([0.001, 0.0015, 0.01]) - np.abs(points)  # of the box, scaled
    found = [signed_distance(jaws.shapes, 0, *point)[0] for point in points]
    assert found == pytest.approx(-inward.min(axis=1), abs=1e-7)


def test_a_finger_presses_with_the_force_that_a_box_there_has(wrist):
    """The same press by a finger of a gripper and by a tool that is a mesh of its shape, at its place."""
    organ = Organ.shipped("kidney")
    points = organ.surface_positions
    node = int(np.argmax(points[:, 0]))
    finger = trimesh.creation.box((0.006, 0.012, 0.04))
    turned = Rotation.from_euler("y", -0.5 * np.pi)  # its end looks along -x
    wrenches = []
    for tool, beside in (
        (Tool("left", "urdf", mesh=TWO_FINGER, links=("finger",), tip_link="tip", jaw_joint="opening"), 0.0),
        (Tool("left", "mesh", mesh=_written(wrist, finger)), 1.0),
    ):
        scene = Scene(organ, [tool])
        for depth in np.linspace(-0.004, 0.004, 120):
            at = points[node] + [-depth, 0.0, 0.0]
            # The finger, 12 mm from the middle, lies with its middle 15 mm beside the tool's origin and 20 mm behind.
            at = at + (turned.apply([0.015, 0.0, -0.02]) if beside else 0.0)
            scene.move(0, at, turned.as_quat(), 0.012)
            scene.step()
        wrenches.append(scene.wrench(0))
    assert np.linalg.norm(wrenches[0][:3]) > 0.05
    assert wrenches[0][:3] == pytest.approx(wrenches[1][:3], abs=1e-6)
    arm = turned.apply([0.015, 0.0, -0.02])
    assert wrenches[0][3:] == pytest.approx(wrenches[1][3:] + np.cross(arm, wrenches[1][:3]), abs=1e-6)


def _written(wrist, mesh):
    path = wrist().replace("wrist.urdf", "finger.stl")
    mesh.export(path)
    return path


def test_meshes_of_many_faces_become_few_and_stay_where_they_are(monkeypatch):
    pytest.importorskip("fast_simplification")
    ring = trimesh.creation.torus(0.01, 0.003, major_sections=96, minor_sections=48)
    thin = simplified(ring, "a ring")
    assert len(thin.faces) <= MAX_FACES < len(ring.faces)
    assert thin.is_watertight
    assert thin.volume == pytest.approx(ring.volume, rel=0.02)
    x, y, z = thin.triangles_center.T
    assert np.hypot(np.hypot(x, y) - 0.01, z) == pytest.approx(0.003, abs=MAX_DECIMATION_ERROR)
    monkeypatch.setattr("tissue_sim.contact.tools.MAX_DECIMATION_ERROR", 1e-6)
    with pytest.raises(UserError, match=r"a ring has \d+ faces; \d+ would move its surface by .* mm"):
        simplified(ring, "a ring")


def test_a_round_part_has_distances_instead_of_many_planes(wrist, tmp_path):
    path = wrist(**{"0.001 0.001 0.002": "0.001 0.001 0.001"})
    trimesh.creation.icosphere(subdivisions=3, radius=5.0).export(tmp_path / "jaw.stl")
    tools = ToolSet([Tool("left", "urdf", mesh=path, links=("jaw_1",))])
    assert tools.shapes.kind[0] == GRID
    points = np.random.default_rng(0).uniform(-0.006, 0.006, (100, 3))
    found = [signed_distance(tools.shapes, 0, *point)[0] for point in points]
    assert found == pytest.approx(np.linalg.norm(points, axis=1) - 0.005, abs=1e-4)


def test_a_part_that_is_not_convex_is_closed_and_keeps_its_hole(wrist, tmp_path):
    path = wrist()
    trimesh.creation.torus(0.01, 0.003).apply_scale(1000.0).export(tmp_path / "jaw.stl")
    tools = ToolSet([Tool("left", "urdf", mesh=path, links=("jaw_1",))])
    assert tools.shapes.kind[0] == GRID
    assert signed_distance(tools.shapes, 0, 0.0, 0.0, 0.0)[0] > 0.005
    open_one = trimesh.load(tmp_path / "jaw.stl")
    open_one.update_faces(np.arange(len(open_one.faces)) > 3)
    open_one.export(tmp_path / "jaw.stl")
    with pytest.raises(UserError, match=r"tool 'left': mesh '.*jaw.stl' is neither convex nor closed; close its holes"):
        ToolSet([Tool("left", "urdf", mesh=path, links=("jaw_1",))])


@pytest.mark.parametrize(
    ("replaced", "chosen", "reason"),
    [
        ({}, {"links": ("jaw",)}, r"no link 'jaw'; it has base, wrist, jaw_1"),
        ({}, {"tip_link": "top"}, "no link 'top'"),
        ({}, {"jaw_joint": "end"}, "no joint 'end' that moves; it has roll, jaw, first, second"),
        ({}, {"links": ("base",)}, "link 'base' has no collision element"),
        ({"</robot>": ""}, {}, "cannot be read"),
        ({"robot": "sdf"}, {}, "begins with <sdf>"),
        ({'radius="0.004"': 'radius="0"'}, {}, "link 'wrist' has a cylinder of size"),
        ({'radius="0.004"': 'radius="wide"'}, {}, "wide"),
        ({'<parent link="base"/>': ""}, {}, "'parent' is missing"),
        ({'<parent link="base"/>': '<parent link="jaw_1"/>'}, {}, "form a circle"),
        ({'<parent link="base"/>': '<parent link="bone"/>'}, {}, "joins a link that it doesn't have"),
        ({'mimic joint="jaw" multiplier="0.5"': 'mimic joint="first"'}, {}, "'first' mimics 'first'"),
        ({"jaw.stl": "claw.stl"}, {}, "mesh file '.*claw.stl' does not exist"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(wrist, replaced, chosen, reason):
    with pytest.raises(UserError, match=rf"^tool 'left': .*{reason}"):
        ToolSet([Tool("left", "urdf", mesh=wrist(**replaced), **chosen)])


def test_meshes_of_a_package_are_found(wrist, tmp_path, monkeypatch):
    share = tmp_path / "ws" / "share" / "some_arm" / "meshes"
    share.mkdir(parents=True)
    trimesh.creation.box((1.0, 1.0, 1.0)).export(share / "jaw.stl")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "ws"))
    path = wrist(**{"jaw.stl": "package://some_arm/meshes/jaw.stl"})
    tools = ToolSet([Tool("left", "urdf", mesh=path, links=("jaw_1",))])
    assert np.ptp(tools.corners[0], axis=0) == pytest.approx([0.001, 0.001, 0.002])


def test_the_gripper_that_ships_opens_by_its_joint():
    values = YAML(typ="safe").load((CONFIG / "instruments" / "two_finger.yaml").read_text())["/**"]["ros__parameters"]
    tools = ToolSet([Tool("left", **values["left"])])
    for opening in (0.0, 0.01):
        _, first, second = tools.poses(0, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), opening)
        inner = first[0] - 0.003, second[0] + 0.003  # m, the sides that grasp
        assert inner == pytest.approx((opening, -opening), abs=1e-12)
        assert first[2] + 0.02 == pytest.approx(0.0, abs=1e-12)  # the fingers end at the tip
