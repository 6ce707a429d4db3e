"""Extended position based dynamics of pypbd: one constraint of elastic energy per tetrahedron.

Macklin, Mueller and Chentanez, XPBD (2016), as the PositionBasedDynamics library has it. What its Python module lacks
is done here: it can't switch gravity off, so lengths are in micrometres, of which 9.81 are negligible; it takes no
forces, so each step begins with their impulse; and it has no damping, so momentum is reduced before each step. Only its
own step is timed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats
from tissue_sim.bench.peers.engine import Answer, Load, settle_by_steps, timed
from tissue_sim.bench.peers.tetrahedra import Tetrahedra
from tissue_sim.bench.timing import Burst
from tissue_sim.organ.organ import Organ

UNIT = 1e-6  # m
DAMPING_RATE = 8.0  # 1/s: together with numerical damping, a kidney settles in a second or two
DAMPED_EVERY = 0.01  # s
TREMBLING = 2e-3  # fraction of its displacement: it never rests completely
ROUNDS = 1  # of scaling the stiffness
FEM_CONSTRAINTS = 3  # pypbd's number of the XPBD constraint of a tetrahedron's strain energy


class Settings(NamedTuple):
    """Tuning of XPBD: step, s, iterations per step, and a factor of Young's modulus."""

    step: float = 1e-3
    iterations: int = 1
    stiffness: float = 1.0


class Xpbd:
    """Organ of tetrahedra in pypbd. Raises ModuleNotFoundError without pypbd."""

    def __init__(self, organ: Organ, mesh: Tetrahedra, settings: Settings, longest: float = 3.0) -> None:
        import pypbd

        self.organ, self.settings, self.longest = organ, settings, longest
        self.update = settings.step
        if not pypbd.Simulation.hasCurrent():
            pypbd.Simulation.getCurrent().initDefault()  # once in a process; gravity is read from it
        self._time = pypbd.TimeManager.getCurrent()
        self._model = pypbd.SimulationModel()
        self._model.init()
        self.rest = mesh.nodes / UNIT
        body = self._model.addTetModel(list(self.rest), mesh.cells.ravel().tolist())
        self._particles = self._model.getParticles()
        self.mass = mesh.masses(organ.density)
        held = np.zeros(len(self.mass), dtype=bool)
        held[organ.fixed] = True
        self._free = np.flatnonzero(~held)
        for node in range(len(self.mass)):
            self._particles.setMass(node, 0.0 if held[node] else float(self.mass[node]))
        modulus = settings.stiffness * organ.youngs_modulus * UNIT  # kg / (um s^2)
        self._model.addSolidConstraints(body, FEM_CONSTRAINTS, modulus, organ.poisson_ratio, 0.0, False, False)
        self.constraints = len(self._model.getConstraints())
        kind = pypbd.TimeStepController
        self._controller = kind()
        self._controller.init()
        self._controller.setValueUInt(kind.NUM_SUB_STEPS, 1)
        self._controller.setValueUInt(kind.MAX_ITERATIONS, settings.iterations)
        self._controller.setValueUInt(kind.MAX_ITERATIONS_V, 0)

    def settle(self, load: Load) -> Answer:
        """Step until the surface is at rest."""
        self._reset()
        step = self._stepper(load)
        return settle_by_steps(step, lambda: self.displacement, self.update, self.longest, TREMBLING)

    def burst(self, load: Load) -> Burst:
        """Return a function that times steps under the load."""
        self._reset()
        step = self._stepper(load)
        return lambda count: np.array([step() for _ in range(count)])

    def _stepper(self, load: Load) -> Callable[[], float]:
        """Return a function that does a step under the load and returns the seconds of the step itself."""
        particles, free = self._particles, self._free.tolist()
        loaded = load.nodes
        kicks = load.force[loaded] * self.update / (self.mass[loaded, None] * UNIT)
        stride = max(1, round(DAMPED_EVERY / self.update))
        keep = math.exp(-DAMPING_RATE * stride * self.update)
        steps = 0

        def step() -> float:
            nonlocal steps
            if steps % stride == 0:
                for node in free:
                    particles.setVelocity(node, keep * particles.getVelocity(node))
            steps += 1
            for node, kick in zip(loaded.tolist(), kicks, strict=True):
                particles.setVelocity(node, particles.getVelocity(node) + kick)
            self._time.setTimeStepSize(self.update)
            return timed(lambda: self._controller.step(self._model))

        return step

    @property
    def displacement(self) -> Floats:
        """Present displacements (n_surface, 3) m of the surface."""
        n = self.organ.n_surface
        return (np.asarray(self._particles.getVertices())[:n] - self.rest[:n]) * UNIT

    def _reset(self) -> None:
        zero: NDArray[np.float64] = np.zeros(3)
        for node in range(len(self.rest)):
            self._particles.setPosition(node, self.rest[node])
            self._particles.setVelocity(node, zero)


def tuned(organ: Organ, mesh: Tetrahedra, loads: Sequence[Load], iterations: Sequence[int] = (1,)) -> Settings:
    """Return the settings that come closest to the reference on some loads: iterations and stiffness.

    Its equilibrium depends on its iterations, which it stops before they converge, as real time requires. So for each
    number of iterations the stiffness is scaled by how much the answers are too small or too large.

    loads: loads of the tuning; iterations: numbers of iterations that are tried. Raises ModuleNotFoundError without
    pypbd.
    """
    best = math.inf, Settings()
    for count in iterations:
        settings = Settings(iterations=count, stiffness=1.0 / count)
        for _ in range(ROUNDS + 1):
            engine = Xpbd(organ, mesh, settings)
            found = [(engine.settle(load).displacement, load.reached) for load in loads]
            off = [float(np.linalg.norm(u - wanted) / np.linalg.norm(wanted)) for u, wanted in found]
            best = min(best, (sum(off) / len(off), settings))
            if not all(np.any(u) for u, _ in found):
                break  # it has run away
            short = [float(np.vdot(u, wanted) / np.vdot(u, u)) for u, wanted in found]
            settings = settings._replace(stiffness=settings.stiffness / float(np.median(short)))
    return best[1]
