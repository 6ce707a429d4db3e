"""Matplotlib figures without pyplot, which would keep state for the whole process."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

from tissue_sim.errors import UserError

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


def save(figure: Figure, path: Path, dpi: float = 140.0) -> None:
    """Write a figure as the format of the file's name. Raises UserError where it can't be written."""
    try:
        figure.savefig(path, dpi=dpi)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}") from None


def png(figure: Figure, dpi: float) -> bytes:
    """Return a figure as a PNG file."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi)
    return stream.getvalue()
