"""Surfaces of simple tools: balls, shafts and plates, as arrays of vertices and triangles."""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.directions import across

AROUND, UPWARD, ALONG = 28, 9, 24  # points around an axis, on a quarter of a cap's outline, along a shaft
AROUND_TUBE = 8


def ball(radius: float) -> tuple[Floats, Longs]:
    """Return vertices (n, 3) m and triangles (t, 3) of a sphere about the origin.

    Parameters
    ----------
    radius : float, m
        Its radius.
    """
    angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 2 * UPWARD + 1)
    return turned(radius * np.cos(angles), radius * np.sin(angles))


def capsule(radius: float, length: float) -> tuple[Floats, Longs]:
    """Return vertices (n, 3) m and triangles (t, 3) of a capsule from the origin along -z.

    Parameters
    ----------
    radius : float, m
        Its radius.
    length : float, m
        Distance between the centres of its caps.
    """
    angles = np.linspace(0.0, 0.5 * np.pi, UPWARD + 1)
    shaft = np.linspace(-length, 0.0, ALONG + 1)[1:-1]
    radii = [radius * np.sin(angles), np.full(len(shaft), radius), radius * np.cos(angles)]
    heights = [-length - radius * np.cos(angles), shaft, radius * np.sin(angles)]
    return turned(np.concatenate(radii), np.concatenate(heights))


def cylinder(radius: float, length: float) -> tuple[Floats, Longs]:
    """Return vertices (n, 3) m and triangles (t, 3) of a closed cylinder about the origin, along z.

    Parameters
    ----------
    radius : float, m
        Its radius.
    length : float, m
        Its length.
    """
    # Both rims twice, so that their normals are those of the wall, and of the ends.
    heights = np.linspace(-0.5 * length, 0.5 * length, ALONG + 1)
    rims = np.concatenate([heights[:1], heights[:1], heights, heights[-1:], heights[-1:]])
    radii = np.concatenate([[0.0, radius], np.full(len(heights), radius), [radius, 0.0]])
    return turned(radii, rims)


def tubes(ends: Floats, radius: float) -> tuple[Floats, Longs]:
    """Return vertices (n, 3) m and triangles (t, 3) of open tubes along lines.

    Parameters
    ----------
    ends : Floats, shape (k, 2, 3), m
        Both ends of each line.
    radius : float, m
        Radius of the tubes.
    """
    direction = ends[:, 1] - ends[:, 0]
    direction = direction / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-12)
    first, second = across(direction)
    angles = np.linspace(0.0, 2.0 * np.pi, AROUND_TUBE, endpoint=False)
    ring = np.einsum("a,kx->kax", np.cos(angles), first) + np.einsum("a,kx->kax", np.sin(angles), second)
    vertices = ends[:, :, None] + radius * ring[:, None]  # (k, 2, AROUND_TUBE, 3)
    spoke = np.arange(AROUND_TUBE)
    after, above = (spoke + 1) % AROUND_TUBE, AROUND_TUBE
    lower = np.stack([spoke, after, after + above], axis=1)
    upper = np.stack([spoke, after + above, spoke + above], axis=1)
    faces = np.concatenate([lower, upper])[None] + 2 * AROUND_TUBE * np.arange(len(ends))[:, None, None]
    return vertices.reshape(-1, 3), faces.reshape(-1, 3)


def turned(radii: Floats, heights: Floats) -> tuple[Floats, Longs]:
    """Return vertices (n, 3) and triangles (t, 3) of an outline that turns about z.

    Parameters
    ----------
    radii, heights : Floats, shape (k,), m
        The outline, from the lowest point to the highest.
    """
    angles = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
    rings = np.stack(
        [np.outer(radii, np.cos(angles)), np.outer(radii, np.sin(angles)), np.outer(heights, np.ones(AROUND))], axis=-1
    )
    ring, spoke = np.meshgrid(np.arange(len(radii) - 1), np.arange(AROUND), indexing="ij")
    after = (spoke + 1) % AROUND
    low, high = ring * AROUND, (ring + 1) * AROUND
    first = np.stack([low + spoke, low + after, high + after], axis=-1)
    second = np.stack([low + spoke, high + after, high + spoke], axis=-1)
    faces = np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])
    vertices = rings.reshape(-1, 3)
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return vertices, faces[area > 1e-15].astype(np.int64)
