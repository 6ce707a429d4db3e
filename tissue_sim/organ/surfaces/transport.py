"""Points of a surface move to where they are needed: from crowded to sparse places, and between their neighbours."""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats, Ints
from tissue_sim.jit import kernel
from tissue_sim.organ.surfaces.remesh import (
    MOST_NEIGHBOURS,
    Free,
    along_edge,
    collapse_edge,
    normal_of,
    split_edge,
    stars,
)


def transport(positions: Floats, triangles: Ints, ratio: float, most: int) -> int:
    """Move points from where edges are short to where they are long, in place.

    The shortest edges are paired with the longest as long as the long one is more than `ratio` times the short one;
    each point takes part once.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    ratio : float
        Least ratio of lengths of a pair.
    most : int
        Largest number of points moved.

    Returns
    -------
    int
        Number of points moved.
    """
    return int(transport_sized(positions, triangles, ratio, most, np.ones(len(positions))))


@kernel
def sized_edges(positions: Floats, triangles: Ints, size: Floats) -> tuple[Ints, Floats]:
    """Return the edges of a closed surface, and their lengths relative to the mean wanted size at their ends.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    size : Floats, shape (n,)
        Wanted edge length at each point, relative.

    Returns
    -------
    tuple[Ints, Floats]
        Point indices, shape (m, 2), and lengths, shape (m,).
    """
    m = 3 * triangles.shape[0] // 2
    edges = np.empty((m, 2), dtype=np.int32)
    length = np.empty(m)
    e = 0
    for t in range(triangles.shape[0]):
        for k in range(3):
            a, b = triangles[t, k], triangles[t, (k + 1) % 3]
            if a < b:
                edges[e, 0], edges[e, 1] = a, b
                d = positions[a] - positions[b]
                length[e] = np.sqrt(d[0] ** 2 + d[1] ** 2 + d[2] ** 2) / (0.5 * (size[a] + size[b]))
                e += 1
    return edges, length


@kernel
def transport_sized(positions: Floats, triangles: Ints, ratio: float, most: int, size: Floats) -> int:
    """Move points as `transport` does, with lengths relative to the mean wanted size at an edge's ends.

    A point that moves takes the size of where it goes; `size` changes in place.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    ratio : float
        Least ratio of lengths of a pair.
    most : int
        Largest number of points moved.
    size : Floats, shape (n,)
        Wanted edge length at each point, relative.

    Returns
    -------
    int
        Number of points moved.
    """
    n = positions.shape[0]
    star = stars(triangles, n)
    edges, length = sized_edges(positions, triangles, size)
    m = len(edges)
    order = np.argsort(length)
    used = np.zeros(n, dtype=np.bool_)
    long = m - 1
    moved = 0
    for short in order:
        if moved >= most:
            break
        a, b = edges[short, 0], edges[short, 1]
        if used[a] or used[b]:
            continue
        while long >= 0:
            c, d = edges[order[long], 0], edges[order[long], 1]
            ready = not (used[c] or used[d]) and c != a and c != b and d != a and d != b
            if ready and along_edge(triangles, star, c, d)[0] >= 0:
                break
            long -= 1
        if long < 0 or length[order[long]] < ratio * length[short]:
            break
        c, d = edges[order[long], 0], edges[order[long], 1]
        _, left = along_edge(triangles, star, c, d)
        _, right = along_edge(triangles, star, d, c)
        if left == a or left == b or right == a or right == b:
            continue
        if star.number[left] >= MOST_NEIGHBOURS - 2 or star.number[right] >= MOST_NEIGHBOURS - 2:
            continue
        t, s = collapse_edge(positions, triangles, star, a, b)
        if t < 0:
            continue
        split_edge(positions, triangles, star, c, d, Free(b, t, s))
        size[b] = 0.5 * (size[c] + size[d])
        used[a] = used[b] = used[c] = used[d] = True
        moved += 1
        long -= 1
    return moved


def relax(positions: Floats, triangles: Ints, fraction: float) -> None:
    """Move every point along the surface towards the area-weighted centroid of its triangles, in place.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    fraction : float
        Fraction of the distance that is moved.
    """
    relax_sized(positions, triangles, fraction, np.ones(len(positions)))


@kernel
def relax_sized(positions: Floats, triangles: Ints, fraction: float, size: Floats) -> None:
    """Relax as `relax` does with areas weighted by size^-4, which spreads the points as densely as wanted.

    The exponent is that of centroidal Voronoi cells of a density in the plane (Du, Faber and Gunzburger 1999).

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    fraction : float
        Fraction of the distance that is moved.
    size : Floats, shape (n,)
        Wanted edge length at each point, relative.

    References
    ----------
    Du, Faber & Gunzburger 1999: Centroidal Voronoi tessellations; the exponent is that of a density in the plane.
    """
    n = positions.shape[0]
    total = np.zeros(n)
    middle, normal = np.zeros((n, 3)), np.zeros((n, 3))
    for t in range(triangles.shape[0]):
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        cross = normal_of(positions[i], positions[j], positions[k])
        x, y, z = cross
        area = np.sqrt(x * x + y * y + z * z) / ((size[i] + size[j] + size[k]) / 3.0) ** 4
        for m in range(3):
            at = area * (positions[i, m] + positions[j, m] + positions[k, m]) / 3.0
            for p in (i, j, k):
                middle[p, m] += at
                normal[p, m] += cross[m]
        for p in (i, j, k):
            total[p] += area
    for i in range(n):
        if total[i] <= 0.0:
            continue
        length = np.sqrt(normal[i, 0] ** 2 + normal[i, 1] ** 2 + normal[i, 2] ** 2)
        along = 0.0
        for m in range(3):
            normal[i, m] /= length if length > 0.0 else 1.0
            middle[i, m] = middle[i, m] / total[i] - positions[i, m]
            along += middle[i, m] * normal[i, m]
        for m in range(3):
            positions[i, m] += fraction * 1.5 * (middle[i, m] - normal[i, m] * along)
