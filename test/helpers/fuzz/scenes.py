"""Organs that are played with, tick by tick, and the check that they are as before afterwards, and asleep."""

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from helpers.fuzz.child import Ready
from helpers.fuzz.plays import TICKS, Hand, Load, Play
from tissue_sim.bench.sweeps.trial_simulations import small_organ
from tissue_sim.contact.attachments import Attachment, Breathing
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.scene_file import FORMAT
from tissue_sim.contact.tools import Tool
from tissue_sim.model.data.records import copy_of, words_of
from tissue_sim.model.data.settings import Settings
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.placement import placed
from tissue_sim.organ.shipped import shipped_organ

MOST_AFTER = 12_000  # ticks in which an organ that is left alone has to be asleep
TICKS_A_SET = 4
LEFT = 1e-4  # m of displacement from rest that may remain
ROUNDING = 1.0 + 1e-9
SILENCE = 0.1  # s after the last pose: more than stale_time and ramp_time of the default settings
TOOLS = (
    Tool("ball", "sphere", radius=0.005),
    Tool("rod", "capsule", radius=0.003, length=0.05),
    Tool("jaws", "gripper", radius=0.003, length=0.04),
)
DISPLACEMENT = (0.003, 0.0, 0.015)  # m that the first organ moves with the breath
BREATHES = (1.0, 0.6)
LIGAMENT = {"within": 0.008, "stiffness": 100.0, "damping": 0.1}
FRICTION = 0.3  # between organs
BESIDE = (0.066, 0.0, 0.0)  # m, of the second kidney
ABOVE = (0.0, 0.061, 0.0)  # m, of the second small organ


class Variant(NamedTuple):
    """Organ, options, and of two organs the position of the second one beside the first, m."""

    organ: str
    options: dict[str, Any]
    beside: tuple[float, float, float] | None = None


VARIANTS = {
    "springs": Variant("small", {}),
    "springs, modal": Variant("small", {"local_region": "auto"}),
    "springs, frozen": Variant("small", {"local_region": "frozen"}),
    "cells": Variant("kidney", {}),
    "cells, modal": Variant("kidney", {"local_region": "modal"}),
    "two of springs": Variant("small", {}, ABOVE),
    "two of springs, folding": Variant("small", {"self_contact": True}, ABOVE),
    "two of cells": Variant("kidney", {"self_contact": True}, BESIDE),
}


# the scenes -----------------------------------------------------------------------------------------


@cache
def _made(variant: str) -> tuple[Scene, list[Settings]]:
    """The scene of a variant, which all its plays use, with everything compiled, and its organs' default settings."""
    name, options, beside = VARIANTS[variant]
    organ: Any = organ_called(name)
    if beside is not None:
        options = options | {
            "attachments": [Attachment((0, 1), **LIGAMENT)],
            "breathing": Breathing(0.0, DISPLACEMENT),
            "breathes": BREATHES,
            "organ_friction": FRICTION,
        }
        organ = [organ, placed(organ, beside)]
    scene = Scene(organ, list(TOOLS), ticks_a_set=TICKS_A_SET, **options)
    for tick in range(1, 4):  # all that compiles does so now
        scene.simulation.apply_force([0], [[0.0, 0.0, 0.1]])
        for tool in range(len(TOOLS)):
            scene.move(tool, scene.simulation.model.rest[0], np.array([0.0, 0.0, 0.0, 1.0]), 0.3, 1_000_000 * tick)
            scene.push(tool, np.full(3, 1e-3))
        scene.step()
    return scene, [copy_of(one.settings) for one in scene.simulations]


@cache
def organ_called(name: str) -> Organ:
    """A small organ of springs, or the kidney that ships."""
    return small_organ() if name == "small" else Organ.load(shipped_organ())


def scene_file(folder: Path) -> Path:
    """Write the scene of two kidneys for a node."""
    organ_called("kidney").save(folder / "kidney.npz")
    organs = [
        {"name": "left", "file": "kidney.npz", "breathes": BREATHES[0]},
        {"name": "right", "file": "kidney.npz", "breathes": BREATHES[1], "position": list(BESIDE)},
    ]
    scene = {
        "format": FORMAT,
        "organs": organs,
        "attachments": [{"between": ["left", "right"], **LIGAMENT}],
        "breathing": {"way": list(DISPLACEMENT)},
        "friction": FRICTION,
    }
    (path := folder / "scene.yaml").write_text(json.dumps(scene), encoding="utf-8")  # JSON is YAML, too
    return path


# what tools do --------------------------------------------------------------------------------------


