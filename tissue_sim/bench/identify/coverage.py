"""How often intervals contain the true modulus, for an exact law and new places in every run.

Runs that draw from the few places with finite elements share these places, and with them the mean of the model's errors
there; their intervals contain the truth more often than they would elsewhere. Here a modulus by Hertz varies from place
to place.
"""

from __future__ import annotations

import numpy as np

from tissue_sim import progress
from tissue_sim.bench import rows
from tissue_sim.bench.identify import synthetic
from tissue_sim.bench.identify.known_presses import FINGER
from tissue_sim.bench.identify.synthetic import BIAS, MODULUS, OFFSET, Recovered
from tissue_sim.identification.force_curves import ForceCurves, hertz, tabulated
from tissue_sim.identification.mixed_effects import Priors

CASES = ((6, 0.03), (6, 0.10), (12, 0.03), (12, 0.10), (24, 0.05))  # presses, and spread of the log moduli
PRIORS = Priors(offset=OFFSET)


def measure(runs: int) -> list[Recovered]:
    """Return what is found in runs of each case."""
    found: list[Recovered] = []
    with rows.until_stopped():
        for number, (presses, spread) in enumerate(CASES):
            found.append(recovered(presses, spread, np.random.default_rng(200 + number), runs))
            one = found[-1]
            rows.report(one.name, f"error {np.abs(one.off).max():.1f} %", f"{one.held} of {runs} intervals hold")
    return found


def recovered(presses: int, spread: float, random: np.random.Generator, runs: int) -> Recovered:
    """Return what is found in runs of so many presses, between which the modulus varies by a relative spread."""
    curves = _by_hertz(presses)
    moduli, widths, held = np.empty(runs), np.empty(runs), 0
    name = f"{presses} presses, modulus varies by {100 * spread:.0f} %"
    for run in progress.steps(range(runs), name):
        stiff = np.exp(spread * random.normal(size=(presses, 1)))
        samples = synthetic.pressed(curves._replace(force=stiff * curves.force), BIAS, OFFSET, random)
        fit, interval = synthetic.identified(samples, curves, PRIORS, 0.0, run)
        moduli[run], widths[run] = fit.factor * MODULUS, 0.5 * np.log(interval.high / interval.low)
        held += bool(interval.low < 1.0 < interval.high)
    return Recovered(name, moduli, held, float(np.median(widths)))


def _by_hertz(presses: int) -> ForceCurves:
    """Return a curve for each press, with the known modulus."""
    depth, force = hertz(FINGER, MODULUS, 0.45, 6e-3)
    return tabulated([depth] * presses, [force] * presses, np.arange(presses))
