"""Which part of the surface lies near a tool: compiled sweeps over boxes."""

from __future__ import annotations

from typing import Any

from tissue_sim.model.jit import kernel


@kernel
def surface_box(position: Any, n_surface: int, low: Any, high: Any) -> None:
    """Axis-aligned box low (3,), high (3,) of the first n_surface positions (n, 3), m."""
    for c in range(3):
        low[c] = high[c] = position[0, c]
    for node in range(1, n_surface):
        for c in range(3):
            low[c] = min(low[c], position[node, c])
            high[c] = max(high[c], position[node, c])


@kernel
def triangles_in_box(position: Any, triangles: Any, low: Any, high: Any, found: Any) -> int:
    """Write the triangles (t, 3) whose box meets the box low, high (3,); returns how many."""
    count = 0
    for t in range(len(triangles)):
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        apart = False
        for c in range(3):
            a, b, d = position[i, c], position[j, c], position[k, c]
            apart = apart or min(a, b, d) > high[c] or max(a, b, d) < low[c]
        if not apart:
            found[count] = t
            count += 1
    return count


@kernel
def nearest_node(position: Any, n_surface: int, x: float, y: float, z: float) -> tuple[int, float]:
    """Surface node nearest to a point, and its squared distance, m^2."""
    best, chosen = 1e300, -1
    for node in range(n_surface):
        dx, dy, dz = position[node, 0] - x, position[node, 1] - y, position[node, 2] - z
        distance = dx * dx + dy * dy + dz * dz
        if distance < best:
            best, chosen = distance, node
    return chosen, best
