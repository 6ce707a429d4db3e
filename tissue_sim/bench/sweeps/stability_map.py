"""Map of a sweep: one panel per axis, one row per integrator and local region, one column per value."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from tissue_sim.bench.sweeps.cells import AXES
from tissue_sim.bench.sweeps.trial import Record
from tissue_sim.figures import empty_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = {"stable": "#7fbf8e", "guarded": "#f2c14e", "diverged": "#c8432f"}
_RECOVERED = "////"


def drawn(records: Sequence[Record], organ: str) -> Figure:
    """Return the map of the records of an organ of that name."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch, Rectangle

    axes = [axis for axis in AXES if any(record.axis == axis for record in records)]
    rows = list(dict.fromkeys((record.integrator, record.local_region) for record in records))
    across = min(2, len(axes))  # so that words are read at the width of a page
    down = -(-len(axes) // across)
    figure = empty_figure(1.7 + 3.6 * across, 1.6 + (0.9 + 0.24 * len(rows)) * down)
    FigureCanvasAgg(figure)
    panels = figure.subplots(down, across, squeeze=False)
    for index, panel in enumerate(panels.ravel()):
        if index >= len(axes):
            panel.set_axis_off()
            continue
        axis = axes[index]
        values = sorted({record.value for record in records if record.axis == axis})
        for record in (record for record in records if record.axis == axis):
            column, row = values.index(record.value), rows.index((record.integrator, record.local_region))
            panel.add_patch(
                Rectangle(
                    (column - 0.5, row - 0.5),
                    1.0,
                    1.0,
                    facecolor=COLOURS[record.outcome],
                    edgecolor="white" if not record.snaps else "#303030",
                    hatch=_RECOVERED if record.snaps else None,
                    linewidth=0.6,
                )
            )
            if record.judged and record.outcome == "diverged":
                panel.plot(column, row, "x", color="black", markersize=7, markeredgewidth=1.8)
            elif not record.settled:
                panel.plot(column, row, ".", color="#303030", markersize=3)
        panel.set_facecolor("#eeeeee")
        panel.set_xlim(-0.5, len(values) - 0.5)
        panel.set_ylim(len(rows) - 0.5, -0.5)
        panel.set_xticks(range(len(values)), [f"{value:g}" for value in values], fontsize=10)
        labels = [f"{integrator}, {region}" for integrator, region in rows] if index % across == 0 else []
        panel.set_yticks(range(len(rows)), labels or [""] * len(rows), fontsize=10)
        panel.tick_params(length=0)
        panel.set_xlabel(AXES[axis].title, fontsize=11)
        for edge in range(1, len(rows)):
            if rows[edge][0] != rows[edge - 1][0]:
                panel.axhline(edge - 0.5, color="black", linewidth=1.0)
    figure.legend(
        handles=[
            *(Patch(facecolor=colour, label=outcome) for outcome, colour in COLOURS.items()),
            Patch(facecolor="white", edgecolor="#303030", hatch=_RECOVERED, label="recovered from a false rest shape"),
            Line2D([], [], linestyle="", marker="x", color="black", label="diverged with default settings"),
            Line2D([], [], linestyle="", marker=".", color="#303030", label="not run until rest"),
        ],
        loc="outside lower center",
        ncols=2,
        fontsize=10,
        frameon=False,
    )
    figure.suptitle(f"Stability of {organ}: {len(records)} runs", fontsize=13)
    return figure
