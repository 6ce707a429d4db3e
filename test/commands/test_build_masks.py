"""`tissue_sim build` from masks: their parts and segments, and inclusions by label."""

import numpy as np
import pytest

from helpers.building import build, refused, write
from helpers.frames import PIXEL, segmentation
from helpers.shapes import solid
from tissue_sim.cli import main
from tissue_sim.organ.inclusions import inclusions_of
from tissue_sim.organ.surface_checks import signed_volume


def test_parts_of_a_mask_are_refused_or_taken(tmp_path, capsys):
    both = solid(lambda x, y, z: np.minimum(round_at(-24, 18)(x, y, z), round_at(24, 14)(x, y, z)), size=(100, 44, 44))
    path = write(both, tmp_path / "kidneys.nrrd")
    error = refused(capsys, "--mask", path)
    assert "kidneys.nrrd has 2 separate parts: 1 24.5 mL, 2 11.5 mL; select one with --part N" in error
    organ, text = build(capsys, "--mask", path, "--part", "2", out=tmp_path / "o.npz")
    assert "omitted 1 separate part of 24.5 mL next to 11.5 mL" in text
    assert "11.5 mL read, " in text
    assert organ.volume == pytest.approx(4 / 3 * np.pi * 14.0**3 * 1e-9, rel=0.03)
    assert organ.surface_positions[:, 0].min() > 0.0
    whole, text = build(capsys, "--mask", path, "--merge-parts", out=tmp_path / "whole.npz")
    assert "joined 2 separate parts across gaps of up to 17 mm: " in text
    assert whole.volume > 36.0e-6


def round_at(middle, radius):
    return lambda x, y, z: np.sqrt((x - middle) ** 2 + y**2 + z**2) - radius


def test_a_segment_of_a_dicom_segmentation_is_named(tmp_path, capsys):
    z, y, x = np.indices((20, 40, 40)) - np.array([9.5, 19.5, 19.5])[:, None, None, None]
    distance = np.sqrt((2.0 * z) ** 2 + (PIXEL[0] * y) ** 2 + (PIXEL[1] * x) ** 2)
    path = str(segmentation(tmp_path / "seg.dcm", {"organ": distance <= 13.0, "tumour": distance <= 6.0}))
    assert "several labels (1 organ, 2 tumour); choose one with --label" in refused(capsys, "--mask", path)
    words = ["--mask", path, "--label", "organ", "--inclusion", "tumour:5"]
    organ, _ = build(capsys, *words, out=tmp_path / "o.npz")
    assert organ.name == "organ"
    assert organ.volume == pytest.approx(4 / 3 * np.pi * 13.0**3 * 1e-9, rel=0.03)
    assert [one.stiffness for one in inclusions_of(organ)] == [5.0]


# inclusions ----------------------------------------------------------------------------------------


GRID = {"size": (64, 56, 72)}


def round_mask(radius, middle):
    """A ball on the labels' grid; mm."""
    x0, y0, z0 = middle
    return solid(lambda x, y, z: np.sqrt((x - x0) ** 2 + (y - y0) ** 2 + (z - z0) ** 2) - radius, **GRID)


INNER = [(2, 5.0, (10.0, 0.0, 0.0)), (3, 4.0, (-8.0, 5.0, 10.0)), (3, 3.0, (-8.0, -5.0, -10.0))]


@pytest.fixture(scope="module")
def labels(tmp_path_factory):
    """An egg of label 1 with balls of labels 2 and 3, specks of 3 and 4 in it, and a ball outside: 5."""
    egg = solid(lambda x, y, z: np.sqrt((x / 24) ** 2 + (y / 20) ** 2 + (z / 30) ** 2) - 1.0, **GRID)
    array = egg.array.astype(np.int16)
    specks = [(3, 1.0, (0.0, 0.0, 15.0)), (4, 1.0, (0.0, 0.0, -15.0)), (5, 3.0, (27.0, 23.0, 31.0))]
    for label, radius, middle in [*INNER, *specks]:
        array[round_mask(radius, middle).array] = label
    return write(egg.with_array(array), tmp_path_factory.mktemp("labels") / "labels.nii.gz")


def test_labels_of_a_mask_become_inclusions(labels, tmp_path, capsys):
    arguments = ["--mask", labels, "--label", "1", "--inclusion", "2:5", "--inclusion", "3:0.5"]
    organ, text = build(capsys, *arguments, out=tmp_path / "organ.npz")
    assert "omitted 1 specks of label 3" in text
    assert "5 times as stiff" in text
    found = inclusions_of(organ)
    assert [one.stiffness for one in found] == [5.0, 0.5, 0.5]
    for one, (_, radius, middle) in zip(found, INNER, strict=True):
        np.testing.assert_allclose(1e3 * one.positions.mean(axis=0), middle, atol=0.3)
        voxels = np.count_nonzero(round_mask(radius, middle).array)  # of 1 mm
        assert 1e9 * signed_volume(one.positions, one.triangles) == pytest.approx(voxels, rel=1e-6)
    plain, _ = build(capsys, "--mask", labels, "--label", "1", out=tmp_path / "plain.npz")
    assert organ.volume > plain.volume, "what is of another stiffness is the organ's, too"
    assert organ.provenance["inclusions"] == ["2:5", "3:0.5"]
    main(["info", str(tmp_path / "organ.npz")])
    assert "times as stiff: 5" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--inclusion", "2"], "write it as 2:5"),
        (["--inclusion", ":5"], "write it as 2:5"),
        (["--inclusion", "tumour:5"], "has no label tumour; it has 1, 2, 3, 4, 5"),
        (["--inclusion", "2:5", "--inclusion", "2:3"], "label 2 is given twice"),
        (["--inclusion", "1:5"], "label 1 is given twice"),
        (["--inclusion", "2:nan"], "outside 0.001..1000"),
        (["--inclusion", "9:5"], "has no label 9"),
        (["--inclusion", "4:5"], "needs at least 50 connected voxels"),
        (["--inclusion", "5:5"], "is outside the organ"),
    ],
)
def test_what_is_no_inclusion_is_refused(labels, arguments, said, tmp_path, capsys):
    given = ["--mask", labels, "--label", "1", *arguments, "--points", "200", "--out", str(tmp_path / "organ.npz")]
    code = main(["build", *given])
    captured = capsys.readouterr()
    assert code == 2
    assert said in captured.err
    assert captured.err.count("\n") == 1
    assert not (tmp_path / "organ.npz").exists()


def test_an_inclusion_belongs_to_a_mask(tmp_path, capsys):
    assert "--inclusion belongs to --mask" in refused(capsys, "--surface", "organ.obj", "--inclusion", "2:5")
