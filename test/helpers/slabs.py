"""A slab with an incision: held below, cut from above through its whole width, and opened by its ends."""

from dataclasses import replace
from functools import cache

import numpy as np

from helpers.bars import bar
from tissue_sim.contact.scene import Scene
from tissue_sim.organ.organ import Organ

SIZE = np.array([0.04, 0.03, 0.03])  # m
MIDDLE = 0.0215  # m, where it is cut along y, off the nodes
INCISION = [[MIDDLE, -0.01, 0.031], [MIDDLE, 0.04, 0.031]], [0.0, 0.0, -1.0], 0.021  # 20 mm deep
THROUGH = [[MIDDLE, -0.01, 0.031], [MIDDLE, 0.04, 0.031]], [0.0, 0.0, -1.0], 0.05


@cache
def slab(held: str = "below") -> Organ:
    """The slab, held below, at its left end, or nowhere."""
    organ = bar(8, 0.005, 6)
    place = organ.surface_positions
    fixed = {"below": place[:, 2] == 0.0, "left": place[:, 0] == 0.0, "": np.zeros(len(place), dtype=bool)}[held]
    return replace(organ, fixed=np.flatnonzero(fixed).astype(np.int32))


def ends(organ: Organ) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of both end faces above the floor of the incision."""
    place = organ.surface_positions
    high = place[:, 2] > 0.0101
    return np.flatnonzero(high & (place[:, 0] == 0.0)), np.flatnonzero(high & (place[:, 0] > SIZE[0] - 1e-9))


def opened(tools, gap: float = 0.006, **options) -> Scene:
    """A scene with the slab, whose incision its ends hold open by `gap` m each; negative: pressed shut."""
    scene = Scene(slab(), tools, **options)
    scene.cut(0, *INCISION)
    hold_open(scene, gap)
    return scene


def hold_open(scene: Scene, gap: float) -> None:
    """Lead both ends outward, and wait until all is at rest."""
    rest = scene.simulation.model.rest
    left, right = ends(slab())
    nodes, shift = np.r_[left, right], np.zeros((len(left) + len(right), 3))
    shift[: len(left), 0], shift[len(left) :, 0] = -gap, gap
    scene.simulation.prescribe(nodes, rest[nodes] + shift, 100)
    scene.step(300)
