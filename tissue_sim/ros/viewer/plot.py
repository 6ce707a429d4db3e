"""The viewer's plot of force over time."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np
import viser
from numpy.typing import NDArray
from viser import uplot

SPAN = 10.0  # s that the plot shows
DRAW_EVERY = 0.2  # s
LINE_COLOURS = ((31, 119, 180), (214, 97, 20), (44, 140, 60), (140, 86, 170))
LEAST_TOP = 0.5  # N; or the noise of a tool in the air would fill the plot


class ForceHistory:
    """The forces on the tools in the last SPAN seconds."""

    def __init__(self, tools: Sequence[str]) -> None:
        self._tools = tuple(tools)
        self._rows: deque[tuple[float, ...]] = deque()

    def add(self, now: float, forces: Mapping[str, float | None]) -> None:
        """Note the forces (N) of a moment in s; None for a tool without a known force."""
        self._rows.append((now, *(np.nan if (f := forces.get(tool)) is None else f for tool in self._tools)))
        while self._rows[0][0] < now - SPAN:
            self._rows.popleft()

    def columns(self, now: float) -> tuple[NDArray[np.float64], ...]:
        """Return seconds before now (k,), all negative or zero, and the force of each tool (k,) N."""
        rows = np.array(self._rows or [(now, *(np.nan for _ in self._tools))])
        return (rows[:, 0] - now, *(np.ascontiguousarray(column) for column in rows[:, 1:].T))


class ForcePlot:
    """Plot of a history of forces in the panel."""

    def __init__(self, server: viser.ViserServer, tools: Sequence[str]) -> None:
        self._history = ForceHistory(tools)
        self._drawn = -np.inf
        lines = [
            uplot.Series(label=tool, stroke=f"rgb{LINE_COLOURS[i % len(LINE_COLOURS)]}", width=2)
            for i, tool in enumerate(tools)
        ]
        self._top = LEAST_TOP
        self._plot = server.gui.add_uplot(
            self._history.columns(0.0),
            (uplot.Series(label="s"), *lines),
            scales=self._scales(),
            title=f"Force, N, in the last {SPAN:g} s",
            axes=(uplot.Axis(size=36), uplot.Axis(size=40)),
            cursor=uplot.Cursor(show=False),
            legend=uplot.Legend(show=True, live=False),
            height=150,
            padding=(10, 12, 0, 0),  # px: half of the labels at the ends lies beyond the axes
        )

    def update(self, now: float, forces: Mapping[str, float | None], visible: bool) -> None:
        """Note forces of a moment, and draw when it is time and a page is open.

        now: the moment, s; forces: force of each tool, N; visible: whether a page is open.
        """
        self._history.add(now, forces)
        if not visible or now - self._drawn < DRAW_EVERY:
            return
        self._drawn = now
        columns = self._history.columns(now)
        highest = max((float(np.nanmax(f)) for f in columns[1:] if not np.isnan(f).all()), default=0.0)
        # Steps of 1, 2, 5: an axis that changes with every sample can't be read.
        top = next(step for step in _steps(LEAST_TOP) if step >= highest)
        if top != self._top:
            self._top = top
            self._plot.scales = self._scales()
        self._plot.data = columns

    def remove(self) -> None:
        """Remove it from the panel."""
        self._plot.remove()

    def _scales(self) -> dict[str, uplot.Scale]:
        return {"x": uplot.Scale(time=False, range=(-SPAN, 0.0)), "y": uplot.Scale(range=(0.0, self._top))}


def _steps(least: float) -> list[float]:
    return [step for power in range(-2, 7) for step in (10.0**power, 2 * 10.0**power, 5 * 10.0**power) if step >= least]
