"""The public names of tissue_sim: loaded when they are used, readable, and strict with what they take."""

import ast
import subprocess
import sys
import warnings

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import tissue_sim
from helpers.paths import ROOT
from helpers.scenes import RADIUS, ball, ball_of_cells
from tissue_sim import Attachment, Organ, Scene, Simulation, Tool, UserError, build, calibrate, load_scene, placed
from tissue_sim.organ.build import BuildOptions
from tissue_sim.organ.pipeline import Request

PUBLIC = ("Organ", "Simulation", "Scene", "Tool", "load_scene", "build", "calibrate", "read_bag")


def loaded_by(code: str) -> set[str]:
    """Modules that a fresh interpreter loads for some code, beside those that it has anyway."""
    whole = f"import sys; before = set(sys.modules)\n{code}\nprint(*sorted(set(sys.modules) - before))"
    run = subprocess.run([sys.executable, "-c", whole], cwd=ROOT, capture_output=True, text=True, check=True)
    return set(run.stdout.split())


def test_the_package_alone_loads_next_to_nothing():
    """Half a second is NumPy's and Numba's, so it is these that must not come, whatever a machine's speed."""
    loaded = loaded_by("import tissue_sim")
    assert "tissue_sim" in loaded
    assert len(loaded) < 12
    assert "numpy" not in loaded


def test_a_name_loads_what_it_needs_and_no_more():
    loaded = loaded_by("from tissue_sim import UserError")
    assert "tissue_sim.errors" in loaded
    assert not loaded & {"numpy", "numba", "scipy"}


def test_every_public_name_is_there_and_listed():
    assert set(PUBLIC) <= set(tissue_sim.__all__)
    assert set(tissue_sim.__all__) <= set(dir(tissue_sim))
    for name in tissue_sim.__all__:
        assert getattr(tissue_sim, name).__name__ == name
    with pytest.raises(AttributeError, match="module 'tissue_sim' has no attribute 'organs'"):
        tissue_sim.organs  # noqa: B018


def test_type_checkers_see_the_same_names():
    tree = ast.parse((ROOT / "tissue_sim" / "__init__.py").read_text())
    checked = next(node for node in tree.body if isinstance(node, ast.If) and node.test.id == "TYPE_CHECKING")
    seen = {alias.name: node.module for node in checked.body for alias in node.names}
    assert seen == tissue_sim._MODULES
    assert sorted(seen) == sorted(tissue_sim.__all__)
    assert (ROOT / "tissue_sim" / "py.typed").is_file()


# what is printed ----------------------------------------------------------------------------------


def test_objects_print_as_a_person_would_say_them():
    organ = ball(2)
    assert repr(organ).startswith("<Organ 'ball': ")
    assert "162 surface nodes, 320 triangles, 5 medial and 0 interior atoms" in repr(organ)
    assert "springs" in repr(organ)
    assert "cells" in repr(ball_of_cells())
    scene = Scene(organ, [Tool("left", "capsule")])
    scene.step(12)
    assert repr(scene) == "<Scene of ball; left (capsule); 1000 Hz, 0.012 s>"
    assert repr(scene.simulation) == "<Simulation of 'ball': hybrid, 1000 Hz, 0.012 s, asleep>"


# surfaces -----------------------------------------------------------------------------------------


def test_normals_of_a_ball_point_away_from_its_middle():
    organ = ball(3)
    for normals in (organ.surface_normals, Simulation(organ).surface_normals, Scene(organ, []).surface_normals()):
        np.testing.assert_allclose(normals, organ.surface_positions / RADIUS, atol=0.02)


def test_normals_turn_with_the_surface():
    simulation = Simulation(ball(2))
    turn = Rotation.from_euler("xyz", [0.1, 0.2, 0.3])
    nodes = np.arange(simulation.organ.n_surface)
    simulation.prescribe(nodes, turn.apply(simulation.surface_positions))
    simulation.step(2)
    np.testing.assert_allclose(simulation.surface_normals, turn.apply(simulation.organ.surface_normals), atol=1e-6)


