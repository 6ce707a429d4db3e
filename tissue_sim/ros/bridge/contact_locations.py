"""Places on an organ's rest surface for the scripted bridge: where a ball meets it, and where it suits an action."""

from __future__ import annotations

from typing import NamedTuple

import fcl
import numpy as np
from scipy.spatial.transform import Rotation

from tissue_sim.array_types import Floats, Longs
from tissue_sim.contact.grasp import Grasp, at_lower_pole
from tissue_sim.contact.gripper import Jaws
from tissue_sim.errors import UserError
from tissue_sim.ros.bridge.motion import Ball

FRONT = np.array([0.0, 1.0, 0.0])  # direction of the first tool: from the front to the back of a patient (LPS)
UP = np.array([0.0, 0.0, 1.0])  # away from the lowest tenth, which is fixed
REFERENCE = 0.03  # m; thinner organs get proportionally smaller depths and distances
MARGIN = 0.012  # m, of the ball around organ and tool
POINT = 1e-6  # m, radius of a ball that represents a point; and the distance from the surface at which a ball stops
STROKE_LENGTH, STROKE_POINTS = 0.040, 21  # m
NIP_THICKNESS = 0.025  # m between the jaws; so much more counts like a side that slopes by 26 degrees
MOST_SAMPLES = 150  # of the surface, in search of a place to nip


class Touch(NamedTuple):
    """Where a tool meets the organ: its place (3,) m, the direction in which it enters (3,), its rotation (4,)."""

    place: Floats
    direction: Floats
    turn: Floats

    def at(self, depth: float) -> Floats:
        """Return the tool's place (3,), m, deeper by some m."""
        return self.place + depth * self.direction


def rotation_towards(direction: Floats) -> Floats:
    """Return a tool's rotation (4,) when its z axis points in a direction (3,): its tip is ahead, its shaft behind."""
    return np.asarray(Rotation.align_vectors([direction], [UP])[0].as_quat())


