"""Figure 6 of the paper: nip, release, global deformation, and the surface model under the same global force.

The organ shaded in the colour of its displacement, from one view and with one scale of colours for all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue_sim import progress
from tissue_sim.array_types import Floats, Pixels
from tissue_sim.bench.organs import press_node
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.figures import empty_figure
from tissue_sim.organ.normals import surface_normals
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.reporting.render import View, balls, rasterize, view_of
from tissue_sim.organ.winding import inside

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure


JAW = 0.004  # m, radius of the two jaws
_OPEN, _DEEP, _PULL = 0.003, 0.007, 0.004  # m: gap before the nip, indentation of either jaw, pull outward
_SIDE = 820  # pixels, longer side of a panel
_SUPERSAMPLING = 2  # as View.project has it
_LAMP = np.array([-0.35, 0.45, 0.82]) / np.linalg.norm([-0.35, 0.45, 0.82])
_STEEL = (0.62, 0.66, 0.72)
_COLOURS = ("#f4e6d8", "#f7c19c", "#ee8a5c", "#cf3f3c", "#7d1240")  # from rest to the largest displacement
_LONGEST_ARROW = 0.016  # m
_PANEL = 5.0  # inches, height of a panel


@dataclass(frozen=True, eq=False)
class Panel:
    """One picture of the figure.

    Attributes
    ----------
    name : str
        Name of its file.
    title : str
        Title.
    positions : Floats, shape (n, 3), m
        Surface.
    jaws : Floats, shape (j, 3), m
        Centres of the jaws.
    nodes : NDArray[np.int64], shape (k,)
        Nodes with arrows of forces.
    forces : Floats, shape (k, 3), N
        The forces.
    """

    name: str
    title: str
    positions: Floats
    jaws: Floats
    nodes: NDArray[np.int64]
    forces: Floats  # (k, 3) N


NO_ARROWS = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
NO_JAWS = np.zeros((0, 3))


def pinch_and_release(organ: Organ) -> tuple[Panel, Panel]:
    """Return panels of two jaws that take the organ at its top and pull, and of the organ after the release.

    The jaws are balls; they touch the organ as the tools of the node do.
    """
    scene = Scene(organ, [Tool("left", radius=JAW), Tool("right", radius=JAW)])
    surface = organ.surface_positions
    level = surface[:, 2].max() - 3.0 * JAW
    around = surface[np.abs(surface[:, 2] - level) < JAW]
    middle = np.append(around[:, :2].mean(axis=0), level)
    across = np.append(np.linalg.svd(around[:, :2] - middle[:2], full_matrices=False)[2][1], 0.0)
    reach = [_exit_distance(organ, middle, sign * across) for sign in (1.0, -1.0)]

    def jaws(gap: float, up: float) -> Floats:
        at = np.stack(
            [middle + sign * (r + gap + JAW) * across + [0, 0, up] for sign, r in zip((1.0, -1.0), reach, strict=True)]
        )
        for tool in range(2):
            scene.move(tool, at[tool])
        scene.step()
        return at

    for gap in np.linspace(_OPEN, -_DEEP, 150):
        at = jaws(gap, 0.0)
    for up in np.linspace(0.0, _PULL, 150):
        at = jaws(-_DEEP, up)
    for _ in range(100):
        at = jaws(-_DEEP, _PULL)
    held = scene.simulation.positions[: organ.n_surface].copy()
    force = float(np.linalg.norm(scene.wrenches[:, :3], axis=1).mean())
    for gap in np.linspace(-_DEEP, 4.0 * JAW, 150):
        jaws(gap, _PULL)
    for _ in range(3000):
        jaws(40.0 * JAW, _PULL)
        if scene.simulation.asleep:
            break
    released = scene.simulation.positions[: organ.n_surface].copy()
    state = "at rest again" if scene.simulation.asleep else "still moving"
    nip = Panel("nip", f"A  Pinch: two jaws press with {force:.2f} N, pull", held, at, *NO_ARROWS)
    return nip, Panel("release", f"B  Release of the pinch: {state}", released, NO_JAWS, *NO_ARROWS)


def _exit_distance(organ: Organ, start: Floats, direction: Floats) -> float:
    """Return the distance, m, from a point inside the organ to where a direction (3,) leaves it."""
    distance = np.linspace(0.0, np.ptp(organ.surface_positions, axis=0).max(), 600)
    within = inside(start + distance[:, None] * direction, organ.surface_positions, organ.surface_triangles)
    return float(distance[np.argmin(within)])


def pictures_of(organ: Organ, panels: Sequence[Panel]) -> dict[str, Callable[[], Figure]]:
    """Return what draws one picture of all panels, and one of each, by their files' names."""
    rest = organ.surface_positions
    most = max(float(np.linalg.norm(panel.positions - rest, axis=1).max()) for panel in panels)
    view = _view(organ, panels)
    drawn = [_shaded(view, organ, panel, most) for panel in progress.steps(panels, "pictures")]
    width = _PANEL * view.size[0] / view.size[1] + 0.3

    def figure_of(numbers: Sequence[int], size: tuple[float, float]) -> Figure:
        figure = empty_figure(*size)
        axes = np.ravel(figure.subplots(-(-len(numbers) // 2), min(len(numbers), 2), squeeze=False))
        for axis, number in zip(axes, numbers, strict=True):
            _show(axis, view, organ, panels[number], drawn[number])
        _colour_bar(figure, list(axes), most)
        return figure

    whole = partial(figure_of, range(len(panels)), (2.0 * width + 1.0, 2.0 * _PANEL + 1.2))
    single = (width + 1.0, _PANEL + 0.6)
    return {
        "figure6.png": whole,
        **{f"figure6_{panel.name}.png": partial(figure_of, [k], single) for k, panel in enumerate(panels)},
    }


def _view(organ: Organ, panels: Sequence[Panel]) -> View:
    """Return the organ upright, seen from the broad side and slightly from above, with room for all panels."""
    surface = organ.surface_positions
    towards = surface_normals(surface, organ.surface_triangles)[press_node(organ)]
    towards = towards * [1.0, 1.0, 0.0]
    towards /= np.linalg.norm(towards)
    # A quarter from the side, so that a push along the view shows.
    beside = np.cross([0.0, 0.0, 1.0], towards)
    towards = towards + 0.9 * beside + np.array([0.0, 0.0, 0.35])
    balls_of = [panel.jaws + JAW * sign for panel in panels for sign in (-1.0, 1.0)]
    points = np.concatenate([surface, *(panel.positions for panel in panels), *balls_of])
    square = view_of(points, towards, (0.0, 0.0, 1.0), (_SIDE, _SIDE), 0.04)
    local = (points - square.centre) @ square.axes.T
    extent = np.ptp(local, axis=0)[:2]
    size = (extent / extent.max() * _SIDE).clip(0.7 * _SIDE).astype(int)
    return view_of(points, towards, (0.0, 0.0, 1.0), (int(size[0]), int(size[1])), 0.04)


def _shaded(view: View, organ: Organ, panel: Panel, most: float) -> Pixels:
    """Return the panel's organ and jaws, (height, width, 3), coloured by displacement from 0 to `most` m."""
    moved = np.linalg.norm(panel.positions - organ.surface_positions, axis=1)
    skin = np.asarray(_colours()(moved / most))[:, :3]
    pieces = [(panel.positions, np.asarray(organ.surface_triangles), skin)]
    if len(panel.jaws):
        solid = balls(panel.jaws, JAW, _STEEL)
        pieces.append((solid.positions, solid.triangles, np.tile(_STEEL, (len(solid.positions), 1))))
    width, height = (_SUPERSAMPLING * pixels for pixels in view.size)
    picture, depth = np.ones((height, width, 3)), np.full((height, width), -np.inf)
    for positions, triangles, colour in pieces:
        owner, weight, rim = rasterize(view.project(positions), triangles, depth, +1)
        hit = owner >= 0
        corners = triangles[owner[hit]]
        normal = np.einsum("pk,pkx->px", weight[hit], surface_normals(positions, triangles)[corners]) @ view.axes.T
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        lit = np.clip(normal @ _LAMP, 0.0, 1.0)[:, None]
        shade = np.einsum("pk,pkx->px", weight[hit], colour[corners]) * (0.58 + 0.42 * lit) + 0.1 * lit**20
        ink = 0.22 * np.clip(1.2 - rim[hit], 0.0, 1.0)[:, None] if len(triangles) == len(organ.surface_triangles) else 0
        picture[hit] = shade * (1.0 - ink)
    small = picture.reshape(view.size[1], _SUPERSAMPLING, view.size[0], _SUPERSAMPLING, 3).mean(axis=(1, 3))
    return (np.clip(small, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)


def _show(axis: Axes, view: View, organ: Organ, panel: Panel, pixels: Pixels) -> None:
    """Put a rendered panel on an axis, with arrows for the forces and a caption."""
    axis.imshow(pixels, interpolation="antialiased")
    axis.set_axis_off()
    moved = float(np.linalg.norm(panel.positions - organ.surface_positions, axis=1).max())
    axis.set_title(panel.title, fontsize=11, loc="left")
    axis.text(0.5, 0.0, f"largest displacement {1e3 * moved:.2f} mm", transform=axis.transAxes, ha="center", va="top")
    height = panel.jaws @ view.axes[2]
    for jaw in panel.jaws[height < height.max(initial=-np.inf) - 2.0 * JAW]:  # behind the organ
        turn = np.linspace(0.0, 2.0 * np.pi, 60)
        x, y = view.project(jaw[None])[0, :2] / _SUPERSAMPLING
        radius = JAW * view.scale
        axis.plot(x + radius * np.cos(turn), y + radius * np.sin(turn), "--", color="#5a6270", linewidth=1.0)
    if not len(panel.nodes):
        return
    largest = float(np.linalg.norm(panel.forces, axis=1).max())
    heads = panel.positions[panel.nodes]
    tails = heads - _LONGEST_ARROW / largest * panel.forces
    facing = surface_normals(panel.positions, organ.surface_triangles)[panel.nodes] @ view.axes[2] > 0.0
    for head, tail, front in zip(view.project(heads), view.project(tails), facing, strict=True):
        style = {"arrowstyle": "-|>", "color": "#1f3a68", "linewidth": 1.6, "alpha": 1.0 if front else 0.3}
        axis.annotate("", head[:2] / _SUPERSAMPLING, tail[:2] / _SUPERSAMPLING, arrowprops=style)


def _colours() -> Colormap:
    """Return the colour map."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("tissue", _COLOURS)


def _colour_bar(figure: Figure, axes: list[Axes], most: float) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    scale = ScalarMappable(Normalize(0.0, 1e3 * most), _colours())
    figure.colorbar(scale, ax=axes, label="displacement (mm)", shrink=0.7, pad=0.02)
