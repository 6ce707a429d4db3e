"""Grasp of an organ by a gripper: across its lower pole, with a jaw on either side."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tissue_sim.array_types import Floats
from tissue_sim.contact.gripper import Jaws

DEPTH = 0.022  # m from the tip of the pole to the tips of the jaws
WITHIN = 0.4  # fraction of the jaws' length that tissue may fill, so that the hinge stays outside
COMPRESSED = 0.5  # distance of the closed jaws relative to the width
CLEARANCE = 0.010  # m by which the open jaws are wider than the tissue


class Grasp(NamedTuple):
    """Pose and angles of a gripper that holds an organ.

    Attributes
    ----------
    place : Floats, shape (3,), m
        Origin of the gripper, between its tips.
    turn : Floats, shape (4,), xyzw
        Unit quaternion.
    out : Floats, shape (3,)
        Unit direction out of the organ, past its pole.
    depth : float, m
        Depth below the tip of the pole.
    width : float, m
        Width of the tissue between the tips, at rest.
    opened : float, rad
        Angle before the grasp.
    closed : float, rad
        Angle of the grasp.
    """

    place: Floats
    turn: Floats
    out: Floats
    depth: float
    width: float
    opened: float
    closed: float


def lower_pole(vertices: Floats) -> Floats:
    """Return the axes (3, 3) of points (n, 3): the longest one, downwards, +z being up; the second; and the third."""
    long, across, thick = np.linalg.svd(vertices - vertices.mean(axis=0), full_matrices=False)[2]
    return np.stack([long if long[2] <= 0.0 else -long, across, thick])


def at_lower_pole(
    vertices: Floats, triangles: NDArray[np.integer], jaws: Jaws, scale: float = 1.0, out: Floats | None = None
) -> Grasp:
    """Return a grasp of a closed surface at the lower end of its longest axis, +z being up.

    The jaws close along its second axis.

    Parameters
    ----------
    vertices : Floats, shape (n, 3), m
        Points.
    triangles : NDArray[np.integer], shape (t, 3)
        Corner indices.
    jaws : Jaws
        The gripper.
    scale : float, optional
        Factor of the depth, for organs smaller than a kidney.
    out : Floats | None, optional, shape (3,)
        Unit direction from which the gripper approaches, instead of that axis; the other axes are rotated with it.

    Raises
    ------
    ValueError
        If the jaws can't grasp it, with the reason.
    """
    axes = lower_pole(vertices)
    if out is not None:
        axes = Rotation.align_vectors([out], [axes[0]])[0].apply(axes)
    out, across, thick = axes
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
        opened, closed = jaws.angle(width + CLEARANCE), jaws.angle(COMPRESSED * width)
    except ValueError as error:
        raise ValueError(f"its lower pole is {1e3 * width:.3g} mm wide, and {error}") from None
    return Grasp(place, np.asarray(turn), out, depth, width, opened, closed)


def _cut(pieces: Floats, point: Floats, normal: Floats) -> Floats:
    """Return where triangles (k, 3, 3) or lines (k, 2, 3) cross a plane: lines (m, 2, 3), or points (m, 1, 3)."""
    height = (pieces - point) @ normal
    n = pieces.shape[1]
    first = np.arange(n) if n > 2 else np.arange(1)
    second = (first + 1) % n
    above = height > 0.0
    crosses = above[:, first] != above[:, second]  # none or two edges of a triangle
    piece, edge = np.nonzero(crosses)
    start, end = height[piece, first[edge]], height[piece, second[edge]]
    fraction = (start / (start - end))[:, None]
    points = (1.0 - fraction) * pieces[piece, first[edge]] + fraction * pieces[piece, second[edge]]
    return np.asarray(points.reshape(-1, n - 1, 3))
