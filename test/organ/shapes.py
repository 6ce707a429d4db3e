"""Volumes for the tests of the organ pipeline: shapes of known size, and CTs as files."""

import time

import numpy as np
import SimpleITK as sitk

from tissue_sim.organ.image import Volume


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


def write_dicom(folder, volume: Volume, uid: str = "1.2.826.0.1.3680043.2.1125.1", skip=(), description="abdomen"):
    """Write a CT series with rescale slope and intercept, slices in scrambled file order."""
    folder.mkdir(exist_ok=True)
    image = sitk.Cast(volume.to_sitk(), sitk.sitkInt16)
    axes = volume.direction.T
    for k in range(image.GetDepth()):
        if k in skip:
            continue
        part = image[:, :, k]
        position = volume.to_points([0, 0, k])
        for tag, value in {
            "0008|0008": "DERIVED\\SECONDARY",
            "0008|0031": time.strftime("%H%M%S"),
            "0008|0060": "CT",
            "0008|103e": description,
            "0020|000e": uid,
            "0020|0013": str(k),
            "0020|0032": "\\".join(f"{v:.6f}" for v in position),
            "0020|0037": "\\".join(f"{v:.6f}" for v in [*axes[0], *axes[1]]),
            "0018|0050": f"{volume.spacing[2]:g}",
        }.items():
            part.SetMetaData(tag, value)
        writer = sitk.ImageFileWriter()
        writer.KeepOriginalImageUIDOn()
        writer.SetFileName(str(folder / f"{uid[-1]}_{(k * 7) % 97:02d}.dcm"))
        writer.Execute(part)
