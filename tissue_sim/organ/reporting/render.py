"""Renderer of triangle surfaces: a z-buffer, shading by a lamp at the viewer's shoulder, wireframe, glass.

The projection is orthographic. Everything is drawn at twice the size and averaged, so edges are smooth and hidden parts
are resolved exactly, pixel by pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tissue_sim.array_types import Floats, Ints
from tissue_sim.directions import across
from tissue_sim.jit import kernel

_SUPERSAMPLING = 2
_LAMP = np.array([-0.35, 0.45, 0.82]) / np.linalg.norm([-0.35, 0.45, 0.82])  # right, up, towards the viewer
_AMBIENT, _SHINE = 0.32, 0.18
_WHITE = np.ones(3)


@dataclass(frozen=True, eq=False)
class View:
    """Orthographic camera.

    Attributes
    ----------
    axes : Floats, shape (3, 3)
        Rows are right, up and towards the viewer in the frame of the points.
    centre : Floats, shape (3,)
        Point at the picture's centre.
    size : tuple[int, int]
        Width and height, pixels.
    scale : float
        Pixels per unit of length.
    """

    axes: Floats
    centre: Floats
    size: tuple[int, int]
    scale: float

    def project(self, points: ArrayLike) -> Floats:
        """Return supersampled pixel coordinates x, y (down) and height towards the viewer.

        Parameters
        ----------
        points : ArrayLike, shape (n, 3)
            The points.

        Returns
        -------
        Floats
            shape (n, 3), pixels
        """
        local = (np.asarray(points, dtype=np.float64) - self.centre) @ self.axes.T * self.scale
        width, height = self.size
        pixels = np.stack([0.5 * width + local[:, 0], 0.5 * height - local[:, 1], local[:, 2]], axis=1)
        return pixels * _SUPERSAMPLING


@dataclass(frozen=True, eq=False)
class Solid:
    """Triangles to draw.

    Attributes
    ----------
    positions : Floats, shape (n, 3)
        Points.
    triangles : Ints, shape (t, 3)
        Corner indices, outward.
    colour : tuple[float, float, float]
        Red, green, blue in 0..1.
    lines : float
        Width of the wireframe, pixels; 0 for none.
    smooth : bool
        Whether it is shaded by the mean normals of the corners.
    """

    positions: Floats
    triangles: Ints
    colour: tuple[float, float, float]
    lines: float = 0.0
    smooth: bool = True


def view_of(points: ArrayLike, towards: ArrayLike, up: ArrayLike, size: tuple[int, int], margin: float = 0.06) -> View:
    """Return the view that points fill.

    Parameters
    ----------
    points : ArrayLike, shape (n, 3)
        Points.
    towards : ArrayLike, shape (3,)
        Direction from the organ to the viewer.
    up : ArrayLike, shape (3,)
        Direction that is up in the picture; not parallel to `towards`.
    size : tuple[int, int]
        Width and height, pixels.
    margin : float, optional
        Fraction of the size that stays free at each border.
    """
    forward = np.asarray(towards, dtype=np.float64) / np.linalg.norm(towards)
    right = np.cross(np.asarray(up, dtype=np.float64), forward)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward])
    local = np.asarray(points, dtype=np.float64) @ axes.T
    low, high = local.min(axis=0), local.max(axis=0)
    room = (1.0 - 2.0 * margin) * np.array(size, dtype=np.float64)
    scale = float((room / np.maximum((high - low)[:2], 1e-12)).min())
    return View(axes, 0.5 * (low + high) @ axes, size, scale)


def draw(view: View, solids: list[Solid], glass: Solid | None = None) -> NDArray[np.uint8]:
    """Return a picture of opaque solids on white, with a translucent closed surface around them.

    Of the translucent surface its nearest front and its nearest back are seen; it is denser where it is seen edge-on.

    Parameters
    ----------
    view : View
        The camera.
    solids : list[Solid]
        Opaque solids.
    glass : Solid | None, optional
        The translucent surface; None for none.

    Returns
    -------
    NDArray[np.uint8], shape (height, width, 3)
        Pixels.
    """
    width, height = (n * _SUPERSAMPLING for n in view.size)
    colour = np.broadcast_to(_WHITE, (height, width, 3)).copy()
    depth = np.full((height, width), -np.inf)
    for solid in solids:
        hit, shaded, _ = _layer(view, solid, depth, +1)
        colour[hit] = shaded
    if glass is not None:
        for side, least, most in ((-1, 0.10, 0.25), (+1, 0.14, 0.62)):
            hit, shaded, slope = _layer(view, glass, depth.copy(), side)
            # Glass is denser where it is seen edge-on, which makes its outline visible.
            fraction = (least + (most - least) * (1.0 - slope) ** 2.5)[:, None]
            colour[hit] += fraction * (shaded - colour[hit])
    small = colour.reshape(view.size[1], _SUPERSAMPLING, view.size[0], _SUPERSAMPLING, 3).mean(axis=(1, 3))
    return (np.clip(small, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)


def _layer(view: View, solid: Solid, depth: Floats, side: int) -> tuple[NDArray[np.bool_], Floats, Floats]:
    """Return pixels, colour and slope of the nearest triangles in front of `depth` (height, width), which is updated.

    side: +1 for triangles that face the viewer, -1 for those that face away. The colour (p, 3) and the slope (p,), 1
    facing the viewer, are of the covered pixels.
    """
    corner = solid.positions[solid.triangles] @ view.axes.T
    face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    owner, weight, rim = rasterize(view.project(solid.positions), solid.triangles, depth, side)
    hit = owner >= 0
    triangle = owner[hit]
    if solid.smooth:
        at_corner = np.zeros_like(solid.positions)
        np.add.at(at_corner, solid.triangles.ravel(), np.repeat(face, 3, axis=0))
        normal = np.einsum("pk,pkd->pd", weight[hit], at_corner[solid.triangles[triangle]])
    else:
        normal = face[triangle]
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    lit = np.clip(side * normal @ _LAMP, 0.0, 1.0)[:, None]
    colour = np.asarray(solid.colour) * (_AMBIENT + (1.0 - _AMBIENT) * lit) + _SHINE * lit**24
    if solid.lines > 0.0:
        ink = np.clip(0.5 * solid.lines * _SUPERSAMPLING + 0.5 - rim[hit], 0.0, 1.0)[:, None]
        colour += 0.8 * ink * (0.12 - colour)
    return hit, colour, np.abs(normal[:, 2])


@kernel
def rasterize(pixels: Floats, triangles: Ints, depth: Floats, side: int) -> tuple[NDArray[np.int32], Floats, Floats]:
    """Find the nearest triangle at every pixel centre, in front of what the depth buffer holds.

    Parameters
    ----------
    pixels : Floats, shape (n, 3)
        Pixel coordinates x, y (down) and height towards the viewer.
    triangles : Ints, shape (t, 3)
        Corner indices.
    depth : Floats, shape (height, width)
        Depth buffer, updated.
    side : int
        +1 for triangles that face the viewer, -1 for those that face away.

    Returns
    -------
    tuple[NDArray[np.int32], Floats, Floats]
        Triangle at each pixel, -1 for none, shape (height, width); its weights of the three corners, shape (height,
        width, 3); and the distance to its nearest edge, pixels, shape (height, width).
    """
    height, width = depth.shape
    owner = np.full((height, width), -1, dtype=np.int32)
    weight = np.zeros((height, width, 3))
    rim = np.full((height, width), 1e9)
    for t in range(len(triangles)):
        a, b, c = pixels[triangles[t, 0]], pixels[triangles[t, 1]], pixels[triangles[t, 2]]
        double = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        # y runs down: a triangle that faces the viewer has a negative area here.
        if double * side >= 0.0:
            continue
        edge_a = np.sqrt((c[0] - b[0]) ** 2 + (c[1] - b[1]) ** 2)
        edge_b = np.sqrt((a[0] - c[0]) ** 2 + (a[1] - c[1]) ** 2)
        edge_c = np.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2)
        size = abs(double)
        left = max(int(np.ceil(min(a[0], b[0], c[0]) - 0.5)), 0)
        right = min(int(np.floor(max(a[0], b[0], c[0]) - 0.5)), width - 1)
        top = max(int(np.ceil(min(a[1], b[1], c[1]) - 0.5)), 0)
        bottom = min(int(np.floor(max(a[1], b[1], c[1]) - 0.5)), height - 1)
        for row in range(top, bottom + 1):
            y = row + 0.5
            for column in range(left, right + 1):
                x = column + 0.5
                u = ((b[0] - x) * (c[1] - y) - (b[1] - y) * (c[0] - x)) / double
                v = ((c[0] - x) * (a[1] - y) - (c[1] - y) * (a[0] - x)) / double
                w = 1.0 - u - v
                if u < 0.0 or v < 0.0 or w < 0.0:
                    continue
                z = u * a[2] + v * b[2] + w * c[2]
                if z <= depth[row, column]:
                    continue
                depth[row, column] = z
                owner[row, column] = t
                weight[row, column, 0], weight[row, column, 1], weight[row, column, 2] = u, v, w
                rim[row, column] = min(u * size / edge_a, v * size / edge_b, w * size / edge_c)
    return owner, weight, rim


def balls(points: Floats, radius: float, colour: tuple[float, float, float]) -> Solid:
    """Return balls of one radius.

    Parameters
    ----------
    points : Floats, shape (n, 3)
        Centres.
    radius : float
        Radius, in the unit of the points.
    colour : tuple[float, float, float]
        Red, green, blue in 0..1.

    Returns
    -------
    Solid
        The triangles of the balls.
    """
    import trimesh

    unit = trimesh.creation.icosphere(subdivisions=2)
    vertices, faces = np.asarray(unit.vertices), np.asarray(unit.faces, dtype=np.int32)
    first = len(vertices) * np.arange(len(points), dtype=np.int32)
    positions = (points[:, None] + radius * vertices).reshape(-1, 3)
    return Solid(positions, (faces + first[:, None, None]).reshape(-1, 3), colour)


def rods(points: Floats, links: Ints, radius: float, colour: tuple[float, float, float], sides: int = 8) -> Solid:
    """Return open prisms of one radius along links.

    Parameters
    ----------
    points : Floats, shape (n, 3)
        Ends of the links.
    links : Ints, shape (m, 2)
        Pairs of points.
    radius : float
        Radius, in the unit of the points.
    colour : tuple[float, float, float]
        Red, green, blue in 0..1.
    sides : int, optional
        Number of sides of a prism.

    Returns
    -------
    Solid
        The triangles of the prisms.
    """
    start, end = points[links[:, 0]], points[links[:, 1]]
    along = end - start
    one, two = across(along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300))
    turn = 2.0 * np.pi * np.arange(sides) / sides
    ring = radius * (np.cos(turn)[:, None] * one[:, None] + np.sin(turn)[:, None] * two[:, None])
    positions = np.concatenate([start[:, None] + ring, end[:, None] + ring], axis=1).reshape(-1, 3)
    k = np.arange(sides)
    after = (k + 1) % sides
    faces = np.concatenate([np.stack([k, after, k + sides], 1), np.stack([after, after + sides, k + sides], 1)])
    first = 2 * sides * np.arange(len(links))
    return Solid(positions, (faces + first[:, None, None]).reshape(-1, 3).astype(np.int32), colour)