class Aim(NamedTuple):
    """A tool's aim: surface (n, 3), its middle, the point that it aims at, and the direction out of the organ there."""

    hand: Hand
    surface: NDArray
    centre: NDArray
    at: NDArray
    outward: NDArray


Rng = np.random.Generator
Place = tuple[NDArray, NDArray, float]  # position, quaternion, angle


def _aim(hand: Hand, scene: Scene) -> Aim:
    simulation = scene.simulations[hand.organ]
    surface = simulation.model.rest[: simulation.organ.n_surface]
    centre, at = surface.mean(axis=0), surface[hand.node % len(surface)]
    return Aim(hand, surface, centre, at, (at - centre) / max(float(np.linalg.norm(at - centre)), 1e-9))


def _rotation(rng: Rng) -> NDArray:
    drawn = rng.normal(size=4)
    return drawn / np.linalg.norm(drawn)


def _teleports(aim: Aim, tick: int, rng: Rng) -> Place:
    low, high = aim.surface.min(axis=0), aim.surface.max(axis=0)
    return rng.uniform(low - 0.02, high + 0.02), _rotation(rng), rng.uniform(-2.0, 2.0)


def _swings(aim: Aim, tick: int) -> NDArray:
    return aim.at - 0.03 * np.sin(0.02 * aim.hand.speed * tick) * aim.outward


def _presses(aim: Aim, tick: int) -> NDArray:
    return aim.at + (0.01 - 1e-4 * tick) * aim.outward


