"""Identification of an organ's stiffness from measured presses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.identification.diagnosis import Diagnosis, diagnosed
from tissue_sim.identification.fitted_organ import with_stiffness
from tissue_sim.identification.force_curves import ForceCurves
from tissue_sim.identification.law_curves import law_curves_of
from tissue_sim.identification.measured import Measurement, Samples, samples_of
from tissue_sim.identification.mixed_effects import Fit, Priors, fitted
from tissue_sim.identification.press_curves import FAST, Arrays, Remember, check_tool, curves_of, forget
from tissue_sim.identification.rate_effects import RateEffects, rate_effects_of
from tissue_sim.identification.relaxing_organ import Presses, relaxing
from tissue_sim.identification.stiff_places import StiffPlaces, stiff_places
from tissue_sim.identification.stiff_places import line_of as line_of_stiff_places
from tissue_sim.identification.stiffening import Stiffening, law_fit
from tissue_sim.identification.stiffening import line_of as line_of_stiffening
from tissue_sim.identification.stiffness_map import decaying
from tissue_sim.identification.uncertainty import (
    Interval,
    NextPress,
    drawn_factors,
    interval_of,
    model_error,
    next_press,
)
from tissue_sim.identification.validation import HeldOut, held_out, places_of
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ

CORRECTIONS = 2  # of a map, since a press feels more than the tissue right under it
MOST_UNSURE = 1.5  # largest ratio of an interval's ends without a warning: +- 20 %

NEO_HOOKEAN, EXPONENTIAL = LAWS = "neo-hookean", "exponential"


class Settings(NamedTuple):
    """Settings of an identification: priors of contact and bias, friction of the tool, whether to try a map.

    law: one of LAWS, of which the exponential one's b is fitted and used where it pays; None for the organ's own.
    """

    priors: Priors = Priors()
    friction: float = 0.6
    with_map: bool = True
    law: str | None = None


class Identified(NamedTuple):
    """Result of an identification; `of_cells` are factors on the cells' moduli, None without a map on the organ."""

    organ: Organ
    source: Organ
    measurement: Measurement
    samples: Samples
    curves: ForceCurves
    fit: Fit
    interval: Interval
    held_out: HeldOut | None
    diagnosis: Diagnosis
    next_press: NextPress
    of_cells: Floats | None
    rate_effects: RateEffects
    stiff_places: StiffPlaces
    stiffening: Stiffening | None
    remarks: list[str]

    @property
    def modulus(self) -> float:
        """Young's modulus, Pa."""
        return self.fit.factor * self.source.youngs_modulus

    @property
    def modulus_interval(self) -> tuple[float, float]:
        """The 95 % interval of Young's modulus, Pa."""
        return self.interval.low * self.source.youngs_modulus, self.interval.high * self.source.youngs_modulus


