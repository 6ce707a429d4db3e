"""Mutations of bytes, numbers, texts and arrays; the first are those with which fuzzers find most.

Every function takes `draw` of Hypothesis, so that what it does can be repeated and made simpler. A failure names the
mutations that were drawn.
"""

import gzip
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from hypothesis import note
from hypothesis import strategies as st
from numpy.typing import NDArray

Draw = Callable[[st.SearchStrategy], Any]
BOMB = 2_000_000_000  # bytes that a bomb unpacks to
_BLOCK = 1 << 20


def some[T](draw: Draw, things: Sequence[T]) -> T:
    """One of several."""
    return draw(st.sampled_from(things))


def chance(draw: Draw, percent: int) -> bool:
    """Whether something of this probability happens."""
    return draw(st.integers(0, 99)) >= 100 - percent


def mutation[T: Callable](draw: Draw, mutations: Sequence[T]) -> T:
    """One of several functions, which a failure names."""
    chosen = some(draw, mutations)
    note(chosen.__name__.strip("_").replace("_", " "))
    return chosen


# numbers ------------------------------------------------------------------------------------------

HUGE = (10**9, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1)
ODD_COUNTS = (0, -1, 1, 2, -(2**31), *HUGE)
ODD_NUMBERS = ("nan", "inf", "-inf", "0", "-0", "-1", "1e-320", "1e300", "-1e300", "1e39", "1e400", "x", "", "0x10")
# Numbers that break arithmetic.
ODD_FLOATS = st.sampled_from((0.0, -1.0, 1e9, 1e39, 1e300, -1e300, np.inf, -np.inf, np.nan)) | st.floats()


