"""Tools in the forms that FCL, the kernels and the broad phase need; and what is refused."""

import fcl
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from helpers.turns import random_turns
from tissue_sim.contact.broad_phase import body_box
from tissue_sim.contact.tools import MARGIN, MAX_PLANES, Tool, ToolSet
from tissue_sim.errors import UserError
from tissue_sim.model.contact.shapes import signed_distance
from tissue_sim.model.data.shapes import CAPSULE, CONVEX, SPHERE


def mesh_file(folder, mesh, name="tool.stl"):
    mesh.export(folder / name)
    return str(folder / name)


def blade():
    """A box of 4 x 6 x 30 mm that reaches from its tip, the origin, along -z."""
    mesh = trimesh.creation.box((0.004, 0.006, 0.030))
    mesh.apply_translation([0.0, 0.0, -0.015])
    return mesh


def distances(tools, tool, points):
    return np.array([signed_distance(tools.shapes, tool, *point)[0] for point in points])


@pytest.fixture
def every_shape(tmp_path):
    """A sphere, a blade, a capsule and a cone in one set."""
    cone = trimesh.creation.cone(0.01, 0.03, sections=12)
    return ToolSet(
        [
            Tool("ball", "sphere", radius=0.008),
            Tool("blade", "mesh", mesh=mesh_file(tmp_path, blade())),
            Tool("grasper", "capsule", radius=0.003, length=0.04),
            Tool("cone", "mesh", mesh=mesh_file(tmp_path, cone, "cone.obj")),
        ]
    )


def test_kernel_shapes_are_those_that_were_asked_for(every_shape):
    shapes = every_shape.shapes
    np.testing.assert_array_equal(shapes.kind, [SPHERE, CONVEX, CAPSULE, CONVEX])
    np.testing.assert_allclose(shapes.size[[0, 2]], [[0.008, 0.0], [0.003, 0.04]])
    assert shapes.plane_start[0] == shapes.plane_start[1] == 0
    assert shapes.plane_start[2] - shapes.plane_start[1] == 6  # two triangles on each side of a box, one plane
    assert len(shapes.plane) == shapes.plane_start[-1]


def test_mesh_tool_measures_distance_like_its_box(every_shape):
    points = np.random.default_rng(0).uniform([-0.006, -0.008, -0.04], [0.006, 0.008, 0.01], (200, 3))
    inward = np.array([0.002, 0.003, 0.015]) - np.abs(points + [0.0, 0.0, 0.015])
    np.testing.assert_allclose(distances(every_shape, 1, points), -inward.min(axis=1), atol=1e-8)


def test_mesh_tools_vertices_lie_on_it(every_shape):
    for tool in (1, 3):
        np.testing.assert_allclose(distances(every_shape, tool, every_shape.corners[tool]), 0.0, atol=1e-8)


def box(tools, body, turn, origin, margin):
    low, high = np.zeros(3), np.zeros(3)
    body_box(tools.corners[body], tools.padding[body] + margin, turn.as_matrix().ravel(), origin, low, high)
    return low, high


@pytest.mark.parametrize("tool", range(4))
def test_box_holds_the_tool_wherever_it_is_turned(every_shape, tool):
    random = np.random.default_rng(tool)
    points = random.uniform([-0.01, -0.01, -0.045], [0.01, 0.01, 0.03], (5000, 3))
    inside = points[distances(every_shape, tool, points) <= 0.0]
    assert len(inside) > 100
    for turn in random_turns(10, np.random.default_rng(0)):
        origin = random.uniform(-1.0, 1.0, 3)
        low, high = box(every_shape, tool, turn, origin, 0.0)
        placed = turn.apply(inside) + origin
        assert np.all(placed >= low - 1e-12)
        assert np.all(placed <= high + 1e-12)
        wide = box(every_shape, tool, turn, origin, 0.002)
        np.testing.assert_allclose([low - wide[0], wide[1] - high], 0.002, atol=1e-15)


@pytest.mark.parametrize("tool", [0, 2])
def test_box_of_a_round_tool_is_tight(every_shape, tool):
    low, high = box(every_shape, tool, Rotation.identity(), np.zeros(3), 0.0)
    radius, length = every_shape.shapes.size[tool]
    np.testing.assert_allclose(low, [-radius, -radius, -radius - length], atol=1e-15)
    np.testing.assert_allclose(high, [radius, radius, radius], atol=1e-15)


