"""Energy, its gradient and its second derivative of springs whose stiffness is an argument; forces.py has the law."""

from __future__ import annotations

import math
from typing import Any

from tissue_sim.jit import kernel
from tissue_sim.model.forces import HARDENING_STRAIN, SHORTEST, secant, stored

WORK = 8  # 3 x 3 matrices that a hinge's second derivative is put together from


@kernel
def axial_energy(position: Any, ends: Any, rest: Any, hardening: float, stiffness: Any, gradient: Any) -> float:
    """Energy, J, of springs (s, 2); adds its gradient (n, 3) N."""
    total = 0.0
    for s in range(len(ends)):
        i, j = ends[s, 0], ends[s, 1]
        x, y, z = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1], position[j, 2] - position[i, 2]
        stretch = math.sqrt(x * x + y * y + z * z) / rest[s]
        total += stiffness[s] * rest[s] * rest[s] * stored(stretch, hardening)
        pull = stiffness[s] * _pull(stretch, hardening)
        gradient[i, 0] -= pull * x
        gradient[i, 1] -= pull * y
        gradient[i, 2] -= pull * z
        gradient[j, 0] += pull * x
        gradient[j, 1] += pull * y
        gradient[j, 2] += pull * z
    return total


@kernel
def axial_slopes(position: Any, ends: Any, rest: Any, hardening: float, slope: Any) -> None:
    """Slopes of the energy over stiffness by the second end of springs (s, 2), into slope (s, 3) m."""
    for s in range(len(ends)):
        i, j = ends[s, 0], ends[s, 1]
        x, y, z = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1], position[j, 2] - position[i, 2]
        pull = _pull(math.sqrt(x * x + y * y + z * z) / rest[s], hardening)
        slope[s, 0], slope[s, 1], slope[s, 2] = pull * x, pull * y, pull * z


@kernel
def _pull(stretch: float, hardening: float) -> float:
    """Force of a spring over its stiffness and length."""
    bounded = max(stretch, SHORTEST)
    return (1.0 - 1.0 / bounded) * secant(bounded - 1.0, hardening)


@kernel
def _secant_slope(strain: float, hardening: float) -> float:
    s = strain / HARDENING_STRAIN
    return hardening * (2.0 * s - 1.0) / HARDENING_STRAIN if -1.0 < s < 1.0 else 0.0


@kernel
def hinge_energy(
    position: Any, nodes: Any, weight: Any, bent: Any, least: Any, stiffness: Any, gradient: Any, work: Any
) -> float:
    """Energy, J, of angular springs (h, 4); adds its gradient (n, 3) N. work (WORK, 3, 3)."""
    total = 0.0
    for h in range(len(nodes)):
        bending, _ = _bend(position, nodes[h], weight[h], least[h], work)
        bending -= bent[h]
        total += 0.5 * stiffness[h] * bending * bending
        for c in range(4):
            for axis in range(3):
                gradient[nodes[h, c], axis] += stiffness[h] * bending * _slope(work, weight[h], c, axis)
    return total


@kernel
def axial_tangent(
    position: Any, ends: Any, rest: Any, hardening: float, stiffness: Any, convex: bool, target: Any, data: Any
) -> None:
    """Add the second derivative of springs to the entries of a matrix; target (s, 2, 2, 3, 3), -1 for none.

    convex: without what a pushed spring's turning takes from it.
    """
    for s in range(len(ends)):
        i, j = ends[s, 0], ends[s, 1]
        length = 0.0
        for axis in range(3):
            length += (position[j, axis] - position[i, axis]) ** 2
        length = math.sqrt(length)
        bounded = max(length, SHORTEST * rest[s])
        strain = bounded / rest[s] - 1.0
        factor = secant(strain, hardening)
        pull = (1.0 - rest[s] / bounded) * factor
        steep = 0.0
        if length == bounded:
            steep = (rest[s] / bounded * factor + strain * _secant_slope(strain, hardening)) / bounded**2
        if convex and pull < 0.0:
            square = max(length, 1e-12) ** 2
            steep, pull = max(pull + steep * square, 0.0) / square, 0.0
        for row in range(3):
            for column in range(3):
                along = (position[j, row] - position[i, row]) * (position[j, column] - position[i, column])
                value = stiffness[s] * (steep * along + (pull if row == column else 0.0))
                for a in range(2):
                    for b in range(2):
                        where = target[s, a, b, row, column]
                        if where >= 0:
                            data[where] += value if a == b else -value


@kernel
def hinge_tangent(
    position: Any,
    nodes: Any,
    weight: Any,
    bent: Any,
    least: Any,
    stiffness: Any,
    convex: bool,
    target: Any,
    data: Any,
    work: Any,
) -> None:
    """Add the second derivative of angular springs to a matrix; target (h, 4, 4, 3, 3), -1 for none; work (WORK, 3, 3).

    The curvature is b.n with b linear in the positions and n = e x d over its length. Its second derivative comes from
    those by b and n through their Jacobians, and from that of e x d.
    """
    for h in range(len(nodes)):
        curvature, sound = _bend(position, nodes[h], weight[h], least[h], work)
        if not convex:
            _second(work, curvature, sound)
        for a in range(4):
            for b in range(4):
                for row in range(3):
                    for column in range(3):
                        where = target[h, a, b, row, column]
                        if where < 0:
                            continue
                        value = _slope(work, weight[h], a, row) * _slope(work, weight[h], b, column)
                        if not convex:
                            value += (curvature - bent[h]) * _turned(work, weight[h], a, b, row, column)
                        data[where] += stiffness[h] * value


