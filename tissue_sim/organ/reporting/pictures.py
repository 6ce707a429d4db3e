"""Pictures of the stages of a build, as PNG: slices with outlines, both surfaces, the skeleton, histograms.

Lengths are millimetres in the frame of the organ.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from tissue_sim.array_types import Floats, Ints
from tissue_sim.figures import empty_figure, png
from tissue_sim.organ.imaging.image import Volume
from tissue_sim.organ.reporting.render import Solid, View, balls, draw, rods, view_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


Surface = tuple[Floats, Ints]

# Okabe and Ito's colours, which colour-blind readers can tell apart.
MASK, CUBES, BALLOON, ATOMS = "#f0e442", "#56b4e9", "#d55e00", "#cc79a7"
_CUBES_SKIN, _BALLOON_SKIN = (0.52, 0.76, 0.92), (0.95, 0.66, 0.46)
_GLASS, _ATOM, _BONE, _SPOKE = (0.45, 0.55, 0.70), (0.78, 0.18, 0.12), (0.30, 0.30, 0.34), (0.55, 0.62, 0.72)
_MARGIN = 25.0  # mm of neighbourhood shown around the organ
_WINDOW = (-160.0, 240.0)  # HU, the usual window for soft tissue
_NEAR = 1.5  # mm: atoms this close to a slice are shown on it
_PICTURE = 620  # pixels, the longer side of a rendered picture
_STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.size": 11.0,
    "axes.edgecolor": "#888888",
    "axes.linewidth": 0.7,
    "axes.titlesize": 11.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
}


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

    Returns
    -------
    bytes
        The PNG file.
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
    with _styled(width, tallest * inches + 0.85) as figure:
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


# surfaces and skeleton -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Picture:
    """Rendered picture.

    Attributes
    ----------
    png : bytes
        The PNG file.
    width : int
        Width in pixels.
    bar : float
        Length of its scale bar, mm.
    """

    png: bytes
    width: int
    bar: float


def views(positions: Floats) -> tuple[View, View]:
    """Return two views with z up that the points fill: from the front (-y) and the side (+x), the broader first.

    Both look slightly from above and from beside, so that the shape shows.

    Parameters
    ----------
    positions : Floats, shape (n, 3), mm
        Points.

    Returns
    -------
    tuple[View, View]
        The views.
    """
    found = []
    for towards in ((0.35, -1.0, 0.22), (1.0, -0.35, 0.22)):
        square = view_of(positions, towards, (0.0, 0.0, 1.0), (_PICTURE, _PICTURE))
        local = (positions - square.centre) @ square.axes.T
        wide, high = (np.ptp(local, axis=0)[:2] / np.ptp(local, axis=0)[:2].max() * _PICTURE).clip(_PICTURE / 2.2)
        size = (int(wide), int(high))
        found.append(view_of(positions, towards, (0.0, 0.0, 1.0), size))
    area = [float(np.prod(np.ptp(positions @ view.axes[:2].T, axis=0))) for view in found]
    return (found[0], found[1]) if area[0] >= area[1] else (found[1], found[0])


def surface_picture(view: View, surface: Surface, *, cubes: bool) -> Picture:
    """Return a picture of shaded triangles with their edges.

    Parameters
    ----------
    view : View
        The camera.
    surface : Surface
        The surface, mm.
    cubes : bool
        Whether it has the colour of marching cubes; otherwise that of the balloon.

    Returns
    -------
    Picture
        The picture.
    """
    skin = _CUBES_SKIN if cubes else _BALLOON_SKIN
    edge = float(np.linalg.norm(surface[0][surface[1][:, 0]] - surface[0][surface[1][:, 1]], axis=1).mean())
    # Lines are thin where triangles are few pixels wide, or they would cover everything.
    lines = float(np.clip(0.06 * edge * view.scale, 0.25, 0.9))
    return _with_bar(view, draw(view, [Solid(*surface, skin, lines, smooth=False)]))


def skeleton_picture(view: View, surface: Surface, atoms: Floats, links: Ints) -> Picture:
    """Return a picture of the medial atoms and their links inside the translucent surface (Fig. 4 A).

    Parameters
    ----------
    view : View
        The camera.
    surface : Surface
        The surface, mm.
    atoms : Floats, shape (a, 3), mm
        Medial atoms.
    links : Ints, shape (m, 2)
        Pairs of neighbouring atoms.

    Returns
    -------
    Picture
        The picture.
    """
    return _with_bar(view, draw(view, _skeleton(view, atoms, links), Solid(*surface, _GLASS)))


def spokes_picture(view: View, nodes: Floats, surface: int, atoms: Floats, links: Ints, spokes: Ints) -> Picture:
    """Return a picture of the skeleton and the spokes, without the surface (Fig. 4 B).

    Parameters
    ----------
    view : View
        The camera.
    nodes : Floats, shape (n, 3), mm
        All nodes.
    surface : int
        Number of nodes on the surface, which come first.
    atoms : Floats, shape (a, 3), mm
        Medial atoms.
    links : Ints, shape (m, 2)
        Pairs of neighbouring atoms.
    spokes : Ints, shape (s, 2)
        Pairs of nodes.

    Returns
    -------
    Picture
        The picture.
    """
    solids = [*_skeleton(view, atoms, links), rods(nodes, spokes, 0.45 / view.scale, _SPOKE, 4)]
    return _with_bar(view, draw(view, [*solids, balls(nodes[:surface], 1.2 / view.scale, _BALLOON_SKIN)]))


def _skeleton(view: View, atoms: Floats, links: Ints) -> list[Solid]:
    gap = np.linalg.norm(atoms[links[:, 0]] - atoms[links[:, 1]], axis=1)
    ball = float(np.clip(0.42 * (gap.min() if len(gap) else np.inf), 2.2 / view.scale, 5.0 / view.scale))
    return [balls(atoms, ball, _ATOM), rods(atoms, links, 0.45 * ball, _BONE)]


def _with_bar(view: View, pixels: NDArray[np.uint8]) -> Picture:
    from matplotlib.image import imsave

    height, width, _ = pixels.shape
    length = nice_length(0.25 * width / view.scale)
    end = 12 + round(length * view.scale)
    pixels[height - 14 : height - 10, 12:end] = 40
    buffer = io.BytesIO()
    imsave(buffer, pixels, format="png")
    return Picture(buffer.getvalue(), width, length)


def nice_length(most: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is at most `most`."""
    power = 10.0 ** np.floor(np.log10(most))
    return float(power * max(k for k in (1, 2, 5) if k * power <= most * (1.0 + 1e-9)))


