"""An error planted in an organ: one cell, or one spring where it has no cells, is a percent stiffer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tissue_sim.organ.organ import Organ
from tissue_sim.ros.bags.recording import Recording


def with_one_stiffer(organ: Organ, place: np.ndarray) -> Organ:
    """The cell, or spring, nearest to a place (3,) m has 1.01 times its stiffness."""
    cells = len(organ.cell_nodes) > 0
    nodes, field = (organ.cell_nodes, "cell_mu") if cells else (organ.spring_nodes, "spring_stiffness")
    middle = organ.rest_positions[nodes].mean(axis=1)
    changed = np.array(getattr(organ, field))
    changed[np.argmin(np.linalg.norm(middle - place, axis=1))] *= 1.01
    return replace(organ, **{field: changed})


def most_moved(recording: Recording, organ: Organ) -> np.ndarray:
    """Where the recorded surfaces are farthest from rest, (3,) m."""
    rest = organ.surface_positions
    moved = max((np.linalg.norm(surface - rest, axis=1) for surface in recording.organs[0].surfaces), key=np.max)
    return rest[np.argmax(moved)]
