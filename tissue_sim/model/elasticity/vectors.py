"""Gathering and scattering of four springs or cells at a time: node rows are transposed to rows of a block and back.

Compiled loops read nodes and add forces one coordinate at a time. These functions read and write all coordinates of a
node together, and transpose four nodes in registers. A node's position and force are adjacent, in one cache line. The
order of the strict IEEE arithmetic is fixed, so that no bit depends on the processor.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from tissue_sim.array_types import Floats
from tissue_sim.jit import kernel
from tissue_sim.model.data.blocks import BLOCK

WIDTH = 4  # doubles of a node's position, or of its force: x, y, z and padding
ROW = 2 * WIDTH  # of a node: its position and its force
_INDEX, _LANE = ir.IntType(64), ir.IntType(32)
_VECTOR = ir.VectorType(ir.DoubleType(), WIDTH)
_BYTES = 8


@intrinsic
def fused(typing_context, a, b, c):  # type: ignore[no-untyped-def]
    """Return a b + c, rounded once: one instruction instead of two, with the same bits on processors without it."""

    def make(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.fma(*arguments)

    return types.double(types.double, types.double, types.double), make


def _gatherer(corners: int) -> Any:
    """Return a kernel that reads the arms of springs or cells with a given number of nodes."""

    @intrinsic
    def gather(typing_context, rows, nodes, work):  # type: ignore[no-untyped-def]
        def make(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
            place, ends, room = _pointers(context, builder, signature, arguments)
            for first in range(0, BLOCK, WIDTH):
                at = [_row_of_each(builder, ends, corners, first + lane) for lane in range(WIDTH)]
                base = [_load(builder, place, row[0]) for row in at]
                for corner in range(1, corners):
                    arms = [builder.fsub(_load(builder, place, at[k][corner]), base[k]) for k in range(WIDTH)]
                    for axis, values in enumerate(_transposed(builder, arms)[:3]):
                        _store(builder, values, room, _at((3 * (corner - 1) + axis) * BLOCK + first))
            return context.get_dummy_value()

        return _signature(rows, nodes, work), make

    return gather


def _scatterer(corners: int) -> Any:
    """Return a kernel that adds the forces of springs or cells with a given number of nodes."""

    @intrinsic
    def scatter(typing_context, rows, nodes, work):  # type: ignore[no-untyped-def]
        def make(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
            target, ends, room = _pointers(context, builder, signature, arguments)
            zero = ir.Constant(_VECTOR, [0.0] * WIDTH)
            for first in range(0, BLOCK, WIDTH):
                pulls = []
                for arm in range(corners - 1):
                    axes = [_load(builder, room, _at((3 * arm + axis) * BLOCK + first)) for axis in range(3)]
                    pulls.append(_transposed(builder, [*axes, zero]))
                for lane in range(WIDTH):
                    row = _row_of_each(builder, ends, corners, first + lane)
                    force = [builder.add(start, _at(WIDTH)) for start in row]
                    total = pulls[0][lane]
                    for pull in pulls[1:]:
                        total = builder.fadd(total, pull[lane])
                    _store(builder, builder.fadd(_load(builder, target, force[0]), total), target, force[0])
                    for corner, pull in enumerate(pulls, 1):
                        moved = builder.fsub(_load(builder, target, force[corner]), pull[lane])
                        _store(builder, moved, target, force[corner])
            return context.get_dummy_value()

        return _signature(rows, nodes, work), make

    return scatter


# gather writes the vectors, m, from the first node of each spring or cell in a block, nodes (BLOCK, c), to its other
# nodes into 3 (c - 1) rows of BLOCK in work. scatter subtracts the values of these rows, N, from the other nodes and
# adds them to the first, so that the sum stays zero. rows has the shape (n, ROW).
gather_arms, scatter_arms = _gatherer(4), _scatterer(4)
gather_group, scatter_group = _gatherer(6), _scatterer(6)


@kernel
def put_node(position: Floats, node: int, rows: Floats) -> None:
    """Write a node's position, of (n, 3) m, to its row, and a force of zero.

    Parameters
    ----------
    position : Floats, shape (n, 3), m
        Positions of the nodes, surface first.
    node : int
        Index of the node.
    rows : Floats, shape (n, ROW)
        Rows of the nodes; updated.
    """
    x, y, z = position[node, 0], position[node, 1], position[node, 2]
    rows[node, 0], rows[node, 1], rows[node, 2], rows[node, 3] = x, y, z, 0.0
    rows[node, 4] = rows[node, 5] = rows[node, 6] = rows[node, 7] = 0.0


def _signature(*arguments: Any) -> Any:
    return types.void(*arguments)


def _pointers(context: Any, builder: Any, signature: Any, arguments: Any) -> list[Any]:
    """Return pointers to the arrays' values."""
    kinds: Callable[..., Any] = context.make_array
    return [
        kinds(kind)(context, builder, value=value).data for kind, value in zip(signature.args, arguments, strict=True)
    ]


def _at(index: int) -> Any:
    return ir.Constant(_INDEX, index)


def _row_of_each(builder: Any, ends: Any, corners: int, lane: int) -> list[Any]:
    """Return the offset of the row of each node of one spring or cell of a block."""
    nodes = [builder.load(builder.gep(ends, [_at(corners * lane + corner)])) for corner in range(corners)]
    return [builder.mul(builder.sext(node, _INDEX), _at(ROW)) for node in nodes]


def _load(builder: Any, base: Any, index: Any) -> Any:
    place = builder.bitcast(builder.gep(base, [index]), _VECTOR.as_pointer())
    return builder.load(place, align=_BYTES)


def _store(builder: Any, value: Any, base: Any, index: Any) -> None:
    place = builder.bitcast(builder.gep(base, [index]), _VECTOR.as_pointer())
    builder.store(value, place, align=_BYTES)


def _transposed(builder: Any, rows: list[Any]) -> list[Any]:
    """Return four vectors of four, columns for rows."""

    def mixed(a: Any, b: Any, *lanes: int) -> Any:
        return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_LANE, WIDTH), list(lanes)))

    even, odd = mixed(rows[0], rows[1], 0, 4, 2, 6), mixed(rows[0], rows[1], 1, 5, 3, 7)
    later_even, later_odd = mixed(rows[2], rows[3], 0, 4, 2, 6), mixed(rows[2], rows[3], 1, 5, 3, 7)
    return [
        mixed(even, later_even, 0, 1, 4, 5),
        mixed(odd, later_odd, 0, 1, 4, 5),
        mixed(even, later_even, 2, 3, 6, 7),
        mixed(odd, later_odd, 2, 3, 6, 7),
    ]