# Rows of work[0]: normal n, slope of the curvature by e x d, and in one entry 1 / |e x d|; of work[1]: edge e, across
# d; of work[2]: slopes by e and by d. Then the matrices of _second: M J by d's and e's Jacobian, and the three J' W J.
_BY_D, _BY_E, _DD, _DE, _EE = 3, 4, 5, 6, 7


@kernel
def _bend(position: Any, nodes: Any, weight: Any, least: float, work: Any) -> tuple[float, bool]:
    """Curvature of a hinge, m, and whether it has an area; leaves in work what follows needs."""
    base, lever = work[0], work[1]
    for axis in range(3):
        lever[0, axis] = position[nodes[1], axis] - position[nodes[0], axis]  # edge
        lever[1, axis] = position[nodes[2], axis] - position[nodes[3], axis]  # across
    _cross(lever[0], lever[1], base[0])
    square = base[0, 0] ** 2 + base[0, 1] ** 2 + base[0, 2] ** 2
    sound = square > least
    inverse = 1.0 / math.sqrt(square if sound else least)
    curvature = 0.0
    for axis in range(3):
        base[0, axis] *= inverse
        base[1, axis] = 0.0
        for c in range(4):
            base[1, axis] += weight[c] * position[nodes[c], axis]
        curvature += base[1, axis] * base[0, axis]
    for axis in range(3):
        base[1, axis] = (base[1, axis] - (curvature * base[0, axis] if sound else 0.0)) * inverse
    base[2, 0] = inverse
    _cross(lever[1], base[1], work[2, 0])  # slope by the edge
    _cross(base[1], lever[0], work[2, 1])  # and across
    return curvature, sound


@kernel
def _slope(work: Any, weight: Any, c: int, axis: int) -> float:
    """Slope of the curvature by a node's position."""
    turn = work[2, 0, axis] if c < 2 else work[2, 1, axis]
    return weight[c] * work[0, 0, axis] + (turn if c == 1 or c == 2 else -turn)


@kernel
def _cross(a: Any, b: Any, found: Any) -> None:
    found[0] = a[1] * b[2] - a[2] * b[1]
    found[1] = a[2] * b[0] - a[0] * b[2]
    found[2] = a[0] * b[1] - a[1] * b[0]


@kernel
def _skew(a: Any, row: int, column: int) -> float:
    """An entry of [a]x, for which [a]x b = a x b."""
    if row == column:
        return 0.0
    other = 3 - row - column
    return -a[other] if (column - row) % 3 == 1 else a[other]


@kernel
def _second(work: Any, curvature: float, sound: bool) -> None:
    """The 3 x 3 matrices of the second derivative: M J and J' W J for the Jacobians of e x d by the edge and across.

    M = (1 - n n') / length; W = -(curvature M + n t' + t n') / length, t the slope by e x d; of a sound hinge.
    """
    normal, turn, inverse = work[0, 0], work[0, 1], work[0, 2, 0]
    for r in range(3):
        for c in range(3):
            by_d = by_e = 0.0
            for k in range(3):
                flat = ((1.0 if r == k else 0.0) - (normal[r] * normal[k] if sound else 0.0)) * inverse
                by_d -= flat * _skew(work[1, 1], k, c)
                by_e += flat * _skew(work[1, 0], k, c)
            work[_BY_D, r, c], work[_BY_E, r, c] = by_d, by_e
            work[_DD, r, c] = work[_DE, r, c] = work[_EE, r, c] = 0.0
    if not sound:
        return
    for i in range(3):
        for j in range(3):
            flat = ((1.0 if i == j else 0.0) - normal[i] * normal[j]) * inverse
            w = -inverse * (curvature * flat + normal[i] * turn[j] + turn[i] * normal[j])
            for r in range(3):
                d, e = -_skew(work[1, 1], i, r), _skew(work[1, 0], i, r)
                for c in range(3):
                    work[_DD, r, c] -= d * w * _skew(work[1, 1], j, c)
                    work[_DE, r, c] += d * w * _skew(work[1, 0], j, c)
                    work[_EE, r, c] += e * w * _skew(work[1, 0], j, c)


@kernel
def _turned(work: Any, weight: Any, a: int, b: int, row: int, column: int) -> float:
    """An entry of the curvature's second derivative by the positions of nodes a and b."""
    edge_a, edge_b = a < 2, b < 2
    sign_a = 1.0 if a == 1 or a == 2 else -1.0
    sign_b = 1.0 if b == 1 or b == 2 else -1.0
    found = weight[a] * sign_b * (work[_BY_D, row, column] if edge_b else work[_BY_E, row, column])
    found += weight[b] * sign_a * (work[_BY_D, column, row] if edge_a else work[_BY_E, column, row])
    if edge_a and edge_b:
        found += sign_a * sign_b * work[_DD, row, column]
    elif not edge_a and not edge_b:
        found += sign_a * sign_b * work[_EE, row, column]
    elif edge_a:
        found += sign_a * sign_b * (work[_DE, row, column] - _skew(work[0, 1], row, column))
    else:
        found += sign_a * sign_b * (work[_DE, column, row] - _skew(work[0, 1], column, row))
    return found