def test_organs_of_a_scene_have_names_and_places(tmp_path):
    ball(1).save(tmp_path / "ball.npz")
    organs = ["{name: liver, file: ball.npz}", "{name: spleen, file: ball.npz, position: [0.1, 0.0, 0.0]}"]
    (tmp_path / "two.yaml").write_text(f"format: 1\norgans: [{', '.join(organs)}]\n")
    scene = load_scene(tmp_path / "two.yaml", [Tool("left")])
    assert scene.names == ["liver", "spleen"]
    np.testing.assert_allclose(scene.surface_positions("spleen"), ball(1).surface_positions + [0.1, 0.0, 0.0])
    np.testing.assert_array_equal(scene.surface_positions("spleen"), scene.surface_positions(-1))
    with pytest.raises(UserError, match=r"^no organ 'splen'; did you mean 'spleen'\?$"):
        scene.surface_normals("splen")


# tools --------------------------------------------------------------------------------------------


def test_a_tool_is_the_same_by_name_and_by_number():
    organ, forces = ball(2), []
    for tool in ("right", 1, -1):
        scene = Scene(organ, [Tool("left", radius=0.004), Tool("right", radius=0.006)])
        for tick in range(60):
            scene.move(tool, [0.0, 0.0, RADIUS + 0.007 - 1e-4 * tick])
            scene.push("left", [0.0, 0.0, 0.0])
            scene.step()
        forces.append(scene.wrench(tool))
        np.testing.assert_array_equal(scene.wrenches[1], forces[-1])
    assert forces[0][2] > 0.01
    assert np.all(forces[0] == forces)


def test_what_a_scene_hands_out_is_not_changed_by_the_next_tick():
    scene = Scene(ball(2), [Tool("left")])
    scene.move("left", [0.0, 0.0, RADIUS + 0.004])
    scene.step(3)
    wrench, surface = scene.wrench("left"), scene.surface_positions()
    kept = wrench.copy(), surface.copy()
    scene.move("left", [0.0, 0.0, RADIUS])
    scene.step(20)
    np.testing.assert_array_equal(wrench, kept[0])
    np.testing.assert_array_equal(surface, kept[1])
    assert np.any(scene.surface_positions() != surface)


NAN = float("nan")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda scene: scene.move("lft", [0, 0, 0]), "no tool 'lft'; did you mean 'left'?"),
        (lambda scene: scene.move(2, [0, 0, 0]), "no tool 2; choose one of left, right"),
        (lambda scene: scene.wrench("needle"), "no tool 'needle'; choose one of left, right"),
        (lambda scene: scene.push(-3, [0, 0, 0]), "no tool -3; choose one of left, right"),
        (
            lambda scene: scene.move("left", [0, NAN, 0]),
            "the position of tool 'left' is [0, nan, 0]; expected: 3 finite numbers",
        ),
        (lambda scene: scene.move(0, [1, 2]), "the position of tool 'left' is [1, 2]; expected: 3 finite numbers"),
        (lambda scene: scene.move(0, "top"), "the position of tool 'left' is 'top'; expected: 3 finite numbers"),
        (
            lambda scene: scene.move("right", [0, 0, 0], [0, 0, 0, 2]),
            "the quaternion of tool 'right', [0.0, 0.0, 0.0, 2.0], is not of length 1",
        ),
        (
            lambda scene: scene.move("right", [0, 0, 0], angle=NAN),
            "the angle of tool 'right' is [nan]; expected: a finite number",
        ),
        (
            lambda scene: scene.push("left", [np.inf, 0, 0]),
            "the force of tool 'left' is [inf, 0, 0]; expected: 3 finite numbers",
        ),
        (lambda scene: scene.surface_positions(1), "no organ 1; choose ball"),
        (lambda scene: scene.simulation.apply_force([0], [[0, NAN, 0]]), "forces must be finite"),
        (lambda _: Scene([], []), "a scene needs at least one organ"),
        (lambda _: Scene(ball(), [], stiffness=[NAN]), "stiffness is [nan]; expected: a finite number"),
        (lambda _: Scene(ball(), [], stiffness=[0.0]), "stiffness is [0.0]; expected: factors greater than 0"),
        (
            lambda _: Scene(ball(), [Tool("left"), Tool("left")]),
            "two tools are called 'left'; give each a name of its own",
        ),
        (lambda _: Scene(ball(), [Tool("left", radius=NAN)]), "tool 'left': radius nan m is outside 0.0005..0.5"),
        (
            lambda _: Organ.shipped("lung"),
            "organ 'lung' is not part of this installation; make one with 'tissue_sim build'",
        ),
        (lambda _: load_scene("nowhere.yaml"), "scene nowhere.yaml can't be read: No such file or directory"),
    ],
)
def test_what_a_scene_refuses_it_says_in_one_line(call, message):
    scene = Scene(ball(), [Tool("left"), Tool("right")])
    with pytest.raises(UserError) as refused:
        call(scene)
    assert str(refused.value) == message


