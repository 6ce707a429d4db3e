"""Pictures of the stages of a build, as PNG: slices with outlines, both surfaces, the skeleton, histograms.

Lengths are millimetres in the frame of the organ.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Ints
from tissue_sim.figures import empty_figure, png
from tissue_sim.organ.reporting.render import Solid, View, balls, draw, rods, view_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.typing import RcKeyType


Surface = tuple[Floats, Ints]
# Okabe and Ito's colours, which colour-blind readers can tell apart.
MASK, CUBES, BALLOON, ATOMS = "#f0e442", "#56b4e9", "#d55e00", "#cc79a7"
_CUBES_SKIN, _BALLOON_SKIN = (0.52, 0.76, 0.92), (0.95, 0.66, 0.46)
_GLASS, _ATOM, _BONE, _SPOKE = (0.45, 0.55, 0.70), (0.78, 0.18, 0.12), (0.30, 0.30, 0.34), (0.55, 0.62, 0.72)
_PICTURE = 620  # pixels, the longer side of a rendered picture
_STYLE: dict[RcKeyType, object] = {
    "font.family": "sans-serif",
    "font.size": 11.0,
    "axes.edgecolor": "#888888",
    "axes.linewidth": 0.7,
    "axes.titlesize": 11.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
}


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


def histograms(sets: Sequence[tuple[str, str, Floats, Floats]]) -> bytes:
    """Return a PNG of two histograms, of edge lengths and of angles, as fractions of each set.

    Parameters
    ----------
    sets : Sequence[tuple[str, str, Floats, Floats]]
        Label, colour, edge lengths (e,) mm and angles (a,) degrees of each set.
    """
    with styled_figure(9.0, 2.9) as figure:
        left, right = figure.subplots(1, 2)
        longest = max(float(np.quantile(edges, 0.999)) for _, _, edges, _ in sets)
        bins = (np.linspace(0.0, 1.05 * longest, 60), np.linspace(0.0, 180.0, 61))
        for label, colour, edges, angles in sets:
            for axis, values, steps in ((left, edges, bins[0]), (right, angles, bins[1])):
                weights = np.full(len(values), 100.0 / len(values))
                plot = partial(axis.hist, values, bins=steps, weights=weights, color=colour)
                plot(histtype="stepfilled", alpha=0.35)
                plot(histtype="step", linewidth=1.3, label=label)
        left.set_xlabel("edge length (mm)")
        right.set_xlabel("angle of a triangle (degrees)")
        left.set_ylabel("fraction (%)")
        right.set_xticks(range(0, 181, 30))
        left.legend(frameon=False)
        return png(figure, 160)


@contextmanager
def styled_figure(width: float, height: float) -> Iterator[Figure]:
    """Yield an empty figure, inches, in one style; without pyplot, which would keep state for the whole process."""
    import matplotlib

    with matplotlib.rc_context(_STYLE):
        yield empty_figure(width, height)
