"""`tissue_sim bench region`: how far the local regions are off the whole model, patch by patch."""

from __future__ import annotations

import argparse
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse.linalg import splu
from tqdm import tqdm

from tissue_sim.array_types import Floats
from tissue_sim.bench.arguments import AS_BUILT_ORGAN, add_shared, check_shared
from tissue_sim.bench.organs import PATCH_NODES, node_normals, patch
from tissue_sim.bench.printing import Bound, aligned, bound_lines, emit, exit_code
from tissue_sim.errors import UserError
from tissue_sim.model.hops import hop_table
from tissue_sim.model.modes import free_axes, stiffness_matrix
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import AS_BUILT, shipped_organ

SMALL = 0.02  # N, under which the whole model is as good as linear
DENT = 3e-3  # m
CORE_HOPS = 2  # around the patch
WHOLE_LINEAR, CORE_LINEAR, WHOLE_NONLINEAR = 2.5, 4.0, 5.0  # %, bounds on the modal region
SEED = 5


class PatchErrors(NamedTuple):
    """One patch under one force; errors in percent, relative L2 of the settled surface or of the core."""

    patch: int
    force: float  # N
    dent: float  # m, of the whole model
    settled: bool
    modal_linear: float  # against the linear whole model
    modal_linear_core: float
    modal: float  # against the whole model
    modal_core: float
    frozen: float
    frozen_core: float
    linear: float  # the linear whole model against the whole model


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add_shared(parser, organ=AS_BUILT_ORGAN, check=True)
    parser.add_argument("--patches", type=int, default=6, help="how many patches, drawn at random")


def run(args: argparse.Namespace) -> int:
    """Settle every case in every region and print errors; returns 1 with --check when a bound is missed, else 0."""
    check_shared(args)
    if not 1 <= args.patches <= 1000:
        raise UserError(f"--patches {args.patches} is outside 1..1000")
    organ = Organ.load(args.organ or shipped_organ(AS_BUILT))
    cases = measure(organ, args.patches)
    found = as_json(cases)
    emit(found, text(organ, cases, found), args.json)
    return exit_code(found, check=args.check)


def measure(organ: Organ, patches: int) -> list[PatchErrors]:
    """For each patch a small force, the one that dents by 3 mm, and the one at which `auto` hands over."""
    whole = Simulation(organ)
    modal, frozen = (Simulation(organ, local_region=region) for region in ("modal", "frozen"))
    for simulation in (modal, frozen):
        simulation.settings.region_force = np.inf  # no handing over here
    model = whole.model
    free = free_axes(model)
    linear = splu(stiffness_matrix(model)[free][:, free].tocsc(), permc_spec="MMD_AT_PLUS_A")
    normals = node_normals(organ.surface_positions, organ.surface_triangles)
    hops = hop_table(model, organ.n_surface)
    far = hops[organ.fixed].min(axis=0) > 5 if len(organ.fixed) else np.ones(organ.n_surface, dtype=bool)
    centres = np.random.default_rng(SEED).choice(np.flatnonzero(far), patches)
    largest = whole.settings.region_force
    cases = []
    for number, centre in enumerate(tqdm(centres, disable=None, desc="region", unit="patch")):
        nodes = patch(organ, int(centre), PATCH_NODES)
        core = np.flatnonzero(hops[nodes].min(axis=0) <= CORE_HOPS)
        unit = np.zeros((organ.n_surface, 3))
        unit[nodes] = -normals[centre] / len(nodes)
        wanted = SMALL
        for step in range(4):
            force = wanted if step < 3 else largest
            forces = force * unit
            answer, settled = whole.settle(forces, 1e-4, 10.0)
            dent = float(np.linalg.norm(answer[centre]))
            wanted = force * DENT / dent  # twice, since the dent is not proportional to the force
            if step == 1:
                continue
            load = np.zeros(3 * organ.n_nodes)
            load[: 3 * organ.n_surface] = forces.ravel()
            straight = np.zeros_like(load)
            straight[free] = linear.solve(load[free])
            surface = straight[: 3 * organ.n_surface].reshape(-1, 3)
            by_modes, modes_settled = modal.settle(forces, 1e-4, 10.0)
            by_freezing, _ = frozen.settle(forces, 1e-4, 10.0)
            cases.append(
                PatchErrors(
                    number,
                    float(force),
                    dent,
                    bool(settled and modes_settled),
                    off(by_modes, surface),
                    off(by_modes[core], surface[core]),
                    off(by_modes, answer),
                    off(by_modes[core], answer[core]),
                    off(by_freezing, answer),
                    off(by_freezing[core], answer[core]),
                    off(surface, answer),
                )
            )
    return cases


def off(found: Floats, wanted: Floats) -> float:
    """Relative L2 error, %."""
    return float(100.0 * np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


def as_json(cases: list[PatchErrors]) -> dict[str, Any]:
    """The bounds on the worst errors of the modal region, and every case."""
    small = [case for case in cases if case.force == SMALL]
    bounds = [
        Bound("modal, whole against linear, small forces", max(case.modal_linear for case in small), WHOLE_LINEAR, "%"),
        Bound(
            "modal, core against linear, small forces", max(case.modal_linear_core for case in small), CORE_LINEAR, "%"
        ),
        Bound("modal, whole against nonlinear, all forces", max(case.modal for case in cases), WHOLE_NONLINEAR, "%"),
        Bound("cases that settle", 100.0 * float(np.mean([case.settled for case in cases])), 100.0, "%", least=True),
    ]
    return {"bounds": [bound.as_json() for bound in bounds], "cases": [case._asdict() for case in cases]}


def text(organ: Organ, cases: list[PatchErrors], found: dict[str, Any]) -> str:
    """The table and the bounds as text."""
    head = ["patch", "N", "dent mm", "modal/linear %", "core %", "modal %", "core %", "frozen %", "core %", "linear %"]
    rows = [head]
    for case in cases:
        errors = case[4:]
        numbers = [f"{error:.1f}" for error in errors]
        rows.append([str(case.patch), f"{case.force:.2f}", f"{1e3 * case.dent:.2f}", *numbers])
    first = f"organ '{organ.name}': settled surface, {PATCH_NODES}-node patches, relative L2"
    return "\n".join([first, *aligned(rows), "", *bound_lines(found["bounds"])])
