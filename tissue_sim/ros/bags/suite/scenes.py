"""The scenes of the suite: poses, angles and forces of their tools, step by step."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from tissue_sim.array_types import Floats, Longs
from tissue_sim.contact.tools import Tool
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.bridge.contact_locations import FRONT, Surface, rotation_towards
from tissue_sim.ros.bridge.motion import minimum_jerk
from tissue_sim.ros.bridge.trajectory import plan

STEP = 0.004  # s of simulated time from one pose to the next
UNIT = 0.002  # N that one unit of the paper's forces stands for, as in `tissue_sim bench table1`
LOCAL, GLOBAL, GLOBAL_POINTS = 100 * UNIT, 500 * UNIT, 10  # N: LF(100), and GF(500) shared by ten points
RADIUS = 0.005  # m, of a usual tool
FAR = 0.03  # m from the surface, where a tool waits
CLEAR = 0.003  # m between the surface and a tool that acts by its external force only
LEFT_ALONE = 0.2  # s after the last action, so that a bag ends at rest
CUT_EDGE = np.array([[0.055, 0.0, 0.0], [0.075, 0.0, 0.0]])  # m, beside the kidney's lateral side
POLE, SPREAD = 0.024, 0.011  # m from the end of the pole to the grippers' tips, and how far each is moved aside
LIP, PRESSED, PULLED = 0.008, 0.003, 0.008  # m from the cut, into the tissue, and aside
TO_SLEEP = 1.5  # s in which the organ comes to rest and falls asleep


class Blade(NamedTuple):
    """Where a cut begins, and where it is moved; the node's parameter cut_depth says how far."""

    edge: Floats  # (2, 3) m
    pose: Floats  # (4,) quaternion xyzw that turns z to the direction


class Step(NamedTuple):
    """What is sent before the next STEP of simulated time, by the number of a tool."""

    poses: Mapping[int, Floats] = {}  # (7,) m, quaternion xyzw
    angles: Mapping[int, float] = {}  # rad between a gripper's jaws
    forces: Mapping[int, Floats] = {}  # (3,) N
    cut: Blade | None = None  # the organ is cut, and more steps without anything are sent until it is
    refused: Sequence[str] = ()  # kinds of bad input that the first tool sends, as the node counts them


Steps = Iterator[Step]


@dataclass(frozen=True)
class Scene:
    """What happens to an organ: its tools, further parameters of the node, and the steps."""

    name: str
    what: str
    steps: Callable[[Organ, Sequence[Tool]], Steps]
    tools: tuple[str, ...] = ("left",)
    radius: float = RADIUS
    shape: str = "sphere"
    parameters: Mapping[str, str] = field(default_factory=dict)
    pushes: bool = False  # its tools bring external forces

    def made_tools(self) -> list[Tool]:
        """Return the tools as the node has them."""
        if self.shape == "gripper":
            return [Tool(name, shape="gripper", length=0.06, mesh="config/jaws/flat.obj") for name in self.tools]
        return [Tool(name, radius=self.radius) for name in self.tools]

    def as_parameters(self) -> dict[str, str]:
        """Return the node's parameters."""
        values = {"tools": f"[{', '.join(self.tools)}]"}
        for tool in self.made_tools():
            values |= {f"{tool.name}.shape": tool.shape, f"{tool.name}.radius": f"{tool.radius}"}
            if self.pushes:
                values |= {f"{tool.name}.external_cf": f"{tool.name}/external_cf"}
            if tool.mesh:
                values |= {f"{tool.name}.mesh": tool.mesh, f"{tool.name}.length": f"{tool.length}"}
        return values | dict(self.parameters)


# parts of scenes -------------------------------------------------------------------------------
def _surface(organ: Organ, radius: float) -> Surface:
    return Surface(organ.surface_positions, organ.surface_triangles.astype(np.int64), radius)


def _pose(place: Floats, direction: Floats) -> Floats:
    return np.concatenate([place, rotation_towards(direction)])


