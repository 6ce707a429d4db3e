"""Cuts by blades: the sheets that they sweep in an organ are cut, again and again while they advance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.contact.quaternions import rotate
from tissue_sim.errors import UserError
from tissue_sim.model.cutting.blade_path import BladePath
from tissue_sim.model.cutting.sheet import Coagulation, Sheet
from tissue_sim.model.simulation import Simulation

MIN_DETERMINANT = 0.05  # of a deformation gradient from which directions at rest can be computed


class BladeCuts:
    """Paths of all blades in one organ, and the sheets that are to be cut.

    Parameters
    ----------
    simulation : Simulation
        Simulation of the organ.
    coagulations : Sequence[Coagulation]
        Effect of the heat of each tool on the walls of its cuts.
    """

    def __init__(self, simulation: Simulation, coagulations: Sequence[Coagulation]) -> None:
        self._organ, self._coagulations = simulation.uncut_organ, coagulations
        blades = simulation.shapes.blades
        self._edges = {body: np.flatnonzero((blades.body == body) & (blades.width > 0.0)) for body in set(blades.body)}
        self._paths: dict[int, BladePath] = {}  # by tool
        self._first: dict[int, int] = {}  # body of each tool that has entered first
        self._left: list[BladePath] = []  # of blades that have left the tissue
        self._earlier: dict[int, BladePath] = {}  # all since the last reset, by their marks
        self._marks = 0  # so far; none is used twice, as a cut may still be made while the organ is reset
        self.refused = 0  # stages of cuts that could not be opened
        self.scratches = 0  # left by blades, too shallow to open

    def __bool__(self) -> bool:
        return bool(self._edges)

    @property
    def in_tissue(self) -> bool:
        """Whether any blade is in tissue."""
        return bool(self._paths)

    def forget(self) -> None:
        """Remove all paths after a reset of the organ."""
        self._paths.clear()
        self._first.clear()
        self._left.clear()
        self._earlier.clear()

    def note(self, simulation: Simulation) -> None:
        """Add the present places of the blades to their paths.

        Parameters
        ----------
        simulation : Simulation
            Simulation of the organ; it may be running.
        """
        state, cells = simulation.state, simulation.model.cut_cells
        for body, edge in self._edges.items():
            held, tool = edge[state.blades.embedded[edge]], int(simulation.shapes.tool[body])
            if not state.bodies.cutting[body] or not len(held):
                if self._first.get(tool) == body:
                    self._left.append(self._paths.pop(tool))
                    del self._first[tool]
                continue
            places, cell = state.blades.rest[held], state.blades.cell[held]
            part = cells.part[cell][:, :, None]
            corner = (1.0 - part) * state.position[cells.nodes[cell]] + part * state.position[cells.others[cell]]
            stretch = np.einsum("kax,kac->xc", corner, cells.slope[cell]) / len(held)
            if not np.linalg.det(stretch) > MIN_DETERMINANT or not state.blades.embedded[held].all():
                continue  # the cell is nearly flat, or the loop has meanwhile taken the blade out
            back = np.linalg.inv(stretch)
            blades, turn = simulation.shapes.blades, tuple(state.body_pose[body, 3:].tolist())
            ahead = blades.forward[held[0]]
            forward = back @ rotate(turn, tuple(ahead.tolist()))
            along = back @ rotate(turn, tuple(np.cross(blades.normal[held[0]], ahead).tolist()))
            reach = 0.5 * blades.width[held[0]] * along
            swept = np.concatenate([places - reach, places, places + reach])
            if tool not in self._paths:
                self._first[tool], self._paths[tool] = body, self._path(places, forward, along)
                self._paths[tool].heat(self._coagulations[tool])
            if self._first[tool] == body:
                self._paths[tool].note(swept, forward, along)
            else:
                self._paths[tool].meet(swept)

    def _path(self, places: Floats, forward: Floats, along: Floats) -> BladePath:
        """Return the path of a blade that has entered: that of an earlier cut which it continues, or a new one."""
        for path in self._earlier.values():
            if path.continues(places, forward, along):
                return path
        self._marks += 1
        self._earlier[self._marks] = BladePath(self._organ, self._marks)
        return self._earlier[self._marks]

    def due(self) -> Iterator[Sheet]:
        """Yield the sheets of cuts that have grown enough to be opened, or opened again.

        Report the result of each by `opened` or `refuse`.
        """
        left, self._left = self._left, []
        for path in left:
            if not path.is_open:
                try:
                    yield path.sheet()
                except UserError:
                    self.scratches += 1
        for path in tuple(self._paths.values()):
            if path.has_grown:
                with suppress(UserError):  # the cut is still too shallow
                    yield path.sheet()

    def opened(self, sheet: Sheet) -> None:
        """Record that a stage of a cut was opened.

        Parameters
        ----------
        sheet : Sheet
            Its sheet.
        """
        if sheet.mark in self._earlier:  # not if the organ was reset meanwhile
            self._earlier[sheet.mark].note_opened()

    def refuse(self, sheet: Sheet) -> str:
        """Count a stage of a cut that could not be opened; return the text of a message about what follows.

        Parameters
        ----------
        sheet : Sheet
            Its sheet.
        """
        self.refused += 1
        if self._earlier.get(sheet.mark) in self._paths.values():
            return "it is tried again when the blade has cut farther, or leaves"
        return "it stays closed, as the blade has left; cut there again"
