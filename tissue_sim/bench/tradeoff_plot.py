"""The plot of `tissue_sim bench tradeoff`: time against error, and the Pareto front."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tissue_sim.errors import UserError

_FRONT, _LIMIT = "#222222", "#999999"
_OURS = ("#08306b", "#2171b5", "#4eb3d3", "#238b45", "#6a51a3", "#41ab5d", "#807dba", "#66c2a4", "#02818a", "#a6bddb")
_THEIRS = ("#99000d", "#ef3b2c", "#fc8d59", "#b15928", "#dd3497", "#ae017e", "#fdae61", "#8c510a")
_LEAST = 0.1  # %, below which an error is drawn there


def write_plot(found: dict[str, Any], folder: Path) -> Path:
    """Write tradeoff.png into the folder; raises UserError when it can't be written."""
    path = folder / "tradeoff.png"
    try:
        _draw(found).savefig(path, dpi=140)
    except OSError as error:
        raise UserError(f"cannot write to {folder}: {error.strerror}") from None
    return path


def _draw(found: dict[str, Any]) -> Any:
    """A line a row's name, a mark a size; log-log."""
    from matplotlib.figure import Figure

    rows = [row for row in found["rows"] if row["errors"]]
    figure = Figure(figsize=(10.5, 6.2), layout="constrained")
    axis = figure.subplots()
    left = {True: list(_OURS), False: list(_THEIRS)}
    for name in dict.fromkeys(row["name"] for row in rows):
        line = [row for row in rows if row["name"] == name]
        ours = line[0]["ours"]
        colour = left[ours].pop(0) if left[ours] else _LIMIT
        times = [row["ms_per_ms"] for row in line]
        errors = [max(row["mean_percent"], _LEAST) for row in line]
        axis.plot(times, errors, "o-" if ours else "s--", color=colour, markersize=5, linewidth=1.2, label=name)
        for row, x, y in zip(line, times, errors, strict=True):
            if len(line) > 1:
                axis.annotate(str(row["points"]), (x, y), (4, 3), textcoords="offset points", fontsize=6, color=colour)
    front = sorted((row["ms_per_ms"], max(row["mean_percent"], _LEAST)) for row in rows if row["pareto"])
    if front:
        axis.step(
            *zip(*front, strict=True), where="post", color=_FRONT, linewidth=2.5, alpha=0.35, label="Pareto front"
        )
    axis.axvline(1.0, color=_LIMIT, linestyle=":", linewidth=1.0)
    beside: dict[str, Any] = {"xycoords": axis.get_xaxis_transform(), "textcoords": "offset points", "fontsize": 7}
    axis.annotate("real time", (1.0, 0.98), (-3, 0), ha="right", rotation=90, va="top", **beside)
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xlabel("processor time for a simulated ms (ms), one thread")
    axis.set_ylabel("mean relative L2 error (%)")
    axis.set_title(f"{found['organ']}: {len(found['loads'])} loads against {found['reference']['name']}", loc="left")
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    figure.legend(loc="outside right upper", frameon=False, fontsize=8)
    return figure