def identify(
    organ: Organ, measurement: Measurement, settings: Settings | None = None, remember: Remember = forget
) -> Identified:
    """Fit an organ's stiffness to measured presses.

    Parameters
    ----------
    organ : Organ
        The organ, of any stiffness.
    measurement : Measurement
        The presses.
    settings : Settings | None, optional
        Settings; None for the usual ones.
    remember : Remember, optional
        Keeps runs of the model by name, so that an identification can be continued.

    Returns
    -------
    Identified
        The fitted organ and all that is known about it.

    Raises
    ------
    UserError
        Without presses, for a tool too small for the organ, for presses that miss it, and where a law is asked for of
        an organ without cells.
    """
    settings = settings or Settings()
    source, organ = organ, _elastic(organ, settings.law)
    check_tool(organ, measurement.radius)
    samples, factor = samples_of(measurement.presses), 1.0
    curves = curves_of(organ, measurement, settings.friction, factor, remember)
    fit = fitted(curves, samples, settings.priors)
    if measurement.is_registered and any(press.speed > FAST for press in measurement.presses):
        factor = float(f"{fit.factor:.2g}")
        curves = curves_of(organ, measurement, settings.friction, factor, remember)
        fit = fitted(curves, samples, settings.priors)
    points = measurement.points
    place = places_of(points, measurement.radius)
    validated = held_out(curves, samples, points, measurement.radius, settings.priors)
    law = None
    if settings.law == EXPONENTIAL:
        pressed = partial(_curves_with_b, measurement, settings.friction, factor, remember)
        every = law_curves_of(organ, curves, pressed)
        law = law_fit(every, samples, settings.priors, points, measurement.radius, validated)
    if law is not None and law.stiffening.pays:
        organ, fit, validated = replace(organ, stiffening=law.stiffening.b), law.fit, law.held_out
        curves, drawn = law.curves.under(fit.law), np.exp(law.drawn[:, 0])
    else:
        drawn = drawn_factors(curves, samples, settings.priors, fit, place)
    interval = interval_of(fit, drawn, int(place.max()) + 1, model_error(organ, measurement.radius))
    following = next_press(
        organ,
        curves,
        measurement.radius,
        settings.priors,
        (fit, interval, points if measurement.is_registered else None),
    )
    wanted = settings.with_map and validated is not None and validated.map_pays
    of_cells = None
    if wanted and measurement.is_registered and len(organ.cell_nodes):
        of_cells = _map_of_cells(organ, measurement, (curves, samples, fit), settings.friction, remember)
    found = Identified(
        organ,
        source,
        measurement,
        samples,
        curves,
        fit,
        interval,
        validated,
        diagnosed(curves, samples, settings.priors, fit),
        following,
        of_cells,
        rate_effects_of(organ, measurement, curves, fit, settings.friction, remember),
        stiff_places(fit, place),
        None if law is None else law.stiffening,
        _remarks(wanted, of_cells is not None),
    )
    stiff = with_stiffness(organ, fit.factor, provenance_of(found), of_cells)
    offsets = fit.common[1] + fit.own[:, 1]
    presses = Presses(measurement, curves, offsets, fit.factor, settings.friction)
    fitting, remark = relaxing(stiff, found.rate_effects.relaxation, presses, remember)
    return found._replace(organ=fitting, remarks=[*found.remarks, *([remark] if remark else [])])


def _elastic(organ: Organ, law: str | None) -> Organ:
    """Return an organ that doesn't relax, nor stiffen where a law is given. Raises UserError as `identify` does."""
    organ = replace(organ, relaxation_fraction=0.0, relaxation_time=0.0)
    if law is None:
        return organ
    if law == EXPONENTIAL and not len(organ.cell_nodes):
        raise UserError(f"organ '{organ.name}' has no cells, which alone have the exponential law; calibrate it first")
    return replace(organ, stiffening=0.0)


def _curves_with_b(
    measurement: Measurement, friction: float, factor: float, remember: Remember, organ: Organ
) -> ForceCurves:
    """Return the curves of an organ with some b, whose runs are kept under names of their own; see `curves_of`."""

    def kept(name: str, make: Callable[[], Arrays]) -> Arrays:
        return remember(f"b {organ.stiffening:g} {name}", make)

    return curves_of(organ, measurement, friction, factor, kept)


def _map_of_cells(
    organ: Organ,
    measurement: Measurement,
    found: tuple[ForceCurves, Samples, Fit],
    friction: float,
    remember: Remember,
) -> Floats:
    """Return factors on the cells' moduli with which the model's presses deviate as the measured ones do."""
    curves, samples, fit = found
    points, wanted = measurement.points, fit.own[:, 0]
    middle = organ.rest_positions[organ.cell_nodes].mean(axis=1)
    deep = samples.depths.max(axis=1, keepdims=True) + fit.common[1] + fit.own[:, 1:]
    plain, given = curves.at(deep)[0][:, 0], wanted.copy()
    for _ in range(CORRECTIONS):
        of_cells = np.exp(decaying(points, given, middle, measurement.radius))
        trial = with_stiffness(organ, 1.0, {}, of_cells)

        def kept(name: str, make: Callable[[], Arrays], tissue: str = trial.digest()) -> Arrays:
            return remember(f"{tissue[:16]} {name}", make)

        of_map = curves_of(trial, measurement, friction, 1.0, kept).at(deep)[0][:, 0]
        given = given + wanted - np.log(np.maximum(of_map, 1e-9) / np.maximum(plain, 1e-9))
    return np.asarray(np.exp(decaying(points, given, middle, measurement.radius)))


def _remarks(map_pays: bool, is_mapped: bool) -> list[str]:
    """Return lines on what the organ file can't hold."""
    if not map_pays or is_mapped:
        return []
    return [
        "a map of stiffness lowers the held-out error, but the organ file has one modulus: places are not in its axes,"
        " or it has no cells"
    ]