def test_a_refused_pose_leaves_no_trace():
    scenes = [Scene(ball(2), [Tool("left")]) for _ in range(2)]
    with pytest.raises(UserError):
        scenes[0].move("left", [0.0, 0.0, NAN])
    for scene in scenes:
        scene.move("left", [0.0, 0.0, RADIUS])
        scene.step(10)
    np.testing.assert_array_equal(*(scene.surface_positions() for scene in scenes))


def test_a_scene_of_the_public_names_alone():
    organ = ball(2)
    pair = [organ, placed(organ, [2.0 * RADIUS + 0.002, 0.0, 0.0])]
    scene = Scene(pair, [Tool("left")], attachments=[Attachment((0, 1), 100.0, within=0.01)], rate=500.0)
    scene.step(5)
    assert scene.time == 0.01


# building and calibrating ---------------------------------------------------------------------------


def egg() -> trimesh.Trimesh:
    """A closed surface of 162 points, 20 x 24 x 40 mm from its middle, in m."""
    mesh = trimesh.creation.icosphere(2, 1.0)
    mesh.apply_scale([0.020, 0.024, 0.040])
    return mesh


@pytest.fixture(scope="module")
def built():
    """The egg with its own points, from arrays that are inside out; and what was warned of."""
    mesh = egg()
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always", UserWarning)
        organ = build((mesh.vertices, mesh.faces[:, ::-1]), name="egg", keep_points=True, atoms=8, fixed=np.arange(10))
    return organ, [str(one.message) for one in warned]


def test_a_surface_is_built_from_arrays_and_repairs_are_warned_of(built):
    organ, warned = built
    np.testing.assert_allclose(organ.surface_positions, egg().vertices)
    assert organ.volume > 0.0
    assert any("flipped inward triangles" in line for line in warned)
    assert organ.name == "egg"
    assert organ.fixed.tolist() == list(range(10))
    assert organ.provenance["fixed"] == "10 nodes"


def test_arrays_a_mesh_and_a_file_are_the_same_surface(tmp_path, monkeypatch):
    handed = []
    monkeypatch.setattr("tissue_sim.organ.build.organ_from_mesh", lambda *given, **_: handed.append(given))
    egg().apply_scale(1e3).export(tmp_path / "egg.off", digits=17)
    build(tmp_path / "egg.off", unit="mm", points=300)
    build(egg(), points=300)
    build([egg().vertices, egg().faces], points=300)
    build(egg(), points=300, organ="liver")
    for mesh, request, keep_points in handed:
        np.testing.assert_allclose(mesh.positions, egg().vertices, atol=1e-9)
        np.testing.assert_array_equal(mesh.triangles, egg().faces)
        assert request.points == 300
        assert not keep_points
    assert [request.name for _, request, _ in handed] == ["egg", "organ", "organ", "liver"]
    assert [request.provenance["source"] for _, request, _ in handed] == ["egg.off", "arrays", "arrays", "arrays"]


