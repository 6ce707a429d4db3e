"""How far the real-time model is off the finite-element body: settled shapes, and the motion after a release."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.calibration.cases import Cases
from tissue_sim.calibration.fem import volume_change
from tissue_sim.model.cells import swelling
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ

TOLERANCE = 1e-4  # residual force over load that counts as settled
LONGEST = 20.0  # simulated seconds after which a load is given up
RAMP = 0.3  # s in which a load is raised: as the finite elements, which know no inertia there, and a hand would
RELEASE_STEP = 0.01  # s of the implicit dynamics
RELEASE_TIME = 1.0  # s


class Answer(NamedTuple):
    """What a body says to cases."""

    displacement: Floats  # (c, n_surface, 3) m
    volume: Floats  # (c,) relative change of volume
    converged: Floats  # (c,) 1 or 0
    least: Floats  # (c,) volume over that at rest, where the body is compressed most


def settled_answers(organ: Organ, cases: Cases, watch: Callable[[], None] | None = None) -> Answer:
    """Where the real-time model comes to rest under each case; a fault or a snap on the way is no rest."""
    simulation = Simulation(organ)
    count = simulation.state.count
    displacement, volume = np.zeros_like(cases.force), np.zeros(len(cases))
    converged, least = np.zeros(len(cases)), np.zeros(len(cases))
    for case, force in enumerate(cases.force):
        before = count.faults, count.snaps
        displacement[case], settled = simulation.settle(force, TOLERANCE, LONGEST, RAMP)
        converged[case] = float(settled and before == (count.faults, count.snaps))
        volume[case] = volume_change(organ, displacement[case])
        least[case] = swelling(simulation.model, simulation.positions).min(initial=1.0)
        if watch is not None:
            watch()
    return Answer(displacement, volume, converged, least)


def errors(found: Floats, wanted: Floats) -> Floats:
    """Relative L2 (c,) of displacements (c, n, 3) over the surface nodes."""
    square: Floats = np.sum((found - wanted) ** 2, axis=(1, 2)) / np.sum(wanted**2, axis=(1, 2))
    return np.sqrt(square)


class Release(NamedTuple):
    """A node after its load was taken away, by both bodies."""

    time: Floats  # (t,) s
    wanted: Floats  # (t, 3) m, of the finite-element body
    found: Floats  # (t, 3) m, of the model

    @property
    def error(self) -> float:
        """Relative L2 over the whole time."""
        return float(np.linalg.norm(self.found - self.wanted) / np.linalg.norm(self.wanted))


def released(organ: Organ, force: Floats, node: int, time: Floats, wanted: Floats) -> Release:
    """A node from the shape settled under forces (n_surface, 3) N, let go, at times (t,) s.

    wanted (t, 3) m: what the finite-element body does.
    """
    simulation = Simulation(organ)
    simulation.settle(force, TOLERANCE, LONGEST, RAMP)
    rest = simulation.model.rest[node]
    history = [simulation.positions[node] - rest]
    for step in np.diff(np.rint(simulation.rate * time).astype(int)):
        for _ in range(step):
            simulation.step()
        history.append(simulation.positions[node] - rest)
    return Release(time, wanted, np.array(history))
