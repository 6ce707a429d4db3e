"""Slices of an image, with the outlines of mask and surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from tissue_sim.array_types import Floats
from tissue_sim.figures import png
from tissue_sim.organ.imaging.image import Volume
from tissue_sim.organ.reporting.pictures import ATOMS, MASK, Surface, nice_length, styled_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_MARGIN = 25.0  # mm of neighbourhood shown around the organ
_WINDOW = (-160.0, 240.0)  # HU, the usual window for soft tissue
_NEAR = 1.5  # mm: atoms this close to a slice are shown on it


@dataclass(frozen=True)
class Plane:
    """Slice plane of the patient frame.

    Attributes
    ----------
    name : str
        Name for the title.
    across : int
        Axis perpendicular to the plane.
    right : int
        Axis that points right in the picture.
    up : int
        Axis that is vertical in the picture.
    up_sign : int
        -1 where that axis points down.
    letters : str
        Letters at the left, right, top and bottom border, for the frame LPS.
    """

    name: str
    across: int
    right: int
    up: int
    up_sign: int
    letters: str


# Views as in radiology: axial from the feet, coronal from the front, sagittal from the patient's left.
PLANES = (
    Plane("axial", 2, 0, 1, -1, "RLAP"),
    Plane("coronal", 1, 0, 2, +1, "RLHF"),
    Plane("sagittal", 0, 1, 2, +1, "APHF"),
)


@dataclass(frozen=True, eq=False)
class Source:
    """What an organ was built from.

    Attributes
    ----------
    ct : Volume | None
        The image; None for none.
    mask : Volume | None
        The mask; None for none.
    patient : bool
        Whether their frame is LPS, so that the borders are lettered.
    seed : Floats | None, shape (3,), mm
        Seed point; None for none.
    """

    ct: Volume | None
    mask: Volume | None
    patient: bool
    seed: Floats | None = None


def slices(source: Source, outlines: Sequence[tuple[str, str, Surface]], atoms: Floats, centre: Floats) -> bytes:
    """Return a PNG of three slices through the CT (or the mask), with the outlines of the mask and of surfaces.

    Parameters
    ----------
    source : Source
        What the organ was built from.
    outlines : Sequence[tuple[str, str, Surface]]
        Label, colour and surface (mm) of each outline.
    atoms : Floats, shape (a, 3), mm
        Medial atoms, shown where they lie near a slice.
    centre : Floats, shape (3,), mm
        Point through which the slices go.
    """
    ct, seed = source.ct, source.seed
    everything = np.concatenate([surface[0] for _, _, surface in outlines])
    low, high = everything.min(axis=0) - _MARGIN, everything.max(axis=0) + _MARGIN
    if ct is not None:
        corners = ct.to_points(np.indices((2, 2, 2)).reshape(3, -1).T * (np.array(ct.size) - 1))
        low, high = np.maximum(low, corners.min(axis=0)), np.minimum(high, corners.max(axis=0))
    extent = high - low
    ratios = [extent[plane.right] for plane in PLANES]
    width = 12.0
    tallest = max(extent[plane.up] for plane in PLANES)
    inches = width / sum(ratios)
    with styled_figure(width, tallest * inches + 0.85) as figure:
        axes = figure.subplots(1, 3, width_ratios=ratios)
        for axis, plane in zip(axes, PLANES, strict=True):
            _slice(axis, plane, ct, source.mask, (low, high), centre)
            _outline(axis, plane, outlines, centre)
            near = atoms[np.abs(atoms[:, plane.across] - centre[plane.across]) < _NEAR]
            axis.plot(near[:, plane.right], near[:, plane.up], "o", color=ATOMS, markersize=3.2, zorder=6)
            if seed is not None and abs(seed[plane.across] - centre[plane.across]) < _NEAR:
                axis.plot(seed[plane.right], seed[plane.up], "+", color="white", markersize=9, zorder=7)
            _borders(axis, plane, source.patient)
            axis.set_title(
                f"{plane.name if source.patient else 'across'} {'xyz'[plane.across]} = {centre[plane.across]:.1f} mm"
            )
        _slice_legend(figure, outlines, source.mask is not None)
        return png(figure, 160)


def _slice(
    axis: Axes, plane: Plane, ct: Volume | None, mask: Volume | None, box: tuple[Floats, Floats], centre: Floats
) -> None:
    low, high = box
    source = ct if ct is not None else mask
    step = 0.6 if source is None else max(0.5 * float(source.spacing.min()), 0.002 * float((high - low).max()))
    right = np.arange(low[plane.right], high[plane.right] + step, step)
    up = np.arange(low[plane.up], high[plane.up] + step, step)
    points = np.empty((len(up), len(right), 3))
    points[..., plane.across] = centre[plane.across]
    points[..., plane.right], points[..., plane.up] = right[None], up[:, None]
    shown = (right[0], right[-1], up[0], up[-1])
    if ct is not None:
        values = _sampled(ct, points, -1000.0)
        axis.imshow(
            values, cmap="gray", vmin=_WINDOW[0], vmax=_WINDOW[1], extent=shown, origin="lower", interpolation="bicubic"
        )
    else:
        axis.set_facecolor("#3a3a3a")
    if mask is not None:
        inside = _sampled(mask, points, 0.0)
        if ct is None:
            grey = np.where(inside > 0.5, 0.62, 0.23)
            axis.imshow(grey, cmap="gray", vmin=0.0, vmax=1.0, extent=shown, origin="lower")
        if inside.min() < 0.5 < inside.max():
            axis.contour(right, up, inside, levels=[0.5], colors=[MASK], linewidths=0.9, zorder=3)
    axis.set_xlim(right[0], right[-1])
    axis.set_ylim(*((up[0], up[-1]) if plane.up_sign > 0 else (up[-1], up[0])))
    axis.set_aspect("equal")


def _sampled(volume: Volume, points: Floats, outside: float) -> NDArray[np.float32]:
    """Return values of the image (linear) or the mask (nearest voxel, so that its steps show) at points (h, w, 3)."""
    index = np.moveaxis(volume.to_index(points), -1, 0)[::-1]
    array, order = (volume.array.astype(np.uint8), 0) if volume.array.dtype == bool else (volume.array, 1)
    return map_coordinates(array, index, output=np.float32, order=order, mode="constant", cval=outside)


def _outline(axis: Axes, plane: Plane, outlines: Sequence[tuple[str, str, Surface]], centre: Floats) -> None:
    from matplotlib.collections import LineCollection

    normal = np.eye(3)[plane.across]
    for k, (_, colour, (positions, triangles)) in enumerate(outlines):
        mesh = trimesh.Trimesh(positions, triangles, process=False)
        # A plane exactly through a point of the mesh would cut it twice.
        parts = np.asarray(trimesh.intersections.mesh_plane(mesh, normal, centre + 1.234e-4 * normal))
        if len(parts):
            lines = parts.reshape(-1, 2, 3)[..., [plane.right, plane.up]]
            axis.add_collection(LineCollection(list(lines), colors=colour, linewidths=2.0 - 1.0 * k, zorder=4 + k))


def _borders(axis: Axes, plane: Plane, patient: bool) -> None:
    for side in ("top", "right", "bottom", "left"):
        axis.spines[side].set_visible(True)
    if not patient:
        axis.set_xlabel(f"{'xyz'[plane.right]} (mm)")
        axis.set_ylabel(f"{'xyz'[plane.up]} (mm)")
        return
    axis.set_xticks([])
    axis.set_yticks([])
    for letter, (x, y) in zip(plane.letters, ((0.03, 0.5), (0.97, 0.5), (0.5, 0.96), (0.5, 0.04)), strict=True):
        axis.text(x, y, letter, color="white", ha="center", va="center", transform=axis.transAxes, fontweight="bold")
    left, right = axis.get_xlim()
    bottom, top = axis.get_ylim()
    length = nice_length(0.25 * abs(right - left))
    x, y = left + 0.05 * (right - left), bottom + 0.05 * (top - bottom)
    axis.plot([x, x + length], [y, y], color="white", linewidth=2.0, solid_capstyle="butt", zorder=8)
    axis.text(
        x + 0.5 * length,
        y + 0.015 * (top - bottom),
        f"{length:g} mm",
        color="white",
        ha="center",
        va="bottom",
        zorder=8,
    )


def _slice_legend(figure: Figure, outlines: Sequence[tuple[str, str, Surface]], with_mask: bool) -> None:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=MASK, lw=2, label="mask")] if with_mask else []
    handles += [Line2D([], [], color=colour, lw=2, label=label) for label, colour, _ in outlines]
    handles.append(Line2D([], [], color=ATOMS, marker="o", lw=0, markersize=4, label="medial atoms near the slice"))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
