"""Hostile tools, loads and settings for an organ, tick by tick in one process; afterwards it has to be as before.

Every tool does one thing for the whole of a scene; so does the load, which ends suddenly. Settings change at any time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.bench.fuzz.cases import Broken, Case, Input
from tissue_sim.bench.sweeps.trial import small_organ
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.model.data.records import copy_of, words_of
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ

TICKS = 160
MOST_AFTER = 12_000  # ticks in which an organ that is left alone has to be asleep
TICKS_A_SET = 4
LEFT = 1e-4  # m of displacement from rest that may remain
ROUNDING = 1.0 + 1e-9
SILENCE = 0.1  # s after the last pose: more than stale_time and ramp_time of the default settings

Rng = np.random.Generator
TOOLS = (
    Tool("ball", "sphere", radius=0.005),
    Tool("rod", "capsule", radius=0.003, length=0.05),
    Tool("jaws", "gripper", radius=0.003, length=0.04),
)
# Most are small, as the errors of a large one are mostly the same.
VARIANTS: dict[str, tuple[float, str, dict[str, Any]]] = {
    "springs": (0.45, "small", {}),
    "springs, modal": (0.1, "small", {"local_region": "auto"}),
    "springs, frozen": (0.05, "small", {"local_region": "frozen"}),
    "cells": (0.35, "kidney", {}),
    "cells, modal": (0.05, "kidney", {"local_region": "modal"}),
}


class Place(NamedTuple):
    """Pose of a tool: m, quaternion xyzw, rad between jaws, stamp in ns."""

    position: Floats
    quaternion: Floats
    angle: float
    stamp: int


Hand = Callable[[int], Place | None]  # by the tick; None: no pose in this one


def prepare(case: Case, folder: Path) -> Input:
    """Make a scene of one variant."""
    rng = case.rng()
    variant = a_variant(rng, VARIANTS)
    scene, defaults = made(variant)
    hands = [a_hand(rng, scene.simulation) for _ in TOOLS]
    load, told = a_load(rng, scene.simulation)
    what = f"{variant}; {', '.join(name for name, _ in hands)}; {told}"
    return Input(what, lambda: use(rng, scene, defaults, [hand for _, hand in hands], load))


def a_variant(rng: Rng, variants: Mapping[str, tuple[Any, ...]]) -> str:
    """Return one of several variants, whose first entry is its fraction of all cases.

    Parameters
    ----------
    rng : Rng
        Random numbers.
    variants : Mapping[str, tuple[Any, ...]]
        The variants.

    Returns
    -------
    str
        Name of the chosen one.
    """
    names = list(variants)
    return names[rng.choice(len(names), p=[share for share, *_ in variants.values()])]


def warm_up(folder: Path) -> None:
    """Do nothing: each variant is made, and its kernels loaded, with its first case."""


@lru_cache(maxsize=len(VARIANTS))
def made(variant: str) -> tuple[Scene, list[Settings]]:
    """Return the scene of a variant, which all its cases use, and its organs' default settings."""
    _, name, chosen = VARIANTS[variant]
    return compiled(Scene(organ_called(name), list(TOOLS), ticks_a_set=TICKS_A_SET, **chosen))


def compiled(scene: Scene) -> tuple[Scene, list[Settings]]:
    """Return a scene after everything is compiled, and its organs' default settings.

    Parameters
    ----------
    scene : Scene
        The scene.

    Returns
    -------
    tuple[Scene, list[Settings]]
        The scene and the settings.
    """
    for tick in range(1, 4):  # all that compiles does so now
        scene.simulation.apply_force([0], [[0.0, 0.0, 0.1]])
        for tool in range(len(TOOLS)):
            scene.move(tool, scene.simulation.model.rest[0], np.array([0.0, 0.0, 0.0, 1.0]), 0.3, 1_000_000 * tick)
            scene.push(tool, np.full(3, 1e-3))
        scene.step()
    return scene, [copy_of(one.settings) for one in scene.simulations]


@lru_cache(maxsize=2)
def organ_called(name: str) -> Organ:
    """Return a small organ of springs, or the kidney that ships.

    Parameters
    ----------
    name : str
        `small`, or another name for the kidney.

    Returns
    -------
    Organ
        The organ.
    """
    return small_organ() if name == "small" else Organ.load(shipped_organ())


