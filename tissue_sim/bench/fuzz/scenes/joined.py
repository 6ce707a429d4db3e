"""Hostile ticks of organs that touch, are attached and breathe, as `ticks` does for one; afterwards all sleep."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from tissue_sim.bench.fuzz.cases import Case, Input
from tissue_sim.bench.fuzz.scenes.ticks import (
    TICKS_A_SET,
    TOOLS,
    Rng,
    a_hand,
    a_load,
    a_variant,
    compiled,
    organ_called,
    use,
)
from tissue_sim.contact.attachments import Attachment, Breathing
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.scene_file import FORMAT
from tissue_sim.model.data.settings import Settings
from tissue_sim.organ.placement import placed

FRICTION = 0.3  # between organs
WAY = (0.003, 0.0, 0.015)  # m that the first organ moves with the breath
BREATHES = (1.0, 0.6)
LIGAMENT = {"within": 0.008, "stiffness": 100.0, "damping": 0.1}
BESIDE = (0.066, 0.0, 0.0)  # m, of the second kidney
SCENE = {
    "format": FORMAT,
    "organs": [
        {"name": "left", "file": "kidney.npz", "breathes": BREATHES[0]},
        {"name": "right", "file": "kidney.npz", "breathes": BREATHES[1], "position": list(BESIDE)},
    ],
    "attachments": [{"between": ["left", "right"], **LIGAMENT}],
    "breathing": {"way": list(WAY)},
    "friction": FRICTION,
}
# For each variant: fraction of the cases, organ, position of the second one beside the first (m), and options.
VARIANTS: dict[str, tuple[float, str, tuple[float, float, float], dict[str, Any]]] = {
    "springs": (0.6, "small", (0.0, 0.061, 0.0), {}),
    "springs, folding": (0.2, "small", (0.0, 0.061, 0.0), {"self_contact": True}),
    "cells": (0.2, "kidney", BESIDE, {"self_contact": True}),
}


def prepare(case: Case, folder: Path) -> Input:
    """Make two organs of one variant."""
    rng = case.rng()
    variant = a_variant(rng, VARIANTS)
    scene, defaults = made(variant)
    hands = [a_hand(rng, scene.simulations[rng.integers(len(BREATHES))]) for _ in TOOLS]
    organ = int(rng.integers(len(BREATHES)))
    load, told = a_load(rng, scene.simulations[organ])
    breath, how = a_breath(rng)
    what = f"{variant}; {', '.join(name for name, _ in hands)}; {told}; {how}"
    return Input(
        what, lambda: use(rng, scene, defaults, [hand for _, hand in hands], load._replace(organ=organ), breath)
    )


def warm_up(folder: Path) -> None:
    """Do nothing; see `ticks`."""


@lru_cache(maxsize=len(VARIANTS))
def made(variant: str) -> tuple[Scene, list[Settings]]:
    """Return the scene of a variant, which all its cases use, and its organs' default settings."""
    _, name, beside, chosen = VARIANTS[variant]
    organ = organ_called(name)
    return compiled(
        Scene(
            [organ, placed(organ, beside)],
            list(TOOLS),
            ticks_a_set=TICKS_A_SET,
            attachments=[Attachment((0, 1), **LIGAMENT)],
            breathing=Breathing(0.0, WAY),
            breathes=BREATHES,
            organ_friction=FRICTION,
            **chosen,
        )
    )


def scene_file(folder: Path) -> Path:
    """Write the scene of two kidneys for a node.

    Parameters
    ----------
    folder : Path
        Where it is written.

    Returns
    -------
    Path
        The scene's file.
    """
    organ_called("kidney").save(folder / "kidney.npz")
    (path := folder / "scene.yaml").write_text(json.dumps(SCENE), encoding="utf-8")  # JSON is YAML, too
    return path


def a_breath(rng: Rng) -> tuple[Callable[[int], float], str]:
    """Return a function of the tick that gives the breath's fraction, and its description."""
    period = 10.0 ** rng.uniform(1.0, 3.0)  # ticks
    ways: dict[str, Callable[[int], float]] = {
        "no breath": lambda tick: 0.0,
        "breathes": lambda tick: float(np.sin(np.pi * tick / period) ** 4),
        "pants": lambda tick: float(tick // 10 % 2),
        "gasps": lambda tick: float(rng.random()),
    }
    name = str(rng.choice(list(ways)))
    return ways[name], name
