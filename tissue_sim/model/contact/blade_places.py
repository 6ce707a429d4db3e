"""Places of blades in tissue: the cells that hold them, and the deformation of these."""

from __future__ import annotations

import math

from tissue_sim.array_types import Floats
from tissue_sim.jit import inner, kernel
from tissue_sim.model.data.blades import CORNERS, BladeSample, CutCells
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.state import State
from tissue_sim.model.data.world import World

MOST_STEPS = 64  # largest number of steps from cell to cell in a search
OUTSIDE = 0.05  # a place with a barycentric weight below minus this has left the tissue
MOST_BACK = 4.0  # Frobenius norm of the matrix from present displacements to those at rest; 1.7 for the identity


@kernel
def leave_tissue(sample: BladeSample) -> None:
    """Take a place of a blade out of the tissue.

    Parameters
    ----------
    sample : BladeSample
        The place; updated.
    """
    sample.embedded = sample.free = False
    sample.depth = sample.deepest = 0.0
    for axis in range(3):
        sample.rest[axis] = sample.force[axis] = sample.offset[axis] = 0.0


@kernel
def locate(cells: CutCells, sample: BladeSample, weight: Floats) -> bool:
    """Find the cell that holds a place, starting from its last one.

    Parameters
    ----------
    cells : CutCells
        The cells.
    sample : BladeSample
        The place; its cell is updated.
    weight : Floats, shape (4,) or more
        Receives the barycentric weights there.

    Returns
    -------
    bool
        False if it is outside the tissue.
    """
    cell, rest = sample.cell, sample.rest
    for _ in range(MOST_STEPS):
        least, across = 0.0, -1
        for corner in range(CORNERS):
            slope = cells.slope[cell, corner]
            value = cells.base[cell, corner] + slope[0] * rest[0] + slope[1] * rest[1] + slope[2] * rest[2]
            weight[corner] = value
            if value < least:
                least, across = value, corner
        if across < 0:
            sample.cell = cell
            return True
        if cells.neighbour[cell, across] < 0:
            sample.cell = cell
            return least > -OUTSIDE
        cell = cells.neighbour[cell, across]
    return False


@inner
def turned_by(rotation: Floats, vector: Floats, result: Floats) -> None:
    """Rotate a vector.

    Parameters
    ----------
    rotation : Floats, shape (9,)
        Rotation matrix, row by row.
    vector : Floats, shape (3,)
        The vector.
    result : Floats, shape (3,)
        Receives the rotated vector.
    """
    for row in range(3):
        result[row] = (
            rotation[3 * row] * vector[0] + rotation[3 * row + 1] * vector[1] + rotation[3 * row + 2] * vector[2]
        )


