"""Damping from sinusoids: the measured loss factor, the model's own, and the damping that makes them equal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.contact.scene import Scene
from tissue_sim.identification.measured import MeasuredPress, Sinusoid
from tissue_sim.identification.press_curves import Remember, forget
from tissue_sim.identification.pressing import Press, ball, lead
from tissue_sim.identification.relaxation import Relaxation
from tissue_sim.identification.sinusoids import CYCLES, Loss, loss_of
from tissue_sim.organ.organ import Organ

SURE = 2.0  # standard deviations, by which a loss factor is above none
SETTLING, MEASURED = 2, 4  # cycles of the model
QUICK = 0.01  # m/s, with which the model's tool goes to the middle of the sinusoid
LEAST, MOST, STEP = 0.05, 50.0, 3.0  # factors on the model's damping, and by how much they differ that are tried first
ROUNDS, CLOSE = 4, 0.02  # of the search between two of them, and of the loss factor


class Damping(NamedTuple):
    """Damping from sinusoids.

    Attributes
    ----------
    loss : Loss
        Loss factor, the mean of the sinusoids, and the median of their frequencies.
    relaxed : float
        Part of the loss factor that relaxation causes.
    own : float
        Loss factor of the model with its own damping; NaN where it was not run.
    scale : float
        Factor on the model's damping that gives the measured loss; NaN where there is none.
    sinusoids : int
        Their number.
    """

    loss: Loss
    relaxed: float
    own: float
    scale: float
    sinusoids: int

    @property
    def ratio(self) -> float:
        """Damping ratio of a mode at that frequency, half the loss factor without what relaxation causes."""
        return 0.5 * max(self.loss.factor - self.relaxed, 0.0)


def losses_of(sinusoids: Sequence[Sinusoid], has_times: bool) -> tuple[Loss | None, str]:
    """Return the loss factor of sinusoids, or None; and why there is none."""
    before = "damping: not identifiable from this recording: "
    if not has_times:
        return None, before + "its samples have no times"
    if not sinusoids:
        return None, f"{before}no tool swings in contact ({CYCLES} cycles at the least, along the direction of a press)"
    every = [loss_of(one) for one in sinusoids]
    factor, frequency, stiffness = (
        float(np.mean([one.factor for one in every])),
        float(np.median([one.frequency for one in every])),
        float(np.mean([one.stiffness for one in every])),
    )
    alone = float(np.mean([one.deviation for one in every])) / np.sqrt(len(every))
    among = float(np.std([one.factor for one in every], ddof=1)) / np.sqrt(len(every)) if len(every) > 1 else 0.0
    found = Loss(factor, max(alone, among), frequency, stiffness)
    if factor < SURE * found.deviation:
        return None, (
            f"{before}the force runs ahead of the depth by a loss factor of {factor:.3f} at {frequency:.2f} Hz, with a"
            f" standard deviation of {found.deviation:.3f}: swing faster, or sample faster"
        )
    return found, ""


def damping_of(
    organ: Organ,
    swings: Sequence[tuple[Sinusoid, MeasuredPress, float]],
    loss: Loss,
    relaxation: Relaxation | None,
    tool: tuple[float, float],
    remember: Remember = forget,
) -> Damping:
    """Return the damping that sinusoids show, and the factor on the model's damping that gives it.

    Parameters
    ----------
    organ : Organ
        The organ with the fitted modulus.
    swings : Sequence[tuple[Sinusoid, MeasuredPress, float]]
        Sinusoids, the press of each, and its contact offset, m; the model follows the first.
    loss : Loss
        Their loss factor.
    relaxation : Relaxation | None
        Relaxation, if it is known; what it causes is not damping.
    tool : tuple[float, float]
        Radius of the tool, m, and its coefficient of friction.
    remember : Remember, optional
        Keeps runs of the model by name.
    """
    relaxed = relaxation.loss_factor(loss.frequency) if relaxation else 0.0
    swing, press, offset = swings[0]
    middle = float(np.mean(swing.depths)) + offset
    amplitude = float(np.sqrt(2.0) * np.std(swing.depths))
    path = Press(press.place, press.direction)

    def own(scale: float) -> float:
        name = f"sinusoid {press.name} {loss.frequency:.6g} {scale:.6g} {middle:.9g} {organ.digest()[:16]}"

        def make() -> dict[str, Floats]:
            scene = ball(organ, *tool)
            return {"loss": np.array([model_loss(scene, path, (middle, amplitude, loss.frequency), scale)])}

        return float(remember(name, make)["loss"][0])

    wanted = loss.factor - relaxed
    first = own(1.0)
    scale = _matched(own, first, wanted) if wanted > 0.0 else np.nan
    return Damping(loss, relaxed, first, scale, len(swings))


def _matched(own: Callable[[float], float], first: float, wanted: float) -> float:
    """Return the factor at which a rising function has a value; NaN where it has none in LEAST..MOST.

    first: its value at 1. The model's loss rises ever more slowly, since damped nodes are moved rather than strained.
    """
    step = STEP if wanted > first else 1.0 / STEP
    near, far = (1.0, first), (step, own(step))
    while (far[1] - wanted) * (near[1] - wanted) > 0.0:
        if not LEAST < far[0] * step < MOST:
            return np.nan
        near, far = far, (far[0] * step, own(far[0] * step))
    for _ in range(ROUNDS):
        fraction = (wanted - near[1]) / (far[1] - near[1])
        scale = near[0] * (far[0] / near[0]) ** fraction
        between = scale, own(scale)
        if abs(between[1] - wanted) < CLOSE * wanted:
            break
        near, far = (between, far) if (between[1] - wanted) * (far[1] - wanted) < 0.0 else (near, between)
    return scale


def model_loss(scene: Scene, path: Press, motion: tuple[float, float, float], scale: float) -> float:
    """Return the loss factor of the model.

    Parameters
    ----------
    scene : Scene
        The organ and a ball.
    path : Press
        Where it presses.
    motion : tuple[float, float, float]
        Middle and amplitude, m, and frequency, Hz, of its depth.
    scale : float
        Factor on the damping.
    """
    middle, amplitude, frequency = motion
    scene.simulation.settings.damping_scale = scale
    scene.set_substeps()
    scene.reset()
    tick = scene.simulation.settings.tick_time
    lead(scene, path, (-0.002, middle), QUICK)
    count = round((SETTLING + MEASURED) / frequency / tick)
    time = tick * np.arange(count)
    depths = middle + amplitude * np.sin(2.0 * np.pi * frequency * time)
    forces = np.empty(count)
    for row in range(count):
        scene.move(0, path.at(float(depths[row])))
        scene.step()
        forces[row] = -float(scene.wrenches[0, :3] @ path.direction)
    late = time >= SETTLING / frequency
    return loss_of(Sinusoid("", time[late] - time[late][0], depths[late], forces[late])).factor


def line_of(found: Damping) -> str:
    """Return a line about damping."""
    loss, parts = found.loss, []
    if found.relaxed > 0.0:
        parts.append(f"relaxation causes {found.relaxed:.3f} of it")
    parts.append(f"the model's own is {found.own:.3f}")
    if np.isfinite(found.scale):
        parts.append(f"with damping_scale {found.scale:.3g} it has the measured one")
    else:
        parts.append(f"no damping_scale from {LEAST:g} to {MOST:g} gives the measured one")
    return (
        f"damping: loss factor {loss.factor:.3f} (standard deviation {loss.deviation:.3f}) at {loss.frequency:.2f} Hz,"
        f" a damping ratio of {found.ratio:.3f} (sinusoids: {found.sinusoids}); {'; '.join(parts)}"
    )