def provenance_of(found: Identified) -> JsonObject:
    """Return what an organ's file states about its identification, as JSON can hold it."""
    low, high = found.modulus_interval
    record: JsonObject = {
        "from": found.measurement.source,
        "presses": len(found.measurement.presses),
        "tool_radius_mm": 1e3 * found.measurement.radius,
        "youngs_modulus_pa": found.modulus,
        "interval_95_percent_pa": [low, high],
        "contact_offset_mm": 1e3 * float(found.fit.common[1]),
        "bias_n": float(found.fit.common[2]),
        "spread_between_places_percent": 100.0 * found.fit.spread,
        "with_map": found.of_cells is not None,
        "holds_to_depth_mm": 1e3 * found.diagnosis.holds_to,
        "digest_before": found.source.digest(),
        **found.rate_effects.as_json(),
    }
    if found.stiffening is not None:
        record |= found.stiffening.as_json()
    if len(found.stiff_places.presses):
        record["stiff_places"] = [found.measurement.presses[row].name for row in found.stiff_places.presses]
    if found.held_out is not None:
        record["held_out_error_percent"] = 100.0 * found.held_out.one
        if np.isfinite(found.held_out.mapped):
            record["held_out_error_with_map_percent"] = 100.0 * found.held_out.mapped
    return record


def lines_of(found: Identified) -> list[str]:
    """Return the result as lines of text."""
    low, high = found.modulus_interval
    interval, fit, seen = found.interval, found.fit, found.diagnosis
    lines = [
        f"presses: {len(found.measurement.presses)} of a tool with a radius of {1e3 * found.measurement.radius:g} mm",
        f"Young's modulus: {found.modulus:.0f} Pa, 95 % interval {low:.0f} to {high:.0f} Pa (standard deviation"
        f" {100 * interval.from_presses:.1f} % from the presses, {100 * interval.from_model:.1f} % of the model)",
        f"contact offset {1e3 * fit.common[1]:+.3f} mm, bias {1e3 * fit.common[2]:+.1f} mN, between places the modulus"
        f" varies by {100 * fit.spread:.0f} %",
    ]
    if high > MOST_UNSURE * low:
        lines.append(
            f"warning: these presses hardly determine the modulus, its interval is a factor of {high / low:.2g} wide:"
            " press slowly and straight in, at more places, and hold (docs/identify.md)"
        )
    if found.held_out is None:
        lines.append("held-out error: not known, with presses at a single place")
    else:
        mapped = found.held_out.mapped
        lines.append(
            f"held-out error of the force, median: {100 * found.held_out.one:.1f} % with one modulus"
            + (f", {100 * mapped:.1f} % with a map" if np.isfinite(mapped) else "")
            + f" ({found.held_out.places} places)"
        )
    if found.stiffening is not None:
        lines.append(line_of_stiffening(found.stiffening))
    lines.append(f"force goes as depth to the power {seen.exponent:.2f}, the model's {seen.model_exponent:.2f}")
    if seen.stiffens:
        lines.append(
            "warning: the tissue stiffens more with depth than the model can: its support or its law are wrong (a thin"
            f" layer on something hard, or tissue of another law); {_holding(seen)}"
        )
    elif seen.holds_to < seen.depths[-1]:
        lines.append(f"warning: {_holding(seen)}")
    if len(found.stiff_places.presses):
        names = [press.name for press in found.measurement.presses]
        lines.append(line_of_stiff_places(found.stiff_places, names, found.measurement.points))
    return [*lines, *found.rate_effects.lines, *found.remarks, _proposal(found)]


def _holding(seen: Diagnosis) -> str:
    if not seen.holds_to:
        return "the fit holds at no depth (median error over 10 %)"
    return f"the fit holds to a depth of {1e3 * seen.holds_to:.1f} mm (median error within 10 % there)"


def _proposal(found: Identified) -> str:
    """Return where to press next, and how deep."""
    after, interval = found.next_press, found.interval
    if interval.from_presses < 0.5 * interval.from_model:
        return "next press: none narrows the interval much, since most of it is the model's own error"
    where = "; ".join("{:.1f}, {:.1f}, {:.1f}".format(*(1e3 * point)) for point in after.places)
    at = f", best at ({where}) mm" if where else ", at another place"
    return f"next press: {1e3 * after.depth:.1f} mm deep{at}; the interval is then +- {100 * after.width:.0f} %"
