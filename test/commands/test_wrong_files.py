"""Files of another kind than their names say, cut off, or empty: one line each, with the file and the remedy."""

import gzip
import re
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tissue_sim.cli import main
from tissue_sim.organ.shipped import shipped_organ

BALL = trimesh.creation.icosphere(1, 30.0)
TEXT_STL, STL = BALL.export(file_type="stl_ascii"), BALL.export(file_type="stl")
PNG = b"\x89PNG\r\n\x1a\n" + bytes(range(200))
ORGAN = shipped_organ().read_bytes()
MESHES = r"\(\.glb, .*\.vtu\)"


def nifti(*size: int) -> bytes:
    """An image of a size, without its voxels."""
    header = bytearray(352)
    struct.pack_into("<i", header, 0, 348)
    struct.pack_into("<8h", header, 40, len(size), *size, *[1] * (7 - len(size)))
    struct.pack_into("<2h", header, 70, 4, 16)
    struct.pack_into("<8f", header, 76, 1, 1, 1, 1, 0, 0, 0, 0)
    struct.pack_into("<f", header, 108, 352.0)
    header[344:348] = b"n+1\0"
    return bytes(header)


PACKED = gzip.compress(nifti(4, 4, 4) + np.random.default_rng(0).bytes(128))
SURFACE = ("build", "--surface", "{file}", "--unit", "mm", "--out", "o.npz")
MASK = ("build", "--mask", "{file}", "--out", "o.npz")
SEEDED = ("build", "{file}", "--seed", "1,2,3", "--out", "o.npz")
INFO, REPLAY = ("info", "{file}"), ("replay", "{file}")
CALIBRATE = ("calibrate", "{file}", "--out", "o.npz")
FOLDER = None  # in place of a file's content

CASES = [
    (SURFACE, "half.stl", TEXT_STL[: len(TEXT_STL) // 2].encode(), "half.stl .*cut off.*; export it again"),
    (SURFACE, "word.stl", TEXT_STL.replace("vertex", "vertax", 1).encode(), "word.stl can't be .*; export it again"),
    (SURFACE, "half.stl", STL[: len(STL) // 2], "half.stl has no triangles: it is cut off.*; export it again"),
    (SURFACE, "empty.stl", b"", f"empty.stl is empty, and not a mesh; name a mesh file {MESHES}"),
    (SURFACE, "picture.obj", PNG, f"picture.obj is a PNG picture, and not a mesh; name a mesh file {MESHES}"),
    (SURFACE, "organ.ply", ORGAN, f"organ.ply is a zip archive, .*; name a mesh file {MESHES}"),
    (SURFACE, "words.trian", b"some words", "a count is expected\\); export it again"),
    (SURFACE, "folder.stl", FOLDER, f"folder.stl is a folder; name a mesh file in it {MESHES}"),
    (MASK, "empty.nii.gz", b"", "empty.nii.gz is empty, and not an image; name a NIfTI, NRRD"),
    (MASK, "picture.nrrd", PNG, "picture.nrrd is a PNG picture, and not an image; name a NIfTI, NRRD"),
    (MASK, "half.nii.gz", PACKED[: len(PACKED) // 2], "half.nii.gz is damaged: its compressed data .* export it again"),
    (MASK, "sum.nii.gz", PACKED[:-8] + bytes(8), "sum.nii.gz is damaged.*"),
    (MASK, "zero.nii", nifti(0, 12, 10), "zero.nii has a damaged header: its size is 0 x 12 x 10 voxels; export"),
    (MASK, "zero.nii.gz", gzip.compress(nifti(0, 12, 10)), "its size is 0 x 12 x 10 voxels; export the image again"),
    (SEEDED, "less.nii", nifti(-5, 12, 10), "less.nii has a damaged header: its size is -5 x 12 x 10 voxels; export"),
    (
        SEEDED,
        "words.nii",
        b"some words",
        "words.nii can't be read as an image \\(its format is unknown\\); name a NIfTI",
    ),
    (
        SEEDED,
        "folder.nii",
        FOLDER,
        "folder folder.nii contains no DICOM series; name the folder that contains the slices",
    ),
    (INFO, "empty.npz", b"", "empty.npz is empty, and not an organ file; make one with 'tissue_sim build'"),
    (INFO, "picture.npz", PNG, "picture.npz is a PNG picture, and not an organ file; make one with 'tissue_sim build'"),
    (INFO, "half.npz", ORGAN[: len(ORGAN) // 2], "organ file half.npz is damaged or .*; build it again"),
    (INFO, "empty.yaml", b"", "scene empty.yaml is empty; 'tissue_sim abdomen' makes one"),
    (CALIBRATE, "ct.npz", nifti(4, 4, 4), "ct.npz is an image .NIfTI., and not an organ file; make one with"),
    (CALIBRATE, "page.npz", b"<!DOCTYPE html><html>", "page.npz is a web page, and not an organ file; make one with"),
    (CALIBRATE, "folder.npz", FOLDER, "organ file folder.npz is a folder; name the .npz file"),
    (REPLAY, "organ.npz", ORGAN, "bag organ.npz is a file; name the folder of a bag"),
    (REPLAY, "bag_0.mcap", b"", "bag bag_0.mcap is a file; name the folder of a bag, here .+"),
    (
        REPLAY,
        "folder",
        FOLDER,
        "folder folder holds no bag: neither metadata.yaml nor a .mcap file; name a bag's folder",
    ),
    (REPLAY, "bag/metadata.yaml", b"some words", "metadata.yaml is damaged; delete it, and a replay makes it anew"),
    (REPLAY, "bag/bag_0.mcap", b"", "bag bag was interrupted before it had any content: delete it"),
]


@pytest.mark.parametrize(("words", "name", "content", "line"), CASES, ids=[f"{case[0][0]} {case[1]}" for case in CASES])
def test_a_wrong_file_is_refused_with_its_name_and_the_remedy(words, name, content, line, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    path = Path(name)
    if content is FOLDER:
        path.mkdir()
    else:
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
    given = path.parent if path.parent != Path() else path
    assert main([word.format(file=given) for word in words]) == 2
    error = capfd.readouterr().err
    assert error.count("\n") == 1
    assert str(given) in error
    assert re.search(line, error), error
