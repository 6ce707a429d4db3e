"""DICOM files of many frames, as scanners and annotation programs write them."""

import numpy as np
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.pixels import pack_bits
from pydicom.uid import ExplicitVRLittleEndian

SEGMENTATION, ENHANCED_CT = "1.2.840.10008.5.1.4.1.1.66.4", "1.2.840.10008.5.1.4.1.1.2.1"
LABEL_MAP = "1.2.840.10008.5.1.4.1.1.66.7"
PIXEL = (0.81, 0.7)  # mm from row to row, from column to column


def item(**values):
    """A dataset of these elements."""
    found = Dataset()
    for name, value in values.items():
        setattr(found, name, value)
    return found


def frame_file(path, storage, frames, positions, *, step=2.0, shared=None, own=(), pixel_measures="shared", **elements):
    """Write frames (n, rows, columns) that lie at positions z, mm, of slices `step` apart.

    shared: further functional groups of all frames; own: of each. pixel_measures: where the pixels' size stands,
    `shared` or `frame`.
    """
    measures = item(PixelSpacing=list(PIXEL), SliceThickness=step, SpacingBetweenSlices=step)
    groups = item(PlaneOrientationSequence=[item(ImageOrientationPatient=[1, 0, 0, 0, 1, 0])], **(shared or {}))
    file = Dataset()
    file.file_meta = FileMetaDataset()
    file.file_meta.MediaStorageSOPClassUID = file.SOPClassUID = storage
    file.file_meta.MediaStorageSOPInstanceUID = file.SOPInstanceUID = "1.2.826.0.1.3680043.2.1125.50"
    file.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    file.StudyInstanceUID, file.SeriesInstanceUID = "1.2.826.0.1.3680043.2.1125.51", "1.2.826.0.1.3680043.2.1125.52"
    file.FrameOfReferenceUID, file.PatientName, file.Modality = "1.2.826.0.1.3680043.2.1125.53", "Phantom", "CT"
    file.NumberOfFrames, file.Rows, file.Columns = frames.shape
    file.SamplesPerPixel, file.PhotometricInterpretation = 1, "MONOCHROME2"
    for name, value in elements.items():
        setattr(file, name, value)
    per_frame = []
    for k, z in enumerate(positions):
        group = item(PlanePositionSequence=[item(ImagePositionPatient=[10.0, 20.0, z])], **(own[k] if own else {}))
        if pixel_measures == "frame":
            group.PixelMeasuresSequence = [measures]
        per_frame.append(group)
    if pixel_measures == "shared":
        groups.PixelMeasuresSequence = [measures]
    file.SharedFunctionalGroupsSequence, file.PerFrameFunctionalGroupsSequence = [groups], per_frame
    file.save_as(path, enforce_file_format=True)
    return path


def segmentation(path, segments, *, kind="BINARY", pixel_measures="shared"):
    """Write segments, name to bool (nz, rows, columns), as a DICOM segmentation that leaves out empty frames."""
    places = [(k, z) for k, mask in enumerate(segments.values(), 1) for z in range(len(mask)) if mask[z].any()]
    masks = list(segments.values())
    frames = np.stack([masks[k - 1][z] for k, z in places])
    names = [item(SegmentNumber=k, SegmentLabel=name) for k, name in enumerate(segments, 1)]
    own = [{"SegmentIdentificationSequence": [item(ReferencedSegmentNumber=k)]} for k, _ in places]
    bits = {"BitsAllocated": 1, "BitsStored": 1, "HighBit": 0, "PixelData": pack_bits(frames.astype(np.uint8))}
    if kind == "FRACTIONAL":
        bits = {"BitsAllocated": 8, "BitsStored": 8, "HighBit": 7, "MaximumFractionalValue": 200}
        bits["PixelData"] = np.where(frames, 100, 99).astype(np.uint8).tobytes()
    positions = [30.0 + 2.0 * z for _, z in places]
    more = {"SegmentSequence": names, "SegmentationType": kind, "PixelRepresentation": 0, **bits}
    return frame_file(path, SEGMENTATION, frames, positions, own=own, pixel_measures=pixel_measures, **more)


def label_map(path, labels, names):
    """Write labels (nz, rows, columns) uint8 as a segmentation whose voxels are numbers of segments."""
    described = [item(SegmentNumber=number, SegmentLabel=name) for number, name in names.items()]
    bits = {"BitsAllocated": 8, "BitsStored": 8, "HighBit": 7, "PixelRepresentation": 0}
    positions = [30.0 + 2.0 * z for z in range(len(labels))]
    more = {"SegmentSequence": described, "SegmentationType": "LABELMAP", "PixelData": labels.tobytes(), **bits}
    return frame_file(path, LABEL_MAP, labels, positions, **more)


def enhanced_ct(path, values, positions, intercepts=None):
    """Write HU (n, rows, columns), each frame at its position z, mm, as an Enhanced CT.

    intercepts: that each frame says it has; the values are stored with -1024.
    """
    bits = {"BitsAllocated": 16, "BitsStored": 16, "HighBit": 15, "PixelRepresentation": 0}
    pixels = (values + 1024).astype("<u2").tobytes()
    rescales = [
        {"PixelValueTransformationSequence": [item(RescaleIntercept=intercept, RescaleSlope=1, RescaleType="HU")]}
        for intercept in intercepts or [-1024]
    ]
    groups = {"own": rescales} if intercepts else {"shared": rescales[0]}
    return frame_file(path, ENHANCED_CT, values, positions, PixelData=pixels, **groups, **bits)
