"""`tissue_sim build` from every kind of input, and its one-line refusals."""

import argparse
import dataclasses
import hashlib
import json
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh

from helpers.building import FEW, build, refused, write
from helpers.html_page import Page
from helpers.phantoms import around_kidney, coarse_phantom
from helpers.shapes import write_dicom
from tissue_sim.cli import main
from tissue_sim.commands.build import parse_triple, report_path
from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.image import Volume
from tissue_sim.organ.imaging.image_file import read_image
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.segmenting.parameters import SegmentationParameters
from tissue_sim.organ.tool_resolution import mean_edge

ONE_WINDOW = ["--window", "3.3"]  # how a window is chosen is no matter of the command line


@pytest.fixture(scope="module")
def ct():
    """The left side of a coarser phantom in whole HU, cropped around the kidney, and its seed."""
    phantom = coarse_phantom()
    return around_kidney(phantom, phantom.ct), phantom.seed_point


def seed_text(seed):
    return ",".join(f"{v:.4f}" for v in seed)


@pytest.mark.extended
def test_a_ct_in_any_format_gives_the_same_organ(ct, tmp_path, capsys):
    volume, seed = ct
    write_dicom(tmp_path / "series", volume)
    sources = [write(volume, tmp_path / f"ct.{suffix}") for suffix in ("nii.gz", "nrrd", "mha")]
    for source in sources[1:]:  # the same image gives the same organ
        one, other = read_image(sources[0]), read_image(source)
        np.testing.assert_array_equal(one.array, other.array)
        for part in ("spacing", "origin", "direction"):
            np.testing.assert_allclose(getattr(one, part), getattr(other, part), atol=1e-4)
    organs = []
    for source in [sources[0], str(tmp_path / "series")]:
        organ, text = build(capsys, source, "--seed", seed_text(seed), *ONE_WINDOW, out=tmp_path / "organ.npz")
        organs.append(organ)
        assert "200 points, 396 triangles, 12 atoms" in text
    for other in organs[1:]:
        np.testing.assert_array_equal(other.surface_triangles, organs[0].surface_triangles)
        np.testing.assert_allclose(other.surface_positions, organs[0].surface_positions, atol=1e-6)
        np.testing.assert_allclose(other.atom_positions, organs[0].atom_positions, atol=1e-6)
    organ = organs[0]
    assert 110e-6 < organ.volume < 150e-6
    assert organ.provenance["source"] == "ct.nii.gz"
    assert organ.provenance["segmentation"]["grid_mm"] == 1.25
    assert "numpy" in organ.provenance["packages"]
    assert str(tmp_path) not in json.dumps(dict(organ.provenance))
    kidney = np.array([0.066, 0.038, 0.0])
    assert np.linalg.norm(organ.surface_positions.mean(axis=0) - kidney) < 0.01


@pytest.mark.extended
def test_a_seed_may_be_voxel_indices_or_negative(ct, tmp_path, capsys):
    volume, seed = ct
    moved = Volume(volume.array, volume.spacing, volume.origin - 300.0, volume.direction, "moved")
    path = write(moved, tmp_path / "ct.nrrd")
    first, _ = build(capsys, path, "--seed", seed_text(seed - 300.0), *ONE_WINDOW, out=tmp_path / "a.npz")
    index = ",".join(str(int(i)) for i in np.round(volume.to_index(seed)))
    second, _ = build(capsys, path, "--seed-voxel", index, *ONE_WINDOW, out=tmp_path / "b.npz")
    assert first.surface_positions[:, 0].max() < 0.0
    assert abs(first.volume - second.volume) < 0.02 * first.volume


