"""Truth Cube: silicone with 343 beads, compressed in a CT (Kerdok et al. 2003).

Its outermost beads don't follow the plates exactly, so they are prescribed as measured; the 125 beads inside are
predicted. Young's modulus has no influence there.
"""

from __future__ import annotations

import csv
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from tissue_sim.array_types import Floats
from tissue_sim.bench.measured.body import Rate, built, calibrated, solve_prescribed_surface, timed
from tissue_sim.bench.measured.lattice import places, shell
from tissue_sim.bench.rows import report, until_stopped
from tissue_sim.calibration.fe_mesh import FeMesh, coordinates
from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.progress import Progress
from tissue_sim.calibration.solid import Material
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.model.simulation import Simulation

FILE = "truth_cube_uniaxial.csv"
STRAINS = (5.0, 12.5, 18.25)  # %, nominal
SIDE = 7  # beads
FINER = 2  # surface points between two beads, and one
# The silicone's modulus and density as in the file's source; its Poisson's ratio is 0.499, and cells allow up to 0.49.
MATERIAL = Material(youngs_modulus=15.3e3, poisson_ratio=0.49, density=980.0)
HELD = "z<0.05"  # for the calibration; here all of the surface is prescribed
LED, STILL = 300, 1000  # ticks
MOST_OFF, MOST_BEHIND = 0.5, 0.1  # mm on average at the last strain: error, and excess over finite elements'


class Compressed(NamedTuple):
    """Results of one strain: positions of the inner beads (5, 5, 5, 3) m, measured and predicted."""

    strain: float  # %
    measured: Floats
    elements: Floats
    model: Floats
    rate: Rate  # of the model
    seconds: float  # that the finite elements took

    @property
    def off(self) -> dict[str, Floats]:
        """Distances from the measured beads (5, 5, 5) mm."""
        return {
            name: 1e3 * np.linalg.norm(found - self.measured, axis=-1)
            for name, found in (("elements", self.elements), ("model", self.model))
        }


def read(path: Path) -> Floats:
    """Return beads (7, 7, 7, 4, 3) m by their place, along x, y and z, at rest and at each strain.

    Raises UserError for a file that is missing, or not the expected one.
    """
    beads = np.full((SIDE, SIDE, SIDE, 1 + len(STRAINS), 3), np.nan)
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            rows = [row for row in csv.reader(stream) if row and row[0].strip().isdigit()]
        for row in rows:
            i, j, k = (int(cell) - 1 for cell in row[:3])
            beads[i, j, SIDE - 1 - k] = 1e-3 * np.array([float(cell) for cell in row[3:15]]).reshape(-1, 3)
    except OSError as error:
        raise UserError(f"cannot read {path}: {error.strerror}; name its folder with --data") from None
    except (ValueError, IndexError):
        raise UserError(f"{path} is not the table of the Truth Cube's beads") from None
    if np.isnan(beads).any():
        raise UserError(f"{path} has no beads of the Truth Cube")
    return beads


def between(beads: Floats) -> Floats:
    """Return the lattice with further points between the beads (7, 7, 7, ...), by linear interpolation."""
    lattice = RegularGridInterpolator((np.arange(SIDE),) * 3, beads.reshape(SIDE, SIDE, SIDE, -1))
    fine = np.linspace(0.0, SIDE - 1.0, FINER * (SIDE - 1) + 1)
    found = lattice(np.stack(np.meshgrid(fine, fine, fine, indexing="ij"), axis=-1))
    return np.asarray(found).reshape(len(fine), len(fine), len(fine), *beads.shape[3:])


def measure(data: Path, folder: Path, progress: Progress) -> list[Compressed]:
    """Build the body between the outermost beads, calibrate it, and predict the inner ones at every strain.

    data: folder of the measured tables; folder: for the calibrated body and intermediate results.
    """
    beads = read(data / FILE)
    lattice = between(beads)
    index, triangles = shell((len(lattice),) * 3)
    outer = lattice[tuple(index.T)]
    surface, led = outer[:, 0], outer[:, 1:] - outer[:, :1]
    plain = built("truth_cube", surface, triangles, HELD, MATERIAL)
    organ = calibrated(plain, folder, progress)
    inner = beads[1:-1, 1:-1, 1:-1]
    at_rest = inner[..., 0, :].reshape(-1, 3)
    body = Body(plain)
    body.solid.held[np.unique(body.filling.facets)] = True
    in_elements = places(at_rest, body.solid.nodes, body.solid.elements)
    in_cells = places(at_rest, organ.rest_positions, organ.cell_nodes)
    simulation = Simulation(organ)
    found = []
    with until_stopped(), progress.stage("truth cube", len(STRAINS)) as done:
        for number, strain in enumerate(STRAINS):
            began = time.perf_counter()
            moved = solve_prescribed_surface(
                body.solid, on_facets(body.filling, surface[triangles], led[triangles, number])
            )
            seconds = time.perf_counter() - began
            simulation.prescribe(np.arange(organ.n_surface), surface + led[:, number], LED)
            rate = timed(simulation, LED + STILL)
            shape = inner.shape[:3]
            found.append(
                Compressed(
                    strain,
                    inner[..., number + 1, :],
                    (at_rest + in_elements @ moved).reshape(*shape, 3),
                    (in_cells @ simulation.positions).reshape(*shape, 3),
                    rate,
                    seconds,
                )
            )
            report(f"truth cube, {strain:g} %", f"error {found[-1].off['model'].mean():.3f} mm")
            done()
    return found


def on_facets(filling: FeMesh, corners: Floats, moved: Floats) -> Floats:
    """Return displacements (n, 3) m of a filling's surface nodes, linear on triangles (t, 3, 3) m; 0 inside."""
    found = np.zeros_like(filling.nodes)
    for column in filling.facets.T:
        fraction = coordinates(filling.nodes[column], corners[filling.triangle])
        found[column] = np.einsum("fc,fcx->fx", fraction, moved[filling.triangle])
    return found


def as_json(found: list[Compressed]) -> list[JsonObject]:
    """Return the figures of every strain."""
    return [
        {
            "strain_percent": one.strain,
            "elements_mean_mm": float(one.off["elements"].mean()),
            "elements_worst_mm": float(one.off["elements"].max()),
            "model_mean_mm": float(one.off["model"].mean()),
            "model_worst_mm": float(one.off["model"].max()),
            "tick_us": 1e6 * one.rate.median,
            "faults": one.rate.faults,
            "elements_s": one.seconds,
        }
        for one in found
    ]
