"""Presses over and beside an inclusion that the organ file has, or has not: what the identification finds of it."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tissue_sim import progress
from tissue_sim.array_types import Floats
from tissue_sim.bench import rows
from tissue_sim.bench.identify import synthetic
from tissue_sim.bench.identify.known_presses import AROUND, FINGER, forces_by_elements, places_with
from tissue_sim.bench.identify.synthetic import BIAS, MODULUS, OFFSET, Recovered, Truth
from tissue_sim.identification.mixed_effects import Priors
from tissue_sim.identification.stiff_places import stiff_places
from tissue_sim.identification.uncertainty import model_error
from tissue_sim.identification.validation import held_out
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.inclusions import cell_factors, inclusions_of, with_inclusions
from tissue_sim.organ.organ import Organ

USED = 10  # places of a run; that over the inclusion is always among them
TIMES = (1, 5)  # how often each is pressed
KNOWN, UNKNOWN = "known inclusion, bias, unknown offsets", "unknown inclusion, bias, unknown offsets"
PRIORS = Priors(offset=OFFSET)


class Around(NamedTuple):
    """Truths of an organ with an inclusion by case, and its places (n, 3) m, that over the inclusion first."""

    truths: dict[str, Truth]
    points: Floats


class Found(NamedTuple):
    """Result of a case, its presses a run, and in how many runs it reports a stiff place.

    reported: over the inclusion; elsewhere: farther from there than its surroundings reach; mapped: runs in which a map
    lowers the held-out error.
    """

    recovered: Recovered
    presses: int
    reported: int
    elsewhere: int
    mapped: int


def around_of(organ: Organ) -> Around:
    """Return the curves of finite elements and of the model, with the inclusion and without it.

    They take minutes, and are kept in the user's cache. Raises UserError for an organ without an inclusion.
    """
    spots = places_with(organ)
    solved = forces_by_elements(organ, spots, "identify-inclusion")
    settled = np.isfinite(solved).all(axis=1)
    spots = [spot for spot, is_settled in zip(spots, settled, strict=True) if is_settled]
    elements, error = synthetic.elements_of(organ, solved[settled]), model_error(organ, FINGER)
    models = {KNOWN: organ, UNKNOWN: without_inclusions(organ)}
    return Around(
        {
            case: Truth(elements, synthetic.model_curves(one, spots), one.youngs_modulus, error)
            for case, one in models.items()
        },
        np.array([spot.point for spot in spots]),
    )


def without_inclusions(organ: Organ) -> Organ:
    """Return the organ as a file of it would be that knows of no inclusion: its cells are those of the tissue."""
    factors = cell_factors(inclusions_of(organ), organ.rest_positions, organ.cell_nodes)
    plain = with_inclusions(organ, [])
    return replace(plain, cell_mu=organ.cell_mu / factors, cell_lambda=organ.cell_lambda / factors)


def measure(organ: Organ, runs: int) -> list[Found]:
    """Return what is found in runs of each case. Raises UserError as `around_of` does."""
    around = around_of(organ)
    found: list[Found] = []
    with rows.until_stopped():
        for number, (times, case) in enumerate(itertools.product(TIMES, around.truths)):
            found.append(found_around(case, around, np.random.default_rng(100 + number), runs, times))
            one = found[-1]
            rows.report(
                one.recovered.name,
                f"error {np.abs(one.recovered.off).max():.1f} %",
                f"reported in {one.reported} of {runs} runs",
            )
    return found


def found_around(case: str, around: Around, random: np.random.Generator, runs: int, times: int = 1) -> Found:
    """Return what is found in runs of one case: each has other places, noise and offsets; times: presses of a place."""
    truth, count = around.truths[case], len(around.points)
    apart = np.linalg.norm(around.points - around.points[0], axis=1)
    moduli, widths = np.empty(runs), np.empty(runs)
    held = reported = elsewhere = mapped = 0
    name = case if times == 1 else f"{case}, each place {times} times"
    place = np.repeat(np.arange(min(USED, count)), times)
    for run in progress.steps(range(runs), name):
        chosen = np.concatenate([[0], 1 + np.sort(random.permutation(count - 1)[: USED - 1])])[place]
        curves = truth.model.some(chosen)
        samples = synthetic.pressed(truth.elements.some(chosen), BIAS, OFFSET, random)
        fit, interval = synthetic.identified(samples, curves, PRIORS, truth.own_error, run, place)
        moduli[run], widths[run] = fit.factor * truth.modulus, 0.5 * np.log(interval.high / interval.low)
        held += bool(interval.low * truth.modulus < MODULUS < interval.high * truth.modulus)
        stiff = chosen[stiff_places(fit, place).presses]
        reported += 0 in stiff
        elsewhere += bool((apart[stiff] > AROUND).any())
        validated = held_out(curves, samples, around.points[chosen], FINGER, PRIORS)
        mapped += validated is not None and validated.map_pays
    recovered = Recovered(name, moduli, held, float(np.median(widths)))
    return Found(recovered, len(place), reported, elsewhere, mapped)


def as_rows(found: list[Found]) -> list[JsonObject]:
    """Return all figures, as JSON can hold them."""
    return [
        {
            **row,
            "presses": one.presses,
            "reported_over_inclusion": one.reported,
            "reported_elsewhere": one.elsewhere,
            "map_pays": one.mapped,
        }
        for one, row in zip(found, synthetic.as_rows([one.recovered for one in found]), strict=True)
    ]
