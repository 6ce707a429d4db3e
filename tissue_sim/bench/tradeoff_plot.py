"""Plot of `tissue_sim bench tradeoff`: time against error, and the Pareto front."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, NamedTuple

from tissue_sim.bench.peers.rows import CALIBRATED
from tissue_sim.bench.variants import BALANCED
from tissue_sim.figures import empty_figure, hide_box
from tissue_sim.json_types import JsonObject

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_LEAST = 0.1  # %, below which an error is drawn there
_ANCHORS = {"left": 1, "center": 0, "right": -1}, {"bottom": 1, "center": 0, "top": -1}
_NEAR, _FAR = 6, 14  # points between a mark and its name; how many times as far a name may go
_APART = 3  # pixels around a name


class _Kind(NamedTuple):
    """Style of rows of one kind, and their name in the legend."""

    name: str
    colour: str
    mark: str
    line: float  # its width


_CELLS = _Kind("cells with fitted stiffness", "#08519c", "o", 2.6)
_SPRINGS = _Kind("the paper's springs", "#2f8f4e", "^", 1.0)
_PEERS = _Kind("others", "#b5401f", "s", 1.0)


def drawn(found: JsonObject) -> Figure:
    """Draw a line per row's name and a mark per size, log-log, with names beside marks of the organ's own size."""
    from matplotlib.ticker import FuncFormatter, LogLocator

    rows = [row for row in found["rows"] if row["errors"]]
    figure = empty_figure(9.0, 6.6)
    axis = figure.subplots()
    front = sorted(_place(row) for row in rows if row["pareto"])
    if front:
        axis.step(*zip(*front, strict=True), where="post", color="#bbbbbb", linewidth=7, zorder=0, label="Pareto front")
    names: list[tuple[tuple[float, float], str, _Kind]] = []
    labelled: dict[str, _Kind] = {}
    for name in dict.fromkeys(row["name"] for row in rows):
        line = [row for row in rows if row["name"] == name]
        kind = _kind(name, line[0]["ours"])
        style = "-" if kind is _CELLS else ":"
        axis.plot(
            *zip(*map(_place, line), strict=True),
            f"{kind.mark}{style}",
            color=kind.colour,
            markersize=8 if name == CALIBRATED else 6,
            linewidth=kind.line,
            label=None if kind.name in labelled else kind.name,
            zorder=3 if kind is _CELLS else 2,
        )
        labelled[kind.name] = kind
        if name == CALIBRATED:
            for row in line:
                aim = f", {BALANCED}" if row["points"] == found["surface_points"] else ""
                names.append((_place(row), f"{row['points']:,}{aim}", kind))
        else:
            own = [row for row in line if row["points"] == found["surface_points"]]
            names.append((_place((own or line)[-1]), name.removeprefix(f"{CALIBRATED}, "), kind))
    axis.axvline(1.0, color="#999999", linestyle=":", linewidth=1.0)
    axis.text(1.0, 0.99, "real time ", transform=axis.get_xaxis_transform(), ha="right", va="top", color="#777777")
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.margins(0.09, 0.13)
    axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.yaxis.set_minor_locator(LogLocator(subs="all"))
    for one in (axis.xaxis, axis.yaxis):
        one.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        one.set_minor_formatter(FuncFormatter(lambda *_: ""))
    axis.tick_params(labelsize=11)
    axis.set_xlabel("processor time for a simulated ms (ms), one thread", fontsize=12)
    axis.set_ylabel("mean error (%), relative L2", fontsize=12)
    loads = f"{len(found['loads'])} loads against neo-Hookean finite elements; numbers are surface points"
    axis.set_title(f"{found['organ']}: {loads}", loc="left", fontsize=11)
    hide_box(axis)
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=11)
    _name_marks(figure, axis, names, [_place(row) for row in rows])
    return figure


def _kind(name: str, ours: bool) -> _Kind:
    if not ours:
        return _PEERS
    return _CELLS if name.startswith(CALIBRATED) else _SPRINGS


_Name = tuple[tuple[float, float], str, _Kind]  # where its mark is, the text, and how it looks


def _place(row: JsonObject) -> tuple[float, float]:
    return row["ms_per_ms"], max(row["mean_percent"], _LEAST)


def _name_marks(figure: Figure, axis: Axes, names: list[_Name], marks: list[tuple[float, float]]) -> None:
    """Write each name beside its mark, where it covers no other name and no mark, as far as there is room."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.transforms import Bbox

    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # names leave it as it is
    renderer, inside = FigureCanvasAgg(figure).get_renderer(), axis.get_window_extent()
    taken = [Bbox.from_bounds(x - 6, y - 6, 12, 12) for x, y in axis.transData.transform(marks)]
    for place, name, kind in sorted(names, key=lambda one: one[2] is not _CELLS):
        best = None
        for far, across, up in product(range(1, _FAR + 1), *_ANCHORS):
            offset = _NEAR * far * _ANCHORS[0][across], _NEAR * far * _ANCHORS[1][up]
            if not any(offset):
                continue
            text = axis.annotate(
                name,
                place,
                offset,
                textcoords="offset points",
                ha=across,
                va=up,
                color=kind.colour,
                fontsize=11,
                fontweight="bold" if kind is _CELLS else "normal",
                annotation_clip=False,
            )
            box = text.get_window_extent(renderer).padded(_APART)
            outside = not (inside.x0 <= box.x0 and box.x1 <= inside.x1 and inside.y0 <= box.y0 and box.y1 <= inside.y1)
            covers = sum(box.overlaps(other) for other in taken) + 2 * outside
            if best is None or covers < best[0]:
                if best is not None:
                    best[1].remove()
                best = covers, text, box, offset, far
            else:
                text.remove()
            if best[0] == 0:
                break
        if best is not None:
            taken.append(best[2])
            if best[-1] > 2:
                line = {"arrowstyle": "-", "color": kind.colour, "linewidth": 0.8}
                axis.annotate("", place, best[3], textcoords="offset points", arrowprops=line)
