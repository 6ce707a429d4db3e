"""The paper's own calibration: an iterative search over one factor for each group of springs.

Section 3.3: "an iterative approach is used to obtain the appropriate parameters of the elastic system, such as d, k, m
of the inner structure and the outer mesh respectively". It tells no more of the approach; here it is a pattern search
(Hooke & Jeeves 1961), which needs no slopes. The baseline for the fit of every spring.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tissue_sim.calibration.fit import Misfit
from tissue_sim.calibration.static import Longs, Springs
from tissue_sim.organ.organ import Floats, Organ, SpringKind

GROUPS = ("edges", "inner", "skeleton", "angular", "return")
FIRST_STEP, LAST_STEP = 8.0, 1.05  # factors on a group's stiffness
LIMITS = (1e-6, 1e3)  # of a group's stiffness over that at the start


def group_of(organ: Organ, springs: Springs) -> Longs:
    """The number in GROUPS of every stiffness (p,): outer mesh, spokes and virtual springs, skeleton, and the rest."""
    kind = organ.spring_kind[organ.spring_stiffness > 0.0]
    axial = np.select([kind == SpringKind.EDGE, kind == SpringKind.SKELETON], [0, 2], 1)
    _, angular, pulls = springs.counts
    return np.concatenate([axial, np.full(angular, 3), np.full(pulls, 4)])


def search(
    start: Floats, group: Longs, misfit: Misfit, iterations: int, watch: Callable[[int, Floats], None] | None = None
) -> Floats:
    """Stiffnesses (p,) N/m of the least misfit that one factor on each group reaches.

    Every group in turn is made stiffer or softer by a factor, kept where that is better; when no group gains, the
    factor shrinks to its root. iterations: misfits looked at, at the most; watch: told their number and the best
    errors (c,) so far.
    """
    present = np.unique(group)
    factors = np.ones(len(GROUPS))
    best = misfit.evaluate(start)
    count, step = 1, FIRST_STEP
    while step > LAST_STEP and count < iterations:
        gained = False
        for member in present:
            for tried in (step, 1.0 / step):
                changed = factors.copy()
                changed[member] = np.clip(changed[member] * tried, *LIMITS)
                if changed[member] == factors[member] or count >= iterations:
                    continue
                found = misfit.evaluate(start * changed[group])
                count += 1
                better = found.loss < best.loss
                if better:
                    best, factors, gained = found, changed, True
                if watch is not None:
                    watch(count, best.error)
                if better:
                    break
        if not gained:
            step = float(np.sqrt(step))
    return start * factors[group]