def test_a_mask_is_built_from_voxels():
    pytest.importorskip("SimpleITK")
    steps = np.array([2.0, 2.5, 3.0])  # mm
    x, y, z = np.indices((24, 24, 32)) * steps[:, None, None, None]
    inside = ((x - 23) / 18) ** 2 + ((y - 28) / 20) ** 2 + ((z - 46) / 35) ** 2 < 1
    labels = np.where(inside, 3, 0)
    labels[0, 0, 0] = 5
    organ = build(labels, spacing=steps, label=3, points=120, atoms=8)
    assert organ.volume == pytest.approx(4.0 / 3.0 * np.pi * 18 * 20 * 35 * 1e-9, rel=0.05)
    np.testing.assert_allclose(1e3 * organ.surface_positions.mean(axis=0), [23, 28, 46], atol=1.5)
    with pytest.raises(UserError, match="the mask holds 2 values other than 0; choose one with label"):
        build(labels, spacing=steps)
    with pytest.raises(UserError, match="voxels need a spacing"):
        build(labels, label=3)


@pytest.mark.parametrize(
    ("source", "options", "message"),
    [
        ("nowhere.stl", {"unit": "mm"}, "surface nowhere.stl does not exist"),
        ("nowhere.nii.gz", {}, "mask nowhere.nii.gz does not exist"),
        ("nowhere.nii.gz", {"seed": (1, 2, 3)}, "image nowhere.nii.gz does not exist"),
        ("a.stl", {"seed": (1, 2, 3)}, "seed does not belong to a surface, which a.stl is taken for"),
        ("a.nrrd", {"unit": "mm"}, "unit does not belong to a mask, which a.nrrd is taken for"),
        (3.0, {}, "nothing can be built from a float; give a file, a mesh"),
        ((np.full((4, 3), NAN), [[0, 1, 2]]), {}, "points that are not finite"),
        ((np.zeros((4, 2)), [[0, 1, 2]]), {}, r"positions has shape \(4, 2\); expected: numbers \(n, 3\)"),
        ((np.zeros((4, 3)), [[0.5, 1, 2]]), {}, "triangles must be whole numbers"),
        ((np.eye(4, 3), [[0, 1, 7]]), {}, "a triangle names a point that doesn't exist"),
        ((np.eye(4, 3), [[0, 1, 2]]), {"unit": "miles"}, "unit miles is unknown"),
    ],
)
def test_what_build_refuses_it_says_in_one_line(source, options, message):
    with pytest.raises(UserError, match=message) as refused:
        build(source, **options)
    assert "\n" not in str(refused.value)
    assert "--" not in str(refused.value), "the command line's word"


def test_options_that_do_not_exist_are_named():
    with pytest.raises(TypeError, match=r"build\(\) got an unexpected keyword argument 'pints'"):
        build("a.stl", pints=100)
    with pytest.raises(TypeError, match=r"calibrate\(\) got an unexpected keyword argument 'case'"):
        calibrate(ball(), case=100)
    fields = set(Request.__annotations__) - {"provenance", "interior_atoms", "inclusions"}
    assert fields < set(BuildOptions.__annotations__)


@pytest.mark.parametrize(
    ("organ", "options", "message"),
    [
        ("nowhere.npz", {}, "organ file nowhere.npz does not exist"),
        (ball(), {"cases": 2}, r"^cases 2 is outside 8\.\.10000$"),
        (ball(), {"aim": "speed"}, "unknown aim 'speed'; choose one of fast, balanced, accurate"),
        (ball(), {"interior": -1}, "interior -1 is negative"),
    ],
)
def test_what_calibrate_refuses_it_says_in_one_line(organ, options, message):
    with pytest.raises(UserError, match=message):
        calibrate(organ, **options)


@pytest.mark.extended
def test_a_calibrated_organ_has_cells_and_its_figures():
    pytest.importorskip("netgen")
    before = build(egg(), keep_points=True, atoms=8, fixed="z<0.2")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # few points, to be quick
        organ = calibrate(before, aim="fast", cases=60, evaluations=5, smooth=3, sharp=1)
    assert len(organ.cell_nodes)
    assert not len(before.cell_nodes)
    assert organ.provenance["calibration"]["held_out"]["smooth"]["cases"] == 3
