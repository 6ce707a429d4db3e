"""Readers of segmentations: the parts that a file names, by number or name, and one of them as a mask.

Label images have a value for each part; 3D Slicer's .seg.nrrd has names beside them, and layers where parts overlap;
a DICOM segmentation has frames for each segment.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import SimpleITK as sitk

from tissue_sim.array_types import Array, Mask
from tissue_sim.errors import UserError, shown
from tissue_sim.organ.imaging.dicom import read_stack
from tissue_sim.organ.imaging.dicom_file import is_dicom
from tissue_sim.organ.imaging.dicom_frames import read_frames
from tissue_sim.organ.imaging.image import Volume, placed
from tissue_sim.organ.imaging.image_file import FORMATS, of_stack, read_file
from tissue_sim.organ.imaging.segments import read_segments, segmentation_in

_MOST_LABELS = 200
_SHOWN = 20  # labels named in a message


class Label(NamedTuple):
    """One part that a segmentation names.

    Attributes
    ----------
    key : str
        Key as --label takes it.
    number : float
        Value of its voxels.
    name : str
        Name, or an empty string.
    voxels : Callable[[], Mask]
        Makes its mask.
    """

    key: str
    number: float
    name: str
    voxels: Callable[[], Mask]

    def __str__(self) -> str:
        return f"{self.key} {shown(self.name)}" if self.name else self.key


def read_mask(path: str | Path, label: int | str | None = None) -> Volume:
    """Read one part of a segmentation as a bool Volume.

    Parameters
    ----------
    path : str | Path
        The file.
    label : int | str | None, optional
        Number or name of the part; None for the only one.

    Raises
    ------
    UserError
        Where the choice is ambiguous or there is no such label; the message lists the labels.
    """
    return read_masks(path, label, ())[0]


def read_masks(path: str | Path, label: int | str | None, parts: Sequence[int | str]) -> list[Volume]:
    """Read an organ's segmentation with further labels for parts of it.

    Parameters
    ----------
    path : str | Path
        The file.
    label : int | str | None
        Number or name of the organ, LAYER:N where a number occurs in several layers of a file; None for the only one
        that `parts` doesn't name.
    parts : Sequence[int | str]
        Numbers or names of the further parts.

    Returns
    -------
    list[Volume]
        The whole organ, parts included, then each part.

    Raises
    ------
    UserError
        As in read_mask.
    """
    source = Path(path)
    if not source.exists():
        raise UserError(f"mask {source} does not exist; name a {FORMATS}")
    grid, labels = _read_labels(source)
    if not labels:
        raise UserError(f"mask {source} is empty: it has no value other than 0")
    further = [_find(source, labels, wanted) for wanted in parts]
    own = [one for one in labels if one not in further] if label is None else [_find(source, labels, label)]
    if len(own) != 1:
        raise UserError(f"mask {source} has several labels ({_listed(labels)}); choose one with --label")
    masks = [grid.with_array(one.voxels()) for one in (*own, *further)]
    for one, mask in zip((*own, *further), masks, strict=True):
        if not mask.array.any():
            raise UserError(f"mask {source} has no voxels of label {one}")
    for mask in masks[1:]:
        masks[0].array[mask.array] = True
    return masks


def _find(source: Path, labels: Sequence[Label], wanted: int | str) -> Label:
    """Return the label of a key, number or name."""
    text = str(wanted).strip()
    numbered = [one for one in labels if text == f"{one.number:g}"]
    for found in (
        [one for one in labels if text == one.key],
        [one for one in numbered if one.name] or numbered,  # a file that names its segments means those
        [one for one in labels if text.casefold() == one.name.casefold()],
    ):
        if len(found) == 1:
            return found[0]
        if found:
            keys = " or ".join(one.key for one in found)
            raise UserError(f"mask {source} has several labels {shown(text)} ({_listed(found)}); name {keys}")
    raise UserError(f"mask {source} has no label {shown(text)}; it has {_listed(labels)}")


def _listed(labels: Sequence[Label]) -> str:
    return ", ".join(map(str, labels[:_SHOWN])) + (", ..." if len(labels) > _SHOWN else "")


def _read_labels(source: Path) -> tuple[Volume, list[Label]]:
    """Return the grid of a segmentation, with an array of arbitrary content, and its labels in order."""
    dicom = segmentation_in(source)
    if dicom is not None:
        grid, segments = read_segments(dicom)
        return grid, [Label(str(one.number), one.number, one.name, one.voxels) for one in segments]
    if source.is_dir() or is_dicom(source):
        volume = of_stack(read_stack(source) if source.is_dir() else read_frames(source), source.name)
        return volume, list(_values(volume.array, "", {}, str(source)))
    image, notes = read_file(source, layers=True)
    names = _names(image)
    array = sitk.GetArrayFromImage(image)
    layers = array if array.ndim > 3 else array[..., None]
    labels: list[Label] = []
    for layer in range(layers.shape[3]):
        prefix = f"{layer}:" if layers.shape[3] > 1 else ""
        own = {number: name for (place, number), name in names.items() if place == layer}
        labels += _values(layers[..., layer], prefix, own, str(source))
    return placed(layers[..., 0], image, source.name, notes), labels


def _names(image: sitk.Image) -> dict[tuple[int, float], str]:
    """Return the names that 3D Slicer gives segments, by layer and value."""
    found: dict[tuple[int, float], str] = {}
    for key in image.GetMetaDataKeys():
        segment, _, field = key.partition("_")
        if field == "Name" and segment.startswith("Segment"):
            layer, value = (
                image.GetMetaData(f"{segment}_{what}") if image.HasMetaDataKey(f"{segment}_{what}") else usual
                for what, usual in (("Layer", "0"), ("LabelValue", ""))
            )
            if layer.isdigit() and value.isdigit():
                found[int(layer), float(value)] = image.GetMetaData(key).strip()
    return found


def _values(array: Array, prefix: str, names: dict[float, str], source: str) -> Iterator[Label]:
    """Yield a label for each value other than 0, in order."""
    found: set[float] = set()
    for layer in array:
        found.update(float(value) for value in np.unique(layer) if value != 0 and np.isfinite(value))
        if len(found) > _MOST_LABELS:
            raise UserError(
                f"mask {source} has more than {_MOST_LABELS} different values; it looks like an image, not a mask"
            )
    for value in sorted(found):
        yield Label(f"{prefix}{value:g}", value, names.get(value, ""), partial(np.equal, array, value))
