"""Random mutations of bytes, numbers and arrays; the first are those with which fuzzers find most."""

from __future__ import annotations

import gzip
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Rng = np.random.Generator
BOMB = 2_000_000_000  # bytes that a bomb unpacks to
_BLOCK = 1 << 20


def some[T](rng: Rng, things: Sequence[T]) -> T:
    """Return one of several things.

    Parameters
    ----------
    rng : Rng
        Random numbers.
    things : Sequence[T]
        The things.

    Returns
    -------
    T
        One of them.
    """
    return things[int(rng.integers(len(things)))]


# numbers ------------------------------------------------------------------------------------------

HUGE = (10**9, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1)
ODD_COUNTS = (0, -1, 1, 2, -(2**31), *HUGE)
ODD_NUMBERS = ("nan", "inf", "-inf", "0", "-0", "-1", "1e-320", "1e300", "-1e300", "1e39", "1e400", "x", "", "0x10")


def odd_count(rng: Rng, value: int) -> int:
    """Return a wrong count.

    Parameters
    ----------
    rng : Rng
        Random numbers.
    value : int
        The right count.

    Returns
    -------
    int
        The wrong one.
    """
    near = (value - 1, value + 1, value * 2, value // 2, -value)
    return int(some(rng, (*near, *ODD_COUNTS)))


def odd_float(rng: Rng) -> float:
    """Return a number that breaks arithmetic.

    Parameters
    ----------
    rng : Rng
        Random numbers.

    Returns
    -------
    float
        The number.
    """
    return some(rng, (np.nan, np.inf, -np.inf, 0.0, -0.0, -1.0, 5e-324, 1e-300, 1e300, -1e300, 1.7e308, 1e39, 1e9))


# bytes --------------------------------------------------------------------------------------------


def _flip(rng: Rng, data: bytearray) -> str:
    for _ in range(int(rng.integers(1, 9))):
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
    return "bits flipped"


def _early_flip(rng: Rng, data: bytearray) -> str:
    for _ in range(int(rng.integers(1, 5))):
        data[int(rng.integers(min(len(data), 400)))] = int(rng.integers(256))
    return "bytes of the head changed"


def _cut(rng: Rng, data: bytearray) -> str:
    del data[int(rng.integers(len(data))) :]
    return f"cut after {len(data)} bytes"


def _drop(rng: Rng, data: bytearray) -> str:
    at, size = _block(rng, data)
    del data[at : at + size]
    return f"{size} bytes left out at {at}"


def _double(rng: Rng, data: bytearray) -> str:
    at, size = _block(rng, data)
    data[at:at] = data[at : at + size]
    return f"{size} bytes doubled at {at}"


def _zero(rng: Rng, data: bytearray) -> str:
    at, size = _block(rng, data)
    data[at : at + size] = bytes(len(data[at : at + size]))
    return f"{size} zeros at {at}"


def _noise(rng: Rng, data: bytearray) -> str:
    at, size = _block(rng, data)
    data[at : at + size] = rng.bytes(len(data[at : at + size]))
    return f"{size} random bytes at {at}"


def _number(rng: Rng, data: bytearray) -> str:
    size = some(rng, (2, 4, 8))
    at = int(rng.integers(len(data)))
    value = some(rng, ODD_COUNTS) % 2 ** (8 * size)
    data[at : at + size] = value.to_bytes(size, some(rng, ("little", "big")))
    return f"a number {value} at {at}"


def _append(rng: Rng, data: bytearray) -> str:
    data += rng.bytes(int(rng.integers(1, 5000)))
    return "rubbish appended"


def _swap(rng: Rng, data: bytearray) -> str:
    size = some(rng, (2, 4, 8))
    end = len(data) // size * size
    data[:end] = np.frombuffer(bytes(data[:end]), dtype=f"u{size}").byteswap().tobytes()
    return f"every {size} bytes swapped"


def _nothing(_rng: Rng, data: bytearray) -> str:
    data.clear()
    return "emptied"


_OF_BYTES = (_flip, _flip, _early_flip, _early_flip, _cut, _cut, _drop, _double, _zero, _noise, _number, _number)
_RARE = (_append, _swap, _nothing)


def _block(rng: Rng, data: bytearray) -> tuple[int, int]:
    at = int(rng.integers(len(data)))
    return at, int(min(rng.integers(1, 2 ** int(rng.integers(1, 14))), len(data) - at))


def of_bytes(rng: Rng, data: bytes) -> tuple[bytes, str]:
    """Mutate bytes one to three times.

    Parameters
    ----------
    rng : Rng
        Random numbers.
    data : bytes
        The bytes.

    Returns
    -------
    tuple[bytes, str]
        The mutated bytes and a description.
    """
    made, told = bytearray(data), []
    for _ in range(int(rng.integers(1, 4))):
        if not made:
            break
        chosen: Callable[[Rng, bytearray], str] = some(rng, _RARE if rng.random() < 0.08 else _OF_BYTES)
        told.append(chosen(rng, made))
    return bytes(made), ", ".join(told)


def gz_bomb(start: bytes = b"") -> bytes:
    """Return a gzip stream that unpacks to `start` and then BOMB zeros.

    Parameters
    ----------
    start : bytes, optional
        First bytes.

    Returns
    -------
    bytes
        The stream.
    """
    block = gzip.compress(bytes(_BLOCK), 9)  # members follow each other
    return gzip.compress(start) + block * (BOMB // _BLOCK)


# text ---------------------------------------------------------------------------------------------


def of_text(rng: Rng, text: bytes) -> tuple[bytes, str]:
    """Change some numbers or lines of a text.

    Parameters
    ----------
    rng : Rng
        Random numbers.
    text : bytes
        The text.

    Returns
    -------
    tuple[bytes, str]
        The changed text and a description.
    """
    lines, told = text.split(b"\n"), []
    for _ in range(int(rng.integers(1, 4))):
        # Counts are mostly in the head.
        at = int(rng.integers(min(len(lines), 15) if rng.random() < 0.6 else len(lines)))
        told.append(_line(rng, lines, at))
    return b"\n".join(lines), ", ".join(told)


def _line(rng: Rng, lines: list[bytes], at: int) -> str:
    way = int(rng.integers(6))
    if way == 0:
        lines.insert(at, lines[at])
        return f"line {at + 1} doubled"
    if way == 1 and len(lines) > 1:
        del lines[at]
        return f"line {at + 1} left out"
    words = lines[at].split(b" ")
    numbers = [k for k, word in enumerate(words) if word.strip(b"-+.0123456789e") == b"" and word]
    if not numbers:
        words.append(b"\xff\xfe" if way == 2 else b"1e9")
        lines[at] = b" ".join(words)
        return f"a word more in line {at + 1}"
    k = some(rng, numbers)
    found = str(some(rng, ODD_COUNTS)) if way < 4 else some(rng, ODD_NUMBERS)
    words[k] = found.encode()
    lines[at] = b" ".join(words)
    return f"'{found}' in line {at + 1}"


# arrays -------------------------------------------------------------------------------------------


def of_array(rng: Rng, array: NDArray[Any]) -> tuple[NDArray[Any], str]:
    """Change an array's values, shape or type.

    Parameters
    ----------
    rng : Rng
        Random numbers.
    array : NDArray[Any]
        The array.

    Returns
    -------
    tuple[NDArray[Any], str]
        The changed array and a description.
    """
    made = np.array(array)
    way = some(
        rng, ("value", "value", "value", "shape", "shorter", "longer", "type", "order", "axes", "empty", "scale")
    )
    if way in ("value", "scale") and made.size and made.dtype.kind in "fiu":
        at = rng.integers(made.size, size=int(rng.integers(1, 4)))
        if made.dtype.kind == "f":
            value = odd_float(rng)
            if way == "scale":
                with np.errstate(all="ignore"):
                    return made * some(rng, (1e-12, 1e-3, 1e3, 1e6, 1e12, -1.0)), "scaled"
            made.reshape(-1)[at] = value
            return made, f"{value:g} in it"
        limits = np.iinfo(made.dtype)
        index = int(np.clip(odd_count(rng, int(made.max())), limits.min, limits.max))
        made.reshape(-1)[at] = index
        return made, f"{index} in it"
    if way == "shorter" and made.ndim:
        return made[: int(rng.integers(len(made) + 1))], "shorter"
    if way == "longer" and made.ndim and made.size:
        return np.concatenate([made, made[: int(rng.integers(1, len(made) + 1))]]), "longer"
    if way == "type":
        kind = some(rng, ("f2", "f4", "c16", "i8", "u1", ">f8", ">i4", "S8", "U4", "?", "M8[s]"))
        with np.errstate(all="ignore"):
            try:
                return made.astype(kind), f"as {kind}"
            except (TypeError, ValueError):
                return np.zeros(made.shape, dtype=kind), f"zeros as {kind}"
    if way == "order" and made.ndim:
        return rng.permutation(made), "shuffled"
    if way == "axes":
        return np.asfortranarray(made.T), "transposed"
    if way == "empty":
        return np.zeros((0, *made.shape[1:]), dtype=made.dtype), "empty"
    return made.reshape((*made.shape, 1)), "with an axis more"
