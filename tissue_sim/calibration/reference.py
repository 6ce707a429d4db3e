"""How good the finite-element reference itself is: the difference to a finer mesh, remembered."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tissue_sim.array_types import Floats
from tissue_sim.calibration.cases import strongest
from tissue_sim.calibration.fe_mesh import Grading
from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.judge import errors
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.surfaces.remesh import vertex_normals
from tissue_sim.store import remembered

BOUND = 1.0  # %, what the reference may be off
DEEP = 12e-3  # m, largest displacement of the loads that are drawn here
SMOOTH = 11e-3  # m, radius of a smooth patch
PATCHES = 4  # smooth and sharp in turn
SEED = 41
APART = 0.25  # of the organ's length, how far from the clamp loads are drawn


class ReferenceError(NamedTuple):
    """Relative L2 differences of the surface displacement between the reference's mesh and a finer one."""

    nodes: int
    finer_nodes: int
    linear: Floats  # (c,) % of each load
    neo_hookean: Floats  # (d,) % of the first d loads; nan where one did not settle

    @property
    def worst(self) -> float:
        """The largest difference, %; nan when a load did not settle."""
        return float(np.max(np.concatenate([self.linear, self.neo_hookean])))

    def __str__(self) -> str:
        """One line for reports."""
        parts = [f"linear {self.linear.mean():.2f} % mean, {self.linear.max():.2f} % worst"]
        if len(self.neo_hookean):
            parts.append(f"neo-Hookean {self.neo_hookean.mean():.2f} % mean, {self.neo_hookean.max():.2f} % worst")
        verdict = "" if self.worst <= BOUND else f" (above {BOUND:g} %)"
        verdict = " (a load did not settle)" if np.isnan(self.worst) else verdict
        return f"reference of {self.nodes} nodes against {self.finer_nodes}: {'; '.join(parts)}{verdict}"


def reference_error(
    organ: Organ,
    forces: ArrayLike | None = None,
    neo_hookean: int = 0,
    near: NDArray[np.int64] | None = None,
    grading: Grading | None = None,
) -> ReferenceError:
    """Difference between Body(organ, near, grading) and one on the next finer level.

    The finer mesh has elements of half the size at the clamp's edge and under the loads, and they grow more slowly
    from there. forces (c, n_surface, 3) N, by default standard_loads; the first `neo_hookean` of them are
    settled with the nonlinear body too, which takes minutes for each. Remembered for the same organ, level, loads
    and version of these sources.

    Raises UserError as Body does.
    """
    grading = Grading() if grading is None else grading
    loads = standard_loads(organ) if forces is None else np.asarray(forces, dtype=np.float64)
    if loads.ndim != 3 or loads.shape[1:] != (organ.n_surface, 3) or not loads.any(axis=(1, 2)).all():
        raise UserError(f"loads of shape {loads.shape} are not (c, {organ.n_surface}, 3), or one of them is zero")
    count = min(max(neo_hookean, 0), len(loads))

    def make() -> dict[str, NDArray]:
        loaded = np.flatnonzero(loads.any(axis=(0, 2)))
        answers = []
        for body in (Body(organ, near, grading), Body(organ, loaded, grading.finer())):
            settled = list(body.settle_many(loads[:count]))
            bent = np.full((count, organ.n_surface, 3), np.nan)
            for number, found in enumerate(settled):
                if found.converged:
                    bent[number] = found.displacement
            answers.append((body.n_nodes, body.settle_linear(loads), bent))
        (nodes, linear, coarse_bent), (finer_nodes, finer, finer_bent) = answers
        return {
            "nodes": np.array([nodes, finer_nodes]),
            "linear": 100.0 * errors(linear, finer),
            "neo_hookean": 100.0 * errors(coarse_bent, finer_bent),
        }

    found = remembered("reference", _key(organ, loads, count, near, grading), make)
    nodes, finer_nodes = (int(number) for number in found["nodes"])
    return ReferenceError(nodes, finer_nodes, found["linear"], found["neo_hookean"])


def standard_loads(organ: Organ) -> Floats:
    """Loads (4, n_surface, 3) N into the organ, each of which moves it by up to 12 mm by linear elasticity.

    None is stronger than the loads of a calibration (cases.strongest). Smooth patches, falling from the middle to 0 at
    11 mm, and sharp ones, on a node and its neighbours, in turn, at nodes drawn by a seed away from the clamp.
    """
    x, triangles = organ.surface_positions, organ.surface_triangles
    normal = vertex_normals(x, triangles)
    clear = np.linalg.norm(x[:, None] - x[organ.fixed][None], axis=2).min(axis=1) > APART * np.ptp(x, axis=0).max()
    middles = np.random.default_rng(SEED).choice(np.flatnonzero(clear), PATCHES, replace=False)
    loads = np.zeros((PATCHES, organ.n_surface, 3))
    for number, middle in enumerate(middles):
        if number % 2 == 0:
            distance = np.linalg.norm(x - x[middle], axis=1)
            share = np.where(normal @ normal[middle] > 0.0, np.maximum(0.0, 1.0 - (distance / SMOOTH) ** 2), 0.0)
        else:
            share = np.isin(np.arange(len(x)), triangles[(triangles == middle).any(axis=1)]).astype(np.float64)
        share[organ.fixed] = 0.0
        loads[number] = -(share / share.sum())[:, None] * normal[middle]
    depth = np.linalg.norm(Body(organ, grading=Grading(clamp=0)).settle_linear(loads), axis=2).max(axis=1)
    return loads * np.minimum(DEEP / depth, strongest(loads, np.ones(PATCHES), organ))[:, None, None]


def _key(organ: Organ, loads: Floats, count: int, near: NDArray[np.int64] | None, grading: Grading) -> str:
    """What the figure depends on: shape, clamp and material, not the springs."""
    digest = hashlib.sha256(repr((count, tuple(grading))).encode())
    for source in ("fe_mesh", "fem", "solid", "neo_hookean"):
        digest.update((Path(__file__).parent / f"{source}.py").read_bytes())
    tissue = np.array([organ.youngs_modulus, organ.poisson_ratio, organ.density])
    nodes = np.zeros(0, dtype=np.int64) if near is None else np.asarray(near, dtype=np.int64)
    for array in (organ.surface_positions, organ.surface_triangles, organ.fixed, tissue, loads, nodes):
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
