"""Where a gripper takes hold of an organ: across its lower pole, with a jaw on either side."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tissue_sim.array_types import Floats
from tissue_sim.contact.gripper import Jaws

DEPTH = 0.022  # m from the tip of the pole to the tips of the jaws
WITHIN = 0.4  # of a gripper's length that tissue may lie between its jaws: the hinge stays outside
SQUEEZED = 0.5  # of the width that the closed jaws leave
CLEARANCE = 0.010  # m that the open jaws have beyond the width


class Grasp(NamedTuple):
    """How a gripper holds an organ.

    place (3,) m of the gripper, between its tips; turn: quaternion (4,) xyzw; out (3,): unit way out of the organ, past
    its pole; depth m under the tip of the pole; width m of the tissue between the tips, at rest; opened and closed:
    angles in rad before and after.
    """

    place: Floats
    turn: Floats
    out: Floats
    depth: float
    width: float
    opened: float
    closed: float


def at_lower_pole(vertices: Floats, triangles: NDArray[np.integer], jaws: Jaws, scale: float = 1.0) -> Grasp:
    """A grasp of a closed surface (n, 3) m, (t, 3) at the lower end of its longest axis, +z being up.

    The jaws close along its second axis. scale: of the depth, for organs smaller than a kidney. Raises ValueError with
    the reason where the jaws can't take hold.
    """
    long, across, thick = np.linalg.svd(vertices - vertices.mean(axis=0), full_matrices=False)[2]
    out = long if long[2] <= 0.0 else -long
    tip = vertices[np.argmax(vertices @ out)]
    depth = min(scale * DEPTH, WITHIN * jaws.length)
    outline = _cut(vertices[triangles], (tip - depth * out), out)
    lengths = np.linalg.norm(outline[:, 1] - outline[:, 0], axis=1)
    middle = np.average(outline.mean(axis=1), axis=0, weights=lengths)
    ends = _cut(outline, middle, thick).reshape(-1, 3) @ across
    if len(ends) < 2:
        raise ValueError("its lower pole doesn't have two sides")
    place = middle + (0.5 * (ends.max() + ends.min()) - middle @ across) * across
    width = float(np.ptp(ends))
    turn = Rotation.from_matrix(np.stack([across, np.cross(-out, across), -out], axis=1)).as_quat()
    try:
        opened, closed = jaws.angle(width + CLEARANCE), jaws.angle(SQUEEZED * width)
    except ValueError as error:
        raise ValueError(f"its lower pole is {1e3 * width:.3g} mm wide, and {error}") from None
    return Grasp(place, np.asarray(turn), out, depth, width, opened, closed)


def _cut(pieces: Floats, point: Floats, normal: Floats) -> Floats:
    """Where triangles (k, 3, 3) or lines (k, 2, 3) cross a plane: lines (m, 2, 3), or points (m, 1, 3)."""
    height = (pieces - point) @ normal
    n = pieces.shape[1]
    first = np.arange(n) if n > 2 else np.arange(1)
    second = (first + 1) % n
    above = height > 0.0
    crosses = above[:, first] != above[:, second]  # of a triangle's edges none or two
    piece, edge = np.nonzero(crosses)
    start, end = height[piece, first[edge]], height[piece, second[edge]]
    share = (start / (start - end))[:, None]
    points = (1.0 - share) * pieces[piece, first[edge]] + share * pieces[piece, second[edge]]
    return np.asarray(points.reshape(-1, n - 1, 3))
