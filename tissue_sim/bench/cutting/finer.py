"""Organs of `tissue_sim bench cut --accuracy --refine`: with a finer surface where the cut will be, and the same loads.

The shape of an organ stays exactly, so that the finite elements of the coarser one are compared with.
"""

from __future__ import annotations

import sys
from dataclasses import asdict
from typing import NamedTuple

import numpy as np

from tissue_sim import progress
from tissue_sim.array_types import Floats
from tissue_sim.bench.cutting.cuts import Cut, placed
from tissue_sim.calibration.calibrate import calibrate
from tissue_sim.calibration.checkpoint import Checkpoint
from tissue_sim.calibration.stiffness import Settings
from tissue_sim.model.cutting.sheet import FINER_WITHIN, Sheet
from tissue_sim.model.cutting.thickness import lip_thickness
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.refined import places_on, refined
from tissue_sim.organ.refinement import Along, Refinement
from tissue_sim.organ.surfaces.sizing import mean_edge
from tissue_sim.organ.tool_resolution import CUT_EDGES
from tissue_sim.organ.topology import node_area
from tissue_sim.result_cache import user_cache
from tissue_sim.version import __version__

HALF = 0.5  # of the edges that there are: wanted at the cut, or half of its depth or of a lip if that is less
# Its assessment by held-out loads takes half of a calibration's time and doesn't change the organ.
SETTINGS = Settings(smooth=1, sharp=0)


class Onto(NamedTuple):
    """How forces on an organ's surface act on a finer one. f surface nodes of that, n of the organ."""

    fraction: Floats  # (f, n) of each force

    def spread(self, force: Floats) -> Floats:
        """Return the forces (f, 3) N that forces (n, 3) N are on the finer organ."""
        found: Floats = self.fraction @ force
        return found


def onto_finer(organ: Organ, finer: Organ, sheet: Sheet) -> Onto:
    """Return how forces on an organ's surface act on a finer one of the same shape.

    As in the finite elements, the force at a node is a traction that falls to 0 across the triangles around it, and
    acts on its own side of the cut.
    """
    positions = finer.surface_positions
    corner, hat = places_on(organ, positions)
    place, own = sheet.place(positions), sheet.place(organ.surface_positions)
    beyond = (place.across < 0.0)[:, None] != (own.across < 0.0)[corner]
    hat = np.where(beyond & sheet.covers(place)[:, None], 0.0, hat)
    area = node_area(positions, finer.surface_triangles)
    fraction = np.zeros((len(positions), organ.n_surface))
    np.add.at(fraction, (np.arange(len(positions))[:, None], corner), hat * area[:, None])
    return Onto(fraction / fraction.sum(axis=0))


def finer_organ(organ: Organ, cut: Cut) -> Organ:
    """Return an organ with a finer surface where a cut will be, calibrated: some minutes, once.

    Returns the finer organ; it is kept in the user's cache. Raises UserError as a calibration does.
    """
    edge = mean_edge(organ.surface_positions, organ.surface_triangles)
    sheet = placed(organ, cut).sheet
    wanted = min(HALF * edge, min(cut.depth, lip_thickness(organ, sheet)) / CUT_EDGES)
    start = refined(organ, Refinement(places=(Along(sheet.polyline, FINER_WITHIN * edge, wanted),)))
    inputs = {"organ": start.digest(), "version": __version__, **asdict(SETTINGS)}
    folder = user_cache() / f"finer-{__version__}"
    path = folder / f"{cut.organ}-{start.digest()[:16]}.npz"
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        checkpoint = Checkpoint(folder / f".{path.stem}.calibration", inputs)
        calibrate(start, SETTINGS, checkpoint, progress.Stages()).organ.save(path)
        checkpoint.remove()
    print(f"organ: {path}", file=sys.stderr)
    return Organ.load(path)