# what is done ---------------------------------------------------------------------------------------
def a_hand(rng: Rng, simulation: Simulation) -> tuple[str, Hand]:
    """Return what a tool does to an organ.

    Parameters
    ----------
    rng : Rng
        Random numbers.
    simulation : Simulation
        The organ's simulation.

    Returns
    -------
    tuple[str, Hand]
        Name and function of the tick.
    """
    surface = simulation.model.rest[: simulation.organ.n_surface]
    low, high = surface.min(axis=0), surface.max(axis=0)
    centre, at = surface.mean(axis=0), surface[rng.integers(len(surface))]
    outward = (at - centre) / max(float(np.linalg.norm(at - centre)), 1e-9)
    speed, turn = 10.0 ** rng.uniform(-1.0, 1.3), rotation(rng)  # 0.1 to 20 m/s
    holes, wild = rng.choice([0.0, 0.3, 0.9]), rng.choice([False, True], p=[0.7, 0.3])

    def stamp(tick: int) -> int:
        return int(rng.integers(0, 2**62)) if wild else 1_000_000 * (1000 + tick)

    def away(tick: int) -> Floats:
        return at + (0.03 - 1e-3 * speed * tick) * outward

    ways: dict[str, Callable[[int], tuple[Floats, Floats, float]]] = {
        "away": lambda tick: (centre + 1.0, turn, 0.5),
        "teleports": lambda tick: (rng.uniform(low - 0.02, high + 0.02), rotation(rng), rng.uniform(-2.0, 2.0)),
        "spins": lambda tick: (at, rotation(rng), 0.2),
        "shoots through": lambda tick: (away(tick), turn, 0.2),
        "swings": lambda tick: (at - 0.03 * np.sin(0.02 * speed * tick) * outward, turn, 0.3),
        "is inside": lambda tick: (centre + 0.3 * (at - centre), turn, 0.1),
        "presses": lambda tick: (at + (0.01 - 1e-4 * tick) * outward, turn, 0.3),
        "snaps": lambda tick: (at + (0.01 - 1e-4 * tick) * outward, turn, 0.6 * (-1.0) ** (tick // 7)),
        "flies far": lambda tick: (99.0 * outward * (-1.0) ** tick, turn, 0.3),
    }
    name = str(rng.choice(list(ways)))
    way = ways[name]
    return name, lambda tick: None if rng.random() < holes else Place(*way(tick), stamp(tick))


def rotation(rng: Rng) -> Floats:
    """Return a random unit quaternion."""
    drawn = rng.normal(size=4)
    return np.asarray(drawn / np.linalg.norm(drawn))


class Load(NamedTuple):
    """Load of a scene: forces (k, 3) N on nodes (k,) from one tick to another, and (T, 3) N at the tools' tips."""

    nodes: Longs
    forces: Floats
    first: int
    last: int
    tips: Floats
    organ: int = 0


def a_load(rng: Rng, simulation: Simulation) -> tuple[Load, str]:
    """Return a load on a patch, or on nodes anywhere, that comes and goes suddenly, and forces at the tips.

    Parameters
    ----------
    rng : Rng
        Random numbers.
    simulation : Simulation
        The organ's simulation.

    Returns
    -------
    tuple[Load, str]
        The load and a description.
    """
    model = simulation.model
    count = int(rng.choice([0, 1, 10, 60]))
    n_nodes = len(model.rest)
    nodes = rng.choice(n_nodes, size=count, replace=False).astype(np.int64)
    if count and rng.random() < 0.6:
        middle = model.rest[rng.integers(n_nodes)]
        nodes = np.argsort(np.linalg.norm(model.rest - middle, axis=1), kind="stable")[:count].astype(np.int64)
    size = 10.0 ** rng.choice([rng.uniform(-2.0, 1.0), rng.uniform(1.0, 9.0)], p=[0.7, 0.3])
    way = rng.normal(size=3) if rng.random() < 0.6 else rng.normal(size=(count, 3))
    forces = np.broadcast_to(size * way / max(float(np.linalg.norm(way)), 1e-9), (count, 3))
    first, last = np.sort(rng.integers(0, TICKS, size=2))
    tips = rng.normal(size=(len(TOOLS), 3)) * 10.0 ** rng.uniform(-3.0, 9.0) * (rng.random() < 0.3)
    told = f"{size:.2g} N on {count} nodes" if count else "no load"
    return Load(nodes, forces, int(first), int(last), tips), told + (", tips" if tips.any() else "")


def one_of(rng: Rng, numbers: list[float]) -> float:
    """Return any of the numbers."""
    return float(rng.choice(numbers))


def change_settings(rng: Rng, scene: Scene) -> None:
    """Change any setting that a parameter may change, within its range, or what degradation reduces."""
    drawn = {
        "friction": one_of(rng, [0.0, 0.6, 5.0]),
        "force_clamp": one_of(rng, [0.0, 0.5, 10.0, 100.0]),
        "force_slew": 10.0 ** rng.uniform(0.0, 6.0),
        "coupling_stiffness": one_of(rng, [0.0, 200.0, 2e4]),
        "coupling_damping": 10.0 ** rng.uniform(-1.0, 2.0),
        "stale_time": 10.0 ** rng.uniform(-2.3, 0.7),
        "ramp_time": 10.0 ** rng.uniform(-3.0, 0.0),
        "stiffness_scale": 10.0 ** rng.uniform(-2.0, 2.0),
        "damping_scale": 10.0 ** rng.uniform(-1.0, 2.0),
        "tick_time": one_of(rng, [1e-3, 2e-3, 4e-3]),
    }
    for simulation in scene.simulations:
        for name, value in drawn.items():
            setattr(simulation.settings, name, value)
    scene.set_gravity(rng.choice([0.0, 9.81, 57.0]) * rng.uniform(-1.0, 1.0, size=3))
    scene.set_substeps()


# what has to hold -----------------------------------------------------------------------------------
def use(
    rng: Rng,
    scene: Scene,
    defaults: list[Settings],
    hands: list[Hand],
    load: Load,
    breath: Callable[[int], float] | None = None,
) -> str:
    """Play it, release, and wait until all organs sleep.

    Parameters
    ----------
    rng : Rng
        Random numbers.
    scene : Scene
        The scene.
    defaults : list[Settings]
        Default settings of its organs.
    hands : list[Hand]
        What the tools do.
    load : Load
        The load.
    breath : Callable[[int], float] | None, optional
        Function of the tick that gives the breath's fraction; None for none.

    Returns
    -------
    str
        A line on the result.
    """
    loaded = scene.simulations[load.organ]
    restore(scene, defaults)
    storm = rng.choice([0.0, 0.02], p=[0.7, 0.3])
    farthest = 0.0
    for tick in range(TICKS):
        if rng.random() < storm:
            change_settings(rng, scene)
        if breath is not None:
            scene.joined.set_breathing(breath(tick))
        for tool, hand in enumerate(hands):
            if (place := hand(tick)) is not None:
                scene.move(tool, *place)
            if load.tips.any() and load.first <= tick < load.last:
                scene.push(tool, load.tips[tool])
        if load.first <= tick < load.last and len(load.nodes):
            loaded.apply_force(load.nodes, load.forces)
        scene.step()
        look(scene, tick)
        farthest = max(farthest, moved(scene))
    faults = faults_of(scene)
    wait_for_rest(scene, defaults)
    left = moved(scene)
    if left > LEFT:
        raise Broken(f"{1e3 * left:.3g} mm from rest at the end, asleep; was {1e3 * farthest:.3g} mm")
    return f"to {1e3 * farthest:.3g} mm, {faults} faults so far, {faults_of(scene) - faults} afterwards"


def moved(scene: Scene) -> float:
    """Return the largest displacement of any node from rest, m."""
    return max(float(np.abs(one.positions - one.model.rest).max()) for one in scene.simulations)


def faults_of(scene: Scene) -> int:
    """Return the number of faults so far, of all organs."""
    return sum(one.state.count.faults for one in scene.simulations)


def restore(scene: Scene, defaults: list[Settings]) -> None:
    """Return the scene to its start."""
    scene.reset()
    usual(scene, defaults)


def usual(scene: Scene, defaults: list[Settings]) -> None:
    """Apply the settings of the start."""
    for one, settings in zip(scene.simulations, defaults, strict=True):
        words_of(one.settings)[:] = words_of(settings)
    scene.set_gravity(np.zeros(3))
    scene.set_substeps()


def look(scene: Scene, tick: int) -> None:
    """Check that everything is finite, and no output exceeds the clamp. Raises Broken."""
    felt, settings = scene.wrenches, scene.simulation.settings
    if not (np.all(np.isfinite(felt)) and all(np.all(np.isfinite(one.positions)) for one in scene.simulations)):
        raise Broken(f"a value that is not finite after tick {tick}")
    if (most := float(np.linalg.norm(felt[:, :3], axis=1).max())) > ROUNDING * settings.force_clamp:
        raise Broken(f"{most:.3g} N at tick {tick}, above the clamp of {settings.force_clamp:g} N")
    for one in scene.simulations:
        span = float(np.abs(one.positions - one.model.rest).max())
        if span > 2.0 * one.settings.runaway_span:
            raise Broken(f"{span:.3g} m from rest at tick {tick}")


def wait_for_rest(scene: Scene, defaults: list[Settings]) -> None:
    """Run without poses, loads and breath, until all sleep. Raises Broken where a force remains."""
    usual(scene, defaults)
    scene.joined.set_breathing(0.0)
    for tick in range(MOST_AFTER):
        scene.step()
        asleep = all(one.asleep for one in scene.simulations)
        if tick % 50 == 0 or asleep:
            look(scene, TICKS + tick)
        if tick >= SILENCE * scene.simulation.rate:
            if scene.wrenches.any():
                raise Broken(f"a force remains {tick} ticks after the last pose")
            if asleep:
                return
    raise Broken(f"not asleep {MOST_AFTER} ticks after the last load, {1e3 * moved(scene):.3g} mm from rest")
