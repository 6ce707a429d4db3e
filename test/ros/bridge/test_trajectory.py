"""The scripted path: smooth, outside when it should be, as deep as it says, jaws that face each other."""

import numpy as np
import pytest
import trimesh

from helpers.ros.clearance import clearance
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.ros.bridge.contact_locations import Surface
from tissue_sim.ros.bridge.motion import FAST, Ball, minimum_jerk
from tissue_sim.ros.bridge.trajectory import HOVER, POKE_DEPTH, SQUEEZE, STROKE_DEPTH, plan

RADIUS = 0.005
RATE = 500.0


def kidney():
    organ = Organ.load(shipped_organ())
    return organ.surface_positions, organ.surface_triangles


def ball(radius=0.04):
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def box():
    mesh = trimesh.creation.box((0.05, 0.04, 0.08))
    return np.asarray(mesh.vertices) + 0.3, np.asarray(mesh.faces)


@pytest.fixture(scope="module", params=[kidney, ball, box], ids=["kidney", "ball", "box"])
def planned(request):
    organ = request.param()
    return plan(Surface(*organ, RADIUS), rate=RATE), organ


def test_the_path_is_smooth_and_closed(planned):
    path, _ = planned
    poses = path.poses
    steps = np.linalg.norm(np.diff(poses[:, :, :3], axis=0, append=poses[:1, :, :3]), axis=2)
    assert steps.max() * RATE < 1.01 * FAST
    # Peak acceleration of a minimum-jerk move of length s and peak speed v is 5.77 s / T^2, bounded here by T >= 0.1 s.
    velocity = np.diff(poses[:, :, :3], axis=0) * RATE
    assert np.abs(np.diff(velocity, axis=0)).max() * RATE < 5.0
    assert np.allclose(np.linalg.norm(poses[:, :, 3:], axis=2), 1.0)
    turns = np.abs(np.einsum("ijk,ijk->ij", poses[1:, :, 3:], poses[:-1, :, 3:]))
    assert turns.min() > np.cos(0.5 * 2.6 / RATE)


def test_it_has_all_phases_in_order_in_about_a_quarter_of_a_minute(planned):
    path, _ = planned
    names = list(dict.fromkeys(path.phases[1:]))
    expected = [
        *("stroke/approach", "stroke/press", "stroke/draw", "stroke/lift", "stroke/retreat"),
        *("poke/approach", "poke/press", "poke/hold", "poke/release", "poke/retreat"),
        *("nip/approach", "nip/close", "nip/lift", "nip/hold", "nip/lower", "nip/open", "nip/retreat"),
        *("return", "pause"),
    ]
    assert names == expected
    assert 8.0 < path.duration < 20.0


def test_tools_are_outside_but_when_they_work(planned):
    path, organ = planned
    poses = path.poses
    for name, tools in zip(path.phases[::20], poses[::20], strict=True):
        action, _, step = name.partition("/")
        for tool, pose in enumerate(tools):
            works = action == "nip" or (tool == 0 and action in ("stroke", "poke"))
            if works and step not in ("approach", "retreat"):
                continue
            assert clearance(*organ, pose[:3]) > RADIUS + 1e-4, name


def test_the_stroke_keeps_its_depth(planned):
    path, organ = planned
    poses = path.poses
    drawn = poses[path.phases == "stroke/draw", 0, :3]
    depth = RADIUS - clearance(*organ, drawn[::10])
    assert np.abs(depth - STROKE_DEPTH).max() < 3e-4
    assert np.linalg.norm(drawn[-1] - drawn[0]) > 0.018


def test_the_poke_is_as_deep_as_it_says(planned):
    path, organ = planned
    poses, names = path.poses, path.phases
    held = poses[names == "poke/hold", 0, :3][0]
    hover = poses[names == "poke/press", 0, :3][0]
    assert np.linalg.norm(held - hover) == pytest.approx(POKE_DEPTH + HOVER, abs=1e-5)
    assert clearance(*organ, hover)[0] - RADIUS == pytest.approx(HOVER, abs=1e-3)


def test_jaws_face_each_other_and_squeeze(planned):
    path, organ = planned
    poses, names = path.poses, path.phases
    open_, closed = poses[names == "nip/close", :, :3][[0, -1]]
    across = (open_[1] - open_[0]) / np.linalg.norm(open_[1] - open_[0])
    closings = closed - open_
    assert np.linalg.norm(closings, axis=1) == pytest.approx(SQUEEZE + HOVER, abs=1e-4)
    assert closings[0] @ across > 0.95 * np.linalg.norm(closings[0])
    assert closings[1] @ -across > 0.95 * np.linalg.norm(closings[1])
    height = organ[0][:, 2]
    assert open_[:, 2].mean() > height.min() + 0.5 * np.ptp(height)
    lifted = poses[names == "nip/hold", :, :3][0]
    assert np.linalg.norm(lifted - closed, axis=1) == pytest.approx(0.01, abs=1e-4)
    assert (lifted - closed)[:, 2].min() > 0.0


