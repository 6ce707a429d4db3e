"""Plot of `tissue_sim bench palpation`: force against depth, and the stiffness that a finger feels around."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tissue_sim.bench.palpation.finger import DEPTHS, MAP_DEPTH, Map, PressForces
from tissue_sim.figures import empty_figure
from tissue_sim.organ.organ import Organ

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def drawn(organ: Organ, pressed: PressForces, around: Map) -> Figure:
    """Return curves on the left, and the map with the inclusion's outline, seen along the finger's direction."""
    from scipy.spatial import ConvexHull

    figure = empty_figure(10.0, 4.4)
    left, right = figure.subplots(1, 2)
    depths = np.concatenate([[0.0], DEPTHS]) * 1e3
    for force, name, style in (
        (pressed.reference, "finite elements, with the inclusion", "k-"),
        (pressed.ours, "tissue_sim", "C0o"),
        (pressed.plain, "finite elements, without", "k:"),
    ):
        left.plot(depths, np.concatenate([[0.0], force]), style, label=name)
    left.set(xlabel="depth, mm", ylabel="force, N", title="above the inclusion")
    left.legend()
    across = np.linalg.svd(pressed.press.direction[None])[2][1:]
    middle = organ.surface_positions[pressed.press.node]
    seen = 1e3 * (organ.surface_positions[around.nodes] - middle) @ across.T
    painted = right.tripcolor(*seen.T, around.stiffness, shading="gouraud", cmap="viridis")
    right.plot(*seen.T, ".", color="white", markersize=2)
    outline = 1e3 * (pressed.inclusion.positions - middle) @ across.T
    hull = outline[ConvexHull(outline).vertices]
    right.plot(*np.concatenate([hull, hull[:1]]).T, "r-", label="inclusion")
    right.set(xlabel="mm", ylabel="mm", title=f"stiffness at a depth of {1e3 * MAP_DEPTH:g} mm", aspect="equal")
    right.legend(loc="upper right")
    figure.colorbar(painted, ax=right, label="N/m")
    return figure
