"""`tissue_sim export`: what is written reads back as the organ, in other programs' readers."""

import numpy as np
import pytest
import trimesh

from helpers.vtk_file import read_vtk
from tissue_sim.cli import main
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.reporting.exchange import bones
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.organ.surface_checks import signed_volume

KIDNEY, AS_BUILT = str(shipped_organ("kidney")), str(shipped_organ("kidney_as_built"))
UNITS = pytest.mark.parametrize(("unit", "scale"), [("m", 1.0), ("mm", 1e3)])


@pytest.fixture(scope="module")
def kidney():
    return Organ.load(KIDNEY)


def export(capsys, *arguments):
    code = main(["export", KIDNEY, *map(str, arguments)])
    captured = capsys.readouterr()
    assert code == 0, captured.err
    return captured.out


@UNITS
@pytest.mark.parametrize(("suffix", "precision"), [("obj", 1e-9), ("ply", 1e-7), ("stl", 1e-7)])
def test_surfaces_read_back(kidney, tmp_path, capsys, suffix, precision, unit, scale):
    path = tmp_path / f"kidney.{suffix}"
    text = export(capsys, path, "--unit", unit)
    assert f"994 points, 1984 triangles, {unit}" in text
    mesh = trimesh.load(path, process=False, maintain_order=True)
    wanted = kidney.surface_positions * scale
    largest = np.abs(wanted).max()
    if suffix == "stl":  # triangles only: corner by corner
        np.testing.assert_allclose(mesh.triangles, wanted[kidney.surface_triangles], atol=precision * largest)
    else:
        np.testing.assert_array_equal(mesh.faces, kidney.surface_triangles)
        np.testing.assert_allclose(mesh.vertices, wanted, rtol=0, atol=precision * largest)
    assert mesh.volume == pytest.approx(kidney.volume * scale**3, rel=1e-6)
    head = path.read_bytes()[:400]
    assert {"m": b"positions in metres", "mm": b"positions in millimetres"}[unit] in head


@UNITS
def test_a_vtp_surface_keeps_every_bit_and_the_model(kidney, tmp_path, capsys, unit, scale):
    export(capsys, tmp_path / "kidney.vtp", "--unit", unit)
    found, attributes = read_vtk(tmp_path / "kidney.vtp")
    assert (attributes["NumberOfPoints"], attributes["NumberOfPolys"], attributes["NumberOfLines"]) == (
        *("994", "1984", "0"),
    )
    np.testing.assert_array_equal(found["Points/Points"], kidney.surface_positions * scale)
    np.testing.assert_array_equal(found["Polys/connectivity"].reshape(-1, 3), kidney.surface_triangles)
    np.testing.assert_array_equal(found["Polys/offsets"], 3 * np.arange(1, 1985))
    np.testing.assert_array_equal(found["PointData/mass_kg"], kidney.mass[:994])
    np.testing.assert_array_equal(np.flatnonzero(found["PointData/held"]), kidney.fixed)
    away = kidney.surface_positions[:, None] - kidney.atom_positions[None]
    np.testing.assert_array_equal(found["PointData/nearest_atom"], np.linalg.norm(away, axis=2).argmin(axis=1))
    assert {"m": b"in metres", "mm": b"in millimetres"}[unit] in (tmp_path / "kidney.vtp").read_bytes()


