"""Direct solver for finite elements: Cholesky by nested dissection of the mesh (George 1973; Duff & Reid 1983).

SciPy has no sparse Cholesky; its LU takes five times as long here, since it neither uses the symmetry nor multiplies
dense blocks of this size. Elements are halved again and again; unknowns inside a part are eliminated there as one dense
front, and the rest is passed on to the part above.

Dense blocks use SciPy's BLAS alone: NumPy has one of its own, and the threads of two that are called in turns wait for
each other, which made solutions for many loads ten times slower.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dgemm, dsyrk, dtrsm, sgemm, strsm
from scipy.linalg.lapack import dpotrf

from tissue_sim.array_types import Array, Floats, Ints, Longs
from tissue_sim.jit import kernel

BALANCE = 0.3  # least fraction of elements in a part
LEAF = 32  # elements that are not divided further

# Transposed, so that rows run along memory: of a front's (p + b) rows those inside (p, p), below (p, b), rest (b, b).
Pieces = tuple[Floats, Floats, Floats]


class Front(NamedTuple):
    """Part of the mesh: its inner unknowns are eliminated here, those on its boundary further up."""

    cells: Ints  # (e,) elements, of a leaf
    children: tuple[int, ...]  # earlier fronts
    inside: Longs  # (p,) unknowns
    boundary: Longs  # (b,) unknowns


class Factor(NamedTuple):
    """Cholesky factor of one front."""

    diagonal: Array  # (p, p) lower triangle
    below: Array  # (b, p)


class _Blas[T: np.floating](NamedTuple):
    """Routines of one precision: solution with a triangle, and product of matrices."""

    triangle: Callable[..., NDArray[T]]
    product: Callable[..., NDArray[T]]
    kind: type[T]


class NotPositive(Exception):
    """Error raised where the matrix has a direction of zero or negative stiffness."""


def dissect(elements: Ints, centres: Floats, held: NDArray[np.bool_], leaf: int = LEAF) -> list[Front]:
    """Return the order of elimination: fronts, children first.

    Every part is cut in two along that of its principal axes where the halves share the fewest nodes.

    Parameters
    ----------
    elements : Ints, shape (e, k)
        Node indices.
    centres : Floats, shape (e, 3)
        Centres of the elements.
    held : NDArray[np.bool_], shape (n, 3)
        Unknowns that are left out.
    leaf : int, optional
        Number of elements that are not divided further.

    Returns
    -------
    list[Front]
        The fronts.
    """
    count = np.bincount(elements.ravel(), minlength=len(held))  # elements around each node
    fronts: list[Front] = []
    free = ~held

    def unknowns(nodes: Longs) -> Longs:
        found: Longs = np.flatnonzero(free[nodes].ravel())
        return 3 * nodes[found // 3] + found % 3

    def build(cells: Longs) -> tuple[int, Longs, Longs]:
        """Return the number of the front, nodes on its boundary, and how many elements inside each has."""
        if len(cells) <= leaf:
            nodes, inner = np.unique(elements[cells], return_counts=True)
            children: tuple[int, ...] = ()
        else:
            one, other = _parts(elements, centres, cells)
            first, nodes_first, inner_first = build(one)
            second, nodes_second, inner_second = build(other)
            children = (first, second)
            nodes, where = np.unique(np.concatenate([nodes_first, nodes_second]), return_inverse=True)
            inner = np.bincount(where, np.concatenate([inner_first, inner_second])).astype(np.int64)
        whole = inner == count[nodes]
        undivided = cells.astype(np.int32) if not children else np.zeros(0, dtype=np.int32)
        fronts.append(Front(undivided, children, unknowns(nodes[whole]), unknowns(nodes[~whole])))
        return len(fronts) - 1, nodes[~whole], inner[~whole]

    build(np.arange(len(elements)))
    return fronts


def _parts(elements: Ints, centres: Floats, cells: Longs) -> tuple[Longs, Longs]:
    """Return two parts of a set of elements, neither of them small, that share few nodes."""
    x = centres[cells] - centres[cells].mean(axis=0)
    nodes, where = np.unique(elements[cells], return_inverse=True)
    where = where.reshape(len(cells), -1)
    size = len(cells)
    least = max(1, int(BALANCE * size))
    best: tuple[int, Longs, int] | None = None
    for axis in np.linalg.eigh(x.T @ x)[1].T:
        order = np.argsort(x @ axis, kind="stable")
        rank = np.empty(size, dtype=np.int64)
        rank[order] = np.arange(size)
        ranks = np.repeat(rank, where.shape[1])
        first, last = np.full(len(nodes), size), np.zeros(len(nodes), dtype=np.int64)
        np.minimum.at(first, where.ravel(), ranks)
        np.maximum.at(last, where.ravel(), ranks)
        # A node is shared by a cut before rank c when first < c <= last.
        shared = np.cumsum(np.bincount(first + 1, minlength=size + 2) - np.bincount(last + 1, minlength=size + 2))
        cut = least + int(np.argmin(shared[least : size - least + 1]))
        if best is None or shared[cut] < best[0]:
            best = int(shared[cut]), order, cut
    assert best is not None
    _, order, cut = best
    return np.sort(cells[order[:cut]]), np.sort(cells[order[cut:]])


@kernel
def _add(update: Floats, where: Longs, diagonal: Floats, below: Floats, rest: Floats) -> None:
    """Add the lower triangle of a symmetric matrix, transposed (k, k), to that of a front, given by its Pieces.

    where (k,): rows of the front, -1 for those left out.
    """
    p = len(diagonal)
    for j in range(len(where)):
        if where[j] < 0:
            continue
        for i in range(j, len(where)):
            if where[i] < 0:
                continue
            low, high = min(where[i], where[j]), max(where[i], where[j])
            if high < p:
                diagonal[low, high] += update[j, i]
            elif low < p:
                below[low, high - p] += update[j, i]
            else:
                rest[low - p, high - p] += update[j, i]


@kernel
def _add_each(matrices: Floats, where: Longs, diagonal: Floats, below: Floats, rest: Floats) -> None:
    """Add symmetric matrices (e, k, k) to a front; where (e, k): rows of the front."""
    for e in range(len(matrices)):
        _add(matrices[e], where[e], diagonal, below, rest)


def add_elements(matrices: Floats, elements: Ints, place: Longs, pieces: Pieces) -> None:
    """Add element matrices to a front.

    Parameters
    ----------
    matrices : Floats, shape (e, 3k, 3k), N/m
        Matrices of the elements.
    elements : Ints, shape (e, k)
        Node indices.
    place : Longs, shape (3n,)
        The front's row of each unknown.
    pieces : Pieces
        The front.
    """
    axes = (3 * elements[:, :, None].astype(np.int64) + np.arange(3)).reshape(len(elements), -1)
    _add_each(matrices, place[axes], *pieces)


class Cholesky:
    """Factor L L' of a symmetric matrix over the unknowns of n nodes.

    Parameters
    ----------
    fronts : list[Front]
        Order of elimination, of dissect.
    n : int
        Number of nodes.
    fill : Callable[[int, Longs, Pieces], None]
        Called with a front's number, the front's row of each of the 3n unknowns, and the front; adds the entries of the
        matrix that no other front adds.

    Raises
    ------
    NotPositive
        Where the matrix isn't positive definite.
    """

    def __init__(self, fronts: list[Front], n: int, fill: Callable[[int, Longs, Pieces], None]) -> None:
        self.fronts = fronts
        self._free = np.concatenate([front.inside for front in fronts])
        self.factors: list[Factor] = []
        updates: dict[int, Floats] = {}
        place = np.full(3 * n, -1, dtype=np.int64)
        for number, front in enumerate(fronts):
            p, b = len(front.inside), len(front.boundary)
            diagonal, below, rest = (np.zeros(shape, order="F") for shape in ((p, p), (b, p), (b, b)))
            pieces = diagonal.T, below.T, rest.T
            place[front.inside], place[front.boundary] = np.arange(p), np.arange(p, p + b)
            for child in front.children:
                _add(updates.pop(child).T, place[fronts[child].boundary], *pieces)
            fill(number, place, pieces)
            place[front.inside] = place[front.boundary] = -1
            if p:
                diagonal, failed = dpotrf(diagonal, lower=1, clean=0, overwrite_a=1)
                if failed:
                    raise NotPositive
            if p and b:
                below = dtrsm(1.0, diagonal, below, side=1, lower=1, trans_a=1, overwrite_b=1)
                rest = dsyrk(-1.0, below, beta=1.0, c=rest, lower=1, overwrite_c=1)
            if b:
                updates[number] = rest
            self.factors.append(Factor(diagonal, below))

    @property
    def size(self) -> int:
        """Number of stored values."""
        return sum(factor.diagonal.size + factor.below.size for factor in self.factors)

    @cached_property
    def _single(self) -> list[Factor]:
        single = (Factor(*(part.astype(np.float32, order="F") for part in factor)) for factor in self.factors)
        return list(single)

    def solve(self, right: Floats) -> Floats:
        """Return the solution; 0 at the held unknowns.

        Parameters
        ----------
        right : Floats, shape (3n, c)
            Right-hand sides.

        Returns
        -------
        Floats
            shape (3n, c)
        """
        return self._solve(right, self.factors, _Blas(dtrsm, dgemm, np.float64))

    def precondition(self, right: Floats) -> Floats:
        """Return the solution in single precision, in half the time.

        Parameters
        ----------
        right : Floats, shape (3n, c)
            Right-hand sides.

        Returns
        -------
        Floats
            shape (3n, c)
        """
        return self._solve(right, self._single, _Blas(strsm, sgemm, np.float32)).astype(np.float64)

    def _solve[T: np.floating](self, right: Floats, factors: list[Factor], blas: _Blas[T]) -> NDArray[T]:
        triangle, product, kind = blas
        work = np.zeros(np.shape(right), dtype=kind)
        work[self._free] = right[self._free]
        for front, (diagonal, below) in zip(self.fronts, factors, strict=True):
            if len(front.inside):
                found = triangle(1.0, diagonal, work[front.inside], lower=1)
                work[front.inside] = found
                if len(front.boundary):
                    work[front.boundary] -= product(1.0, below, found)
        for front, (diagonal, below) in zip(reversed(self.fronts), reversed(factors), strict=True):
            if len(front.inside):
                found = work[front.inside]
                if len(front.boundary):
                    found -= product(1.0, below, work[front.boundary], trans_a=1)
                work[front.inside] = triangle(1.0, diagonal, found, lower=1, trans_a=1)
        return work
