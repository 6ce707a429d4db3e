"""Plot of `tissue_sim bench soak`: memory and lateness over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tissue_sim.figures import empty_figure, hide_box
from tissue_sim.json_types import JsonObject

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_NODE, _BARE, _GUIDE = "#2166ac", "#b2182b", "#777777"


def drawn(found: JsonObject) -> Figure:
    """Draw memory and lateness over the minutes."""
    series = {name: np.array(values) for name, values in found["series"].items()}
    minutes = series["seconds"] / 60.0
    figure = empty_figure(9.0, 5.6)
    memory, lateness = figure.subplots(2, 1, sharex=True)
    memory.plot(minutes, series["megabytes"], color=_NODE, linewidth=1.0)
    for key in ("first", "last"):
        if (level := found["memory"][f"{key}_mb"]) is not None:
            memory.axhline(level, color=_GUIDE, linewidth=0.8, linestyle=":")
    memory.set_ylabel("memory of its own (MB)")
    memory.set_title(f"{found['organ']}, {found['rate_hz']:g} Hz, {found['minutes']:g} min", loc="left")
    lateness.plot(minutes, series["late_us"], color=_NODE, linewidth=0.8, label="node, p99 of each second")
    bare = found["late"]["bare_turns"]
    lateness.plot(
        [turn["seconds"] / 60.0 for turn in bare],
        [turn["p99_us"] for turn in bare],
        ".",
        color=_BARE,
        label="a bare loop, p99 of each turn",
    )
    lateness.set_yscale("log")
    lateness.set_ylabel("ticks late by (us)")
    lateness.set_xlabel("time (min)")
    lateness.legend(frameon=False)
    hide_box(memory, lateness)
    return figure
