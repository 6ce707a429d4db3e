"""Errors at places that the fit has not used: cross-validation by place, with one modulus and with a map."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from tissue_sim.array_types import Floats, Longs
from tissue_sim.identification.force_curves import Curves
from tissue_sim.identification.measured import Samples, relative_errors
from tissue_sim.identification.mixed_effects import Priors, fitted
from tissue_sim.identification.stiffness_map import interpolated

FOLDS = 5
LEAST_MAPPED = 10  # places for a map
GAIN = 0.95  # of the error with one modulus, below which a map is worth its numbers


class HeldOut(NamedTuple):
    """Median relative errors of the force at places that were not fitted; forces (n, d) N predicted there.

    mapped is NaN where no map was tried.
    """

    one: float
    mapped: float
    predicted: Floats
    places: int

    @property
    def map_pays(self) -> bool:
        """Whether a map lowers the error."""
        return self.mapped < GAIN * self.one


def places_of(points: Floats, radius: float) -> Longs:
    """Return the number of each press's place, (n,): presses within a radius, m, of each other share one.

    Presses without a known point (n, 3) have places of their own. Numbers follow the direction in which places spread
    most.
    """
    if not np.isfinite(points).all() or len(points) < 2:
        return np.arange(len(points))
    cluster = fcluster(linkage(points, "complete"), radius, "distance") - 1
    middle = np.array([points[cluster == one].mean(axis=0) for one in range(cluster.max() + 1)])
    centred = middle - middle.mean(axis=0)
    along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    rank = np.argsort(np.argsort(along, kind="stable"), kind="stable")
    return np.asarray(rank[cluster], dtype=np.int64)


def held_out(curves: Curves, samples: Samples, points: Floats, radius: float, priors: Priors) -> HeldOut | None:
    """Return the errors at held-out places, each fifth of which is left out in turn; None for a single place.

    The contact offset of a held-out press is unknown: it gets the offset that the fitted presses share.

    Parameters
    ----------
    curves : Curves
        The model's curves.
    samples : Samples
        The measured forces.
    points : Floats, shape (n, 3), m
        Where presses first touched.
    radius : float, m
        Radius of the tool.
    priors : Priors
        As for `fitted`.

    Returns
    -------
    HeldOut | None
        The errors.
    """
    place = places_of(points, radius)
    count = int(place.max()) + 1
    if count < 2:
        return None
    fold = place % min(FOLDS, count)
    with_map = count >= LEAST_MAPPED and bool(np.isfinite(points).all())
    one, mapped = (np.full(samples.depths.shape, np.nan) for _ in range(2))
    for number in range(int(fold.max()) + 1):
        left, used = fold == number, fold != number
        fit = fitted(curves.some(used), samples.some(used), priors)
        one[left] = fit.predicted(curves.some(left), samples.some(left))
        if with_map:
            own = np.zeros((int(left.sum()), 2))
            own[:, 0] = interpolated(points[used], fit.own[:, 0], points[left], radius)
            mapped[left] = fit.predicted(curves.some(left), samples.some(left), own)
    errors = [float(np.nanmedian(relative_errors(samples, one))), np.nan]
    if with_map:
        errors[1] = float(np.nanmedian(relative_errors(samples, mapped)))
    pays = errors[1] < GAIN * errors[0]
    return HeldOut(errors[0], errors[1], mapped if pays else one, count)