class Surface:
    """A closed rest surface that balls meet; its methods raise UserError where the organ has no such place.

    vertices (n, 3) m: points of the surface; triangles (t, 3); radius: radius of the balls, m.
    """

    def __init__(self, vertices: Floats, triangles: Longs, radius: float) -> None:
        self._vertices, self._triangles, self.radius = vertices, triangles, radius
        self._low, self._high = vertices.min(axis=0), vertices.max(axis=0)
        self._thinnest = float((self._high - self._low).min())
        self.scale = min(1.0, self._thinnest / REFERENCE)  # of depths and distances
        centre = 0.5 * (self._low + self._high)
        self.ball = Ball(centre, float(np.linalg.norm(vertices - centre, axis=1).max()) + radius + MARGIN)
        # The organ's longest direction across the front's line of sight, pointing up.
        along = np.linalg.svd((vertices - vertices.mean(axis=0)) * (1.0 - FRONT), full_matrices=False)[2][0]
        self._along = along if along @ UP >= 0.0 else -along
        self._length = float(np.ptp(vertices @ along))
        mesh = fcl.BVHModel()
        mesh.beginModel(len(vertices), len(triangles))
        mesh.addSubModel(vertices, triangles)
        mesh.endModel()
        self._surface = fcl.CollisionObject(mesh, fcl.Transform())

    def touch(self, through: Floats, direction: Floats, depth: float = 0.0) -> Touch | None:
        """Return where a ball that comes from outside along a line first reaches a depth, by sphere tracing.

        through (3,) m: a point of the line; direction (3,): of length 1; depth: m. Returns None where the line misses
        the organ.
        """
        offset = through - self.ball.centre
        across = offset - (offset @ direction) * direction
        if across @ across >= self.ball.radius**2:
            return None
        place, end = (self.ball.leave(self.ball.centre + across, side * direction) for side in (-1.0, 1.0))
        probe = fcl.CollisionObject(fcl.Sphere(self.radius - depth), fcl.Transform(place))
        while (gap := fcl.distance(probe, self._surface)) > POINT:
            place = place + gap * direction
            if (end - place) @ direction < 0.0:
                return None
            probe.setTranslation(place)
        return Touch(place, direction, rotation_towards(direction))

    def normal(self, touch: Touch) -> Floats:
        """Return the unit direction (3,) from the surface to a ball that touches it there."""
        found = fcl.DistanceResult()
        probe = fcl.CollisionObject(fcl.Sphere(POINT), fcl.Transform(touch.place))
        fcl.distance(self._surface, probe, fcl.DistanceRequest(enable_nearest_points=True), found)
        away = touch.place - found.nearest_points[0]
        return np.asarray(away / np.linalg.norm(away))

    def stroke_line(self, depth: float) -> list[Touch]:
        """Return touches along the front, about STROKE_LENGTH m, all equally deep, m."""
        length = min(STROKE_LENGTH, 0.4 * self._length)
        line = np.linspace(-0.5, 0.5, STROKE_POINTS)[:, None] * length * self._along
        sideways = 0.1 * self._thinnest * np.cross(self._along, FRONT)
        for shift in (0.0, 1.0, -1.0, 2.0, -2.0, 3.0, -3.0):
            found = [self.touch(point, FRONT, depth) for point in self.ball.centre + shift * sideways + line]
            touches = [touch for touch in found if touch]
            jumps = np.abs(np.diff([touch.place @ FRONT for touch in touches]))
            # A line that leaves the organ, or jumps at an edge, is not a stroke.
            if len(touches) == len(line) and jumps.max() < 2.0 * length / (len(line) - 1):
                return touches
        raise UserError("found no path on the organ's front to stroke; leave 'stroke' out of the script")

    def poke_location(self) -> Touch:
        """Return a touch square to the front, a little above the middle."""
        for shift in (0.12, 0.0, 0.24, -0.12):
            seen = self.touch(self.ball.centre + shift * self._length * self._along, FRONT)
            square = seen and self.touch(seen.place, -self.normal(seen))
            if seen and square and np.linalg.norm(square.place - seen.place) < self.radius:
                return square
        raise UserError("found no point on the organ's front to poke; leave 'poke' out of the script")

    def pinch_locations(self) -> list[Touch]:
        """Return two touches that face each other across little tissue, near the upper pole."""
        corners = self._vertices[self._triangles]
        edges = corners[:, 1:] - corners[:, :1]
        normals = np.cross(edges[:, 0], edges[:, 1])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        points = corners.mean(axis=1)
        height = self._high[2] - self._low[2]
        upper = points[:, 2] > self._high[2] - 0.4 * height
        # Jaws come from the sides: pressed on from above or below, the tissue would slip out of them, and organs
        # lie with their back on something.
        sides = np.flatnonzero((np.abs(normals @ UP) < 0.5) & (np.abs(normals @ FRONT) < 0.5) & upper)
        best: list[Touch] = []
        least = np.inf
        for index in sides[:: 1 + len(sides) // MOST_SAMPLES]:
            inward = -normals[index]
            near, far = self.touch(points[index], inward), self.touch(points[index], -inward)
            if near and far and (gap := float((far.place - near.place) @ inward) - 2.0 * self.radius) > 0.0:
                # Squareness counts most: a jaw slides off a slope.
                slope = 1.0 - min(self.normal(far) @ inward, self.normal(near) @ -inward)
                deep = self._high[2] - 0.5 * (near.place[2] + far.place[2])
                if (cost := gap / NIP_THICKNESS + 10.0 * slope + 0.5 * deep / height) < least:
                    best, least = [near, far], cost
        if not best:
            raise UserError("found no fold on the organ for two tools; leave 'nip' out of the script")
        return best

    def grasp(self, jaws: Jaws) -> Grasp:
        """Return a grasp across the lower pole, which hangs free of an organ that is fixed along its back."""
        try:
            return at_lower_pole(self._vertices, self._triangles, jaws, self.scale)
        except ValueError as error:
            raise UserError(f"no part of the organ fits the gripper: {error}; give it longer jaws") from None
