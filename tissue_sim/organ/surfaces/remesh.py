"""Changes of a closed triangle surface that keep its point count and genus: flips, point transport, relaxation.

A flip turns the edge between two triangles; a transport collapses a short edge and splits a long one with
the point that became free. Compiled; arrays are changed in place.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Ints
from tissue_sim.jit import kernel

MOST_NEIGHBOURS = 32  # triangles at a point; the changes below never exceed it
_KEEP_NORMAL = 0.3  # cosine: a change that turns a triangle further is refused


class Stars(NamedTuple):
    """Triangles around each of n points."""

    triangles: Ints  # (n, MOST_NEIGHBOURS), filled with -1
    number: Ints  # (n,)


class Free(NamedTuple):
    """Point and two triangles that a collapse leaves over, and a split uses."""

    point: int
    first: int
    second: int


@kernel
def stars(triangles: Ints, n: int) -> Stars:
    """Return the triangles around each point.

    Parameters
    ----------
    triangles : Ints, shape (t, 3)
        Corner indices.
    n : int
        Number of points.

    Raises
    ------
    ValueError
        Where a point has more than MOST_NEIGHBOURS triangles.
    """
    star = np.full((n, MOST_NEIGHBOURS), -1, dtype=np.int32)
    count = np.zeros(n, dtype=np.int32)
    for t in range(triangles.shape[0]):
        for k in range(3):
            v = triangles[t, k]
            if count[v] >= MOST_NEIGHBOURS:
                raise ValueError("too many triangles at a point")
            star[v, count[v]] = t
            count[v] += 1
    return Stars(star, count)


@kernel
def _remove(star: Stars, v: int, t: int) -> None:
    for k in range(star.number[v]):
        if star.triangles[v, k] == t:
            star.number[v] -= 1
            star.triangles[v, k] = star.triangles[v, star.number[v]]
            star.triangles[v, star.number[v]] = -1
            return


@kernel
def _add(star: Stars, v: int, t: int) -> None:
    star.triangles[v, star.number[v]] = t
    star.number[v] += 1


@kernel
def along_edge(triangles: Ints, star: Stars, a: int, b: int) -> tuple[int, int]:
    """Return the triangle that runs along the directed edge a -> b, and its third corner; -1, -1 if there is none.

    Parameters
    ----------
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    star : Stars
        Triangles around each point; updated.
    a : int
        First point of the edge.
    b : int
        Last point of the edge.
    """
    for k in range(star.number[a]):
        t = star.triangles[a, k]
        for c in range(3):
            if triangles[t, c] == a and triangles[t, (c + 1) % 3] == b:
                return t, triangles[t, (c + 2) % 3]
    return -1, -1


@kernel
def _joined(triangles: Ints, star: Stars, a: int, b: int) -> bool:
    for k in range(star.number[a]):
        t = star.triangles[a, k]
        if triangles[t, 0] == b or triangles[t, 1] == b or triangles[t, 2] == b:
            return True
    return False


@kernel
def normal_of(p, q, r):  # type: ignore[no-untyped-def]
    """Return twice the area times the unit normal as a tuple: small arrays cost more than the arithmetic."""
    ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    vx, vy, vz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@kernel
def _agree(m, n):  # type: ignore[no-untyped-def]
    dot = m[0] * n[0] + m[1] * n[1] + m[2] * n[2]
    mm = m[0] * m[0] + m[1] * m[1] + m[2] * m[2]
    nn = n[0] * n[0] + n[1] * n[1] + n[2] * n[2]
    return nn > 1e-24 and dot > _KEEP_NORMAL * np.sqrt(mm * nn)


@kernel
def _wider(c, d, a, b):  # type: ignore[no-untyped-def]
    """Return whether the angles at c and d towards a and b sum to more than 180 degrees."""
    ux, uy, uz = a[0] - c[0], a[1] - c[1], a[2] - c[2]
    vx, vy, vz = b[0] - c[0], b[1] - c[1], b[2] - c[2]
    sx, sy, sz = a[0] - d[0], a[1] - d[1], a[2] - d[2]
    tx, ty, tz = b[0] - d[0], b[1] - d[1], b[2] - d[2]
    cos_c = ux * vx + uy * vy + uz * vz
    cos_d = sx * tx + sy * ty + sz * tz
    sin_c = np.sqrt((uy * vz - uz * vy) ** 2 + (uz * vx - ux * vz) ** 2 + (ux * vy - uy * vx) ** 2)
    sin_d = np.sqrt((sy * tz - sz * ty) ** 2 + (sz * tx - sx * tz) ** 2 + (sx * ty - sy * tx) ** 2)
    scale = np.sqrt((cos_c**2 + sin_c**2) * (cos_d**2 + sin_d**2))
    if scale == 0.0:
        return False
    return sin_c * cos_d + cos_c * sin_d < -1e-6 * scale


@kernel
def flip_edges(positions: Floats, triangles: Ints) -> int:
    """Do one pass of flips towards the Delaunay condition (opposite angles sum to at most 180 degrees), in place.

    Flips that would duplicate an edge or fold the surface are left out.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.

    Returns
    -------
    int
        Number of flips.
    """
    n = positions.shape[0]
    star = stars(triangles, n)
    flips = 0
    for t in range(triangles.shape[0]):
        for k in range(3):
            a, b = triangles[t, k], triangles[t, (k + 1) % 3]
            if a > b:
                continue
            c = triangles[t, (k + 2) % 3]
            s, d = along_edge(triangles, star, b, a)
            if s < 0 or c == d or star.number[a] <= 3 or star.number[b] <= 3:
                continue
            if star.number[c] >= MOST_NEIGHBOURS - 1 or star.number[d] >= MOST_NEIGHBOURS - 1:
                continue
            pa, pb, pc, pd = positions[a], positions[b], positions[c], positions[d]
            if not _wider(pc, pd, pa, pb):
                continue
            if _joined(triangles, star, c, d):
                continue
            one, other = normal_of(pa, pb, pc), normal_of(pb, pa, pd)
            old = (one[0] + other[0], one[1] + other[1], one[2] + other[2])
            if not (_agree(old, normal_of(pa, pd, pc)) and _agree(old, normal_of(pd, pb, pc))):
                continue
            triangles[t, 0], triangles[t, 1], triangles[t, 2] = a, d, c
            triangles[s, 0], triangles[s, 1], triangles[s, 2] = d, b, c
            _remove(star, a, s)
            _remove(star, b, t)
            _add(star, d, t)
            _add(star, c, s)
            flips += 1
            break
    return flips


@kernel
def collapse_edge(positions: Floats, triangles: Ints, star: Stars, a: int, b: int) -> tuple[int, int]:
    """Collapse b into a at their midpoint, in place; return the two triangles that become free, -1 where it can't be.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    star : Stars
        Triangles around each point; updated.
    a : int
        Point that stays.
    b : int
        Point that becomes free.
    """
    t, c = along_edge(triangles, star, a, b)
    s, d = along_edge(triangles, star, b, a)
    if t < 0 or s < 0 or c == d or star.number[c] <= 3 or star.number[d] <= 3:
        return -1, -1
    if star.number[a] + star.number[b] - 4 >= MOST_NEIGHBOURS - 1 or star.number[a] + star.number[b] - 4 < 4:
        return -1, -1
    common = 0
    for k in range(star.number[a]):
        q = star.triangles[a, k]
        for m in range(3):
            if triangles[q, m] == a:
                v = triangles[q, (m + 1) % 3]
                if v != b and _joined(triangles, star, b, v):
                    common += 1
    if common != 2:
        return -1, -1
    middle = 0.5 * (positions[a] + positions[b])
    for v in (a, b):
        for k in range(star.number[v]):
            q = star.triangles[v, k]
            if q == t or q == s:
                continue
            old = normal_of(positions[triangles[q, 0]], positions[triangles[q, 1]], positions[triangles[q, 2]])
            corners = np.empty((3, 3))
            for m in range(3):
                w = triangles[q, m]
                corners[m] = middle if w == v else positions[w]
            if not _agree(old, normal_of(corners[0], corners[1], corners[2])):
                return -1, -1
    _remove(star, a, t)
    _remove(star, b, t)
    _remove(star, c, t)
    _remove(star, a, s)
    _remove(star, b, s)
    _remove(star, d, s)
    while star.number[b] > 0:
        q = star.triangles[b, star.number[b] - 1]
        for m in range(3):
            if triangles[q, m] == b:
                triangles[q, m] = a
        _remove(star, b, q)
        _add(star, a, q)
    positions[a] = middle
    return t, s


@kernel
def split_edge(positions: Floats, triangles: Ints, star: Stars, a: int, b: int, free: Free) -> None:
    """Split edge a - b at its midpoint, in place.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    star : Stars
        Triangles around each point; updated.
    a : int
        First point of the edge.
    b : int
        Last point of the edge.
    free : Free
        Point and triangles that it uses.
    """
    middle, t_new, s_new = free
    t, c = along_edge(triangles, star, a, b)
    s, d = along_edge(triangles, star, b, a)
    positions[middle] = 0.5 * (positions[a] + positions[b])
    triangles[t, 0], triangles[t, 1], triangles[t, 2] = a, middle, c
    triangles[t_new, 0], triangles[t_new, 1], triangles[t_new, 2] = middle, b, c
    triangles[s, 0], triangles[s, 1], triangles[s, 2] = middle, a, d
    triangles[s_new, 0], triangles[s_new, 1], triangles[s_new, 2] = b, middle, d
    _remove(star, b, t)
    _remove(star, b, s)
    _add(star, b, t_new)
    _add(star, b, s_new)
    _add(star, middle, t)
    _add(star, middle, s)
    _add(star, middle, t_new)
    _add(star, middle, s_new)
    _add(star, c, t_new)
    _add(star, d, s_new)