@pytest.mark.extended
def test_the_nip_lifts_the_kidney():
    """Tick by tick, without a node: what is between the jaws comes along, and they still hold it at the end."""
    organ = Organ.load(shipped_organ())
    path = plan(Surface(*kidney(), RADIUS), script=("nip",), rate=1000.0)
    scene = Scene(organ, [Tool("left", radius=RADIUS), Tool("right", radius=RADIUS)], ticks_a_set=4)
    begin, end = (np.flatnonzero(path.phases == name)[index] for name, index in (("nip/close", 0), ("nip/hold", -1)))
    for poses in path.poses[begin:end]:
        for tool, pose in enumerate(poses):
            scene.move(tool, pose[:3], pose[3:])
        scene.step()
    lift = path.poses[end, 0, :3] - path.poses[path.phases == "nip/lift", 0, :3][0]
    moved = (scene.simulation.positions[: organ.n_surface] - organ.surface_positions) @ lift / np.linalg.norm(lift)
    assert np.sort(moved)[-8:].mean() > 0.0035
    assert np.linalg.norm(scene.wrenches[:, :3], axis=1).min() > 0.2, "N"


@pytest.mark.parametrize("fraction", [0.0, 0.17, 0.3, 0.45, 0.68, 0.75, 0.99])
def test_a_retreat_from_anywhere_ends_outside_without_a_jump(planned, fraction):
    path, organ = planned
    index = int(fraction * len(path.poses))
    out = path.retreat(index).poses
    steps = np.linalg.norm(np.diff(out[:, :, :3], axis=0, prepend=path.poses[None, index, :, :3]), axis=2)
    assert steps.max() < 1.01 * FAST / RATE
    assert clearance(*organ, out[-1, :, :3]).min() > RADIUS


def test_the_same_organ_gives_the_same_path():
    vertices, triangles = kidney()
    first, second = (plan(Surface(vertices, triangles, RADIUS)).poses for _ in range(2))
    assert np.array_equal(first, second)


def test_one_tool_can_stroke_and_poke():
    path = plan(Surface(*ball(), RADIUS), tools=("probe",), script=("poke", "stroke"))
    assert path.poses.shape[1:] == (1, 7)
    assert path.phases[1] == "poke/approach"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"tools": ("left",)}, "two tools"),
        ({"script": ("stroke", "cut")}, "'cut'"),
        ({"script": ()}, "empty"),
        ({"tools": ("left", "left")}, "each once"),
    ],
)
def test_what_cannot_be_planned_is_said(given, message):
    with pytest.raises(UserError, match=message):
        plan(Surface(*ball(), RADIUS), **given)


def test_a_move_has_no_speed_at_its_ends():
    ends = np.array([0.0, 1e-3, 1.0 - 1e-3, 1.0])
    assert minimum_jerk(ends) == pytest.approx([0.0, 0.0, 1.0, 1.0], abs=2e-8)
    assert minimum_jerk(np.array([0.5])) == pytest.approx([0.5])
    nearly = minimum_jerk(1.0 - np.logspace(-17, -4, 10_001))
    assert nearly.max() == 1.0, "no rotation goes further than its end"


def test_an_arc_keeps_its_distance_also_to_the_opposite_point():
    centre, start = np.array([0.1, 0.2, 0.3]), np.array([0.1, 0.2, 0.4])
    points = Ball(centre, 0.1).arc(start, 2.0 * centre - start)
    assert np.linalg.norm(points - centre, axis=1) == pytest.approx(0.1, abs=1e-6)
    assert np.allclose(points[[0, -1]], [start, 2.0 * centre - start])


def test_touching_a_box():
    surface, above, down = Surface(*box(), RADIUS), np.array([0.3, 0.301, 0.5]), np.array([0.0, 0.0, -1.0])
    touch = surface.touch(above, down)
    assert touch.place == pytest.approx([0.3, 0.301, 0.345], abs=1e-5)
    assert surface.touch(above, down, 0.002).place == pytest.approx([0.3, 0.301, 0.343], abs=1e-5)
    assert surface.normal(touch) == pytest.approx([0.0, 0.0, 1.0], abs=1e-6)
    assert surface.touch(np.array([0.36, 0.301, 0.5]), down) is None
