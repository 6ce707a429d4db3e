"""Four springs or cells at a time: what their nodes have, in rows of four, turned into rows of a block and back.

The compiler reads nodes one coordinate at a time and adds forces likewise. These read and write a node at once and
transpose four of them in registers. Strict IEEE arithmetic in a fixed order: no bit depends on the processor.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from tissue_sim.model.blocks import BLOCK

WIDTH = 4  # doubles in a row of a node: x, y, z and nothing
_INDEX, _LANE = ir.IntType(64), ir.IntType(32)
_VECTOR = ir.VectorType(ir.DoubleType(), WIDTH)
_BYTES = 8


@intrinsic
def fused(typing_context, a, b, c):  # type: ignore[no-untyped-def]
    """a b + c, rounded once: one step of the processor in place of two, with the same bits on those that lack it."""

    def make(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.fma(*arguments)

    return types.double(types.double, types.double, types.double), make


@intrinsic
def gather_arms(typing_context, position, nodes, work):  # type: ignore[no-untyped-def]
    """From the first of a block's four nodes to the others, in nine rows of a block.

    position (n, WIDTH) m, nodes (BLOCK, 4), work (9 BLOCK,).
    """

    def make(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        place, corners, room = _pointers(context, builder, signature, arguments)
        for first in range(0, BLOCK, WIDTH):
            rows = [_rows(builder, corners, first + lane) for lane in range(WIDTH)]
            base = [_load(builder, place, row[0]) for row in rows]
            for corner in range(1, 4):
                arms = [builder.fsub(_load(builder, place, rows[k][corner]), base[k]) for k in range(WIDTH)]
                for axis, values in enumerate(_transposed(builder, arms)[:3]):
                    _store(builder, values, room, _at((3 * (corner - 1) + axis) * BLOCK + first))
        return context.get_dummy_value()

    return _signature(position, nodes, work), make


@intrinsic
def scatter_arms(typing_context, force, nodes, work):  # type: ignore[no-untyped-def]
    """Take what nine rows of a block hold from its last three nodes, and add it to the first: the sum stays zero.

    force (n, WIDTH) N, nodes (BLOCK, 4), work (9 BLOCK,).
    """

    def make(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        target, corners, room = _pointers(context, builder, signature, arguments)
        zero = ir.Constant(_VECTOR, [0.0] * WIDTH)
        for first in range(0, BLOCK, WIDTH):
            pulls = []
            for corner in range(3):
                axes = [_load(builder, room, _at((3 * corner + axis) * BLOCK + first)) for axis in range(3)]
                pulls.append(_transposed(builder, [*axes, zero]))
            for lane in range(WIDTH):
                row = _rows(builder, corners, first + lane)
                total = builder.fadd(builder.fadd(pulls[0][lane], pulls[1][lane]), pulls[2][lane])
                _store(builder, builder.fadd(_load(builder, target, row[0]), total), target, row[0])
                for corner in range(3):
                    moved = builder.fsub(_load(builder, target, row[corner + 1]), pulls[corner][lane])
                    _store(builder, moved, target, row[corner + 1])
        return context.get_dummy_value()

    return _signature(force, nodes, work), make


def _signature(*arguments: Any) -> Any:
    return types.void(*arguments)


def _pointers(context: Any, builder: Any, signature: Any, arguments: Any) -> list[Any]:
    """Where the arrays' values lie."""
    kinds: Callable[..., Any] = context.make_array
    return [
        kinds(kind)(context, builder, value=value).data for kind, value in zip(signature.args, arguments, strict=True)
    ]


def _at(index: int) -> Any:
    return ir.Constant(_INDEX, index)


def _rows(builder: Any, corners: Any, lane: int) -> list[Any]:
    """Where the rows of the four nodes of one of a block begin."""
    nodes = [builder.load(builder.gep(corners, [_at(4 * lane + corner)])) for corner in range(4)]
    return [builder.shl(builder.sext(node, _INDEX), _at(2)) for node in nodes]


def _load(builder: Any, base: Any, index: Any) -> Any:
    place = builder.bitcast(builder.gep(base, [index]), _VECTOR.as_pointer())
    return builder.load(place, align=_BYTES)


def _store(builder: Any, value: Any, base: Any, index: Any) -> None:
    place = builder.bitcast(builder.gep(base, [index]), _VECTOR.as_pointer())
    builder.store(value, place, align=_BYTES)


def _transposed(builder: Any, rows: list[Any]) -> list[Any]:
    """Four vectors of four, columns for rows."""

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
