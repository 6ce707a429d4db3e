"""What depends on time in a recording: friction, relaxation and damping, or why they can't be identified from it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim import progress
from tissue_sim.identification.damping import Damping, damping_of, line_of, losses_of
from tissue_sim.identification.fitted_organ import with_stiffness
from tissue_sim.identification.force_curves import ForceCurves
from tissue_sim.identification.friction import Friction, friction_of
from tissue_sim.identification.measured import Measurement
from tissue_sim.identification.mixed_effects import Fit
from tissue_sim.identification.press_curves import Remember, forget
from tissue_sim.identification.relaxation import Relaxation, relaxation_of
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ


class RateEffects(NamedTuple):
    """Friction, relaxation and damping, each None where it can't be identified, and a line about each."""

    friction: Friction | None
    relaxation: Relaxation | None
    damping: Damping | None
    lines: list[str]

    def as_json(self) -> JsonObject:
        """Return the figures, as JSON can hold them."""
        found: JsonObject = {}
        if self.friction is not None:
            found["friction"] = self.friction.coefficient
        if self.relaxation is not None:
            found |= {
                "relaxation_fraction_percent": 100.0 * self.relaxation.fraction,
                "relaxation_fraction_deviation_percent": 100.0 * self.relaxation.fraction_deviation,
                "relaxation_time_s": self.relaxation.time,
                "relaxation_time_deviation_s": self.relaxation.time_deviation,
            }
        if self.damping is not None:
            found |= {
                "loss_factor": self.damping.loss.factor,
                "loss_factor_deviation": self.damping.loss.deviation,
                "loss_factor_at_hz": self.damping.loss.frequency,
                "damping_ratio": self.damping.ratio,
            }
            if self.damping.scale == self.damping.scale:  # not NaN, which JSON can't hold
                found["damping_scale"] = self.damping.scale
        return found


def rate_effects_of(
    organ: Organ,
    measurement: Measurement,
    curves: ForceCurves,
    fit: Fit,
    friction: float,
    remember: Remember = forget,
) -> RateEffects:
    """Return what a recording shows about friction, relaxation and damping.

    Parameters
    ----------
    organ : Organ
        The organ, with its own modulus.
    measurement : Measurement
        Strokes, holds and sinusoids.
    curves : ForceCurves
        The model's curves of all presses.
    fit : Fit
        Their fit.
    friction : float
        Coefficient of friction between tool and tissue in the model.
    remember : Remember, optional
        Keeps runs of the model by name.
    """
    row_of = {press.name: row for row, press in enumerate(measurement.presses)}
    has_times = any(press.speed > 0.0 for press in measurement.presses)
    offset = fit.common[1] + fit.own[:, 1]
    elastic, holds = [], []
    for hold in measurement.holds:
        row = row_of[hold.press]
        elastic.append(curves.some(np.array([row])).at(hold.depths[None] + offset[row])[0][0])
        holds.append(hold._replace(forces=hold.forces - fit.common[2]))
    sliding, lines = friction_of(measurement.strokes)
    relaxation, relaxing = relaxation_of(holds, elastic, has_times)
    loss, swinging = losses_of(measurement.sinusoids, has_times)
    damping = None
    if loss is not None:
        with progress.task("sinusoid of the model"):
            damping = damping_of(
                with_stiffness(organ, fit.factor, {}),
                [
                    (one, measurement.presses[row_of[one.press]], float(offset[row_of[one.press]]))
                    for one in measurement.sinusoids
                ],
                loss,
                relaxation,
                (measurement.radius, friction),
                remember,
            )
        swinging = line_of(damping)
    return RateEffects(sliding, relaxation, damping, [lines, relaxing, swinging])
