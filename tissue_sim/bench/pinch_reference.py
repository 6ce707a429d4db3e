"""Force of two spheres that squeeze the organ and don't slip, beside finite elements that are touched alike."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.bench import rows
from tissue_sim.bench.printing import Bound, aligned
from tissue_sim.bench.two_tools import SPHERE, Place, both, pinched, place
from tissue_sim.calibration.squeeze import squeezed, touchable
from tissue_sim.organ.organ import Organ

SHARES = (0.2, 0.4)  # of the organ's width
STEPS = 8  # for each share
FRICTION = 10.0  # at which nothing slips
UNDER = 0.014  # m from the axis, where a sphere may touch
MOST_OFF = 10.0  # %


class Compared(NamedTuple):
    """A pinch along one axis by a share of the width."""

    axis: int
    share: float
    ours: Floats  # (2, 3) N on the tools
    reference: Floats  # (2, 3) N
    least: float  # J of our cells
    reference_least: float  # det F
    settled: bool  # whether the reference was

    @property
    def off(self) -> float | None:
        """Difference of the forces on both tools, % of the reference's; None where that did not settle."""
        if not self.settled:
            return None
        return float(100.0 * np.linalg.norm(self.ours - self.reference) / np.linalg.norm(self.reference))


def measure(organ: Organ) -> list[Compared]:
    """Every axis by every share. Raises UserError as Body does."""
    found: list[Compared] = []
    with rows.until_stopped():
        for axis in rows.each(range(3), "finite elements, axes"):
            for one in compared(organ, axis):
                found.append(one)
                off = "not settled" if one.off is None else f"off {one.off:.1f} %"
                rows.tell(f"{'xyz'[axis]}, {100.0 * one.share:g} %", off)
    return found


def compared(organ: Organ, axis: int) -> list[Compared]:
    """One axis by every share."""
    where = place(organ, axis, SPHERE)
    found = []
    for share, reference in zip(SHARES, by_elements(organ, where, axis), strict=True):
        one = pinched(organ, "spheres", both(radius=SPHERE), axis, share, FRICTION)
        found.append(Compared(axis, share, one.forces, reference[0], one.least, reference[1], reference[2]))
    return found


def by_elements(organ: Organ, where: Place, axis: int) -> list[tuple[Floats, float, bool]]:
    """For every share the force on the tools (2, 3) N, the least det F and whether the body settled."""
    beside = np.delete(organ.surface_positions - where.start[0], axis, axis=1)
    solid, points = touchable(organ, np.linalg.norm(beside, axis=1) < UNDER)
    deepest = 0.5 * SHARES[-1] * where.width
    count = STEPS * len(SHARES)
    paths = np.array([where.at(deepest * (step + 1) / count) for step in range(count)])
    steps = squeezed(solid, points, paths, SPHERE)
    found = []
    for number in range(len(SHARES)):
        last = steps[min(STEPS * (number + 1), len(steps)) - 1]
        found.append((-last.forces, last.least_det, last.settled and len(steps) >= STEPS * (number + 1)))
    return found


def as_json(found: list[Compared]) -> dict[str, Any]:
    """All figures, and the bound."""
    table = [
        {
            "axis": "xyz"[one.axis],
            "share_percent": 100.0 * one.share,
            "force_n": one.ours.tolist(),
            "reference_n": one.reference.tolist(),
            "off_percent": one.off,
            "least_volume": one.least,
            "reference_least": one.reference_least,
        }
        for one in found
    ]
    off = [one.off for one in found if one.off is not None]
    worst = max(off, default=None) if len(off) == len(found) else None
    return {
        "rows": table,
        "bound": Bound("force of the spheres against finite elements", worst, MOST_OFF, "%").as_json(),
    }


def lines(rows: list[dict[str, Any]]) -> list[str]:
    """The figures as a table."""
    table = [["axis", "%", "on the tools N", "finite elements N", "off %", "least J", "det F"]]
    for row in rows:
        sizes = [" ".join(f"{np.linalg.norm(force):.2f}" for force in row[key]) for key in ("force_n", "reference_n")]
        least = [f"{row[key]:.2f}" for key in ("least_volume", "reference_least")]
        off = "-" if row["off_percent"] is None else f"{row['off_percent']:.1f}"
        table.append([row["axis"], f"{row['share_percent']:.0f}", *sizes, off, *least])
    return ["spheres that don't slip, held, beside quasi-static finite elements between the same:", *aligned(table)]