def test_a_mask_with_labels_and_fixed_nodes(ct, tmp_path, capsys):
    volume, seed = ct
    x, y, z = (volume.to_points(np.argwhere(np.ones(volume.array.shape))[:, ::-1]) - seed).T
    inside = ((x / 20) ** 2 + (y / 18) ** 2 + (z / 34) ** 2 < 1).reshape(volume.array.shape)
    labels = inside * 4.0 + ~inside * (volume.array < -200) * 2.0
    path = write(volume.with_array(labels.astype(np.float32)), tmp_path / "labels.nrrd")
    options = ["--youngs-modulus", "5000", "--density", "1000", "--fixed", "x>0.75"]
    organ, _ = build(capsys, "--mask", path, "--label", "4", *options, out=tmp_path / "o.npz")
    assert organ.volume == pytest.approx(4 / 3 * np.pi * 20 * 18 * 34 * 1e-9, rel=0.03)
    assert organ.youngs_modulus == 5000
    assert organ.mass.sum() == pytest.approx(1000 * organ.volume)
    held = organ.surface_positions[organ.fixed, 0]
    free = np.delete(organ.surface_positions[:, 0], organ.fixed)
    assert held.min() >= free.max()
    assert 0.05 < len(held) / 200 < 0.35
    assert "several labels (2, 4)" in refused(capsys, "--mask", path)


def egg(folder, inward=False):
    """A mesh of an egg with half axes 20 x 16 x 32 mm, as PLY in mm."""
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=20.0)
    mesh.apply_scale([1.0, 0.8, 1.6])
    mesh.vertices = mesh.vertices.astype(np.float32)
    if inward:
        mesh.invert()
    mesh.export(folder / "egg.ply")
    return str(folder / "egg.ply"), mesh


@pytest.mark.extended
def test_a_surface_keeps_its_points(tmp_path, capsys):
    path, mesh = egg(tmp_path)
    kept, text = build(capsys, "--surface", path, "--unit", "mm", "--keep-points", out=tmp_path / "k.npz")
    np.testing.assert_array_equal(kept.surface_positions, np.asarray(mesh.vertices) * 1e-3)
    np.testing.assert_array_equal(kept.surface_triangles, mesh.faces)
    assert kept.n_atoms == 12
    assert "642 points" in text
    assert f"resolves spheres with a radius of at least {1e3 * mean_edge(kept):.2g} mm" in text


def test_a_report_lies_where_it_is_wanted(tmp_path):
    named = argparse.Namespace(report=str(tmp_path / "page.html"))
    assert report_path(named, tmp_path / "o.npz") == tmp_path / "page.html"
    assert report_path(argparse.Namespace(report=None), tmp_path / "o.npz") is None


@pytest.mark.parametrize("library", ["matplotlib", "jinja2"])
def test_what_a_report_lacks_is_named_before_the_build(tmp_path, monkeypatch, library):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(UserError, match=f"--report needs {library}; install the extra"):
        report_path(argparse.Namespace(report=""), tmp_path / "o.npz")


@pytest.mark.extended
def test_a_mesh_has_a_report_too_beside_the_organ(tmp_path, capsys):
    egg = trimesh.creation.icosphere(subdivisions=2, radius=0.02)
    egg.apply_scale([1.0, 0.8, 1.6])
    egg.invert()
    egg.export(tmp_path / "egg.ply")
    words = ["--surface", str(tmp_path / "egg.ply"), "--length", "0.08", "--keep-points", "--atoms", "6"]
    assert main(["build", *words, "--interior", "9", "--out", str(tmp_path / "o.npz"), "--report"]) == 0
    assert f"{tmp_path / 'o.html'}: report" in capsys.readouterr().out
    text = (tmp_path / "o.html").read_text(encoding="utf-8")
    assert "<h1>egg</h1>" in text
    parsed = Page(text)
    assert "surface as given" in parsed.text
    assert "repaired: flipped inward triangles" in parsed.text
    assert "scaled: the longest side is 8 cm" in parsed.text
    assert "HU" not in parsed.text
    assert "interior points 9" in parsed.text
    assert len(parsed.images) == 7


