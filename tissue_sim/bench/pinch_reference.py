"""Force of two spheres that compress the organ and don't slip, compared with finite elements under the same spheres.

The forces of the finite elements are stored, as they take minutes; `tissue_sim bench pinch --remake`
computes them again. Each pinch is settled on two meshes, and a third of their difference is added as a correction, as
in calibration.reference.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim import progress
from tissue_sim.array_types import Floats
from tissue_sim.bench import rows
from tissue_sim.bench.pinch_tools import CLEAR, SPHERE, Place, both, place
from tissue_sim.bench.printing import Bound, aligned
from tissue_sim.bench.processes import on_all_cores
from tissue_sim.calibration.fe_mesh import Grading
from tissue_sim.calibration.reference import LEFT
from tissue_sim.calibration.sphere_compression import CompressionStep, compressed, touchable
from tissue_sim.contact.scene import Scene
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.model.elasticity.cells import swelling
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_file

STORED = "config/references/pinch.json"  # of the kidney that ships
FRACTIONS = (0.2, 0.4)  # of the organ's width
STEP = 0.0014  # m, largest step of the finite elements: no longer than the elements where they are touched
UNDER = 0.012  # m from the axis, where a sphere may touch: up to 7 mm do
MESHES = (Grading(clamp=0), Grading(clamp=0, near=1, growth=1.6))  # the second is twice as fine where they touch
FRICTION = 10.0  # so high that nothing slips
SPEED = 0.005  # m/s: so slow that the organ isn't swung
HOLDING, LONGEST = 0.2, 3.0  # s between two checks of the force, and at most
STILL = 1e-3  # relative change of the force since the last check
MOST_OFF = 10.0  # %


class Compared(NamedTuple):
    """Results of a pinch along one axis by a fraction of the width."""

    axis: str
    fraction: float
    ours: Floats  # (t, 3) N on the tools that press tissue which may move
    reference: Floats | None  # (t, 3) N; None where finite elements did not settle
    least: float  # J of our cells
    reference_least: float | None  # det F

    @property
    def off(self) -> float | None:
        """Difference of the forces on the tools, % of the reference's; None where there is none."""
        if self.reference is None or not self.reference.any():
            return None
        return float(100.0 * np.linalg.norm(self.ours - self.reference) / np.linalg.norm(self.reference))


# finite elements -----------------------------------------------------------------------------------


def fits(organ: Organ) -> str:
    """Return a digest of what finite elements use of an organ: its surface, its clamp, its material, but no fit."""
    digest = hashlib.sha256()
    for array in (organ.surface_positions, organ.surface_triangles, organ.fixed, organ.inclusion_positions):
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(repr((organ.youngs_modulus, organ.poisson_ratio)).encode())
    return digest.hexdigest()


def stored() -> Path | None:
    """Return the path of the table that ships; None where it is missing."""
    return shipped_file(STORED)


def make(organ: Organ) -> JsonObject:
    """Squeeze finite elements along every axis by every fraction. Raises UserError as Body does."""
    start = time.monotonic()
    # Those that take longest come first: on the finer mesh, and along the axis on which spheres go deepest.
    axes = sorted(range(3), key=lambda axis: -place(organ, axis, SPHERE).width)
    runs = [(axis, mesh) for mesh in reversed(MESHES) for axis in axes]
    found = on_all_cores(compressed_between, [(organ, *run) for run in runs])
    settled = dict(zip(runs, progress.steps(found, "finite elements, axes on two meshes", len(runs)), strict=True))
    table = [row for axis in range(3) for row in rows_of(axis, *(settled[axis, mesh] for mesh in MESHES))]
    return {"organ": organ.name, "fits": fits(organ), "seconds": round(time.monotonic() - start), "rows": table}


def rows_of(axis: int, coarse: list[CompressionStep | None], fine: list[CompressionStep | None]) -> list[JsonObject]:
    """Return a row for every fraction: force on the tools (2, 3) N on both meshes, and the corrected one."""
    found_rows = []
    for fraction, one, other in zip(FRACTIONS, coarse, fine, strict=True):
        row: JsonObject = {"axis": "xyz"[axis], "share_percent": 100.0 * fraction, "force_n": None}
        if one is not None and other is not None:
            force = -other.forces - LEFT * (other.forces - one.forces)
            found = {"force_n": force, "coarse_n": -one.forces, "fine_n": -other.forces}
            row |= {name: np.round(value, 6).tolist() for name, value in found.items()}
            row["least_volume"] = round(other.least_det, 4)
        found_rows.append(row)
    return found_rows


def compressed_between(organ: Organ, axis: int, mesh: Grading) -> list[CompressionStep | None]:
    """Return the equilibria of finite elements along an axis at every fraction; None where they don't settle."""
    where = place(organ, axis, SPHERE)
    beside = np.delete(organ.surface_positions - where.start[0], axis, axis=1)
    solid, nodes = touchable(organ, np.linalg.norm(beside, axis=1) < UNDER, mesh)
    deep, last = [0.0], []
    for fraction in FRACTIONS:
        end = 0.5 * fraction * where.width
        deep += np.linspace(deep[-1], end, math.ceil((end - deep[-1]) / STEP) + 1)[1:].tolist()
        last.append(len(deep) - 2)
    steps = compressed(solid, nodes, np.array([where.at(one) for one in deep[1:]]), SPHERE)
    return [steps[number] if number < len(steps) and steps[number].settled else None for number in last]