@UNITS
@pytest.mark.parametrize("suffix", ["obj", "ply", "vtp"])
def test_skeletons_read_back(kidney, tmp_path, capsys, suffix, unit, scale):
    path = tmp_path / f"skeleton.{suffix}"
    text = export(capsys, tmp_path / "kidney.stl", "--skeleton", path, "--unit", unit)
    assert f"48 atoms, 47 lines, {unit}" in text
    radius = None
    if suffix == "vtp":
        found, _ = read_vtk(path)
        positions, lines = found["Points/Points"], found["Lines/connectivity"].reshape(-1, 2)
        radius = found[f"PointData/radius_{unit}"]
        np.testing.assert_array_equal(found["PointData/parent"], kidney.atom_parent)
    elif suffix == "obj":
        rows = [line.split() for line in path.read_text().splitlines()]
        positions = np.array([row[1:] for row in rows if row[0] == "v"], dtype=float)
        lines = np.array([row[1:] for row in rows if row[0] == "l"], dtype=int) - 1
    else:
        head, _, body = path.read_text().partition("end_header\n")
        assert "element vertex 48\n" in head
        assert "element edge 47\n" in head
        rows = body.splitlines()
        values = np.array([row.split() for row in rows[:48]], dtype=float)
        positions, radius = values[:, :3], values[:, 3]
        lines = np.array([row.split() for row in rows[48:]], dtype=int)
    np.testing.assert_allclose(positions, kidney.atom_positions * scale, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(lines, bones(kidney))
    if radius is not None:
        np.testing.assert_allclose(radius, kidney.atom_radius * scale, rtol=1e-15)
    assert {"m": b"in metres", "mm": b"in millimetres"}[unit] in path.read_bytes()[:400]


@UNITS
def test_cells_keep_every_bit_and_fill_the_surface(kidney, tmp_path, capsys, unit, scale):
    path = tmp_path / "cells.vtu"
    text = export(capsys, tmp_path / "kidney.stl", "--cells", path, "--unit", unit)
    assert f"{kidney.n_nodes} nodes, {len(kidney.cell_nodes)} cells, {unit}" in text
    found, attributes = read_vtk(path, "UnstructuredGrid")
    assert attributes["NumberOfCells"] == str(len(kidney.cell_nodes))
    positions, cells = found["Points/Points"], found["Cells/connectivity"].reshape(-1, 4)
    np.testing.assert_array_equal(positions, kidney.rest_positions * scale)
    np.testing.assert_array_equal(cells, kidney.cell_nodes)
    np.testing.assert_array_equal(found["Cells/offsets"], 4 * np.arange(1, len(cells) + 1))
    assert set(found["Cells/types"]) == {10}
    np.testing.assert_array_equal(found["CellData/mu_Pa"], kidney.cell_mu)
    np.testing.assert_array_equal(found["CellData/lambda_Pa"], kidney.cell_lambda)
    np.testing.assert_array_equal(np.flatnonzero(found["PointData/held"]), kidney.fixed)
    edges = positions[cells[:, 1:]] - positions[cells[:, :1]]
    assert np.linalg.det(edges).sum() / 6.0 == pytest.approx(kidney.volume * scale**3, rel=0.01)


def test_trimesh_reads_the_obj_skeleton_as_lines(kidney, tmp_path, capsys):
    export(capsys, tmp_path / "kidney.obj", "--skeleton", tmp_path / "skeleton.ply")
    mesh = trimesh.load(tmp_path / "kidney.obj", process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(signed_volume(kidney.surface_positions, kidney.surface_triangles), rel=1e-9)


def test_what_is_exported_builds_again(kidney, tmp_path, capsys):
    export(capsys, tmp_path / "kidney.obj", "--unit", "mm")
    arguments = ["--surface", str(tmp_path / "kidney.obj"), "--unit", "mm", "--keep-points", "--atoms", "12"]
    assert main(["build", *arguments, "--out", str(tmp_path / "again.npz")]) == 0
    again = Organ.load(tmp_path / "again.npz")
    np.testing.assert_allclose(again.surface_positions, kidney.surface_positions, rtol=1e-9, atol=1e-14)
    np.testing.assert_array_equal(again.surface_triangles, kidney.surface_triangles)


def test_a_strange_name_stays_in_its_comment(kidney, tmp_path):
    from dataclasses import replace

    name = 'Nière -- <"gauche">\nend_header\nv 0 0 0'
    replace(kidney, name=name).save(tmp_path / "odd.npz")
    for suffix in ("ply", "obj", "stl", "vtp"):
        path = tmp_path / f"odd.{suffix}"
        skeleton = [] if suffix == "stl" else ["--skeleton", str(tmp_path / f"bones.{suffix}")]
        assert main(["export", str(tmp_path / "odd.npz"), str(path), *skeleton]) == 0
        if suffix == "vtp":
            assert read_vtk(path)[0]["Points/Points"].shape == (994, 3)
        else:
            assert len(trimesh.load(path, process=False).faces) == 1984


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ([KIDNEY, "kidney.xyz"], "kidney.xyz: unknown format of the surface; use the extension .ply, .obj, .stl, .vtp"),
        ([KIDNEY, "kidney"], "unknown format of the surface"),
        ([KIDNEY, "kidney.ply", "--skeleton", "s.stl"], "unknown format of the skeleton"),
        ([KIDNEY, "kidney.ply", "--skeleton", "./kidney.ply"], "name two files"),
        ([KIDNEY, "nowhere/kidney.ply"], "folder nowhere"),
        ([KIDNEY, "kidney.ply", "--cells", "cells.vtp"], "unknown format of the cells; use the extension .vtu"),
        ([AS_BUILT, "kidney.ply", "--cells", "cells.vtu"], "has no cells for cells.vtu; tissue_sim calibrate"),
        (["none.npz", "kidney.ply"], "none.npz does not exist"),
    ],
)
def test_wrong_use_takes_one_line(arguments, reason, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["export", *arguments]) == 2
    error = capsys.readouterr().err
    assert reason in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())
