"""Boundary that the present skeleton implies: a target for the return springs.

The compiled counterpart of `tissue_sim.organ.medial.recalculated_boundary`, without a singular value decomposition and
without allocations: rotations are found by their twist in closed form and a few Newton steps.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tissue_sim.handles import has
from tissue_sim.jit import chosen, kernel
from tissue_sim.model.data.arrays import copy
from tissue_sim.model.data.model import Spokes
from tissue_sim.organ.medial import neighbours, represent
from tissue_sim.organ.organ import Organ

_POWER_STEPS = 40
_NEWTON_STEPS = 8
# As in organ.medial.
_HALF_TURN = 1e-12
_UNDECIDED = 1e-12
_SHORTEST = 1e-12  # m


def spokes_of(organ: Organ) -> Spokes:
    """Return the spokes of every surface node, from its nearest medial atom, and of every interior atom.

    Parameters
    ----------
    organ : Organ
        The organ.

    Returns
    -------
    Spokes
        The spokes.

    Raises
    ------
    UserError
        Where the organ has fewer than two medial atoms.
    """
    x = organ.atom_positions
    rep = represent(organ.surface_positions, x, organ.atom_parent)
    towards = neighbours(organ.atom_parent)
    interior = organ.n_surface + organ.n_atoms + np.arange(organ.n_interior)
    node = np.concatenate([np.arange(organ.n_surface), interior]).astype(np.int32)
    atom = np.concatenate([rep.atom, organ.interior_spoke[:, 0]]).astype(np.int32)
    bone = x - x[towards]
    offset = x - x.mean(axis=0)
    return Spokes(
        first_atom=organ.n_surface,
        towards=towards,
        parent=np.array(organ.atom_parent),
        bone=bone / np.maximum(np.linalg.norm(bone, axis=1, keepdims=True), _SHORTEST),
        offset=offset,
        axis=np.ascontiguousarray(np.linalg.svd(offset, full_matrices=False)[2][0]),
        node=node,
        atom=atom,
        spoke=organ.rest_positions[node] - x[atom],
        frame=np.zeros((len(x), 3, 3)),
        work=np.zeros((5, 3, 3)),
    )


@kernel
def _lead(model: Any, state: Any) -> None:
    if not state.status.asleep:
        imply_boundary(model.spokes, state.position, model.return_target)


@kernel
def _leave(model: Any, state: Any) -> None:
    """Return springs pull to where they always do."""


@chosen(lambda model, *_: _lead if has(model, "spokes") else _leave)
def lead_return_springs(model: Any, state: Any) -> None:
    """Have return springs pull to the boundary that the skeleton implies now, where they do."""


@kernel
def imply_boundary(spokes: Any, position: Any, target: Any) -> None:
    """Compute where the atoms imply the spokes' ends.

    Parameters
    ----------
    spokes : Any
        The M-rep; its frames are updated.
    position : Any, shape (n, 3), m
        Positions of the nodes, surface first.
    target : Any, shape (n, 3), m
        Receives the positions.
    """
    transport_frames(spokes, position)
    for s in range(len(spokes.node)):
        turn, spoke = spokes.frame[spokes.atom[s]], spokes.spoke[s]
        node, atom = spokes.node[s], spokes.first_atom + spokes.atom[s]
        for i in range(3):
            end = turn[i, 0] * spoke[0] + turn[i, 1] * spoke[1] + turn[i, 2] * spoke[2]
            target[node, i] = position[atom, i] + end


@kernel
def transport_frames(spokes: Any, position: Any) -> None:
    """Compute the rotations of the atoms' frames, twist-free from the root outwards, into spokes.frame."""
    whole, small, carried, vectors = spokes.work[0], spokes.work[1], spokes.work[2], spokes.work[3]
    whole_rotation(spokes, position)
    old, new = vectors[0], vectors[1]
    for a in range(len(spokes.parent)):
        up, first = spokes.parent[a], spokes.first_atom
        for i in range(3):
            for j in range(3):
                carried[i, j] = whole[i, j] if up < 0 else spokes.frame[up, i, j]
        length = 0.0
        for i in range(3):
            new[i] = position[first + a, i] - position[first + spokes.towards[a], i]
            length += new[i] * new[i]
        length = max(math.sqrt(length), _SHORTEST)
        for i in range(3):
            new[i] /= length
        apply(carried, spokes.bone[a], old, False)
        if new[0] == 0.0 and new[1] == 0.0 and new[2] == 0.0:
            copy(carried, spokes.frame[a])
            continue
        smallest(old, new, small)
        for i in range(3):
            for j in range(3):
                spokes.frame[a, i, j] = (
                    small[i, 0] * carried[0, j] + small[i, 1] * carried[1, j] + small[i, 2] * carried[2, j]
                )