@inner
def times(matrix: Floats, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the product of a matrix (9,), row by row, and a vector.

    Parameters
    ----------
    matrix : Floats, shape (9,)
        The matrix.
    x, y, z : float
        The vector.
    """
    return (
        matrix[0] * x + matrix[1] * y + matrix[2] * z,
        matrix[3] * x + matrix[4] * y + matrix[5] * z,
        matrix[6] * x + matrix[7] * y + matrix[8] * z,
    )


@inner
def write_inverse(a: Floats, inverse: Floats) -> None:
    """Write the inverse (9,) of a deformation gradient (9,), row by row, with a norm of at most MOST_BACK.

    It is 0 if the gradient is nearly singular: inverted cells don't determine directions.

    Parameters
    ----------
    a : Floats, shape (9,)
        The deformation gradient.
    inverse : Floats, shape (9,)
        Receives the inverse.
    """
    c0, c1, c2 = a[4] * a[8] - a[5] * a[7], a[5] * a[6] - a[3] * a[8], a[3] * a[7] - a[4] * a[6]
    determinant = a[0] * c0 + a[1] * c1 + a[2] * c2
    if determinant < 0.05:
        inverse[:] = 0.0
        return
    inverse[0], inverse[3], inverse[6] = c0, c1, c2
    inverse[1], inverse[4], inverse[7] = a[2] * a[7] - a[1] * a[8], a[0] * a[8] - a[2] * a[6], a[1] * a[6] - a[0] * a[7]
    inverse[2], inverse[5], inverse[8] = a[1] * a[5] - a[2] * a[4], a[2] * a[3] - a[0] * a[5], a[0] * a[4] - a[1] * a[3]
    square = 0.0
    for c in range(9):
        inverse[c] /= determinant
        square += inverse[c] * inverse[c]
    if square > MOST_BACK * MOST_BACK:
        for c in range(9):
            inverse[c] *= MOST_BACK / math.sqrt(square)


@inner
def is_known(back: Floats) -> bool:
    """Return whether a matrix (9,) from displacements to those at rest is known; see write_inverse."""
    return back[0] != 0.0 or back[4] != 0.0 or back[8] != 0.0


@inner
def corner_at(cells: CutCells, cell: int, corner: int, position: Floats, axis: int) -> float:
    """Return a coordinate, m, of a corner of a cell, between its copies on both sides of a cut."""
    part = cells.part[cell, corner]
    first, second = position[cells.nodes[cell, corner], axis], position[cells.others[cell, corner], axis]
    return (1.0 - part) * first + part * second


@kernel
def place_in(cells: CutCells, cell: int, position: Floats, weight: Floats, axis: int) -> float:
    """Return a coordinate, m, of the place with given weights in a cell, between both sides of a cut.

    Parameters
    ----------
    cells : CutCells
        The cells.
    cell : int
        Index of the cell.
    position : Floats, shape (n, 3), m
        Positions of the nodes.
    weight : Floats, shape (4,) or more
        Barycentric weights.
    axis : int
        Index of the coordinate.
    """
    place = 0.0
    for corner in range(CORNERS):
        place += weight[corner] * corner_at(cells, cell, corner, position, axis)
    return place


@inner
def write_back(cells: CutCells, cell: int, position: Floats, scratch: Scratch, back: Floats) -> None:
    """Write the matrix from displacements in a cell to those at rest, between both sides of a cut.

    Parameters
    ----------
    cells : CutCells
        The cells.
    cell : int
        Index of the cell.
    position : Floats, shape (n, 3), m
        Positions of the nodes.
    scratch : Scratch
        Working memory; updated.
    back : Floats, shape (9,)
        Receives the matrix, row by row; see write_inverse.
    """
    stretch = scratch.blade_stretch
    stretch[:] = 0.0
    for corner in range(CORNERS):
        for axis in range(3):
            at = corner_at(cells, cell, corner, position, axis)
            for c in range(3):
                stretch[3 * axis + c] += at * cells.slope[cell, corner, c]
    write_inverse(stretch, back)


@kernel
def write_offset(world: World, number: int, weight: Floats) -> None:
    """Store the offset at which tissue holds a place of a blade, so that it enters without a jump.

    Parameters
    ----------
    world : World
        Model, state, shapes and working memory; updated.
    number : int
        Index of the place.
    weight : Floats, shape (4,) or more
        Barycentric weights of the place in its cell.
    """
    state, scratch, cells, blades = world.state, world.scratch, world.model.cut_cells, world.shapes.blades
    sample, body, away = state.blades[number], blades.body[number], scratch.blade_way
    rotation, origin = scratch.rotation[body], scratch.origin[body]
    for axis in range(3):
        away[axis] = place_in(cells, sample.cell, state.position, weight, axis) - origin[axis]
    for axis in range(3):
        back = rotation[axis] * away[0] + rotation[3 + axis] * away[1] + rotation[6 + axis] * away[2]
        sample.offset[axis] = back - blades.at[number, axis]


@kernel
def put_into(cells: CutCells, sample: BladeSample, weight: Floats, rest: Floats) -> None:
    """Move a place that is outside into the last cell of the search for it.

    Parameters
    ----------
    cells : CutCells
        The cells.
    sample : BladeSample
        The place; updated.
    weight : Floats, shape (4,) or more
        Its barycentric weights in that cell; updated.
    rest : Floats, shape (n, 3), m
        Nodes at rest.
    """
    cell, total = sample.cell, 0.0
    for corner in range(CORNERS):
        weight[corner] = max(weight[corner], 1e-3)
        total += weight[corner]
    for axis in range(3):
        place = 0.0
        for corner in range(CORNERS):
            place += weight[corner] / total * rest[cells.nodes[cell, corner], axis]
        sample.rest[axis] = place


@kernel
def forget_blades(state: State) -> None:
    """Take all blades out of the tissue.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    """
    for number in range(len(state.blades)):
        leave_tissue(state.blades[number])
        state.blades[number].load = 0.0
    for body in range(len(state.bodies)):
        state.bodies[body].cutting = False