@pytest.mark.parametrize("tool", range(4))
def test_fcl_shape_holds_everything_within_the_margin(every_shape, tool):
    """A speck anywhere nearer than the margin touches the grown shape."""
    random = np.random.default_rng(tool)
    points = random.uniform(-0.02, 0.02, (6000, 3)) - [0.0, 0.0, 0.01]
    near = points[np.abs(distances(every_shape, tool, points) - 0.5 * MARGIN) < 0.45 * MARGIN]
    # Planes measure too short off a mesh's edges; keep the points beside its faces.
    if every_shape.shapes.kind[tool] == CONVEX:
        hull = trimesh.convex.convex_hull(every_shape.corners[tool])
        foot = trimesh.triangles.closest_point(
            np.repeat(hull.triangles, len(near), axis=0), np.tile(near, (len(hull.triangles), 1))
        ).reshape(len(hull.triangles), len(near), 3)
        near = near[np.linalg.norm(foot - near, axis=2).min(axis=0) < 0.95 * MARGIN]
    assert len(near) > 50
    shift = every_shape.grown_centre[tool]
    body = fcl.CollisionObject(every_shape.grown[tool], fcl.Transform(np.eye(3), shift))
    missed = []
    for point in near:
        speck = fcl.CollisionObject(fcl.Sphere(1e-6), fcl.Transform(point))
        if not fcl.collide(speck, body, fcl.CollisionRequest(), fcl.CollisionResult()):
            missed.append(point)
    assert not missed, f"{len(missed)} of {len(near)} missed"


def test_no_tools_are_a_set_too():
    tools = ToolSet([])
    assert len(tools.shapes.kind) == 0
    assert tools.shapes.size.shape == (0, 2)
    assert tools.shapes.plane.shape == (0, 4)
    np.testing.assert_array_equal(tools.shapes.plane_start, [0])


# refusals --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("tool", "message"),
    [
        (Tool("left", "cube"), "tool 'left': unknown shape 'cube'.*sphere, capsule, gripper, mesh"),
        (Tool("left", radius=0.0), "tool 'left': radius 0 m"),
        (Tool("left", radius=-0.01), "radius -0.01 m"),
        (Tool("left", radius=5.0), "radius 5 m"),
        (Tool("left", radius=float("nan")), "radius nan m"),
        (Tool("left", "capsule", length=-0.1), "tool 'left': length -0.1 m"),
        (Tool("left", "capsule", length=50.0), "length 50 m"),
        (Tool("left", "capsule", length=float("nan")), "length nan m"),
        (Tool("left", "mesh"), "tool 'left': mesh file '' does not exist"),
        (Tool("left", "mesh", mesh="/no/tool.stl"), "mesh file '/no/tool.stl' does not exist"),
    ],
)
def test_bad_tool_is_refused_by_name(tool, message):
    with pytest.raises(UserError, match=message):
        ToolSet([Tool("right"), tool])


def test_mesh_in_millimetres_is_refused_with_the_reason(tmp_path):
    mesh = blade()
    mesh.apply_scale(1000.0)
    with pytest.raises(UserError, match=r"tool 'left': .*30 m long; meshes are in metres"):
        ToolSet([Tool("left", "mesh", mesh=mesh_file(tmp_path, mesh))])


@pytest.mark.parametrize("content", [b"", b"no mesh at all\n", b"\0" * 200])
@pytest.mark.parametrize("name", ["tool.stl", "tool.obj", "tool.xyz"])
def test_file_without_a_mesh_is_refused(tmp_path, content, name):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(UserError, match="tool 'left'.*" + name):
        ToolSet([Tool("left", "mesh", mesh=str(tmp_path / name))])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", ["secret", "secret.txt", "secret.npz"])
def test_file_of_another_format_is_not_even_opened(tmp_path, monkeypatch, name):
    """A bag may name any."""
    (tmp_path / name).write_text("secret")
    monkeypatch.setattr("trimesh.load_mesh", None)
    with pytest.raises(UserError, match="is not a mesh file"):
        ToolSet([Tool("left", "mesh", mesh=str(tmp_path / name))])


def test_flat_mesh_is_refused_in_one_line(tmp_path):
    flat = trimesh.Trimesh([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0], [0.01, 0.01, 0]], [[0, 1, 2], [1, 3, 2]])
    with pytest.raises(UserError, match=r"tool 'left'.*flat; give it a thickness"):
        ToolSet([Tool("left", "mesh", mesh=mesh_file(tmp_path, flat))])


def test_mesh_with_too_many_faces_is_refused_by_name(tmp_path):
    fine = trimesh.creation.icosphere(3, 0.01)
    with pytest.raises(UserError, match=f"left.*{MAX_PLANES}"):
        ToolSet([Tool("left", "mesh", mesh=mesh_file(tmp_path, fine))])


def test_open_mesh_that_is_not_convex_is_refused_with_the_remedy(tmp_path):
    notched = trimesh.util.concatenate([blade(), blade().apply_translation([0.02, 0.0, 0.0])])
    notched.update_faces(np.arange(len(notched.faces)) > 0)
    with pytest.raises(UserError, match=r"tool 'left'.*neither convex nor closed; close its holes"):
        ToolSet([Tool("left", "mesh", mesh=mesh_file(tmp_path, notched))])


def test_gripper_has_two_bodies_and_other_tools_one():
    tools = ToolSet([Tool("left"), Tool("right", "gripper", radius=0.002, length=0.03), Tool("third", "capsule")])
    assert tools.bodies == [[0], [1, 2], [3]]
    np.testing.assert_array_equal(tools.shapes.tool, [0, 1, 1, 2])
    np.testing.assert_array_equal(tools.shapes.kind, [SPHERE, CAPSULE, CAPSULE, CAPSULE])
