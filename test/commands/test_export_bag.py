"""`tissue_sim export` of a bag: frames read back in other programs' readers as the replay shows them."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
import trimesh

from helpers.paths import ROOT
from tissue_sim.cli import main
from tissue_sim.contact.tools import Tool, ToolSet
from tissue_sim.organ.meshes.mesh_input import read_mesh
from tissue_sim.ros.bags import frames
from tissue_sim.ros.bags.reading import read_bag

POKE = ROOT / "bags" / "poke"


@pytest.fixture(scope="module")
def poke():
    return read_bag(POKE)


@pytest.fixture(scope="module")
def shown(poke):
    return frames.frames_of(poke, 400)


def test_frames_are_the_replay_at_their_ticks(poke, shown):
    assert [frame.tick for frame in shown] == [400, 800, 1200, 1600]
    assert [frame.time for frame in shown] == pytest.approx([0.4, 0.8, 1.2, 1.6])
    surfaces = poke["small kidney/surface"]
    for frame in frames.frames_of(poke, int(surfaces.ticks[4])):  # the bag shows this very tick
        recorded = surfaces.values[surfaces.ticks == frame.tick]
        if len(recorded):
            np.testing.assert_allclose(frame.parts[0].positions, recorded[0], atol=1e-6)
            break
    else:
        pytest.fail("no tick that the bag shows")


def test_a_tool_stands_where_the_hand_held_it(poke, shown):
    for frame in shown:
        _, tool = frame.parts
        held = poke["left/position"].at([frame.tick])[0]
        np.testing.assert_allclose(np.linalg.norm(tool.positions - held, axis=1), poke.tools[0].radius, rtol=1e-6)
        forces = poke["left/force"]
        newest = forces.values[forces.ticks <= frame.tick][-1]
        np.testing.assert_allclose(tool.data["force_N"][0], newest, atol=0.05)


def test_bodies_have_the_shapes_that_touch():
    tools = ToolSet([Tool("a", "capsule", radius=0.004, length=0.03), Tool("b", "gripper", length=0.05)])
    capsule = frames._mesh(tools, 0)
    np.testing.assert_allclose(capsule.bounds, [[-0.004, -0.004, -0.034], [0.004, 0.004, 0.004]], atol=5e-5)  # facets
    assert len(tools.bodies[1]) == 2


def test_paraview_files_have_times_and_units(poke, shown, tmp_path, capsys):
    meshio = pytest.importorskip("meshio")
    assert main(["export", str(POKE), str(tmp_path / "poke.pvd"), "--every", "400", "--unit", "mm"]) == 0
    assert "4 frames, every 400 ticks, 0.400 to 1.600 s, mm" in capsys.readouterr().out
    entries = list(ElementTree.parse(tmp_path / "poke.pvd").iter("DataSet"))
    assert [float(entry.get("timestep")) for entry in entries] == [0.4, 0.4, 0.8, 0.8, 1.2, 1.2, 1.6, 1.6]
    assert [entry.get("part") for entry in entries] == ["0", "1"] * 4
    mesh = meshio.read(tmp_path / entries[4].get("file"))
    organ = shown[2].parts[0]
    np.testing.assert_array_equal(mesh.cells_dict["triangle"], organ.triangles)
    np.testing.assert_allclose(mesh.points, 1e3 * organ.positions)
    np.testing.assert_allclose(mesh.point_data["displacement_m"], 1e3 * organ.data["displacement_m"])
    tool = meshio.read(tmp_path / entries[5].get("file"))
    np.testing.assert_allclose(tool.point_data["force_N"][0], shown[2].parts[1].data["force_N"][0])


def test_blender_files_are_turned_to_gltf_and_know_their_time(shown, tmp_path, capsys):
    assert main(["export", str(POKE), str(tmp_path / "poke.glb"), "--every", "400"]) == 0
    assert "poke_0000.glb to poke_0003.glb: 4 frames" in capsys.readouterr().out
    scene = trimesh.load_scene(tmp_path / "poke_0002.glb")
    assert scene.metadata["tick"] == 1200
    assert scene.metadata["time_s"] == pytest.approx(1.2)
    assert set(scene.geometry) == {"small kidney", "left"}
    low, high = shown[2].parts[0].positions.min(axis=0), shown[2].parts[0].positions.max(axis=0)
    bounds = scene.geometry["small kidney"].bounds  # y up: the patient's z
    np.testing.assert_allclose(bounds[:, 1], [low[2], high[2]], atol=1e-6)
    again = read_mesh(tmp_path / "poke_0002.glb", part="small kidney")
    np.testing.assert_allclose(again.positions.min(axis=0), low, atol=1e-6)


def test_frames_of_an_earlier_export_are_not_taken_for_new_ones(shown, tmp_path, capsys):
    (tmp_path / "poke_0007.glb").touch()
    assert main(["export", str(POKE), str(tmp_path / "poke.glb"), "--every", "400"]) == 2
    assert "poke_0007.glb is a frame of an earlier export" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([POKE, "out.vtk"], "out.vtk: no format for the frames of a bag; let its name end in .pvd or .glb"),
        ([POKE, "nowhere/out.pvd"], "folder nowhere for nowhere/out.pvd does not exist; make it first"),
        ([POKE, "out.glb", "--unit", "mm"], "out.glb: GLB is in metres; leave out --unit mm"),
        ([POKE, "out.pvd", "--every", "0"], "--every 0 is less than 1 tick"),
        ([POKE, "out.pvd", "--every", "5000"], "too few for one frame in 5000"),
        ([POKE, "out.pvd", "--cells", "a.vtu"], "--cells belongs to an organ file, and"),
        ([ROOT / "docs", "out.pvd"], "docs"),
        ([ROOT / "config/organs/kidney.npz", "out.ply", "--every", "5"], "--every belongs to a bag, which"),
    ],
)
def test_what_cannot_be_written_is_refused_in_one_line(arguments, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["export", *map(str, arguments)]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())
