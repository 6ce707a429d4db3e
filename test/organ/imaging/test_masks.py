"""Labels of a segmentation, by number and by name, in one layer or several."""

import gzip

import numpy as np
import pytest

from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.masks import read_mask, read_masks

SIZE = (8, 7, 6)


def layered(path, layers, *names):
    """A .seg.nrrd of layers (nx, ny, nz), as 3D Slicer writes it; names: (name, value, layer)."""
    keys = [
        line
        for k, (name, value, layer) in enumerate(names)
        for line in (f"Segment{k}_Name:={name}", f"Segment{k}_LabelValue:={value}", f"Segment{k}_Layer:={layer}")
    ]
    several = len(layers) > 1
    head = [
        "NRRD0005",
        "type: uint8",
        f"dimension: {3 + several}",
        "space: left-posterior-superior",
        f"sizes: {f'{len(layers)} ' if several else ''}{' '.join(map(str, SIZE))}",
        f"space directions: {'none ' if several else ''}(1,0,0) (0,1,0) (0,0,2)",
        f"kinds: {'list ' if several else ''}domain domain domain",
        "space origin: (0,0,0)",
        *keys,
        "encoding: gzip",
    ]
    voxels = np.stack(layers).astype(np.uint8) if several else layers[0].astype(np.uint8)
    path.write_bytes("\n".join([*head, "", ""]).encode() + gzip.compress(voxels.tobytes(order="F")))
    return path


def boxes():
    """Two overlapping boxes, (nx, ny, nz)."""
    first, second = np.zeros(SIZE), np.zeros(SIZE)
    first[1:6, 1:5, 1:5], second[3:7, 2:6, 2:4] = 1, 1
    return first, second


def test_layers_are_chosen_by_name_or_place(tmp_path):
    liver, tumour = boxes()
    path = layered(tmp_path / "a.seg.nrrd", [liver, tumour], ("liver", 1, 0), ("a tumour", 1, 1))
    for label, expected in (("liver", liver), ("Liver", liver), ("0:1", liver), ("a tumour", tumour), ("1:1", tumour)):
        found = read_mask(path, label)
        np.testing.assert_array_equal(found.array, expected.T == 1)
        np.testing.assert_allclose(found.spacing, [1.0, 1.0, 2.0])
    for label in (None, 1, "1", "2:1", "spleen"):
        with pytest.raises(UserError, match=r"0:1 liver, 1:1 a tumour") as caught:
            read_mask(path, label)
        assert "\n" not in str(caught.value)


def test_a_part_that_overlaps_belongs_to_the_whole(tmp_path):
    liver, tumour = boxes()
    path = layered(tmp_path / "a.seg.nrrd", [liver, tumour], ("liver", 1, 0), ("tumour", 1, 1))
    whole, part = read_masks(path, "liver", ["tumour"])
    np.testing.assert_array_equal(whole.array, ((liver == 1) | (tumour == 1)).T)
    np.testing.assert_array_equal(part.array, (tumour == 1).T)


def test_a_number_means_the_segment_that_the_file_names(tmp_path):
    liver, other = boxes()
    path = layered(tmp_path / "a.seg.nrrd", [liver, other], ("liver", 1, 0))
    np.testing.assert_array_equal(read_mask(path, 1).array, liver.T == 1)


def test_names_of_a_single_layer(tmp_path):
    liver, tumour = boxes()
    path = layered(tmp_path / "a.seg.nrrd", [np.where(tumour == 1, 3, liver)], ("liver", 1, 0), ("tumour", 3, 0))
    np.testing.assert_array_equal(read_mask(path, "tumour").array, tumour.T == 1)
    with pytest.raises(UserError, match=r"several labels \(1 liver, 3 tumour\); choose one with --label"):
        read_mask(path)


def test_names_that_come_twice_are_distinguished(tmp_path):
    path = layered(tmp_path / "a.seg.nrrd", boxes(), ("mass", 1, 0), ("mass", 1, 1))
    with pytest.raises(UserError, match=r"several labels mass \(0:1 mass, 1:1 mass\); name 0:1 or 1:1"):
        read_mask(path, "mass")
