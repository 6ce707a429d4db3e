"""Command `tissue_sim solve`: displacements of an organ at equilibrium under given loads."""

from __future__ import annotations

import argparse
import time
import zipfile
from pathlib import Path

import numpy as np

from tissue_sim import progress
from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.interrupts import leaving
from tissue_sim.model.data.settings import INTEGRATORS, LOCAL_REGIONS
from tissue_sim.model.elasticity.assembly import MODEL_NAMES
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ
from tissue_sim.outputs import check_file


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("organ", metavar="ORGAN", help="organ file (.npz)")
    parser.add_argument(
        "--loads",
        required=True,
        metavar="LOADS.npz",
        help=".npz file with forces (L, n_surface, 3) in N, one set for each of L loads",
    )
    parser.add_argument(
        "--out",
        required=True,
        metavar="U.npz",
        help=".npz file to write: displacements (L, n_surface, 3) in m, seconds (L,) of computing, converged (L,)",
    )
    parser.add_argument(
        "--model",
        choices=MODEL_NAMES,
        default="auto",
        help="model variant (default: %(default)s, the one for which the organ was made)",
    )
    parser.add_argument(
        "--local-region", choices=LOCAL_REGIONS, default="off", help="part of the organ that moves under a small load"
    )
    parser.add_argument("--integrator", choices=INTEGRATORS, default="symplectic", help="time integration of the nodes")
    parser.add_argument("--rate", type=float, default=1000.0, help="ticks per second, Hz")
    parser.add_argument(
        "--tolerance",
        type=float,
        default=1e-3,
        help="residual force relative to the load at which a load counts as converged",
    )
    parser.add_argument(
        "--longest", type=float, default=5.0, help="simulated seconds after which a load counts as not converged"
    )


def run(args: argparse.Namespace) -> int:
    """Solve every load; return 0, even when some did not settle (which `converged` states)."""
    if not 0.0 < args.tolerance < 1.0:
        raise UserError(f"--tolerance {args.tolerance:g} is outside 0..1")
    if not 0.0 < args.longest <= 3600.0:
        raise UserError(f"--longest {args.longest:g} is outside 0..3600 s")
    check_file("--out", Path(args.out), ".npz", args.out)
    organ = Organ.load(args.organ)
    forces = read_loads(args.loads, organ.n_surface)
    simulation = Simulation(
        organ, model=args.model, rate=args.rate, local_region=args.local_region, integrator=args.integrator
    )
    simulation.step()  # compiles before the time is taken
    displacements = np.zeros_like(forces)
    seconds = np.zeros(len(forces))
    converged = np.zeros(len(forces), dtype=bool)
    with leaving("nothing was written"):
        for load in progress.steps(range(len(forces)), "loads"):
            start = time.perf_counter()
            displacements[load], converged[load] = simulation.settle(forces[load], args.tolerance, args.longest)
            seconds[load] = time.perf_counter() - start
    try:
        with open(args.out, "wb") as stream:  # numpy would add .npz to .NPZ
            np.savez_compressed(stream, displacements=displacements, seconds=seconds, converged=converged)
    except OSError as error:
        raise UserError(f"cannot write {args.out}: {error.strerror}") from None
    print(
        f"{len(forces)} loads, {int(converged.sum())} converged, {seconds.sum():.1f} s, largest displacement"
        f" {1e3 * np.linalg.norm(displacements, axis=2).max(initial=0.0):.2f} mm -> {args.out}"
    )
    return 0


def read_loads(path: str, n_surface: int) -> Floats:
    """Return the forces (L, n_surface, 3) N of a loads file; raises UserError naming what is wrong with it."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            if "forces" not in stored.files:
                raise UserError(f"{path} has no array 'forces' (L, {n_surface}, 3)")
            forces = np.asarray(stored["forces"], dtype=np.float64)
    except FileNotFoundError:
        raise UserError(f"loads file {path} does not exist") from None
    except (OSError, ValueError, TypeError, EOFError, AttributeError, zipfile.BadZipFile):
        raise UserError(f"{path} is not an .npz file of loads; write one with numpy.savez(path, forces=...)") from None
    if forces.ndim != 3 or forces.shape[1:] != (n_surface, 3):
        raise UserError(f"{path}: forces has shape {forces.shape}, expected (L, {n_surface}, 3) for this organ")
    if not np.all(np.isfinite(forces)):
        raise UserError(f"{path}: forces holds values that are not finite")
    return forces