# histograms -----------------------------------------------------------------------------------------


def histograms(sets: Sequence[tuple[str, str, Floats, Floats]]) -> bytes:
    """Return a PNG of two histograms, of edge lengths and of angles, as fractions of each set.

    Parameters
    ----------
    sets : Sequence[tuple[str, str, Floats, Floats]]
        Label, colour, edge lengths (e,) mm and angles (a,) degrees of each set.

    Returns
    -------
    bytes
        The PNG file.
    """
    with _styled(9.0, 2.9) as figure:
        left, right = figure.subplots(1, 2)
        longest = max(float(np.quantile(edges, 0.999)) for _, _, edges, _ in sets)
        bins = (np.linspace(0.0, 1.05 * longest, 60), np.linspace(0.0, 180.0, 61))
        for label, colour, edges, angles in sets:
            for axis, values, steps in ((left, edges, bins[0]), (right, angles, bins[1])):
                weights = np.full(len(values), 100.0 / len(values))
                options: dict[str, Any] = {"bins": steps, "weights": weights, "color": colour}
                axis.hist(values, histtype="stepfilled", alpha=0.35, **options)
                axis.hist(values, histtype="step", linewidth=1.3, label=label, **options)
        left.set_xlabel("edge length (mm)")
        right.set_xlabel("angle of a triangle (degrees)")
        left.set_ylabel("fraction (%)")
        right.set_xticks(range(0, 181, 30))
        left.legend(frameon=False)
        return png(figure, 160)


@contextmanager
def _styled(width: float, height: float) -> Iterator[Any]:
    """Yield an empty figure, inches, in one style; without pyplot, which would keep state for the whole process."""
    import matplotlib

    with matplotlib.rc_context(_STYLE):
        yield empty_figure(width, height)
