"""Medial atoms at equal distances along the lines of a skeleton."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.organ.polyline import arc_length
from tissue_sim.organ.skeletons.skeleton_tree import Line, Tree

_MERGED = 0.5  # radii: junctions nearer than this are one


def place_atoms(lines: list[Line], atoms: int) -> Tree:
    """Return atoms evenly spaced over all lines, with one at every end and every junction.

    A branch is a segment between junctions and tips; a junction's atom belongs to the branch towards the root.

    Parameters
    ----------
    lines : list[Line]
        The lines.
    atoms : int
        Number of atoms.

    Raises
    ------
    UserError
        Where the branches need more atoms.
    """
    lines = _merged(lines)
    segments = _segments(lines)
    count = len(segments)
    if count == 0:
        raise UserError("the organ is too small for a skeleton of several atoms; use --atoms 1 or a finer image")
    if atoms < count + 1:
        raise UserError(
            f"--atoms {atoms} is too few for a skeleton of {count} branches;"
            f" use {count + 1} or more, or --branches none"
        )
    length = np.array([stop - start for _, start, stop in segments])
    counts = np.ones(count, dtype=np.int64)
    for _ in range(atoms - 1 - count):
        counts[(length / counts).argmax()] += 1
    positions = [lines[0].points[0][None]]
    parent, branch = [-1], [0]
    node = {(0, 0.0): 0}
    for number, (k, start, stop) in enumerate(segments):
        line = lines[k]
        last = node[_junction(lines, k, start)]
        positions.append(points_at(line.points, np.linspace(start, stop, counts[number] + 1)[1:]))
        for _ in range(counts[number]):
            parent.append(last)
            branch.append(number)
            last = len(parent) - 1
        node[(k, stop)] = last
    return Tree(
        np.concatenate(positions), np.array(parent, np.int32), np.array(branch, np.int32), count, float(length.sum())
    )


def _junction(lines: list[Line], k: int, at: float) -> tuple[int, float]:
    """Return line and length along it of the same place: a line's start lies on the line that it starts from."""
    while at <= 0.0 and k > 0:
        k, at = lines[k].on, lines[k].at
    return k, at


def points_at(points: Floats, arc: Floats) -> Floats:
    """Return points (n, 3) at lengths (n,) along a polyline (m, 3)."""
    own = arc_length(points)
    return np.stack([np.interp(arc, own, points[:, k]) for k in range(3)], axis=1)


def _merged(lines: list[Line]) -> list[Line]:
    """Return the lines with junctions that are nearer than half a radius merged into one place."""
    merged = [lines[0]]
    moved: dict[int, float] = {}
    for k in range(len(lines)):
        group: list[int] = []
        for j in sorted((j for j, line in enumerate(lines) if line.on == k), key=lambda j: lines[j].at):
            if group and lines[j].at - lines[group[-1]].at >= _MERGED * lines[j].radius:
                group = []
            group.append(j)
            moved.update(dict.fromkeys(group, float(np.mean([lines[i].at for i in group]))))
    for j, line in enumerate(lines[1:], start=1):
        mother = merged[line.on].points
        # A child's own start moves with its junction; lengths along it stay, to within that small move.
        at = min(moved[j], float(arc_length(mother)[-1]))
        points = np.concatenate([points_at(mother, np.array([at])), line.points[1:]])
        merged.append(Line(points, line.on, at, line.radius))
    return merged


def _segments(lines: list[Line]) -> list[tuple[int, float, float]]:
    """Return line, start and stop of every piece between junctions, parents first."""
    found = []
    for k, line in enumerate(lines):
        cuts = sorted({child.at for child in lines if child.on == k} - {0.0})
        ends = [0.0, *cuts, float(arc_length(line.points)[-1])]
        found += [(k, a, b) for a, b in pairwise(ends) if b > a]
    return found
