"""The slab that `tissue_sim bench palpation --places N --slab` presses."""

from __future__ import annotations

import sys

from tissue_sim.identification.slab import cached_slab, slab_file
from tissue_sim.organ.organ import Organ

SLAB = (0.06, 0.06, 0.025)  # m


def slab() -> Organ:
    """Return a slab of 60 x 60 x 25 mm that lies on its clamp, calibrated with defaults: four minutes, once.

    It is kept in the user's cache.
    """
    found = cached_slab(SLAB)
    print(f"organ: {slab_file(SLAB)}", file=sys.stderr)
    return found