_MOTIONS: dict[str, Callable[[Aim, int, Rng], Place]] = {
    "away": lambda aim, tick, rng: (aim.centre + 1.0, aim.hand.turn, 0.5),
    "teleports": _teleports,
    "spins": lambda aim, tick, rng: (aim.at, _rotation(rng), 0.2),
    "shoots through": lambda aim, tick, rng: (
        aim.at + (0.03 - 1e-3 * aim.hand.speed * tick) * aim.outward,
        aim.hand.turn,
        0.2,
    ),
    "swings": lambda aim, tick, rng: (_swings(aim, tick), aim.hand.turn, 0.3),
    "is inside": lambda aim, tick, rng: (aim.centre + 0.3 * (aim.at - aim.centre), aim.hand.turn, 0.1),
    "presses": lambda aim, tick, rng: (_presses(aim, tick), aim.hand.turn, 0.3),
    "snaps": lambda aim, tick, rng: (_presses(aim, tick), aim.hand.turn, 0.6 * (-1.0) ** (tick // 7)),
    "flies far": lambda aim, tick, rng: (99.0 * aim.outward * (-1.0) ** tick, aim.hand.turn, 0.3),
}
_BREATHS: dict[str, Callable[[float, int, Rng], float]] = {
    "no breath": lambda period, tick, rng: 0.0,
    "breathes": lambda period, tick, rng: float(np.sin(np.pi * tick / period) ** 4),
    "pants": lambda period, tick, rng: float(tick // 10 % 2),
    "gasps": lambda period, tick, rng: float(rng.random()),
}


def _change_settings(rng: Rng, scene: Scene) -> None:
    """Change any setting that a parameter may change, within its range, or what degradation reduces."""
    drawn = {
        "friction": rng.choice([0.0, 0.6, 5.0]),
        "force_clamp": rng.choice([0.0, 0.5, 10.0, 100.0]),
        "force_slew": 10.0 ** rng.uniform(0.0, 6.0),
        "coupling_stiffness": rng.choice([0.0, 200.0, 2e4]),
        "coupling_damping": 10.0 ** rng.uniform(-1.0, 2.0),
        "stale_time": 10.0 ** rng.uniform(-2.3, 0.7),
        "ramp_time": 10.0 ** rng.uniform(-3.0, 0.0),
        "stiffness_scale": 10.0 ** rng.uniform(-2.0, 2.0),
        "damping_scale": 10.0 ** rng.uniform(-1.0, 2.0),
        "tick_time": rng.choice([1e-3, 2e-3, 4e-3]),
    }
    for simulation in scene.simulations:
        for name, value in drawn.items():
            setattr(simulation.settings, name, float(value))
    scene.set_gravity(rng.choice([0.0, 9.81, 57.0]) * rng.uniform(-1.0, 1.0, size=3))
    scene.set_substeps()


# what has to hold -----------------------------------------------------------------------------------


def prepare(play: Play) -> Ready:
    """Compile or load the kernels of its variant."""
    scene, defaults = _made(play.variant)
    return lambda: _use(play, scene, defaults)


def _use(play: Play, scene: Scene, defaults: list[Settings]) -> str:
    """Play it, release, and wait until all organs sleep."""
    scene.reset()
    _return_to_defaults(scene, defaults)
    farthest = _played(play, scene)
    faults = _faults_of(scene)
    _wait_for_rest(scene, defaults)
    left = _moved(scene)
    assert left <= LEFT, f"{1e3 * left:.3g} mm from rest at the end, asleep; was {1e3 * farthest:.3g} mm"
    return f"to {1e3 * farthest:.3g} mm, {faults} faults so far, {_faults_of(scene) - faults} afterwards"


def _played(play: Play, scene: Scene) -> float:
    """Do all of it; return how far any node came from rest, m."""
    rng = np.random.default_rng(play.noise if isinstance(play.noise, int) else 0)
    if isinstance(play.noise, dict):
        rng.bit_generator.state = play.noise
    aims = [_aim(hand, scene) for hand in play.hands]
    loaded, begin, end = scene.simulations[play.load.organ], *play.load.ticks
    pushed = _nodes_of(play.load, loaded.model.rest)
    pushes = np.resize(play.load.forces, (len(pushed), 3)) if len(pushed) else np.empty((0, 3))
    breath, period = play.breath
    farthest = 0.0
    for tick in range(TICKS):
        if rng.random() < play.storm:
            _change_settings(rng, scene)
        scene.joined.set_breathing(_BREATHS[breath](period, tick, rng))
        for tool, aim in enumerate(aims):
            if rng.random() >= aim.hand.holes:
                place = _MOTIONS[aim.hand.motion](aim, tick, rng)
                stamp = int(rng.integers(0, 2**62)) if aim.hand.wild else 1_000_000 * (1000 + tick)
                scene.move(tool, *(np.asarray(one) for one in place[:2]), place[2], stamp)
            if play.load.tips and begin <= tick < end:
                scene.push(tool, np.asarray(play.load.tips[tool % len(play.load.tips)]))
        if begin <= tick < end and len(pushed):
            loaded.apply_force(pushed, pushes)
        scene.step()
        _look(scene, tick)
        farthest = max(farthest, _moved(scene))
    return farthest


def _nodes_of(load: Load, rest: NDArray) -> NDArray:
    chosen = np.array(list(dict.fromkeys(node % len(rest) for node in load.nodes)), dtype=np.int64)
    if not len(chosen) or not load.patch:
        return chosen
    return np.argsort(np.linalg.norm(rest - rest[chosen[0]], axis=1), kind="stable")[: load.patch]


def _moved(scene: Scene) -> float:
    """The largest displacement of any node from rest, m."""
    return max(float(np.abs(one.positions - one.model.rest).max()) for one in scene.simulations)


def _faults_of(scene: Scene) -> int:
    return sum(one.state.count.faults for one in scene.simulations)


def _return_to_defaults(scene: Scene, defaults: list[Settings]) -> None:
    for one, settings in zip(scene.simulations, defaults, strict=True):
        words_of(one.settings)[:] = words_of(settings)
    scene.set_gravity(np.zeros(3))
    scene.set_substeps()


def _look(scene: Scene, tick: int) -> None:
    """Check that everything is finite, and no output exceeds the clamp."""
    wrenches, settings = scene.wrenches, scene.simulation.settings
    finite = np.all(np.isfinite(wrenches)) and all(np.all(np.isfinite(one.positions)) for one in scene.simulations)
    assert finite, f"a value that is not finite after tick {tick}"
    most = float(np.linalg.norm(wrenches[:, :3], axis=1).max())
    assert most <= ROUNDING * settings.force_clamp, f"{most:.3g} N at tick {tick}, above {settings.force_clamp:g} N"
    for one in scene.simulations:
        span = float(np.abs(one.positions - one.model.rest).max())
        assert span <= 2.0 * one.settings.runaway_span, f"{span:.3g} m from rest at tick {tick}"


def _wait_for_rest(scene: Scene, defaults: list[Settings]) -> None:
    """Run without poses, loads and breath, until all sleep and no force remains."""
    _return_to_defaults(scene, defaults)
    scene.joined.set_breathing(0.0)
    for tick in range(MOST_AFTER):
        scene.step()
        asleep = all(one.asleep for one in scene.simulations)
        if tick % 50 == 0 or asleep:
            _look(scene, TICKS + tick)
        if tick >= SILENCE * scene.simulation.rate:
            assert not scene.wrenches.any(), f"a force remains {tick} ticks after the last pose"
            if asleep:
                return
    raise AssertionError(f"not asleep {MOST_AFTER} ticks after the last load, {1e3 * _moved(scene):.3g} mm from rest")
