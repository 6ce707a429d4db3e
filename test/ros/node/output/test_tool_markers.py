"""Tools as RViz shows them, against the shapes that touch the organ."""

import numpy as np
import pytest
import trimesh
from rclpy.serialization import deserialize_message
from scipy.spatial.transform import Rotation
from visualization_msgs.msg import Marker, MarkerArray

from tissue_sim.contact.tools import Tool, ToolSet
from tissue_sim.model.contact.shapes import rotation_matrix, signed_distance
from tissue_sim.ros.node.output.markers import ARROW_LENGTH
from tissue_sim.ros.node.output.tool_markers import ToolMarkers

POSE = np.array([0.1, -0.2, 0.3, *Rotation.from_euler("xyz", (0.4, -1.1, 2.0)).as_quat()])


@pytest.fixture(scope="module")
def tools(tmp_path_factory):
    blade = tmp_path_factory.mktemp("mesh") / "blade.stl"
    trimesh.creation.box((0.004, 0.01, 0.03)).export(blade)
    ring = blade.with_name("ring.stl")
    trimesh.creation.torus(0.01, 0.003).export(ring)
    return ToolSet(
        [
            Tool("ball", radius=0.004),
            Tool("rod", "capsule", radius=0.003, length=0.04),
            Tool("jaws", "gripper", radius=0.002, length=0.02),
            Tool("blade", "mesh", mesh=str(blade)),
            Tool("ring", "mesh", mesh=str(ring)),
        ]
    )


def message_of(tools, poses, forces=None):
    forces = np.zeros((len(tools.tools), 3)) if forces is None else forces
    tips = np.tile(POSE[:3], (len(tools.tools), 1))
    raw = ToolMarkers("organ", tools).message(7_000_000_001, poses, tips, forces)
    return deserialize_message(raw, MarkerArray).markers


def surface_of(marker):
    """Points (k, 3) m on what a marker shows."""
    if marker.type == Marker.SPHERE:
        points = np.asarray(trimesh.creation.icosphere(subdivisions=2, radius=0.5).vertices)
    elif marker.type == Marker.CYLINDER:
        points = np.asarray(trimesh.creation.cylinder(radius=0.5, height=1.0).vertices)
        points = points[np.linalg.norm(points[:, :2], axis=1) > 0.49]  # its rim, not the middle of its ends
    else:
        points = np.array([(p.x, p.y, p.z) for p in marker.points])
    at, turn = marker.pose.position, marker.pose.orientation
    points = points * (marker.scale.x, marker.scale.y, marker.scale.z)
    return Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).apply(points) + (at.x, at.y, at.z)


@pytest.mark.extended
@pytest.mark.parametrize("tool", range(5))
def test_what_is_shown_is_the_surface_that_touches(tools, tool):
    poses = [tools.poses(index, POSE, 0.6) for index in range(5)]
    shown = [marker for marker in message_of(tools, poses) if marker.ns == tools.tools[tool].name]
    solid = [marker for marker in shown if marker.type != Marker.ARROW]
    assert all(marker.action == Marker.ADD for marker in solid)
    assert [marker.id for marker in shown] == list(range(len(shown)))
    assert (shown[0].header.stamp.sec, shown[0].header.frame_id) == (7, "organ")
    per_body = len(solid) // len(tools.bodies[tool])
    matrix = np.zeros(9)
    for index, marker in enumerate(solid):
        body = tools.bodies[tool][index // per_body]
        pose = poses[tool][index // per_body]
        rotation_matrix(pose[3:], matrix)
        local = (surface_of(marker) - pose[:3]) @ matrix.reshape(3, 3)
        gaps = np.array([signed_distance(tools.shapes, body, *point)[0] for point in local])
        # Half of each end's ball lies inside the shaft; a grid rounds a ring off.
        assert gaps.max() == pytest.approx(0.0, abs=3e-4 if tools.tools[tool].name == "ring" else 1e-9)


def test_a_tool_that_nobody_moves_is_deleted_and_no_list_is_empty(tools):
    markers = message_of(tools, [None] * 5, np.ones((5, 3)))
    assert {marker.action for marker in markers} == {Marker.DELETE}
    for marker in markers:
        assert min(marker.scale.x, marker.scale.y, marker.scale.z) > 0.0
        if marker.type in (Marker.TRIANGLE_LIST, Marker.ARROW):
            assert len(marker.points) > 0


def test_an_arrow_is_as_long_as_the_force_and_gone_without(tools):
    poses = [tools.poses(index, POSE) for index in range(5)]
    forces = np.zeros((5, 3))
    forces[1] = (0.0, 2.0, -1.0)
    arrows = [marker for marker in message_of(tools, poses, forces) if marker.type == Marker.ARROW]
    assert [marker.action for marker in arrows] == [Marker.DELETE, Marker.ADD, *[Marker.DELETE] * 3]
    start, end = (np.array([p.x, p.y, p.z]) for p in arrows[1].points)
    assert start == pytest.approx(POSE[:3])
    assert end - start == pytest.approx(ARROW_LENGTH * forces[1])
