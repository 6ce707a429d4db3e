"""The scripted bridge's path over an organ: strokes it, pokes it, nips it with two tools, lifts it with a gripper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from tissue_sim.array_types import Floats, Longs
from tissue_sim.contact.grasp import Grasp, at_lower_pole
from tissue_sim.contact.gripper import Jaws
from tissue_sim.errors import UserError
from tissue_sim.ros.bridge.motion import Move, Path, Segment, leave
from tissue_sim.ros.bridge.probing import Surface
from tissue_sim.ros.bridge.script import ACTIONS, SCRIPT

FRONT = np.array([0.0, 1.0, 0.0])  # the way the first tool looks: from the front to the back of a patient (LPS)
UP = np.array([0.0, 0.0, 1.0])  # away from the lowest tenth, which is held

# Depths and ways in m, for organs at least REFERENCE m thick; smaller ones get proportionally smaller values.
REFERENCE = 0.03
STROKE_DEPTH, STROKE_LENGTH = 0.002, 0.040
POKE_DEPTH = 0.006
SQUEEZE, LIFT = 0.006, 0.010
NIP_THICKNESS = 0.025  # between the jaws: twice as thick is as bad as sides that slope by 40 degrees
MOST_SAMPLES = 500  # of the surface, to look for a place to nip
HOVER = 0.006  # between tool and surface, where a fast approach ends
MARGIN = 0.012  # of the ball around organ and tool

# Peak speeds in m/s, times in s.
FAST, PRESS, STROKE, CLOSE, LIFTING = 0.150, 0.040, 0.060, 0.020, 0.030
POKE_HOLD, LIFT_HOLD, PAUSE = 0.5, 1.0, 1.0


@dataclass(frozen=True)
class Touch:
    """First contact of a tool that comes straight from outside: its centre (3,) m and the way in (3,)."""

    centre: Floats
    way: Floats


def plan(
    vertices: Floats,
    triangles: Longs,
    radius: float,
    tools: Sequence[str] = ("left", "right"),
    script: Sequence[str] = SCRIPT,
    grippers: Mapping[str, Jaws] | None = None,
) -> Path:
    """A path for spheres of a radius in m over a closed rest surface (n, 3) m, (t, 3).

    The first tool strokes and pokes; a nip takes the first two; a grip the first that has jaws, of which `grippers`
    tells by the tools' names. Raises UserError when the script asks for what isn't there, or the organ has no place
    for it.
    """
    grippers = grippers or {}
    for action in script:
        if action not in ACTIONS:
            raise UserError(f"unknown action '{action}' in the script; choose from {', '.join(ACTIONS)}")
    if not script:
        raise UserError(f"the script is empty; choose from {', '.join(ACTIONS)}")
    if not tools or len(set(tools)) != len(tools):
        raise UserError("name at least one tool, each once")
    if "nip" in script and len(tools) < 2:
        raise UserError("a nip needs two tools; name two, or leave it out of the script")
    holder = next((index for index, tool in enumerate(tools) if tool in grippers), None)
    if "grip" in script and holder is None:
        raise UserError(f"a grip needs a gripper, and {', '.join(tools)} has no jaws; name one that has")
    jaws = None if holder is None else (holder, grippers[tools[holder]])
    return _Planner(Surface(vertices, triangles), radius, tuple(tools), jaws).plan(script)


class _Planner:
    """Builds the segments of a path one after the other, knowing where the tools are."""

    def __init__(
        self, surface: Surface, radius: float, tools: tuple[str, ...], gripper: tuple[int, Jaws] | None
    ) -> None:
        self.surface, self.tool_radius, self.tools = surface, radius, tools
        self.gripper = gripper  # which of the tools it is
        self.angle = 0.0  # rad between its jaws
        low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
        self.extent = high - low
        self.centre = 0.5 * (low + high)
        self.radius = float(np.linalg.norm(surface.vertices - self.centre, axis=1).max()) + radius + MARGIN
        self.scale = min(1.0, float(self.extent.min()) / REFERENCE)
        self.segments: list[Segment] = []
        self.position: list[Floats] = []
        self.turn: list[Rotation] = []

    def plan(self, script: Sequence[str]) -> Path:
        stroke = self._stroke_places() if "stroke" in script else []
        poke = self._poke_place() if "poke" in script else None
        jaws = self._nip_places() if "nip" in script else None
        if jaws and (front := poke or (stroke[0] if stroke else None)):
            # The first tool takes the jaw that it has the shorter way to.
            jaws = min(jaws, jaws[::-1], key=lambda pair: float(np.linalg.norm(pair[0].centre - front.centre)))
        grasp = self._grasp() if "grip" in script else None
        first = {"stroke": stroke[0] if stroke else None, "poke": poke, "nip": jaws[0] if jaws else None}
        self._park(first.get(script[0]), jaws, grasp)
        home, home_turn = list(self.position), list(self.turn)
        for action in script:
            if action == "stroke":
                self._stroke(stroke)
            elif action == "poke" and poke is not None:
                self._poke(poke)
            elif action == "nip" and jaws is not None:
                self._nip(jaws)
            elif grasp is not None:
                self._grip(grasp)
        moved = {0} if grasp is None or self.gripper is None else {0, self.gripper[0]}
        back = {
            tool: Move.arc(self.centre, self.position[tool], home[tool], (self.turn[tool], home_turn[tool]))
            for tool in moved
        }
        self._add("return", back, {}, FAST, 0.0)
        self._wait("pause", PAUSE, {})
        return Path(self.tools, tuple(self.segments), self.centre, self.radius)

    # places ------------------------------------------------------------------------------------
    def _touch(self, through: Floats, way: Floats) -> Touch | None:
        """Where the tool first touches when its centre moves along a line, from outside the ball."""
        offset = through - self.centre
        across = offset - (offset @ way) * way
        if across @ across >= self.radius**2:
            return None
        start = self.centre + across - np.sqrt(self.radius**2 - across @ across) * way
        stop = self.surface.advance(start, way, self.tool_radius, 2.0 * self.radius)
        return None if stop is None else Touch(stop, way)

    def _along(self) -> Floats:
        """The organ's longest direction across the front's line of sight, pointing up."""
        flat = self.surface.vertices - self.centre
        flat = flat - np.outer(flat @ FRONT, FRONT)
        longest = np.linalg.svd(flat - flat.mean(axis=0), full_matrices=False)[2][0]
        longest = longest - (longest @ FRONT) * FRONT
        return longest / np.linalg.norm(longest) * (1.0 if longest @ UP >= 0.0 else -1.0)

    def _stroke_places(self) -> list[Touch]:
        """Touches along the front, about STROKE_LENGTH m."""
        along = self._along()
        sideways = np.cross(along, FRONT)
        spread = float(np.ptp(self.surface.vertices @ along))
        length = min(STROKE_LENGTH, 0.4 * spread)
        for shift in np.array([0.0, 1.0, -1.0, 2.0, -2.0, 3.0, -3.0]) * 0.1 * float(self.extent.min()):
            points = self.centre + shift * sideways + np.linspace(-0.5, 0.5, 21)[:, None] * length * along
            places = [self._touch(point, FRONT) for point in points]
            found = [place for place in places if place is not None]
            jumps = np.abs(np.diff([place.centre @ FRONT for place in found]))
            # A line that leaves the organ, or steps over an edge, is no stroke.
            if len(found) == len(points) and jumps.max() < 2.0 * length / (len(points) - 1):
                return found
        raise UserError("found no line on the organ's front to stroke; leave 'stroke' out of the script")

    def _poke_place(self) -> Touch:
        """A touch square to the front, a little above the middle."""
        along = self._along()
        spread = float(np.ptp(self.surface.vertices @ along))
        for shift in (0.12, 0.0, 0.24, -0.12):
            seen = self._touch(self.centre + shift * spread * along, FRONT)
            if seen is None:
                continue
            inward = self.surface.closest(seen.centre)[1] - seen.centre
            square = self._touch(seen.centre, inward / np.linalg.norm(inward))
            if square is not None and np.linalg.norm(square.centre - seen.centre) < self.tool_radius:
                return square
        raise UserError("found no place on the organ's front to poke; leave 'poke' out of the script")

    def _nip_places(self) -> tuple[Touch, Touch]:
        """Two touches that face each other across little tissue, near the upper pole."""
        surface = self.surface
        low, high = float(surface.vertices[:, 2].min()), float(surface.vertices[:, 2].max())
        points, outward = surface.samples(above=high - 0.4 * (high - low), at_most=MOST_SAMPLES)
        # Jaws come from the sides: pressed on from above or below, the tissue would slip out of them, and organs
        # lie with their back on something.
        sides = (np.abs(outward @ UP) < 0.5) & (np.abs(outward @ FRONT) < 0.5)
        points, inward = points[sides], -outward[sides]
        thickness, opposite = surface.cast(points + 1e-6 * inward, inward)
        facing = np.einsum("ij,ij->i", surface.triangle_normals(opposite), inward)  # 1: the far side faces away
        # Squareness counts most: a jaw slides off a slope.
        cost = thickness / NIP_THICKNESS + 4.0 * (1.0 - facing) + 0.5 * (high - points[:, 2]) / (high - low)
        best: tuple[float, tuple[Touch, Touch] | None] = (np.inf, None)
        for index in np.argsort(cost)[:60]:
            near, far = self._touch(points[index], inward[index]), self._touch(points[index], -inward[index])
            if near is None or far is None:
                continue
            # Other parts of the organ in the way stop a jaw early.
            gap = float((far.centre - near.centre) @ inward[index]) - 2.0 * self.tool_radius
            total = float(cost[index]) + 2.0 * abs(gap - float(thickness[index])) / self.tool_radius
            if total < best[0]:
                best = total, (near, far)
        if best[1] is None:
            raise UserError("found no place on the organ for two jaws; leave 'nip' out of the script")
        return best[1]

    def _grasp(self) -> Grasp:
        """Across the lower pole, which is what hangs free of an organ that is held along its back."""
        assert self.gripper is not None
        try:
            return at_lower_pole(self.surface.vertices, self.surface.triangles, self.gripper[1], self.scale)
        except ValueError as error:
            raise UserError(f"the organ has no place for a gripper: {error}; give it longer jaws") from None

    # segments ----------------------------------------------------------------------------------
    def _entry(self, touch: Touch) -> Floats:
        return leave(touch.centre, -touch.way, self.centre, self.radius)

    def _park(self, first: Touch | None, jaws: tuple[Touch, Touch] | None, grasp: Grasp | None) -> None:
        """Where the tools are before the first action: on the ball, apart from each other."""
        places: dict[int, tuple[Floats, Rotation]] = {}
        if grasp is not None and self.gripper is not None:
            over = leave(grasp.place, grasp.out, self.centre, self.radius)
            places[self.gripper[0]] = over, Rotation.from_quat(grasp.turn)
        if jaws is not None:
            places[1] = self._entry(jaws[1]), _looking(jaws[1].way)
        if first is not None:
            places[0] = self._entry(first), _looking(first.way)
        for index in range(len(self.tools)):
            # Else behind the organ, each a little farther round.
            outward = Rotation.from_rotvec(0.5 * (index - 1) * UP).apply(FRONT)
            place, turn = places.get(index, (self.centre + self.radius * outward, _looking(-outward)))
            self.position.append(place)
            self.turn.append(turn)

    def _add(
        self,
        name: str,
        moves: dict[int, Move],
        outward: dict[int, Floats],
        speed: float,
        angle: float | None = None,
    ) -> None:
        """Append a segment; tools without a move stay where they are. angle: rad to which a gripper's jaws turn."""
        stay = [Move.line(p, p, t) for p, t in zip(self.position, self.turn, strict=True)]
        every = [moves.get(tool, stay[tool]) for tool in range(len(self.tools))]
        reach = self.gripper[1].length if self.gripper is not None else 0.0
        self._append(Segment.timed(name, every, self._ways(outward), speed, self._jaws(angle), reach))

    def _wait(self, name: str, duration: float, outward: dict[int, Floats]) -> None:
        stay = tuple(Move.line(p, p, t) for p, t in zip(self.position, self.turn, strict=True))
        self._append(Segment(name, duration, stay, self._ways(outward), self._jaws(None)))

    def _jaws(self, angle: float | None) -> Floats | None:
        """Angles (2, T) rad of a segment in which the gripper's jaws turn to an angle, or stay as they are."""
        if self.gripper is None:
            return None
        jaws = np.zeros((2, len(self.tools)))
        jaws[0, self.gripper[0]] = self.angle
        self.angle = self.angle if angle is None else angle
        jaws[1, self.gripper[0]] = self.angle
        return jaws

    def _append(self, segment: Segment) -> None:
        self.segments.append(segment)
        self.position = [move.points[-1] for move in segment.moves]
        self.turn = [move.rotations[1] for move in segment.moves]

    def _ways(self, outward: dict[int, Floats]) -> Floats:
        return np.array([outward.get(tool, np.zeros(3)) for tool in range(len(self.tools))])

    def _straight(self, name: str, targets: dict[int, Floats], touches: dict[int, Touch], speed: float) -> None:
        moves = {tool: Move.line(self.position[tool], point, self.turn[tool]) for tool, point in targets.items()}
        self._add(name, moves, {tool: -touch.way for tool, touch in touches.items()}, speed)

    def _approach(self, action: str, touches: dict[int, Touch]) -> None:
        """Around the organ, then straight in to a little above the surface."""
        around = {
            tool: Move.arc(self.centre, self.position[tool], self._entry(touch), (self.turn[tool], _looking(touch.way)))
            for tool, touch in touches.items()
        }
        self._go_round(action, around)
        hover = {tool: touch.centre - HOVER * touch.way for tool, touch in touches.items()}
        self._straight(f"{action}/approach", hover, touches, FAST)

    def _go_round(self, action: str, around: dict[int, Move]) -> None:
        """Outside of the organ to where an action begins, unless the tools are there."""
        if any(move.length > 1e-6 or move.angle > 1e-6 for move in around.values()):
            self._add(f"{action}/approach", around, {}, FAST)

    def _leave(self, action: str, touches: dict[int, Touch]) -> None:
        """Straight out to the ball."""
        out = {
            tool: leave(self.position[tool], -touch.way, self.centre, self.radius) for tool, touch in touches.items()
        }
        self._straight(f"{action}/retreat", out, touches, FAST)

    def _stroke(self, places: list[Touch]) -> None:
        depth = self.scale * min(STROKE_DEPTH, 0.8 * self.tool_radius)
        line = []
        for place in places:
            inside = self.surface.advance(place.centre, place.way, self.tool_radius - depth, 2.0 * self.tool_radius)
            line.append(place.centre + depth * place.way if inside is None else inside)
        first, last = {0: places[0]}, {0: places[-1]}
        self._approach("stroke", first)
        self._straight("stroke/press", {0: line[0]}, first, PRESS)
        turn = self.turn[0]
        self._add("stroke/draw", {0: Move(np.array(line), Rotation.concatenate([turn, turn]))}, {0: -FRONT}, STROKE)
        self._straight("stroke/lift", {0: places[-1].centre - HOVER * FRONT}, last, PRESS)
        self._leave("stroke", last)

    def _poke(self, place: Touch) -> None:
        touch = {0: place}
        depth = self.scale * POKE_DEPTH
        self._approach("poke", touch)
        self._straight("poke/press", {0: place.centre + depth * place.way}, touch, PRESS)
        self._wait("poke/hold", POKE_HOLD, {0: -place.way})
        self._straight("poke/release", {0: place.centre - HOVER * place.way}, touch, PRESS)
        self._leave("poke", touch)

    def _lift_way(self, jaws: tuple[Touch, Touch]) -> Floats:
        """Unit vector up and to the side, square to the jaws, to where the tissue between them widens."""
        way = jaws[0].way
        normals = [jaw.centre - self.surface.closest(jaw.centre)[1] for jaw in jaws]
        sideways = np.cross(way, UP)
        sideways *= -1.0 if sideways @ np.sum(normals, axis=0) > 0.0 else 1.0
        lift = sideways / np.linalg.norm(sideways) + 0.5 * UP
        lift -= (lift @ way) * way
        return lift / np.linalg.norm(lift)

    def _nip(self, jaws: tuple[Touch, Touch]) -> None:
        touches = dict(enumerate(jaws))
        lift = self.scale * LIFT * self._lift_way(jaws)
        closed = {tool: jaw.centre + self.scale * SQUEEZE * jaw.way for tool, jaw in touches.items()}
        self._approach("nip", touches)
        self._straight("nip/close", closed, touches, CLOSE)
        self._straight("nip/lift", {tool: point + lift for tool, point in closed.items()}, touches, LIFTING)
        self._wait("nip/hold", LIFT_HOLD, {tool: -jaw.way for tool, jaw in touches.items()})
        self._straight("nip/lower", closed, touches, LIFTING)
        self._straight(
            "nip/open", {tool: jaw.centre - HOVER * jaw.way for tool, jaw in touches.items()}, touches, CLOSE
        )
        self._leave("nip", touches)

    def _grip(self, grasp: Grasp) -> None:
        assert self.gripper is not None
        tool, out, turn = self.gripper[0], {self.gripper[0]: grasp.out}, Rotation.from_quat(grasp.turn)

        def go(name: str, place: Floats, speed: float, angle: float | None = None) -> None:
            self._add(f"grip/{name}", {tool: Move.line(self.position[tool], place, turn)}, out, speed, angle)

        over = leave(grasp.place, grasp.out, self.centre, self.radius)
        around = Move.arc(self.centre, self.position[tool], over, (self.turn[tool], turn))
        self._go_round("grip", {tool: around})
        lifted = grasp.place + self.scale * LIFT * grasp.out
        go("approach", grasp.place + (grasp.depth + HOVER) * grasp.out, FAST, grasp.opened)
        go("enter", grasp.place, PRESS)
        go("close", grasp.place, CLOSE, grasp.closed)
        go("lift", lifted, LIFTING)
        self._wait("grip/hold", LIFT_HOLD, out)
        go("open", lifted, CLOSE, grasp.opened)
        go("retreat", over, FAST)


def _looking(way: Floats) -> Rotation:
    """A tool's rotation when its z axis points a way: the tip looks ahead, the shaft lies behind."""
    return Rotation.align_vectors([way], [UP])[0]
