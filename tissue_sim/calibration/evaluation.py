"""Errors of the real-time model against the finite-element body: at equilibrium, and in motion after a release."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.calibration.cases import Cases
from tissue_sim.calibration.fem import volume_change
from tissue_sim.errors import UserError
from tissue_sim.model.elasticity.cells import swelling
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ

TOLERANCE = 1e-4  # residual force over load, below which it counts as settled
LONGEST = 20.0  # simulated seconds after which a load is given up
LEAST_SETTLED = 0.5  # fraction of the loads; with fewer, errors say nothing of the organ
RAMP = 0.3  # s in which a load is raised: slowly, as a hand does and as the finite elements without inertia imply
RELEASE_STEP = 0.01  # s of the implicit dynamics
RELEASE_TIME = 1.0  # s


class Answer(NamedTuple):
    """Answer of a body to load cases."""

    displacement: Floats  # (c, n_surface, 3) m
    volume: Floats  # (c,) relative change of volume
    converged: Floats  # (c,) 1 or 0
    least: Floats  # (c,) volume over that at rest, where the body is compressed most


def settled_answers(organ: Organ, cases: Cases, watch: Callable[[], None] | None = None) -> Answer:
    """Return where the real-time model comes to rest under each case; one with a fault or a snap doesn't count.

    Parameters
    ----------
    organ : Organ
        The organ.
    cases : Cases
        The load cases.
    watch : Callable[[], None] | None, optional
        Called after each case.
    """
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


def check_pace(name: str, lowest: float) -> None:
    """Raise UserError where an organ comes to rest too slowly for its calibration to be judged.

    Parameters
    ----------
    name : str
        The organ's name.
    lowest : float, Hz
        Its lowest frequency. Damped critically, that motion takes log(1 / TOLERANCE) / (2 pi lowest) to die away.
    """
    needed = math.log(1.0 / TOLERANCE) / (2.0 * math.pi * lowest)
    if needed > LONGEST:
        raise UserError(
            f"organ '{name}' is held so loosely that its slowest motion takes {1.0 / lowest:.0f} s: under a load it"
            f" would come to rest after {needed:.0f} s, and at most {LONGEST:g} s are simulated; hold it in more places"
            " with --fixed"
        )


def check_settled(name: str, found: Answer) -> None:
    """Raise UserError where an organ comes to rest under fewer than half of the loads.

    Parameters
    ----------
    name : str
        The organ's name.
    found : Answer
        The model's answers.
    """
    settled, count = int(found.converged.sum()), len(found.converged)
    if settled < LEAST_SETTLED * count:
        raise UserError(
            f"organ '{name}' came to rest under {settled} of {count} held-out loads only, so that nothing is known of"
            " its accuracy; hold it in more places with --fixed, or build it with more --points"
        )


def errors(found: Floats, wanted: Floats) -> Floats:
    """Return the relative L2 errors of displacements over the surface nodes.

    Parameters
    ----------
    found : Floats, shape (c, n, 3), m
        Displacements.
    wanted : Floats, shape (c, n, 3), m
        Displacements of the reference.

    Returns
    -------
    Floats, shape (c,)
        Errors.
    """
    square: Floats = np.sum((found - wanted) ** 2, axis=(1, 2)) / np.sum(wanted**2, axis=(1, 2))
    return np.sqrt(square)


class Release(NamedTuple):
    """Motion of a node after its load was removed, of both bodies."""

    time: Floats  # (t,) s
    wanted: Floats  # (t, 3) m, of the finite-element body
    found: Floats  # (t, 3) m, of the model

    @property
    def error(self) -> float:
        """Relative L2 error over the whole time."""
        return float(np.linalg.norm(self.found - self.wanted) / np.linalg.norm(self.wanted))


def released(organ: Organ, force: Floats, node: int, time: Floats, wanted: Floats) -> Release:
    """Return the motion of a node of the model, released from equilibrium under a load.

    Parameters
    ----------
    organ : Organ
        The organ.
    force : Floats, shape (n_surface, 3), N
        Load before the release.
    node : int
        Surface node.
    time : Floats, shape (t,), s
        Times.
    wanted : Floats, shape (t, 3), m
        Motion of the finite-element body.

    Returns
    -------
    Release
        Both motions.
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