def test_a_surface_gets_new_points_interior_atoms_and_provenance_and_repairs_are_reported(tmp_path, capsys):
    path, mesh = egg(tmp_path, inward=True)
    options = ["--interior", "20", "--name", "my egg", "--length", "0.08"]
    organ, text = build(capsys, "--surface", path, *options, out=tmp_path / "n.npz")
    assert "repaired: flipped inward triangles" in text
    assert (organ.n_surface, len(organ.surface_triangles)) == (200, 396)
    assert np.ptp(organ.surface_positions, axis=0).max() == pytest.approx(0.08, rel=0.02)
    scale = 0.08 / np.ptp(mesh.vertices, axis=0).max()
    assert organ.volume == pytest.approx(abs(mesh.volume) * scale**3, rel=0.02)
    np.testing.assert_allclose(organ.surface_positions.mean(axis=0), 0.0, atol=1e-3)
    assert len(organ.interior_positions) == 20
    assert organ.name == "my egg"
    provenance = organ.provenance
    assert (provenance["points"], provenance["atoms"], provenance["interior_atoms"], provenance["branches"]) == (
        200,
        12,
        20,
        "none",
    )
    assert provenance["source_sha256"] == hashlib.sha256(Path(path).read_bytes()).hexdigest()
    assert provenance["packages"]["numpy"] == np.__version__


def test_wrong_arguments_take_one_line_each(ct, tmp_path, capsys):
    volume, seed = ct
    image = write(volume, tmp_path / "ct.nrrd")
    here = ["--seed", seed_text(seed)]
    for arguments, reason in [
        ([], "nothing to build from"),
        ([image], "--seed X,Y,Z"),
        ([image, "--mask", image, *here], "IMAGE and --mask were given"),
        ([image, "--seed", "1,2"], "'1,2' is not three numbers"),
        ([image, "--seed", "1,2,x"], "is not three numbers"),
        ([image, *here, "--seed-voxel", "1,2,3"], "choose one"),
        ([image, *here, "--label", "1"], "--label belongs to --mask"),
        (["--mask", image, *here], "--seed belongs to IMAGE"),
        (["--surface", "egg.stl"], "egg.stl does not exist"),
        ([str(tmp_path / "none.nii"), *here], "does not exist"),
        ([image, "--seed", "900,0,0"], "is outside"),
        ([image, *here, "--window", "-1"], "--window -1 must lie within"),
        (["--mask", image, "--window", "2"], "--window belongs to IMAGE, not to --mask"),
        (["--mask", image, "--length", "0.2"], "--length belongs to --surface"),
        ([image, *here, "--part", "2"], "--part belongs to --mask and --surface"),
        ([image, *here, "--merge-parts"], "--merge-parts belongs to --mask and --surface"),
        (["--mask", image, "--part", "left"], "--part left is not a number"),
        (["--mask", image, "--part", "2", "--merge-parts"], "--part and --merge-parts were given; choose one"),
        ([image, *here, "--organ", "spline"], "--organ spline is unknown; choose one of kidney"),
        ([image, *here, "--interior", "-1"], "--interior -1 is negative"),
        ([image, *here, "--fixed", str(tmp_path / "none.npy")], "none.npy does not exist"),
        (["--report", image, *here], "nothing to build from"),
        ([image, *here, "--report", str(tmp_path / "r.pdf")], "must end in .html"),
        ([image, *here, "--report", str(tmp_path / "no" / "r.html")], "for the report does not exist"),
        ([image, *here, "--out", str(tmp_path / "no" / "o.npz")], "for the organ file does not exist"),
        ([image, *here, "--out", str(tmp_path / "kidney.stl")], "kidney.stl must end in .npz"),
        ([image, *here, "--points", "10"], "--points 10 is too few"),
        ([image, *here, "--atoms", "0"], "--atoms 0 is too few"),
        ([image, *here, *FEW, "--fixed", "w<3"], "is not understood"),
        ([image, *here, *FEW, "--poisson-ratio", "0.7"], "Poisson's ratio 0.7"),
    ]:
        assert reason in refused(capsys, *arguments), arguments


