"""Meshes: units, winding, holes, parts, and what is refused."""

import numpy as np
import pytest
import trimesh

from tissue_sim.errors import UserError
from tissue_sim.organ.mesh_input import read_mesh, voxelize
from tissue_sim.organ.organ import signed_volume


@pytest.fixture
def egg():
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=20.0)
    mesh.apply_scale([1.0, 0.8, 1.6])
    return mesh


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "off"])
@pytest.mark.parametrize(("unit", "scale"), [("mm", 1e-3), ("m", 1.0)])
def test_units_and_formats(tmp_path, egg, suffix, unit, scale):
    path = tmp_path / f"egg.{suffix}"
    egg.export(path)
    surface = read_mesh(path, unit)
    assert surface.triangles.shape == (1280, 3)
    assert signed_volume(surface.positions, surface.triangles) == pytest.approx(egg.volume * scale**3, rel=1e-4)


def test_points_keep_their_order(tmp_path, egg):
    shuffled = np.random.default_rng(4).permutation(len(egg.vertices))
    rank = np.argsort(shuffled)
    path = tmp_path / "egg.ply"
    trimesh.Trimesh(egg.vertices[shuffled], rank[egg.faces], process=False).export(path)
    surface = read_mesh(path, "mm")
    np.testing.assert_allclose(surface.positions * 1e3, egg.vertices[shuffled], rtol=1e-6)
    assert surface.repairs == ()


def test_gltf_is_in_metres(tmp_path, egg):
    path = tmp_path / "egg.glb"
    egg.apply_scale(1e-3).export(path)
    assert np.ptp(read_mesh(path).positions[:, 2]) == pytest.approx(0.064, rel=1e-3)


def test_the_unit_must_be_known(tmp_path, egg):
    path = tmp_path / "egg.stl"
    egg.export(path)
    with pytest.raises(UserError, match=r"STL doesn't say its length unit; give --unit mm or --unit m"):
        read_mesh(path)


def test_an_open_surface_is_refused_with_its_open_edges(tmp_path, egg):
    keep = np.ones(len(egg.faces), dtype=bool)
    keep[0] = False
    egg.update_faces(keep)
    path = tmp_path / "open.obj"
    egg.export(path)
    with pytest.raises(UserError, match=r"open\.obj is open \(3 open edges\)"):
        read_mesh(path, "mm")


def test_inward_and_mixed_winding_are_repaired_and_told(tmp_path, egg):
    inward = tmp_path / "inward.ply"
    trimesh.Trimesh(egg.vertices, egg.faces[:, ::-1], process=False).export(inward)
    surface = read_mesh(inward, "mm")
    assert surface.repairs == ("turned inward triangles outward",)
    assert signed_volume(surface.positions, surface.triangles) > 0
    mixed = tmp_path / "mixed.ply"
    faces = egg.faces.copy()
    faces[::3] = faces[::3, ::-1]
    trimesh.Trimesh(egg.vertices, faces, process=False).export(mixed)
    surface = read_mesh(mixed, "mm")
    assert "made the winding consistent" in surface.repairs
    assert signed_volume(surface.positions, surface.triangles) == pytest.approx(egg.volume * 1e-9, rel=1e-6)


def test_other_refusals(tmp_path, egg):
    two = tmp_path / "two.ply"
    trimesh.util.concatenate([egg, egg.copy().apply_translation([100.0, 0.0, 0.0])]).export(two)
    garbage = tmp_path / "garbage.ply"
    garbage.write_bytes(b"ply\nnot really")
    unknown = tmp_path / "mesh.step"
    unknown.write_text("x")
    empty = tmp_path / "empty.obj"
    empty.write_text("v 0 0 0\n")
    fan = tmp_path / "fan.off"
    fan.write_text("OFF\n5 3 0\n0 0 0\n0 0 1\n1 0 0\n0 1 0\n-1 0 0\n3 0 1 2\n3 0 1 3\n3 0 1 4\n")
    for path, reason in {
        two: "2 separate parts",
        garbage: "can't be read",
        unknown: "no known mesh format",
        empty: "no triangles|can't be read",
        fan: "open",
        tmp_path / "none.stl": "does not exist",
    }.items():
        with pytest.raises(UserError, match=reason) as caught:
            read_mesh(path, "mm")
        assert path.name in str(caught.value)
        assert "\n" not in str(caught.value)


def test_voxels_have_the_solids_volume(tmp_path, egg):
    path = tmp_path / "egg.ply"
    egg.export(path)
    mask = voxelize(read_mesh(path, "mm"), "egg")
    assert mask.array.sum() * mask.voxel_volume == pytest.approx(egg.volume * 1e-3, rel=0.01)
    inside = mask.to_points(np.argwhere(mask.array)[:, ::-1])
    np.testing.assert_allclose(inside.mean(axis=0), 0.0, atol=0.3)


def test_a_thin_shell_is_refused(tmp_path, egg):
    inner = egg.copy().apply_scale(0.995)
    inner.invert()
    tube = trimesh.util.concatenate([egg, inner])  # two parts to trimesh, so join them by a slot
    path = tmp_path / "shell.ply"
    tube.export(path)
    with pytest.raises(UserError, match="separate parts"):
        read_mesh(path, "mm")
    from tissue_sim.organ.mesh_input import SurfaceMesh

    thin = trimesh.creation.box([60.0, 60.0, 0.3])
    surface = SurfaceMesh(np.array(thin.vertices) * 1e-3, np.array(thin.faces, dtype=np.int32), ())
    with pytest.raises(UserError, match="too thin"):
        voxelize(surface, "sheet")
