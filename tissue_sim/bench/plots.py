"""Plots of `tissue_sim bench tick`: time of every row, and growth with the organ."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tissue_sim.figures import empty_figure, hide_box
from tissue_sim.json_types import JsonObject

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_OURS, _THEIRS, _LIMIT = "#2166ac", "#b2182b", "#777777"


def drawn_rows(found: JsonObject) -> Figure:
    """Return a figure of the median and p99 of every row, on a logarithmic scale."""
    rows = [row for row in found["rows"] if row["median_us"] is not None][::-1]
    figure = empty_figure(9.0, 0.36 * len(rows) + 1.3)
    axis = figure.subplots()
    peers = ("MuJoCo", "compliance", "the same")
    for place, row in enumerate(rows):
        median = row["median_us"]
        axis.barh(place, median, color=_THEIRS if row["name"].startswith(peers) else _OURS, height=0.62)
        axis.plot([median, max(row["p99_us"], median)], [place, place], color="black", linewidth=1.0)
        label = f"{median:.0f}" if median >= 100.0 else f"{median:.3g}"
        axis.annotate(label, (max(row["p99_us"], median), place), (4, 0), textcoords="offset points", va="center")
    axis.set_yticks(range(len(rows)), [row["name"] for row in rows])
    axis.set_xscale("log")
    axis.set_xlim(0.5 * min(row["median_us"] for row in rows), 4.0 * max(row["p99_us"] for row in rows))
    axis.set_xlabel("median time (us); the line reaches to the 99th percentile")
    axis.set_title(
        f"{found['organ']}, {found['surface_points']} points, 1 ms of simulated time, one thread", loc="left"
    )
    hide_box(axis)
    return figure


def drawn_growth(found: JsonObject) -> Figure:
    """Return a figure of whole tick, substep and modal tick over the number of points."""
    sizes = found["growth"]["sizes"]
    points = [size["points"] for size in sizes]
    figure = empty_figure(6.6, 4.4)
    axis = figure.subplots()
    lines = (
        ("whole_us", "whole tick", _OURS, "o-"),
        ("substep_us", "one of its substeps", _OURS, "s--"),
        ("modal_us", "modal tick", _THEIRS, "o-"),
    )
    for key, label, colour, style in lines:
        axis.plot(points, [size[key] for size in sizes], style, color=colour, label=label)
    start = sizes[0]["substep_us"]
    slope = [start * (count / points[0]) ** 1.1 for count in points]
    axis.plot(points, slope, ":", color=_LIMIT, label="n^1.1 from the first substep")
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xticks(points, [str(count) for count in points])
    axis.minorticks_off()
    axis.set_xlabel("surface points")
    axis.set_ylabel("median time (us)")
    axis.legend(frameon=False)
    hide_box(axis)
    return figure