def test_triples():
    np.testing.assert_array_equal(parse_triple("--seed", "-1, 2.5,3e1"), [-1.0, 2.5, 30.0])
    with pytest.raises(UserError, match="--seed 'nan,1,2'"):
        parse_triple("--seed", "nan,1,2")


CT, SEED = "study.nii.gz", ("--seed", "1,2,3")


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ((CT, *SEED), "study"),
        ((CT, *SEED, "--organ", "kidney"), "kidney"),
        ((CT, *SEED, "--organ", "any"), "study"),
        ((CT, *SEED, "--organ", "kidney", "--name", "left kidney"), "left kidney"),
        (("--mask", CT), "study"),
        (("--mask", CT, "--label", "5"), "study"),
        (("--mask", CT, "--label", "1:5"), "study"),
        (("--mask", CT, "--label", "spleen"), "spleen"),
        (("--surface", "a/mesh.obj", "--unit", "mm", "--part", "2"), "mesh"),
        (("--surface", "a/mesh.obj", "--unit", "mm", "--part", "Liver_1"), "Liver_1"),
    ],
)
def test_an_organ_is_named_by_what_it_is_said_to_be(words, name, tmp_path, monkeypatch):
    asked = []

    def make(kind, source, request, *_):
        asked.append(request.name)
        raise UserError("not built")

    monkeypatch.setattr("tissue_sim.commands.build.make", make)
    assert main(["build", *words, "--out", str(tmp_path / "o.npz")]) == 2
    assert asked == [name]


def test_help_names_every_option(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["build", "--help"])
    assert ended.value.code == 0
    text = capsys.readouterr().out
    for option in ("--seed ", "--seed-voxel", "--mask", "--label", "--surface", "--keep-points", "--fixed", "--unit"):
        assert option in text
    for item in dataclasses.fields(SegmentationParameters):
        assert f"--{item.name.replace('_', '-')} " in text
        assert " ".join(item.metadata["help"].split()) in " ".join(text.split())
    assert "LPS" in text
    assert "None" not in text


@pytest.mark.extended
def test_without_the_image_libraries_help_is_whole_and_a_build_names_what_to_install():
    blocked = "import sys\nsys.modules.update(dict.fromkeys(('SimpleITK', 'skimage')))\n"
    code = blocked + "from tissue_sim.cli import main\nsys.exit(main(['build', *sys.argv[1:]]))"
    helped, tried = (
        subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=False)
        for words in (["--help"], ["ct.nii", "--seed", "1,2,3"])
    )
    assert helped.returncode == 0, helped.stderr
    assert all(
        f"--{item.name.replace('_', '-')} " in helped.stdout for item in dataclasses.fields(SegmentationParameters)
    )
    assert tried.returncode == 2
    assert "pip install 'tissue_sim[image]'" in tried.stderr
    assert tried.stderr.count("\n") == 1


def test_every_parameter_of_the_segmentation_reaches_it(ct, tmp_path, capsys, monkeypatch):
    volume, seed = ct
    path = write(volume, tmp_path / "ct.nrrd")
    seen = {}

    def caught(_ct, _seed, parameters, organ, accept, progress):
        seen.update(dataclasses.asdict(parameters), organ=organ, accept=accept)
        raise UserError("far enough")

    monkeypatch.setattr("tissue_sim.organ.segmenting.segmentation.segment", caught)
    wanted, options = {}, []
    for item in dataclasses.fields(SegmentationParameters):
        low, high = item.metadata["range"]
        wanted[item.name] = round(low + 0.37 * (high - low), 3)
        options += [f"--{item.name.replace('_', '-')}", f"{wanted[item.name]}"]
    here = [path, "--seed", seed_text(seed)]
    assert "far enough" in refused(capsys, *here, *options, "--organ", "spleen", "--accept")
    assert seen == {**wanted, "organ": "spleen", "accept": True}
    refused(capsys, *here, "--organ", "any")
    assert seen == {**dataclasses.asdict(SegmentationParameters()), "organ": None, "accept": False}


