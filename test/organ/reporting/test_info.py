"""`tissue_sim info`: what an organ file holds, as text and as JSON, without the image libraries."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tissue_sim.cli import main
from tissue_sim.organ.organ import SCHEMA_VERSION, Organ
from tissue_sim.organ.reporting.info import describe, label, shown, text_lines
from tissue_sim.organ.topology import assemble_organ


@pytest.fixture(scope="module")
def egg():
    """An egg of 642 points around a forked skeleton of five atoms, 20 x 16 x 32 mm in half axes."""
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.02)
    mesh.apply_scale([1.0, 0.8, 1.6])
    return assemble_organ(
        name="egg <1>",
        surface_positions=mesh.vertices,
        surface_triangles=mesh.faces,
        atom_positions=[[0, 0, -0.01], [0, 0, 0.0], [0, 0, 0.01], [0.005, 0, 0.015], [-0.005, 0, 0.015]],
        atom_radius=[0.01, 0.012, 0.01, 0.008, 0.007],
        atom_parent=[-1, 0, 1, 2, 2],
        fixed=[3, 1, 2],
        youngs_modulus=5000.0,
        provenance={"source": "egg.ply", "seed_mm": [1.0, -2.5, 3.0], "phantom": {"noise": 12, "gaps": [{"mm": 0.5}]}},
    )


@pytest.fixture
def path(egg, tmp_path):
    egg.save(tmp_path / "egg.npz")
    return str(tmp_path / "egg.npz")


def test_figures_are_those_of_the_organ(egg):
    found = describe(egg)
    assert found["volume_ml"] == pytest.approx(egg.volume * 1e6)
    np.testing.assert_allclose(found["extent_mm"], [40.0, 32.0, 64.0], rtol=1e-9)
    edges = np.linalg.norm(
        np.diff(egg.surface_positions[egg.angular_nodes[:, :2]], axis=1)[:, 0], axis=1
    )  # an angular spring on every edge
    surface = found["surface"]
    assert (surface["points"], surface["triangles"], surface["edges"]) == (642, 1280, len(edges)) == (642, 1280, 1920)
    assert surface["edge_mean_mm"] == pytest.approx(1e3 * edges.mean())
    assert surface["edge_variation"] == pytest.approx(edges.std() / edges.mean())
    assert surface["least_angle_deg"] == pytest.approx(
        np.rad2deg(trimesh.Trimesh(egg.surface_positions, egg.surface_triangles).face_angles.min())
    )
    assert (surface["held_points"], surface["euler_number"]) == (3, 2)
    skeleton = found["skeleton"]
    assert (skeleton["atoms"], skeleton["branches"], skeleton["tips"], skeleton["junctions"]) == (5, 3, 3, 1)
    assert skeleton["length_mm"] == pytest.approx(20.0 + 2.0 * np.hypot(5.0, 5.0))
    assert skeleton["radius_mm"] == pytest.approx({"least": 7.0, "median": 10.0, "largest": 12.0})
    springs = found["springs"]
    assert springs["edge"]["count"] == 1920
    assert springs["spoke"]["count"] == 642
    assert springs["virtual"]["count"] == 3 * 642
    assert springs["skeleton"]["count"] == 4
    assert sum(kind["count"] for name, kind in springs.items() if name not in ("angular", "return")) == len(
        egg.spring_stiffness
    )
    stiffness = egg.spring_stiffness[egg.spring_kind == 0]
    assert springs["edge"]["stiffness_n_per_m"]["largest"] == stiffness.max()
    assert found["mass_g"]["total"] == pytest.approx(1060.0 * egg.volume * 1e3)
    assert found["mass_g"]["surface"] + found["mass_g"]["atoms"] == pytest.approx(found["mass_g"]["total"])
    assert found["digest"] == egg.digest()


def test_one_atom_and_interior_atoms():
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.02)
    organ = assemble_organ(
        name="ball",
        surface_positions=ball.vertices,
        surface_triangles=ball.faces,
        atom_positions=[[0.0, 0.0, 0.0]],
        atom_radius=[0.019],
        atom_parent=[-1],
        interior_atoms=7,
    )
    found = describe(organ)
    assert found["interior_points"] == 7
    assert found["mass_g"]["interior"] > 0.0
    assert (found["skeleton"]["branches"], found["skeleton"]["length_mm"]) == (0, 0.0)
    assert "spacing_mm" not in found["skeleton"]


def test_text_says_it_all(path, egg, capsys):
    assert main(["info", path]) == 0
    lines = capsys.readouterr().out.splitlines()
    for line in (
        "name: egg <1>",
        f"schema version: {SCHEMA_VERSION}",
        "units: SI: m, kg, s, N, Pa",
        f"digest: {egg.digest()}",
        f"volume (mL): {egg.volume * 1e6:.4g}",
        "extent (mm): 40, 32, 64",
        "  held points: 3",
        "    count: 1920",
        "  Young's modulus (Pa): 5000",
        "  source: egg.ply",
        "  seed (mm): 1, -2.5, 3",
        "    noise: 12",
        "        mm: 0.5",
    ):
        assert line in lines


def test_json_reads_back_with_the_same_figures(path, egg, capsys):
    assert main(["info", path, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found == json.loads(json.dumps(describe(Organ.load(path))))
    assert found["provenance"] == egg.provenance


def test_a_future_schema_is_refused_by_its_number(path, tmp_path, capsys):
    with np.load(path) as stored:
        content = dict(stored)
    header = json.loads(str(content["header"])) | {"schema_version": SCHEMA_VERSION + 1}
    content["header"] = np.array(json.dumps(header))
    np.savez(tmp_path / "future.npz", **content)
    assert main(["info", str(tmp_path / "future.npz")]) == 2
    assert f"has schema version {SCHEMA_VERSION + 1}" in capsys.readouterr().err


@pytest.mark.parametrize("damage", ["truncated", "altered", "no organ", "missing"])
def test_a_damaged_file_is_refused_in_one_line(path, tmp_path, capsys, damage):
    bad = tmp_path / "bad.npz"
    content = bytearray(Path(path).read_bytes())
    if damage == "truncated":
        bad.write_bytes(content[: len(content) // 2])
    elif damage == "altered":
        content[len(content) // 3] ^= 0x10
        bad.write_bytes(content)
    elif damage == "no organ":
        np.savez(bad, a=np.zeros(3))
    assert main(["info", str(bad)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert "bad.npz" in captured.err


def test_needs_no_image_libraries(path):
    code = (
        "import sys\nsys.modules.update(dict.fromkeys(('SimpleITK', 'skimage', 'matplotlib')))\n"
        f"from tissue_sim.cli import main\nsys.exit(main(['info', {path!r}]))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert "egg <1>" in run.stdout


def test_words_and_numbers():
    assert label("edge_mean_mm") == "edge mean (mm)"
    assert label("stiffness_n_per_m") == "stiffness (N/m)"
    assert label("tissue_sim") == "tissue_sim"
    assert [shown(value) for value in (None, True, 0.123456, 12345.6, 7, [], [1.0, 2.5])] == [
        *("not given", "yes", "0.1235", "12346", "7", "none", "1, 2.5")
    ]
    assert shown({"least": 1.0, "median": 2.0, "largest": 3.0}) == "1 to 3, median 2"
    assert list(text_lines({"a": [[1, 2], [3]]})) == ["a:", "  1: 1, 2", "  2: 3"]
