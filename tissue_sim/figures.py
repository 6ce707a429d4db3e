"""Matplotlib figures without pyplot, which would keep state for the whole process."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def empty_figure(width: float, height: float) -> Figure:
    """Return an empty figure whose layout follows its contents; width and height in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def hide_box(*axes: Axes) -> None:
    """Hide the upper and right-hand lines around axes."""
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)


def png(figure: Figure, dpi: float) -> bytes:
    """Return a figure as a PNG file."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi)
    return stream.getvalue()
