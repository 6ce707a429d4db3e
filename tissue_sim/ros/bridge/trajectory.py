"""The scripted bridge's path over an organ: stroke, poke, nip with two tools, lift with a gripper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from tissue_sim.contact.gripper import Jaws
from tissue_sim.errors import UserError
from tissue_sim.ros.bridge.contact_locations import FRONT, UP, Surface, Touch, rotation_towards
from tissue_sim.ros.bridge.motion import Leg, Path
from tissue_sim.ros.bridge.script import SCRIPT, check

# Depths and distances in m, of a tool of a radius in m; thin organs get proportionally smaller values.
STROKE_DEPTH, POKE_DEPTH, SQUEEZE, LIFT = 0.002, 0.006, 0.008, 0.010
HOVER = 0.006  # between tool and surface, where a fast approach ends
# Peak speeds in m/s, times in s.
PRESS, STROKE, CLOSE, LIFTING = 0.040, 0.060, 0.020, 0.030
POKE_HOLD, LIFT_HOLD, PAUSE = 0.5, 1.0, 1.0


def plan(
    surface: Surface,
    tools: Sequence[str] = ("left", "right"),
    script: Sequence[str] = SCRIPT,
    grippers: Mapping[str, Jaws] | None = None,
    rate: float = 500.0,
) -> Path:
    """Return a closed path for spheres over a closed rest surface that they meet.

    The first tool strokes and pokes; a nip takes the first two; a grip the first that has jaws.

    surface: the surface, and the radius of the spheres; script: the actions; grippers: jaws by the tools' names; rate:
    poses per second, Hz. Raises UserError when a tool is missing, or the organ has no place for an action.
    """
    check(script, tools)
    holders = [(index, grippers[tool]) for index, tool in enumerate(tools) if grippers and tool in grippers]
    if "grip" in script and not holders:
        raise UserError(f"a grip needs a gripper, but {', '.join(tools)} has no jaws; name a tool with jaws")
    planner = _Planner(surface, len(tools), holders[:1], rate)
    for action in script:
        getattr(planner, action)()
    return planner.closed_path()


class _Planner:
    """Builder of a path from actions, each of which begins and ends outside of the organ."""

    def __init__(self, surface: Surface, n_tools: int, gripper: Sequence[tuple[int, Jaws]], rate: float) -> None:
        self._surface, self._scale, self._gripper = surface, surface.scale, gripper
        self._stroke_depth = self._scale * min(STROKE_DEPTH, 0.8 * surface.radius)
        self._placed: set[int] = set()
        # A tool without an action waits behind the organ, each a little farther round.
        outward = [Rotation.from_rotvec(0.5 * (tool - 1) * UP).apply(FRONT) for tool in range(n_tools)]
        poses = [
            np.append(surface.ball.leave(surface.ball.centre, direction), rotation_towards(-direction))
            for direction in outward
        ]
        reach = max((jaws.length for _, jaws in gripper), default=0.0)
        self._path = Path.standing(np.array(poses), rate, surface.ball, reach)

    def stroke(self) -> None:
        """Move the first tool along the front, pressed in evenly."""
        touches, depth = self._surface.stroke_line(self._stroke_depth), self._stroke_depth
        fraction = np.linspace(0.0, 1.0, len(touches))
        line = CubicSpline(fraction, [touch.place for touch in touches])(np.linspace(0.0, 1.0, 20 * len(touches)))
        self._enter("stroke", {0: touches[0]}, HOVER + depth)
        self._then(Leg("press", {0: touches[0].place}, PRESS))
        self._then(Leg("draw", {0: line}, STROKE))
        self._then(Leg("lift", {0: touches[-1].at(-HOVER - depth)}, PRESS))
        self._leave()

    def poke(self) -> None:
        """Press the first tool in, square to the front."""
        touch = self._surface.poke_location()
        self._enter("poke", {0: touch})
        self._then(Leg("press", {0: touch.at(self._scale * POKE_DEPTH)}, PRESS))
        self._then(Leg("hold", seconds=POKE_HOLD))
        self._then(Leg("release", {0: touch.at(-HOVER)}, PRESS))
        self._leave()

    def nip(self) -> None:
        """Nip with two tools that face each other near the upper pole; the first takes the place nearer to it."""
        first = self._path.poses[-1, 0, :3]
        jaws = sorted(self._surface.pinch_locations(), key=lambda jaw: float(np.linalg.norm(jaw.place - first)))
        # Up and to the side, square to the jaws, to where the tissue between them widens.
        direction, sideways = jaws[0].direction, np.cross(jaws[0].direction, UP)
        widening = sum(self._surface.normal(jaw) for jaw in jaws)
        lift = -np.sign(sideways @ widening) * sideways / np.linalg.norm(sideways) + 0.5 * UP
        lift -= (lift @ direction) * direction
        lift *= self._scale * LIFT / np.linalg.norm(lift)
        closed = {tool: jaw.at(self._scale * SQUEEZE) for tool, jaw in enumerate(jaws)}
        self._enter("nip", dict(enumerate(jaws)))
        self._then(Leg("close", closed, CLOSE))
        self._then(Leg("lift", {tool: place + lift for tool, place in closed.items()}, LIFTING))
        self._then(Leg("hold", seconds=LIFT_HOLD))
        self._then(Leg("lower", closed, LIFTING))
        self._then(Leg("open", {tool: jaw.at(-HOVER) for tool, jaw in enumerate(jaws)}, CLOSE))
        self._leave()

    def grip(self) -> None:
        """Grip across the lower pole."""
        tool, jaws = self._gripper[0]
        grasp = self._surface.grasp(jaws)
        touch = Touch(grasp.place, -grasp.out, grasp.turn)
        self._enter("grip", {tool: touch}, grasp.depth + HOVER, angle={tool: grasp.opened})
        self._then(Leg("enter", {tool: touch.place}, PRESS))
        self._then(Leg("close", {}, CLOSE, angle={tool: grasp.closed}))
        self._then(Leg("lift", {tool: touch.at(-self._scale * LIFT)}, LIFTING))
        self._then(Leg("hold", seconds=LIFT_HOLD))
        self._then(Leg("open", {}, CLOSE, angle={tool: grasp.opened}))
        self._leave()

    def closed_path(self) -> Path:
        """Return the path, with all tools back where they were at its start."""
        home, last = self._path.poses[[0, -1]]
        back = {tool: self._path.ball.arc(last[tool, :3], pose[:3]) for tool, pose in enumerate(home)}
        shut = dict.fromkeys(back, 0.0)
        turn = {tool: pose[3:] for tool, pose in enumerate(home)}
        path = self._path.then(Leg("return", back, angle=shut, turn=turn))
        return path.then(Leg("pause", seconds=PAUSE))

    def _enter(
        self, action: str, touches: dict[int, Touch], hover: float = HOVER, angle: Mapping[int, float] | None = None
    ) -> None:
        """Go around the organ, then straight in to a distance, m, before the place where tools touch.

        angle: between jaws when they are there, rad.
        """
        ball, turn = self._path.ball, {tool: touch.turn for tool, touch in touches.items()}
        self._action, self._out = action, {tool: -touch.direction for tool, touch in touches.items()}
        starts = {tool: ball.leave(touch.place, -touch.direction) for tool, touch in touches.items()}
        for tool in set(touches) - self._placed:  # it waits where its first action begins
            self._path.poses[:, tool] = np.append(starts[tool], turn[tool])
        self._placed |= set(touches)
        around = {tool: ball.arc(self._path.poses[-1, tool, :3], start) for tool, start in starts.items()}
        self._path = self._path.then(Leg(f"{action}/approach", around, turn=turn))
        before = {tool: touch.at(-hover) for tool, touch in touches.items()}
        self._then(Leg("approach", before, angle=angle or {}))

    def _then(self, leg: Leg) -> None:
        """Add a leg of the action, during which the direction out of the tissue stays the same."""
        self._path = self._path.then(replace(leg, phase=f"{self._action}/{leg.phase}", outward=self._out))

    def _leave(self) -> None:
        """Go straight out, until the tools are clear of the organ."""
        last = self._path.poses[-1, :, :3]
        self._then(
            Leg(
                "retreat", {tool: self._path.ball.leave(last[tool], direction) for tool, direction in self._out.items()}
            )
        )