def meets_clamp(organ: Organ, where: Place) -> NDArray[np.bool_]:
    """Return which of the two spheres (2,) meet held tissue, where finite elements have no force.

    A solid whose surface is held is like a wall.
    """
    ends = where.at(0.5 * FRACTIONS[-1] * where.width)
    away = organ.surface_positions[organ.fixed] - where.start[:, None]
    along = np.clip(
        np.einsum("tkx,tx->tk", away, where.directions), 0.0, np.linalg.norm(ends - where.start, axis=1)[:, None]
    )
    apart = np.linalg.norm(away - along[:, :, None] * where.directions[:, None], axis=2)
    return np.asarray((apart < SPHERE).any(axis=1))


def read(path: Path, organ: Organ) -> JsonObject:
    """Return a stored table. Raises UserError where the file is not a table, or was made for another organ."""
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        made_for, name = table["fits"], table["organ"]
        pinches = [(row["axis"], row["share_percent"], row["force_n"]) for row in table["rows"]]
    except OSError as error:
        raise UserError(f"cannot read reference {path}: {error.strerror}; make it with --remake") from None
    except (ValueError, KeyError, TypeError):
        raise UserError(f"{path} is not a table of 'tissue_sim bench pinch'; make one with --remake") from None
    if made_for != fits(organ):
        raise UserError(
            f"reference {path} was made for organ '{name}' of another surface, clamp or material than '{organ.name}';"
            " make one with --remake"
        )
    if [row[:2] for row in pinches] != [(axis, 100.0 * fraction) for axis in "xyz" for fraction in FRACTIONS]:
        raise UserError(f"reference {path} has other pinches than these; make it again with --remake")
    return dict(table)


# ours ----------------------------------------------------------------------------------------------


def measure(organ: Organ, table: JsonObject) -> list[Compared]:
    """Squeeze the organ as the table's rows were: slowly, until the force is constant."""
    found: list[Compared] = []
    with rows.until_stopped():
        for axis in rows.each(range(3), "slowly, axes"):
            wanted = [row for row in table["rows"] if row["axis"] == "xyz"[axis]]
            free = ~meets_clamp(organ, place(organ, axis, SPHERE))
            for row, (forces, least) in zip(wanted, slowly(organ, axis), strict=True):
                reference = None if row["force_n"] is None else np.array(row["force_n"])[free]
                one = Compared(
                    row["axis"], row["share_percent"], forces[free], reference, least, row.get("least_volume")
                )
                found.append(one)
                off = "not converged" if one.off is None else f"error {one.off:.1f} %"
                rows.report(f"{one.axis}, {one.fraction:g} %", off)
    return found


def slowly(organ: Organ, axis: int) -> list[tuple[Floats, float]]:
    """Return for every fraction the force on spheres (2, 3) N that don't slip, held, and the least J of a cell."""
    scene = Scene(organ, both(radius=SPHERE), ticks_a_set=4)
    scene.simulation.settings.friction = FRICTION
    where, tick, found = place(organ, axis, SPHERE), scene.simulation.settings.tick_time, []

    def go(deep: float) -> None:
        for tool, centre in enumerate(where.at(deep)):
            scene.move(tool, centre)
        scene.step()

    deep = -CLEAR
    for fraction in FRACTIONS:
        end = 0.5 * fraction * where.width
        for at in np.linspace(deep, end, max(2, round((end - deep) / (SPEED * tick)))):
            go(float(at))
        deep, force = end, np.full((2, 3), np.inf)
        for _ in range(round(LONGEST / HOLDING)):
            before = force
            for _ in range(round(HOLDING / tick)):
                go(deep)
            force = scene.wrenches[:, :3].copy()
            if np.linalg.norm(force - before) <= STILL * np.linalg.norm(force):
                break
        found.append((force, float(swelling(scene.simulation.model, scene.simulation.positions).min())))
    return found


# telling -------------------------------------------------------------------------------------------


def as_json(found: list[Compared]) -> JsonObject:
    """Return all figures, and the bound."""
    table = [
        {
            "axis": one.axis,
            "share_percent": one.fraction,
            "force_n": one.ours.tolist(),
            "reference_n": None if one.reference is None else one.reference.tolist(),
            "off_percent": one.off,
            "least_volume": one.least,
            "reference_least": one.reference_least,
        }
        for one in found
    ]
    off = [one.off for one in found if one.off is not None]
    worst = max(off) if off and len(off) == len(found) else None
    return {
        "rows": table,
        "bound": Bound("force of the spheres against finite elements", worst, MOST_OFF, "%").as_json(),
    }


def lines(rows: list[JsonObject]) -> list[str]:
    """Return the figures as a table."""
    table = [["axis", "%", "on the tools N", "finite elements N", "off %", "least J", "det F"]]
    for row in rows:
        sizes = [
            "-" if row[key] is None else " ".join(f"{np.linalg.norm(force):.3f}" for force in row[key])
            for key in ("force_n", "reference_n")
        ]
        least = ["-" if row[key] is None else f"{row[key]:.2f}" for key in ("least_volume", "reference_least")]
        off = "-" if row["off_percent"] is None else f"{row['off_percent']:.1f}"
        table.append([row["axis"], f"{row['share_percent']:.0f}", *sizes, off, *least])
    return [
        "spheres without slip, held, compared with quasi-static finite elements between the same spheres:",
        *aligned(table),
    ]
