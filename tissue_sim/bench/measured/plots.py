"""Pictures of measured bodies: the cube's inner beads, and the motion of the beam's end."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from tissue_sim.bench.measured.beam import WEIGHTS, Bent
from tissue_sim.bench.measured.truth_cube import Compressed
from tissue_sim.figures import empty_figure, hide_box

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_MEASURED, _ELEMENTS, _MODEL = "#222222", "#2166ac", "#d55e00"
MIDDLE = 2  # index among the inner beads' layers


def pictures_of(cube: list[Compressed] | None, bent: list[Bent] | None) -> dict[str, Callable[[], Figure]]:
    """Return what draws truth_cube.png and beam.png, as far as there are results of the cube and of the beam."""
    pictures: dict[str, Callable[[], Figure]] = {}
    if cube is not None:
        pictures["truth_cube.png"] = partial(_cube, cube)
    if bent is not None:
        pictures["beam.png"] = partial(_beam, bent)
    return pictures


def _cube(found: list[Compressed]) -> Figure:
    """Return a figure of a layer of beads at the last strain, and of the errors of all inner beads at every strain."""
    figure = empty_figure(10.0, 4.6)
    layer, errors = figure.subplots(1, 2, width_ratios=(1.0, 1.2))
    last = found[-1]
    shown = ((last.measured, "o", _MEASURED, "measured"), (last.elements, "+", _ELEMENTS, "finite elements"))
    for beads, mark, colour, label in (*shown, (last.model, "x", _MODEL, "model")):
        x, z = 1e3 * beads[:, MIDDLE, :, 0].ravel(), 1e3 * beads[:, MIDDLE, :, 2].ravel()
        filled = {"facecolors": "none", "edgecolors": colour} if mark == "o" else {"color": colour}
        layer.scatter(x, z, s=60, marker=mark, label=label, **filled)
    layer.set_aspect("equal")
    layer.set_xlabel("x (mm)")
    layer.set_ylabel("z (mm)")
    layer.set_title(f"middle layer of the inner beads, {last.strain:g} %", loc="left", fontsize=10)
    layer.legend(frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=3, fontsize=9)
    for offset, who, colour, label in (
        (-0.2, "elements", _ELEMENTS, "finite elements"),
        (0.2, "model", _MODEL, "model"),
    ):
        values = [one.off[who].ravel() for one in found]
        boxes = errors.boxplot(
            values,
            positions=np.arange(len(found)) + offset,
            widths=0.3,
            patch_artist=True,
            manage_ticks=False,
            medianprops={"color": "black"},
        )
        for box in boxes["boxes"]:
            box.set(facecolor=colour, alpha=0.5, label=label if box is boxes["boxes"][0] else None)
    errors.set_xticks(range(len(found)), [f"{one.strain:g} %" for one in found])
    errors.axhline(0.35, color="#777777", linestyle=":", label="accuracy of a bead's position")
    errors.set_ylabel("distance from the measured bead (mm)")
    errors.set_ylim(0.0, 1.3 * max(float(one.off[who].max()) for one in found for who in one.off))
    errors.legend(frameon=False, fontsize=9, loc="upper left")
    hide_box(layer, errors)
    return figure


def _beam(found: list[Bent]) -> Figure:
    """Return a figure of the markers at the free end, measured and predicted, with a panel for each weight."""
    figure = empty_figure(12.0, 4.2)
    panels = figure.subplots(1, len(WEIGHTS))
    for panel, load in zip(panels, WEIGHTS, strict=True):
        for number, one in enumerate(some for some in found if some.run.startswith(load)):
            first = number == 0
            down = {"measured": one.measured, "finite elements": one.elements, "model": one.model}
            styles = ((_MEASURED, 2.5, 0.45), (_ELEMENTS, 1.2, 1.0), (_MODEL, 1.2, 1.0))
            for (label, moved), (colour, width, strength) in zip(down.items(), styles, strict=True):
                panel.plot(
                    one.time,
                    1e3 * moved[:, :, 2].mean(axis=1),
                    color=colour,
                    linewidth=width,
                    alpha=strength,
                    linestyle="-" if first else "--",
                    label=label if first else None,
                )
        panel.set_xlabel("time (s)")
        worst = max(some.off_moving["model"] for some in found if some.run.startswith(load))
        panel.set_title(f"{load}: error of the model {worst:.1f} %", loc="left", fontsize=10)
        hide_box(panel)
    panels[0].set_ylabel("free end's markers, upward (mm)")
    panels[0].legend(frameon=False, fontsize=9, title="runs a (solid) and b (dashed)", title_fontsize=9)
    return figure