def _along(paths: Mapping[int, tuple[Floats, Floats, Floats]], seconds: float) -> Steps:
    """Yield steps that move tools from a place to another in some s, from rest to rest; each looks in a direction."""
    count = max(1, round(seconds / STEP))
    for fraction in minimum_jerk(np.arange(1, count + 1) / count):
        yield Step({tool: _pose(a + fraction * (b - a), direction) for tool, (a, b, direction) in paths.items()})


def _nothing(seconds: float) -> Steps:
    """Yield steps in which time passes and nothing is sent."""
    for _ in range(round(seconds / STEP)):
        yield Step()


def _scripted(action: str, every: int = 1, faster: int = 1) -> Callable[[Organ, Sequence[Tool]], Steps]:
    """Return what the scripted bridge does, from where its fast approach ends on.

    every: steps from one pose to the next; faster: how much faster than the bridge, since long scenes make large bags.
    """

    def steps(organ: Organ, tools: Sequence[Tool]) -> Steps:
        jaws = {tool.name: tool.jaws for tool in tools if tool.shape == "gripper"}
        names, rate = [tool.name for tool in tools], 1.0 / STEP
        path = plan(_surface(organ, tools[0].radius), names, (action,), jaws, rate / every)
        acting = np.char.startswith(path.phases, action)
        acting &= ~np.isin(path.phases, (f"{action}/approach", f"{action}/retreat"))
        for index in np.flatnonzero(acting)[::faster]:
            angles = {tool: float(path.angles[index, tool]) for tool, name in enumerate(names) if name in jaws}
            yield Step(dict(enumerate(path.poses[index])), angles)
            yield from _nothing((every - 1) * STEP)
        yield from _nothing(LEFT_ALONE)

    return steps


def _squeeze(organ: Organ, tools: Sequence[Tool]) -> Steps:
    """Press all of the organ from both sides with two balls as large as it is wide."""
    surface, direction = _surface(organ, tools[0].radius), np.array([1.0, 0.0, 0.0])
    touches = [surface.touch(surface.ball.centre, one) for one in (direction, -direction)]
    places = [(touch.place, touch.direction) for touch in touches if touch]
    away = {tool: (place - FAR * one, place, one) for tool, (place, one) in enumerate(places)}
    pressed = {tool: (place, place + 0.006 * one, one) for tool, (place, one) in enumerate(places)}
    yield from _along(away, 0.3)
    yield from _along(pressed, 0.4)
    yield from _along({tool: (b, b, one) for tool, (_, b, one) in pressed.items()}, 0.3)
    yield from _along({tool: (b, a, one) for tool, (a, b, one) in pressed.items()}, 0.4)
    yield from _along({tool: (b, a, one) for tool, (a, b, one) in away.items()}, 0.3)
    yield from _nothing(LEFT_ALONE)


