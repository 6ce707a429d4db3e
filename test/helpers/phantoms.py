"""Phantoms, each painted once for all tests, and what lies around their kidneys."""

from functools import cache

import numpy as np

from tissue_sim.organ.imaging.phantom import PhantomParameters, make_phantom


@cache
def fine_phantom():
    return make_phantom()


@cache
def coarse_phantom():
    """A coarser phantom, for what doesn't depend on fineness."""
    return make_phantom(PhantomParameters(spacing=(2.0, 2.0, 2.5)))


def around_kidney(phantom, volume):
    """What of a phantom's volume lies close around its kidney, which is found sooner there."""
    centre = np.round(phantom.ct.to_index(phantom.seed_point)).astype(int)
    reach = np.ceil([60.0, 56.0, 72.5] / phantom.ct.spacing).astype(int)
    return volume.crop(centre - reach, centre + reach)
