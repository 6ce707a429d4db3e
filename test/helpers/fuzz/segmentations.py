"""DICOM segmentations: fields that lie, segments that aren't there, frames that lie nowhere, parts cut off."""

import tempfile
from functools import cache
from io import BytesIO
from pathlib import Path

import numpy as np
from hypothesis import strategies as st
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.pixels import pack_bits
from pydicom.uid import UID, ExplicitVRLittleEndian

from helpers.frames import item
from helpers.fuzz.child import Input, Ready
from helpers.fuzz.dicom import changed_field
from helpers.fuzz.images import check_place
from helpers.fuzz.mutations import Draw, mutation, of_bytes, some
from tissue_sim.organ.imaging.masks import read_mask

_STORAGE = {"BINARY": "66.4", "FRACTIONAL": "66.4", "LABELMAP": "66.7"}  # behind 1.2.840.10008.5.1.4.1.1.
_UID = "1.2.826.0.1.3680043.2.1125"
_LABELS = None, 1, 2, 7, "liver", "tumour", "no such"

# Group and element of what says which frames are whose, where they lie and how their pixels are to be read.
_TAGS = {
    "frames": (0x28, 0x08),
    "rows": (0x28, 0x10),
    "columns": (0x28, 0x11),
    "bits": (0x28, 0x100),
    "bits stored": (0x28, 0x101),
    "high bit": (0x28, 0x102),
    "pixel spacing": (0x28, 0x30),
    "spacing between slices": (0x18, 0x88),
    "position": (0x20, 0x32),
    "orientation": (0x20, 0x37),
    "type": (0x62, 0x01),
    "segments": (0x62, 0x02),
    "segment number": (0x62, 0x04),
    "segment label": (0x62, 0x05),
    "referenced segment": (0x62, 0x0B),
    "largest fraction": (0x62, 0x0E),
    "groups of each frame": (0x5200, 0x9230),
    "groups of all frames": (0x5200, 0x9229),
    "class": (0x08, 0x16),
    "transfer syntax": (0x02, 0x10),
    "pixels": (0x7FE0, 0x10),
}


def prepare(path: Path, label: int | str | None) -> Ready:
    """Read one of each kind, intact."""
    _use_intact()
    return lambda: _use(path, label)


@cache
def _use_intact() -> None:
    for kind in _STORAGE:
        path = Path(tempfile.gettempdir()) / f"{kind}.dcm"
        path.write_bytes(_written(kind))
        _use(path, "liver")


def _use(path: Path, label: int | str | None) -> str:
    volume = read_mask(path, label)
    check_place(volume)
    return f"{' x '.join(map(str, volume.size))} voxels, {np.count_nonzero(volume.array)} of the segment"


@st.composite
def segmentations(draw: Draw) -> Input:
    """Segmentations with one or more mutations, from which one segment is requested."""
    data = _written(some(draw, tuple(_STORAGE)))
    for _ in range(draw(st.integers(1, 3))):
        if data:
            data = mutation(draw, (_field, _field, of_bytes))(draw, data)
    return Input({"seg.dcm": data}, "seg.dcm", prepare, (some(draw, _LABELS),))


def _field(draw: Draw, data: bytes) -> bytes:
    return changed_field(draw, data, _TAGS)


# whole files --------------------------------------------------------------------------------------


@cache
def _written(kind: str) -> bytes:
    """Two boxes that overlap, the second without some of its slices."""
    liver, tumour = np.zeros((8, 24, 20), dtype=bool), np.zeros((8, 24, 20), dtype=bool)
    liver[:, 4:20, 3:15] = True
    tumour[2:6, 8:16, 8:18] = True
    tumour[4] = False
    if kind == "LABELMAP":
        frames, places = np.where(tumour, 2, liver.astype(np.uint8)).astype(np.uint8), [(0, z) for z in range(8)]
    else:
        places = [(k, z) for k, mask in enumerate((liver, tumour), 1) for z in range(8) if mask[z].any()]
        frames = np.stack([(liver, tumour)[k - 1][z] for k, z in places]).astype(np.uint8)
    file = _described(kind, frames.shape)
    file.PerFrameFunctionalGroupsSequence = [_of_frame(number, z) for number, z in places]
    file.PixelData = pack_bits(frames) if kind == "BINARY" else (frames * (1 if kind == "LABELMAP" else 200)).tobytes()
    stream = BytesIO()
    file.save_as(stream, enforce_file_format=True)
    return stream.getvalue()


def _described(kind: str, shape: tuple[int, ...]) -> Dataset:
    """A file for frames (n, rows, columns) of one kind, without the frames."""
    file = Dataset()
    file.file_meta = FileMetaDataset()
    file.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    file.file_meta.MediaStorageSOPClassUID = file.SOPClassUID = UID(f"1.2.840.10008.5.1.4.1.1.{_STORAGE[kind]}")
    file.file_meta.MediaStorageSOPInstanceUID = file.SOPInstanceUID = UID(f"{_UID}.1")
    file.StudyInstanceUID, file.SeriesInstanceUID = f"{_UID}.2", f"{_UID}.3"
    file.FrameOfReferenceUID, file.Modality, file.SegmentationType = f"{_UID}.4", "SEG", kind
    file.NumberOfFrames, file.Rows, file.Columns = shape
    file.SamplesPerPixel, file.PhotometricInterpretation, file.PixelRepresentation = 1, "MONOCHROME2", 0
    bits = 1 if kind == "BINARY" else 8
    file.BitsAllocated, file.BitsStored, file.HighBit = bits, bits, bits - 1
    if kind == "FRACTIONAL":
        file.MaximumFractionalValue = 200
    file.SegmentSequence = [
        item(SegmentNumber=number, SegmentLabel=name) for number, name in ((1, "liver"), (2, "tumour"))
    ]
    measures = item(PixelSpacing=[2.0, 2.5], SliceThickness=3.0, SpacingBetweenSlices=3.0)
    plane = item(ImageOrientationPatient=[1, 0, 0, 0, 1, 0])
    file.SharedFunctionalGroupsSequence = [item(PixelMeasuresSequence=[measures], PlaneOrientationSequence=[plane])]
    return file


def _of_frame(segment: int, z: int) -> Dataset:
    """The functional groups of a frame: its position, and its segment; segment 0 stands for all."""
    found = item(PlanePositionSequence=[item(ImagePositionPatient=[10.0, 20.0, 30.0 + 3.0 * z])])
    if segment:
        found.SegmentIdentificationSequence = [item(ReferencedSegmentNumber=segment)]
    return found
