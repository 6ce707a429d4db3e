"""A picture of two runs: the force of each tool over time, and the deviation of force and position."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tissue_sim.errors import UserError
from tissue_sim.figures import empty_figure, save
from tissue_sim.ros.bags.comparison import Deviation
from tissue_sim.ros.bags.outcome import Outcome

if TYPE_CHECKING:
    from matplotlib.axes import Axes


RECORDED, REPLAYED = "#777777", "#b2182b"
LEAST = 1e-18  # stands for a deviation of zero: the axis is logarithmic


def picture_path(given: str, bag: Path) -> Path:
    """Return the file of a picture: the given one that ends in .png, or the bag's name in a folder, which is made.

    Raises UserError without matplotlib, or when the folder can't be made.
    """
    if importlib.util.find_spec("matplotlib") is None:
        raise UserError("--plot needs matplotlib: pip install matplotlib")
    path = Path(given)
    if path.suffix.lower() != ".png":
        path = path / f"{bag.resolve().name}.png"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot make the folder {path.parent}: {error.strerror}") from None
    return path


def write_picture(path: Path, outcome: Outcome) -> None:
    """Write the result of a bag as a PNG. Raises UserError when it can't be written."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    wanted, found, rate = outcome.replayed.wanted, outcome.replayed.shown, outcome.rate
    tools = wanted.tools
    figure = empty_figure(9.0, 2.0 * (len(tools) + 2))
    FigureCanvasAgg(figure)
    axes = np.atleast_1d(figure.subplots(len(tools) + 2, sharex=True))
    for tool, (name, axis) in enumerate(zip(tools, axes[:-2], strict=True)):
        time = wanted.wrench_ticks[tool] / rate
        for label, run, colour, width in (("recorded", wanted, RECORDED, 3.0), ("replayed", found, REPLAYED, 1.0)):
            size = np.linalg.norm(run.wrenches[tool][:, :3], axis=1)
            axis.plot(time, size, color=colour, linewidth=width, label=label)
        axis.set_ylabel(f"{name} (N)")
        axis.legend(loc="upper right", frameon=False)
    _deviation(axes[-2], rate, outcome.comparison.force)
    _deviation(axes[-1], rate, outcome.comparison.position)
    axes[-1].set_xlabel("simulated time (s)")
    axes[0].set_title(outcome.name, loc="left")
    save(figure, path, 120.0)


def _deviation(axis: Axes, rate: float, found: Deviation) -> None:
    finite = np.where(np.isfinite(found.values), found.values, np.nan)
    axis.semilogy(found.ticks / rate, np.maximum(finite, LEAST), ".", markersize=3.0, color=REPLAYED)
    axis.axhline(found.tolerance, color=RECORDED, linestyle="--", linewidth=1.0)
    axis.set_ylabel(f"deviation of {found.what} ({found.unit})")