@kernel
def whole_rotation(spokes: Any, position: Any) -> None:
    """Compute the rotation of the skeleton as a whole into work[0]; see organ.medial.nearest_rotation."""
    whole, straight, spread, vectors = spokes.work[0], spokes.work[1], spokes.work[2], spokes.work[3]
    middle, axis, image = vectors[0], vectors[1], vectors[2]
    count, first = len(spokes.offset), spokes.first_atom
    middle[:] = 0.0
    for a in range(count):
        for i in range(3):
            middle[i] += position[first + a, i] / count
    spread[:] = 0.0
    for a in range(count):
        for i in range(3):
            for j in range(3):
                spread[i, j] += (position[first + a, i] - middle[i]) * spokes.offset[a, j]
    copy(spokes.axis, axis)
    size = 0.0
    for _ in range(_POWER_STEPS):
        size = apply(spread, axis, image, False)
        if size == 0.0:
            break
        apply(spread, image, axis, True)
    if size == 0.0:
        copy(spokes.axis, axis)
        copy(axis, image)
    else:
        apply(spread, axis, image, False)
    smallest(axis, image, straight)
    turn_best(straight, spread, axis, whole, spokes.work[4])
    misfit = 0.0
    for a in range(count):
        for i in range(3):
            away = position[first + a, i] - middle[i]
            for j in range(3):
                away -= whole[i, j] * spokes.offset[a, j]
            misfit += away * away
    misfit += _UNDECIDED * size
    for i in range(3):
        for j in range(3):
            spread[i, j] += misfit * straight[i, j]
    turn_best(straight, spread, axis, whole, spokes.work[4])


@kernel
def apply(matrix: Any, vector: Any, out: Any, transposed: bool) -> float:
    """Write matrix (3, 3), or its transpose, times vector (3,) to out as a unit vector; return its length."""
    total = 0.0
    for i in range(3):
        out[i] = 0.0
        for j in range(3):
            out[i] += (matrix[j, i] if transposed else matrix[i, j]) * vector[j]
        total += out[i] * out[i]
    total = math.sqrt(total)
    if total > 0.0:
        for i in range(3):
            out[i] /= total
    return total


@kernel
def turn_best(start: Any, spread: Any, axis: Any, best: Any, product: Any) -> None:
    """Compute the rotation R with the largest tr(R' spread), from start turned about axis, into best (3, 3).

    The turn about the axis has a closed form; Newton steps do the rest.
    """
    copy(start, best)
    for step in range(_NEWTON_STEPS + 1):
        for i in range(3):
            for j in range(3):
                product[i, j] = best[0, i] * spread[0, j] + best[1, i] * spread[1, j] + best[2, i] * spread[2, j]
        gx, gy, gz = product[2, 1] - product[1, 2], product[0, 2] - product[2, 0], product[1, 0] - product[0, 1]
        trace = product[0, 0] + product[1, 1] + product[2, 2]
        if step == 0:
            along = 0.0
            for i in range(3):
                for j in range(3):
                    along += axis[i] * product[i, j] * axis[j]
            angle = math.atan2(gx * axis[0] + gy * axis[1] + gz * axis[2], trace - along)
            turn_by(best, angle * axis[0], angle * axis[1], angle * axis[2])
            continue
        # (tr(A) I - sym(A)) d = g
        a, b, c = trace - product[0, 0], trace - product[1, 1], trace - product[2, 2]
        d = -0.5 * (product[0, 1] + product[1, 0])
        e = -0.5 * (product[0, 2] + product[2, 0])
        f = -0.5 * (product[1, 2] + product[2, 1])
        det = a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)
        if det <= 1e-30 * (trace * trace * trace) or trace <= 0.0:
            return
        x = ((b * c - f * f) * gx + (e * f - d * c) * gy + (d * f - b * e) * gz) / det
        y = ((e * f - d * c) * gx + (a * c - e * e) * gy + (d * e - a * f) * gz) / det
        z = ((d * f - b * e) * gx + (d * e - a * f) * gy + (a * b - d * d) * gz) / det
        size = math.sqrt(x * x + y * y + z * z)
        scale = min(1.0, 0.5 / max(size, 1e-300))
        turn_by(best, scale * x, scale * y, scale * z)


@kernel
def turn_by(matrix: Any, x: float, y: float, z: float) -> None:
    """Multiply a rotation (3, 3) from the right by the one about (x, y, z), rad, in place."""
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < 1e-300:
        return
    half = math.sin(0.5 * angle) / angle
    w, x, y, z = math.cos(0.5 * angle), half * x, half * y, half * z
    for i in range(3):
        p, q, r = matrix[i, 0], matrix[i, 1], matrix[i, 2]
        matrix[i, 0] = p * (1.0 - 2.0 * (y * y + z * z)) + q * 2.0 * (x * y + z * w) + r * 2.0 * (x * z - y * w)
        matrix[i, 1] = p * 2.0 * (x * y - z * w) + q * (1.0 - 2.0 * (x * x + z * z)) + r * 2.0 * (y * z + x * w)
        matrix[i, 2] = p * 2.0 * (x * z + y * w) + q * 2.0 * (y * z - x * w) + r * (1.0 - 2.0 * (x * x + y * y))


@kernel
def smallest(source: Any, target: Any, out: Any) -> None:
    """Compute the rotation by the smallest angle from one unit vector (3,) to another into out (3, 3)."""
    square = 0.0
    for i in range(3):
        square += (source[i] + target[i]) ** 2
    if square >= _HALF_TURN:
        for i in range(3):
            for j in range(3):
                both = (source[i] + target[i]) * (source[j] + target[j])
                out[i, j] = (1.0 if i == j else 0.0) - 2.0 / square * both + 2.0 * target[i] * source[j]
        return
    # Half a turn about a perpendicular axis: the one nearest to the direction of the smallest component.
    least = 0
    for i in range(1, 3):
        if abs(source[i]) < abs(source[least]):
            least = i
    total = math.sqrt(1.0 - source[least] * source[least])
    for i in range(3):
        for j in range(3):
            a = ((1.0 if i == least else 0.0) - source[least] * source[i]) / total
            b = ((1.0 if j == least else 0.0) - source[least] * source[j]) / total
            out[i, j] = 2.0 * a * b - (1.0 if i == j else 0.0)
