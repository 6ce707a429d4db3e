"""Volumes for the tests of the organ pipeline: shapes of known size, and CTs as files."""

import struct

import numpy as np

from tissue_sim.organ.imaging.image import Volume


def solid(shape, spacing=(1.0, 1.0, 1.0), size=(50, 50, 50), direction=None):
    """Mask of the points (mm from the grid's middle) where shape(x, y, z) is negative."""
    step = np.array(spacing)
    axes = [step[k] * (np.arange(size[k]) - 0.5 * (size[k] - 1)) for k in range(3)]
    z, y, x = np.meshgrid(axes[2], axes[1], axes[0], indexing="ij")
    origin = np.array([a[0] for a in axes])
    return Volume(shape(x, y, z) < 0, step, origin, np.eye(3) if direction is None else direction, "test")


def ball(radius):
    return lambda x, y, z: np.sqrt(x**2 + y**2 + z**2) - radius


def small_volume(direction=None) -> Volume:
    """A volume of 7 x 6 x 5 voxels with a different value in each."""
    array = np.arange(5 * 6 * 7, dtype=np.float32).reshape(5, 6, 7)
    return Volume(
        array,
        np.array([0.8, 0.9, 2.5]),
        np.array([-40.0, 12.5, 300.0]),
        np.eye(3) if direction is None else direction,
        "small",
    )


def write_dicom(
    folder,
    volume: Volume,
    uid: str = "1.2.826.0.1.3680043.2.1125.1",
    skip=(),
    description="abdomen",
    rescale=(1.0, 0.0),
    shear=0.0,
    changed=None,
):
    """Write a CT series with rescale slope and intercept, slices in scrambled file order.

    shear: mm that each slice shifts along its rows, as under a tilted gantry; changed: tags set otherwise, or left
    out (None).
    """
    folder.mkdir(exist_ok=True, parents=True)
    slope, intercept = rescale
    stored = np.round((volume.array - intercept) / slope).astype("<i2")
    axes = volume.direction.T
    for k in range(len(stored)):
        if k in skip:
            continue
        position = volume.to_points([0, 0, k]) + k * shear * axes[0]
        tags = {
            (0x0008, 0x0008): ("CS", "ORIGINAL\\PRIMARY\\AXIAL"),
            (0x0008, 0x0016): ("UI", CT_IMAGE),
            (0x0008, 0x0018): ("UI", f"{uid}.{k + 1}"),
            (0x0008, 0x0060): ("CS", "CT"),
            (0x0008, 0x103E): ("LO", description),
            (0x0020, 0x000D): ("UI", "1.2.826.0.1.3680043.2.1125.99"),
            (0x0020, 0x000E): ("UI", uid),
            (0x0020, 0x0013): ("IS", str(len(stored) - k)),
            (0x0020, 0x0032): ("DS", _decimals(position)),
            (0x0020, 0x0037): ("DS", _decimals([*axes[0], *axes[1]])),
            (0x0028, 0x0030): ("DS", _decimals(volume.spacing[[1, 0]])),
            (0x0028, 0x1052): ("DS", f"{intercept:g}"),
            (0x0028, 0x1053): ("DS", f"{slope:g}"),
            **(changed or {}),
        }
        write_slice(folder / f"{uid[-1]}_{(k * 7) % 997:03d}.dcm", stored[k], tags)


CT_IMAGE = "1.2.840.10008.5.1.4.1.1.2"


def _decimals(values) -> str:
    return "\\".join(f"{value:.8g}"[:16] for value in values)


def write_slice(path, pixels, tags):
    """One CT slice, pixels (rows, columns) int16, as DICOM in explicit little-endian; tags: {tag: (VR, text)}."""
    rows, columns = pixels.shape
    numbers = {0x0002: 1, 0x0010: rows, 0x0011: columns, 0x0100: 16, 0x0101: 16, 0x0102: 15, 0x0103: 1}
    elements = {tag: value for tag, value in tags.items() if value is not None}
    elements |= {(0x0028, item): ("US", value) for item, value in numbers.items()}
    elements[0x0028, 0x0004] = ("CS", "MONOCHROME2")
    elements[0x7FE0, 0x0010] = ("OW", pixels.astype("<i2").tobytes())
    meta = {
        (0x0002, 0x0001): ("OB", b"\0\1"),
        (0x0002, 0x0002): ("UI", CT_IMAGE),
        (0x0002, 0x0003): ("UI", elements.get((0x0008, 0x0018), ("UI", "1.2"))[1]),
        (0x0002, 0x0010): ("UI", "1.2.840.10008.1.2.1"),
    }
    head = b"".join(_element(tag, *meta[tag]) for tag in sorted(meta))
    group = _element((0x0002, 0x0000), "UL", struct.pack("<I", len(head)))
    path.write_bytes(
        bytes(128) + b"DICM" + group + head + b"".join(_element(t, *elements[t]) for t in sorted(elements))
    )


def _element(tag, kind, value) -> bytes:
    if kind == "US":
        value = struct.pack("<H", value)
    elif isinstance(value, str):
        value = value.encode()
        value += (b"\0" if kind == "UI" else b" ") * (len(value) % 2)
    wide = kind in ("OB", "OW")
    length = struct.pack("<2xI", len(value)) if wide else struct.pack("<H", len(value))
    return struct.pack("<2H", *tag) + kind.encode() + length + value


def write_nifti(path, array, affine=None, quaternion=None, unit=2, scaling=(1.0, 0.0)):
    """Write a NIfTI-1 file byte by byte: array (nx, ny, nz[, nt]) int16 or float32.

    affine (4, 4): the sform, RAS; quaternion: the qform's (b, c, d), offset (3,), spacing (3,) and handedness
    (1 or -1); unit: 1 m, 2 mm, 3 um.
    """
    header = bytearray(352)
    struct.pack_into("<i", header, 0, 348)
    struct.pack_into("<8h", header, 40, array.ndim, *array.shape, *[1] * (7 - array.ndim))
    struct.pack_into("<2h", header, 70, {"i2": 4, "f4": 16}[array.dtype.str[1:]], 8 * array.itemsize)
    spacing, hand = np.ones(3), 1.0
    if affine is not None:
        spacing = np.linalg.norm(affine[:3, :3], axis=0)
        struct.pack_into("<12f", header, 280, *affine[:3].ravel())
    if quaternion is not None:
        turn, offset, spacing, hand = quaternion
        struct.pack_into("<6f", header, 256, *turn, *offset)
    struct.pack_into("<8f", header, 76, hand, *spacing, 1.0, 0.0, 0.0, 0.0)
    struct.pack_into("<3f", header, 108, 352.0, *scaling)
    header[123] = unit
    struct.pack_into("<2h", header, 252, quaternion is not None, affine is not None)
    header[344:348] = b"n+1\0"
    path.write_bytes(bytes(header) + array.tobytes(order="F"))
