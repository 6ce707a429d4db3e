"""The real-time model under the loads of the reference: displacements, opening of the lips, energy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.bench.cutting.cut_body import SAMPLES, Answer
from tissue_sim.bench.cutting.cuts import Place
from tissue_sim.bench.cutting.finer import Onto
from tissue_sim.bench.cutting.reference import force_for, middle_opening
from tissue_sim.calibration.evaluation import LONGEST, RAMP, TOLERANCE
from tissue_sim.model.cutting.cut import CutOrgan
from tissue_sim.model.elasticity.energy import energy_of
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ


class Lips(NamedTuple):
    """Places on both lips of a cut organ. s places; those that the cut doesn't divide have no opening."""

    below: Longs  # (s, 4) nodes of the copy on the negative side
    above: Longs  # (s, 4) of that on the positive side
    weights: Floats  # (s, 4)

    def opening(self, positions: Floats) -> Floats:
        """Return how far the positive lip is from the negative one, (s, 3) m, for positions (n, 3) m of all nodes."""
        apart = positions[self.above] - positions[self.below]
        found: Floats = np.einsum("sk,skx->sx", self.weights, apart)
        return found


class Settled(NamedTuple):
    """Answer of the model, and its potential energy."""

    answer: Answer
    potential: float  # J, of tissue and load


def lips_of(cut: CutOrgan) -> Lips:
    """Return places evenly along the lips of an organ's last cut."""
    sheet, uncut = cut.sheets[-1], cut.uncut
    points = sheet.top(np.linspace(0.0, sheet.begins[-1], SAMPLES))
    below, above = np.flatnonzero(cut.side < 0), np.flatnonzero(cut.side > 0)
    below = below[np.argsort(cut.cell_of[below])]
    above = above[np.argsort(cut.cell_of[above])]
    corner = uncut.rest_positions[uncut.cell_nodes[cut.cell_of[below]]]
    inverse = np.linalg.inv((corner[:, 1:] - corner[:, :1]).transpose(0, 2, 1))
    inner = np.einsum("cxy,scy->scx", inverse, points[:, None] - corner[None, :, 0])
    weights = np.concatenate([1.0 - inner.sum(axis=2, keepdims=True), inner], axis=2)
    best = np.argmax(weights.min(axis=2), axis=1)
    nodes = cut.organ.cell_nodes.astype(np.int64)
    return Lips(nodes[below[best]], nodes[above[best]], weights[np.arange(SAMPLES), best])


class Modelled:
    """The real-time model of an organ, with a cut or without.

    place: where it is cut, None for the uncut organ; onto: how forces on the organ of which this one is a finer form
    act on this one, None where it is not one. Raises UserError as Simulation.cut does.
    """

    def __init__(self, organ: Organ, place: Place | None, onto: Onto | None = None) -> None:
        whole = Simulation(organ)
        self._onto = onto
        if place is None:
            self.simulation, self._lips = whole, None
        else:
            self.simulation = whole.cut(place.sheet.polyline, place.sheet.direction, place.sheet.depth)
            assert self.simulation.cut_organ is not None
            self._lips = lips_of(self.simulation.cut_organ)

    @property
    def resolved(self) -> bool:
        """True if the cut is deep enough for the edges of the surface."""
        return all(report.resolved for report in self.simulation.cuts)

    def settle(self, force: Floats) -> Settled:
        """Return where the model comes to rest under forces (n_surface, 3) N."""
        simulation = self.simulation
        count = simulation.state.count
        before = count.faults, count.snaps
        acting = force if self._onto is None else self._onto.spread(force)
        displacement, settled = simulation.settle(acting, TOLERANCE, LONGEST, RAMP)
        settled = settled and before == (count.faults, count.snaps)
        positions = simulation.positions.copy()
        opening = np.zeros((SAMPLES, 3)) if self._lips is None else self._lips.opening(positions)
        energy = energy_of(simulation.model, positions, np.zeros_like(positions)).elastic
        potential = energy - float(np.vdot(acting, displacement))
        return Settled(Answer(displacement[: len(force)], opening, settled), potential)

    def opening_force(self, force: Floats, size: float, wanted: float) -> float:
        """Return the force on each lip, N, that opens the middle of the cut; nan where none is found.

        force (n_surface, 3) N: the load that pulls the lips apart; size: its force on each lip, N; wanted: the opening,
        m.
        """

        def opened_by(newton: float) -> float | None:
            answer = self.settle(force * (newton / size)).answer
            return middle_opening(answer.opening) if answer.settled else None

        return force_for(wanted, size, opened_by)