def spread_over_front(organ: Organ, count: int) -> tuple[Longs, Floats]:
    """Return surface nodes (k,), each as far from the others as can be, and the normal (3,) at the first one."""
    points, triangles = organ.surface_positions, organ.surface_triangles
    corner = points[triangles]
    normals = np.zeros_like(points)
    for node in range(3):
        np.add.at(normals, triangles[:, node], np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    front = np.flatnonzero(normals @ FRONT < -0.8)
    middle = points[front].mean(axis=0)
    chosen = [int(front[np.argmin(np.linalg.norm(points[front] - middle, axis=1))])]
    while len(chosen) < count:
        gaps = np.linalg.norm(points[front][:, None] - points[chosen][None], axis=2).min(axis=1)
        chosen.append(int(front[np.argmax(gaps)]))
    return np.array(chosen), normals[chosen[0]]


def _pushed(total: float, points: int) -> Callable[[Organ, Sequence[Tool]], Steps]:
    """Return steps of forces alone, shared by points; each tool sends its point once, and stays clear of it."""

    def steps(organ: Organ, tools: Sequence[Tool]) -> Steps:
        nodes, normal = spread_over_front(organ, points)
        places = organ.surface_positions[nodes] + (tools[0].radius + CLEAR) * normal
        yield Step({tool: _pose(place, -normal) for tool, place in enumerate(places)})
        yield from _nothing(2 * STEP)
        up = minimum_jerk(np.linspace(0.0, 1.0, round(0.3 / STEP)))
        every = max(1, points // 4)  # steps between two forces of a tool: a bag of ten tools is no larger for it
        for index, fraction in enumerate([*up, *np.ones(round(0.8 / STEP)), *up[::-1]]):
            force = -fraction * total / points * normal
            yield Step(forces=dict.fromkeys(range(points), force) if index % every == 0 else {})
        yield Step(forces=dict.fromkeys(range(points), np.zeros(3)))
        yield from _nothing(LEFT_ALONE)

    return steps


def _fly(organ: Organ, tools: Sequence[Tool]) -> Steps:
    """Move a tool through all of the organ at 1.5 m/s, and back."""
    surface = _surface(organ, tools[0].radius)
    touch = surface.poke_location()
    start, end = touch.at(-0.05), touch.at(0.12)
    for a, b in ((start, end), (end, start)):
        yield from _along({0: (a, a, touch.direction)}, 0.1)
        count = round(np.linalg.norm(end - start) / 1.5 / STEP)
        for fraction in np.arange(1, count + 1) / count:
            yield Step({0: _pose(a + fraction * (b - a), touch.direction)})
        yield from _along({0: (b, b, touch.direction)}, 0.5)
    yield from _nothing(LEFT_ALONE)


def _bad_input(organ: Organ, tools: Sequence[Tool]) -> Steps:
    """Send poses that are refused while a tool presses; then none, until its force has faded."""
    touch = _surface(organ, tools[0].radius).poke_location()
    yield from _along({0: (touch.at(-FAR), touch.place, touch.direction)}, 0.4)
    yield from _along({0: (touch.place, touch.at(0.005), touch.direction)}, 0.3)
    for kind in ("malformed", "nan_pose", "zero_quaternion", "unknown_frame", "no_stamp", "backward_stamp", "far_pose"):
        yield Step(refused=[kind])
        yield from _along({0: (touch.at(0.005), touch.at(0.005), touch.direction)}, 0.04)
    yield from _nothing(0.3)
    yield from _along({0: (touch.at(0.005), touch.at(-FAR), touch.direction)}, 0.4)
    yield from _along({0: (touch.at(-FAR), touch.at(0.003), touch.direction)}, 0.5)
    yield from _along({0: (touch.at(0.003), touch.at(-FAR), touch.direction)}, 0.4)
    yield from _nothing(LEFT_ALONE)


def _sleep(organ: Organ, tools: Sequence[Tool]) -> Steps:
    """Touch the organ, leave it until it sleeps, wake it by a touch, and leave it again."""
    touch = _surface(organ, tools[0].radius).poke_location()
    for depth in (0.004, 0.002):
        yield from _along({0: (touch.at(-FAR), touch.at(depth), touch.direction)}, 0.5)
        yield from _along({0: (touch.at(depth), touch.at(-FAR), touch.direction)}, 0.5)
        yield from _nothing(TO_SLEEP)


def _cut_and_spread(organ: Organ, tools: Sequence[Tool]) -> Steps:
    """Cut the lateral side, pull the lips apart by friction, and release them."""
    surface, direction = _surface(organ, tools[0].radius), np.array([0.0, 1.0, 0.0])
    quarter = np.sqrt(0.5)
    yield Step(cut=Blade(CUT_EDGE, np.array([-quarter, 0.0, 0.0, quarter])))
    middle, aside = CUT_EDGE.mean(axis=0), np.array([0.0, 0.0, 1.0])
    found = {tool: surface.touch(middle + side * LIP * aside, direction) for tool, side in ((0, -1.0), (1, 1.0))}
    places = {tool: touch.place for tool, touch in found.items() if touch}
    pressed = {tool: place + PRESSED * direction for tool, place in places.items()}
    pulled = {tool: place + (2 * tool - 1) * PULLED * aside for tool, place in pressed.items()}
    away = {tool: place - FAR * direction for tool, place in places.items()}
    legs = (away, away), (away, places), (places, pressed), (pressed, pulled), (pulled, pulled), (pulled, away)
    for seconds, (start, end) in zip((0.04, 0.2, 0.12, 0.32, 0.08, 0.2), legs, strict=True):
        yield from _along({tool: (start[tool], end[tool], direction) for tool in places}, seconds)
    yield from _nothing(LEFT_ALONE)


def _split_and_spread(organ: Organ, tools: Sequence[Tool]) -> Steps:
    """Split the lower pole, spread both halves with a gripper on each, and release them."""
    points = organ.surface_positions
    out, aside, front = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    out, aside = -out * np.sign(out[2]), aside * np.sign(aside[0])
    front, end = np.cross(out, aside), float((points @ out).max())
    pole = points[points @ out > end - POLE] @ np.stack([aside, front]).T
    across, along = 0.5 * (pole.min(axis=0) + pole.max(axis=0))
    middle, quarter = across * aside + along * front, 0.25 * float(np.ptp(pole[:, 0]))
    ends = np.array([middle + (end + 0.005) * out + side * 0.04 * front for side in (-1.0, 1.0)])
    turn = Rotation.from_matrix(np.column_stack([aside, np.cross(aside, out), -out])).as_quat()
    yield Step(cut=Blade(ends, turn))
    wide, tight = 2.0 * quarter + 0.012, 1.1 * quarter
    # How far each gripper is beside the middle of its half, and outside, and how far its tips are apart, m.
    legs = (0.006, 0.04, wide), (0.006, 0.0, wide), (0.004, 0.0, tight), (SPREAD, 0.0, tight), (SPREAD, 0.05, 0.05)
    for (start, goal), seconds in zip(pairwise(legs), (0.16, 0.24, 0.32, 0.2), strict=True):
        count = round(0.5 * seconds / STEP)  # every other step: contact of jaws makes large bags
        for fraction in minimum_jerk(np.arange(1, count + 1) / count):
            beside, outside, gap = np.array(start) + fraction * np.subtract(goal, start)
            sides = {0: -1.0, 1: 1.0}
            places = {
                tool: middle + side * (quarter + beside) * aside + (end - POLE + outside) * out
                for tool, side in sides.items()
            }
            poses = {tool: np.concatenate([place, turn]) for tool, place in places.items()}
            yield Step(poses, {tool: tools[tool].jaws.angle(gap) for tool in sides})
            yield Step()
    yield from _nothing(LEFT_ALONE)


_SHARED = tuple(f"point_{index}" for index in range(GLOBAL_POINTS))
SCENES = (
    Scene("stroke", "a tool moved along the front", _scripted("stroke")),
    Scene("poke", "a tool pressed in and held", _scripted("poke")),
    Scene(
        "nip",
        "two tools pinch, lift and release",
        _scripted("nip", every=3, faster=2),
        ("left", "right"),
        parameters={"marker_rate": "1.0"},
    ),
    Scene("squeeze", "two large spheres compress the whole organ", _squeeze, ("left", "right"), radius=0.03),
    Scene("local_force", "the paper's LF(100), as a force without a tool", _pushed(LOCAL, 1), pushes=True),
    Scene(
        "global_force",
        "the paper's GF(500) on ten points, as a force without a tool",
        _pushed(GLOBAL, GLOBAL_POINTS),
        _SHARED,
        pushes=True,
    ),
    Scene(
        "gripper",
        "jaws close on a pole and lift it",
        _scripted("grip", every=2, faster=2),
        shape="gripper",
        parameters={"friction": "1.0"},
    ),
    Scene("fly_through", "a tool through the whole organ at 1.5 m/s", _fly),
    Scene("bad_input", "poses that are refused, and poses that stop coming", _bad_input),
    Scene(
        "cut",
        "a cut whose lips two tools pull apart",
        _cut_and_spread,
        ("left", "right"),
        parameters={"cut_depth": "0.03", "marker_rate": "1.0"},
    ),
    Scene(
        "spread",
        "a split pole whose halves two grippers spread",
        _split_and_spread,
        ("left", "right"),
        shape="gripper",
        parameters={"cut_depth": "0.033", "marker_rate": "1.0", "friction": "1.0"},
    ),
    Scene("sleep", "touched, asleep, woken, asleep", _sleep),
)