@pytest.mark.extended
def test_what_cannot_be_the_organ_passes_only_with_accept(ct, tmp_path, capsys):
    volume, seed = ct
    here = [write(volume, tmp_path / "ct.nrrd"), "--seed", seed_text(seed), "--organ", "liver", *ONE_WINDOW]
    assert re.search(
        r"does not fit the anatomy of the liver: it has a volume of \d+ mL \(at least 550\)", refused(capsys, *here)
    )
    organ, text = build(capsys, *here, "--accept", out=tmp_path / "o.npz")
    assert "warning: the region found" in text
    assert organ.provenance["segmentation_parameters"]["organ"] == "liver"
    assert any("does not fit the anatomy of the liver" in line for line in organ.provenance["segmentation"]["warnings"])


def test_options_of_a_mesh_reach_its_reader(tmp_path, capsys, monkeypatch):
    seen = []

    def caught(*arguments, **options):
        seen.append((arguments, options))
        raise UserError("far enough")

    monkeypatch.setattr("tissue_sim.organ.meshes.mesh_input.read_mesh", caught)
    refused(capsys, "--surface", "a.ply", "--unit", "cm", "--part", "2")
    refused(capsys, "--surface", "a.ply", "--length", "0.12", "--merge-parts")
    refused(capsys, "--surface", "a.ply", "--part", "left wall")
    assert seen == [
        (("a.ply", "cm"), {"longest": None, "part": 2, "merge_parts": False}),
        (("a.ply", None), {"longest": 0.12, "part": None, "merge_parts": True}),
        (("a.ply", None), {"longest": None, "part": "left wall", "merge_parts": False}),
    ]


@pytest.mark.slow
def test_parts_of_a_mesh(tmp_path, capsys):
    apart = [trimesh.creation.icosphere(subdivisions=2, radius=r) for r in (20.0, 18.0)]
    apart[1].apply_translation([60.0, 0.0, 0.0])
    trimesh.util.concatenate(apart).export(tmp_path / "two.ply")
    here = ["--surface", str(tmp_path / "two.ply"), "--unit", "mm"]
    assert "parts" in refused(capsys, *here, *FEW)
    organ, _ = build(capsys, *here, "--part", "2", out=tmp_path / "o.npz")
    assert organ.volume == pytest.approx(4 / 3 * np.pi * 18.0**3 * 1e-9, rel=0.05)
    touching = [trimesh.creation.icosphere(subdivisions=2, radius=20.0) for _ in range(2)]
    touching[1].apply_translation([25.0, 0.0, 0.0])
    trimesh.util.concatenate(touching).export(tmp_path / "two.ply")
    organ, _ = build(capsys, *here, "--merge-parts", out=tmp_path / "o.npz")
    assert np.ptp(organ.surface_positions, axis=0)[0] == pytest.approx(0.065, rel=0.02)


def call(arguments, **streams):
    code = "import sys\nfrom tissue_sim.cli import main\nsys.exit(main(sys.argv[1:]))"
    return subprocess.run([sys.executable, "-c", code, "build", *arguments], text=True, check=True, **streams)


@pytest.mark.slow
def test_from_ct_crop_to_organ_within_a_minute(tmp_path):
    """994 points and 48 atoms on two cores in at most 60 s, in a process of its own, imports included."""
    crop = Path(__file__).parents[2].parent / "shared" / "data" / "ct_abdomen" / "crop_left_kidney_ct.nii.gz"
    if not crop.is_file():
        pytest.skip("no ct_abdomen in ../shared/data beside the project")
    started = time.perf_counter()
    here = [str(crop), "--seed", "85,-110.3,364.3", "--out", str(tmp_path / "o.npz")]
    print(call(here, stdout=subprocess.PIPE).stdout)
    seconds = time.perf_counter() - started
    print(f"CT crop to organ: {seconds:.1f} s")
    organ = Organ.load(tmp_path / "o.npz")
    assert (organ.n_surface, len(organ.surface_triangles), organ.n_atoms) == (994, 1984, 48)
    assert seconds <= 60.0
