"""Plot of `tissue_sim bench haptics`: the stable stiffness over the delay."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tissue_sim.figures import empty_figure, hide_box
from tissue_sim.json_types import JsonObject

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def drawn(found: JsonObject) -> Figure:
    """Draw a panel for each device and a colour for each rate; lines: found, dotted: theory with delay."""
    names = list(dict.fromkeys(row["device"] for row in found["rows"]))
    rates = list(dict.fromkeys(row["rate"] for row in found["rows"]))
    figure = empty_figure(4.2 * len(names), 4.2)
    panels = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    for panel, name in zip(panels, names, strict=True):
        for number, rate in enumerate(rates):
            rows = [row for row in found["rows"] if (row["device"], row["rate"]) == (name, rate)]
            delays = [1e3 * row["delay"] for row in rows]
            panel.plot(delays, [row["found"] for row in rows], f"C{number}o-", label=f"{rate:g} Hz")
            panel.plot(delays, [row["with_delay"] for row in rows], f"C{number}:")
        panel.set(xlabel="delay, there and back (ms)", title=name, yscale="log")
        hide_box(panel)
    panels[0].set_ylabel("stable stiffness (N/m); dotted: b / (T / 2 + t)")
    panels[0].legend(title="poses", frameon=False)
    return figure