def odd_count(draw: Draw, value: int) -> int:
    """A wrong count, in place of a right one."""
    return some(draw, (value - 1, value + 1, value * 2, value // 2, -value, *ODD_COUNTS))


# bytes --------------------------------------------------------------------------------------------


def _place(draw: Draw, data: bytearray) -> int:
    """One of its bytes, all equally likely: of a wide range Hypothesis mostly draws the first few hundred."""
    at = 256 * draw(st.integers(0, (len(data) - 1) // 256)) + draw(st.integers(0, 255))
    return min(at, len(data) - 1)


def _block(draw: Draw, data: bytearray) -> slice:
    at = _place(draw, data)
    return slice(at, min(at + draw(st.integers(1, 2 ** draw(st.integers(1, 13)))), len(data)))


def _flip_bits(draw: Draw, data: bytearray) -> None:
    for _ in range(draw(st.integers(1, 8))):
        data[_place(draw, data)] ^= 1 << draw(st.integers(0, 7))


def _change_the_head(draw: Draw, data: bytearray) -> None:
    for _ in range(draw(st.integers(1, 4))):
        data[draw(st.integers(0, min(len(data), 400) - 1))] = draw(st.integers(0, 255))


def _cut(draw: Draw, data: bytearray) -> None:
    del data[_place(draw, data) :]


def _leave_out(draw: Draw, data: bytearray) -> None:
    del data[_block(draw, data)]


def _double(draw: Draw, data: bytearray) -> None:
    block = _block(draw, data)
    data[block] = data[block] * 2


def _zero(draw: Draw, data: bytearray) -> None:
    block = _block(draw, data)
    data[block] = bytes(len(data[block]))


def _make_noise(draw: Draw, data: bytearray) -> None:
    block = _block(draw, data)
    data[block] = np.resize(list(draw(st.binary(min_size=1, max_size=64))), len(data[block])).astype(np.uint8).tobytes()


def _write_a_number(draw: Draw, data: bytearray) -> None:
    size, at = some(draw, (2, 4, 8)), _place(draw, data)
    value = some(draw, ODD_COUNTS) % 2 ** (8 * size)
    data[at : at + size] = value.to_bytes(size, some(draw, ("little", "big")))


def _append(draw: Draw, data: bytearray) -> None:
    data += draw(st.binary(min_size=1, max_size=64)) * draw(st.integers(1, 80))


def _swap_bytes(draw: Draw, data: bytearray) -> None:
    size = some(draw, (2, 4, 8))
    end = len(data) // size * size
    data[:end] = np.frombuffer(bytes(data[:end]), dtype=f"u{size}").byteswap().tobytes()


def _empty(_draw: Draw, data: bytearray) -> None:
    data.clear()


_OFTEN = (_flip_bits, _change_the_head, _cut, _write_a_number)
_EDITS = (*_OFTEN, *_OFTEN, _leave_out, _double, _zero, _make_noise)
_RARE = (_append, _swap_bytes, _empty)


def of_bytes(draw: Draw, data: bytes) -> bytes:
    """Bytes after one to three mutations."""
    made = bytearray(data)
    for _ in range(draw(st.integers(1, 3))):
        if made:
            mutation(draw, _RARE if chance(draw, 8) else _EDITS)(draw, made)
    return bytes(made)


def gz_bomb(start: bytes = b"") -> bytes:
    """A gzip stream that unpacks to `start` and then BOMB zeros."""
    block = gzip.compress(bytes(_BLOCK), 9)  # members follow each other
    return gzip.compress(start) + block * (BOMB // _BLOCK)


# text ---------------------------------------------------------------------------------------------


def of_text(draw: Draw, text: bytes) -> bytes:
    """A text with other numbers or lines."""
    lines = text.split(b"\n")
    for _ in range(draw(st.integers(1, 3))):
        # Counts are mostly in the head.
        most = min(len(lines), 15) if chance(draw, 60) else len(lines)
        mutation(draw, (_double_a_line, _drop_a_line, _change_a_word, _change_a_word))(
            draw, lines, draw(st.integers(0, most - 1))
        )
    return b"\n".join(lines)


def _double_a_line(_draw: Draw, lines: list[bytes], at: int) -> None:
    lines.insert(at, lines[at])


def _drop_a_line(_draw: Draw, lines: list[bytes], at: int) -> None:
    if len(lines) > 1:
        del lines[at]


def _change_a_word(draw: Draw, lines: list[bytes], at: int) -> None:
    words = lines[at].split(b" ")
    numbers = [k for k, word in enumerate(words) if word.strip(b"-+.0123456789e") == b"" and word]
    if numbers:
        words[some(draw, numbers)] = some(draw, [*map(str, ODD_COUNTS), *ODD_NUMBERS]).encode()
    else:
        words.append(some(draw, (b"1e9", b"\xff\xfe")))
    lines[at] = b" ".join(words)


# arrays -------------------------------------------------------------------------------------------


def of_array(draw: Draw, array: NDArray) -> NDArray:
    """An array with other values, another shape or type."""
    return mutation(draw, (_with_values, _with_values, _with_values, *_OF_ARRAYS))(draw, np.array(array))


def _with_values(draw: Draw, array: NDArray) -> NDArray:
    if array.size and array.dtype.kind in "fiu":
        at = draw(st.lists(st.integers(0, array.size - 1), min_size=1, max_size=3))
        array.reshape(-1)[at] = odd_value(draw, array)
    return array


def odd_value(draw: Draw, array: NDArray) -> float:
    """A number that doesn't belong into an array of floats or integers, of its type."""
    if array.dtype.kind == "f":
        with np.errstate(all="ignore"):
            return array.dtype.type(draw(ODD_FLOATS))
    limits = np.iinfo(array.dtype)
    return int(np.clip(odd_count(draw, int(array.max())), limits.min, limits.max))


def _scaled(draw: Draw, array: NDArray) -> NDArray:
    if array.dtype.kind != "f":
        return _with_values(draw, array)
    with np.errstate(all="ignore"):
        return array * some(draw, (1e-12, 1e-3, 1e3, 1e6, 1e12, -1.0))


def _shorter(draw: Draw, array: NDArray) -> NDArray:
    return array[: draw(st.integers(0, len(array)))] if array.ndim else _deeper(draw, array)


def _longer(draw: Draw, array: NDArray) -> NDArray:
    if not array.ndim or not array.size:
        return _deeper(draw, array)
    return np.concatenate([array, array[: draw(st.integers(1, len(array)))]])


def _of_another_type(draw: Draw, array: NDArray) -> NDArray:
    kind = some(draw, ("f2", "f4", "c16", "i8", "u1", ">f8", ">i4", "S8", "U4", "?", "M8[s]"))
    with np.errstate(all="ignore"):
        try:
            return array.astype(kind)
        except (TypeError, ValueError):
            return np.zeros(array.shape, dtype=kind)


def _shuffled(draw: Draw, array: NDArray) -> NDArray:
    return np.random.default_rng(draw(st.integers(0, 2**32))).permutation(array) if array.ndim else array


def _transposed(_draw: Draw, array: NDArray) -> NDArray:
    return np.asfortranarray(array.T)


def _emptied(_draw: Draw, array: NDArray) -> NDArray:
    return np.zeros((0, *array.shape[1:]), dtype=array.dtype)


def _deeper(_draw: Draw, array: NDArray) -> NDArray:
    return array.reshape((*array.shape, 1))


_OF_ARRAYS = (_scaled, _shorter, _longer, _of_another_type, _shuffled, _transposed, _emptied, _deeper)
