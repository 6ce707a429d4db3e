"""Rows of `tissue_sim bench tradeoff`: the engines that are compared at one size."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, partial
from typing import NamedTuple, Unpack

import numpy as np
from numpy.typing import NDArray

from tissue_sim.bench.peers.chainmail import ChainMail
from tissue_sim.bench.peers.engine import Engine, Load
from tissue_sim.bench.peers.linear_fem import Compliance, LinearTetrahedra, QuadraticTetrahedra, compliance_table
from tissue_sim.bench.peers.mujoco import Mujoco
from tissue_sim.bench.peers.ours import Ours
from tissue_sim.bench.peers.tetrahedra import Tetrahedra, tetrahedra_of
from tissue_sim.bench.peers.xpbd import Xpbd, tuned
from tissue_sim.bench.simulation_options import SimulationOptions
from tissue_sim.bench.variants import BALANCED, Variants
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ

# Surface points up to which an engine is made: beyond them it takes minutes or many GB.
MOST_QUADRATIC, MOST_FLEX, MOST_XPBD, MOST_LINEAR = 2000, 1000, 2000, 4000

CALIBRATED = "cells"


class Row(NamedTuple):
    """Line of the table before it is measured; make() returns the engine and a remark on it."""

    name: str
    ours: bool
    points: int
    make: Callable[[], tuple[Engine, str]]


def rows_of(variants: Variants, tuning: Sequence[Load], *, own: bool, quick: bool) -> Iterator[Row]:
    """Yield the rows of one size.

    tuning: loads on which XPBD is tuned; own: whether it is the organ's own size, which has the paper's springs, too;
    quick: whether rows that differ only in their steps are left out.
    """
    plain, groups, cells = variants
    points, balanced = plain.n_surface, cells[BALANCED]
    thorough = own and not quick

    def ours(name: str, organ: Organ | str, finer: int = 1, **options: Unpack[SimulationOptions]) -> Row:
        return Row(name, True, points, partial(_ours, organ, finer, **options))

    for aim, made in cells.items():
        yield ours(CALIBRATED if aim == BALANCED else f"{CALIBRATED}, {aim}", made)
    if own:
        yield ours(f"{CALIBRATED}, modal region", balanced, local_region="modal")
        yield ours("surface", plain, model="surface")
        yield ours("volume", plain, model="volume")
        yield ours("hybrid, uncalibrated", plain, model="hybrid")
        yield ours("hybrid, by groups", groups, model="hybrid")
        yield ours("hybrid, by groups, frozen region", groups, model="hybrid", local_region="frozen")
    if thorough:
        yield ours(f"{CALIBRATED}, substeps x4", balanced, finer=4)
    shared = _Shared(plain, tuning, (1, 2) if thorough else (1,))

    def peer(name: str, make: Callable[..., tuple[Engine, str]], *arguments: object) -> Row:
        return Row(name, False, points, partial(make, *arguments))

    if points <= MOST_LINEAR:
        yield peer("linear FEM, linear tetrahedra", shared.linear)
        yield peer("ChainMail", shared.chainmail)
    if points <= MOST_QUADRATIC:
        yield peer("linear FEM, quadratic tetrahedra", shared.quadratic_tetrahedra)
        yield peer("compliance, all points", shared.compliance, False)
        yield peer("compliance, one patch", shared.compliance, True)
    if points <= MOST_FLEX:
        yield peer("MuJoCo flex, 20 ms step", shared.flex, 0.02)
        if thorough:
            yield peer("MuJoCo flex, 5 ms step", shared.flex, 0.005)
    if points <= MOST_XPBD:
        yield peer("pypbd, XPBD", shared.xpbd)


def _ours(organ: Organ | str, finer: int, **options: Unpack[SimulationOptions]) -> tuple[Engine, str]:
    """Return one of the package's models; finer: factor of its default number of substeps."""
    if isinstance(organ, str):
        raise UserError(organ)
    engine = Ours(organ, **options)
    if finer > 1:
        engine = Ours(organ, substeps=finer * engine.substeps, **options)
    fit = f"; fitted by {organ.provenance['fit']}" if "fit" in organ.provenance else ""
    return engine, f"{organ.n_interior} interior atoms, {engine.substeps} substeps{fit}"


class _Shared:
    """Peers of one size, and what they share, made on first use."""

    def __init__(self, organ: Organ, tuning: Sequence[Load], iterations: Sequence[int]) -> None:
        self.organ, self.tuning, self.iterations = organ, tuning, iterations

    @cached_property
    def mesh(self) -> Tetrahedra:
        return tetrahedra_of(self.organ)

    @cached_property
    def quadratic(self) -> QuadraticTetrahedra:
        return QuadraticTetrahedra(self.organ)

    @cached_property
    def table(self) -> NDArray[np.float32]:
        return compliance_table(self.quadratic.body)

    def linear(self) -> tuple[Engine, str]:
        return LinearTetrahedra(self.organ, self.mesh), f"{len(self.mesh.nodes)} nodes, factored in advance"

    def quadratic_tetrahedra(self) -> tuple[Engine, str]:
        return self.quadratic, f"{self.quadratic.body.n_nodes} nodes, factored in advance"

    def compliance(self, one_patch: bool) -> tuple[Engine, str]:
        engine = Compliance(self.organ, self.table, one_patch=one_patch)
        return engine, f"of that FEM, {self.table.nbytes / 2**20:.0f} MiB"

    def flex(self, step: float) -> tuple[Engine, str]:
        return Mujoco(self.organ, self.mesh, step), f"{len(self.mesh.nodes)} nodes, implicit, CG"

    def xpbd(self) -> tuple[Engine, str]:
        settings = tuned(self.organ, self.mesh, self.tuning, self.iterations)
        remark = f"{settings.iterations} iteration{'s' if settings.iterations > 1 else ''}"
        remark += f", stiffness {settings.stiffness:.2f} E, tuned on {len(self.tuning)} other loads"
        return Xpbd(self.organ, self.mesh, settings), remark

    def chainmail(self) -> tuple[Engine, str]:
        engine = ChainMail(self.organ, self.mesh.nodes, self.mesh.edges)
        return engine, "has no forces: the loaded nodes are moved to the reference's positions"
