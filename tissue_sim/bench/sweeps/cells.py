"""Cells of the stability sweep: a value on one axis, for one integrator and one local region."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from tissue_sim.errors import UserError
from tissue_sim.model.data.settings import INTEGRATORS, LOCAL_REGIONS

SMALL_ORGAN = "ellipsoid"  # organ for --quick where no organ file is named
DEFAULT_RATE = 1000.0  # Hz
NEWTONS_A_UNIT = 2e-3  # the paper's forces have no unit; its 100 on one point is taken as 0.2 N


class Axis(NamedTuple):
    """Quantity that one panel of the map varies."""

    title: str
    values: tuple[float, ...]
    quick: tuple[float, ...]  # values with --quick
    load: str = "patch"  # one of loads.LOADS
    units: float = 100.0  # the load in the paper's units; 500 over ten points is its global force


_MULTIPLES = (0.1, 1.0, 5.0, 10.0, 20.0, 50.0, 100.0, 1000.0)
_QUICK_MULTIPLES = (1.0, 10.0, 1000.0)
_DEPTHS = (0.1, 0.3, 0.4, 0.5, 0.8, 1.0, 1.3)
_QUICK_DEPTHS = (0.1, 0.5, 1.3)

AXES: dict[str, Axis] = {
    "step": Axis(
        "substep / critical step",
        (0.1, 0.3, 0.9, 0.95, 1.05, 1.2, 2.0, 5.0, 10.0, 30.0),
        (0.1, 0.95, 1.2, 30.0),
    ),
    "stiffness": Axis(
        "stiffness scale (load in proportion)",
        (1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0, 1e3, 1e4),
        (1e-3, 1.0, 100.0),
    ),
    "mass_ratio": Axis("mass of the surface / of the atoms", (0.01, 0.1, 1.0, 4.0, 20.0, 100.0), (0.01, 4.0, 100.0)),
    "damping": Axis("nodal damping scale", (0.0, 0.01, 0.1, 1.0, 10.0, 100.0), (0.0, 1.0, 100.0)),
    "rate": Axis("tick rate, Hz", (100.0, 200.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0), (100.0, 1000.0, 4000.0)),
    "force_point": Axis("force on a point / paper's 100", _MULTIPLES, _QUICK_MULTIPLES, "point"),
    "force_patch": Axis("force on 19 nodes / paper's 100", _MULTIPLES, _QUICK_MULTIPLES, "patch"),
    "force_far": Axis("force on 19 nodes at the far end", _MULTIPLES, _QUICK_MULTIPLES, "far"),
    "force_pull": Axis("pull on 19 nodes / paper's 100", _MULTIPLES, _QUICK_MULTIPLES, "pull"),
    "force_ten": Axis("force on ten points / paper's 500", _MULTIPLES, _QUICK_MULTIPLES, "ten", 500.0),
    "depth_side": Axis("poke depth / thickness, from the side", _DEPTHS, _QUICK_DEPTHS, "tool"),
    "depth_far": Axis("poke depth / length, from the far end", _DEPTHS, _QUICK_DEPTHS, "tool_far"),
}
QUICK_AXES = [axis for axis in AXES if axis not in ("force_far", "force_pull", "depth_far")]  # without being named


@dataclass(frozen=True)
class Cell:
    """One trial, as it is handed to a worker.

    Attributes
    ----------
    axis : str
        Name of the varied quantity.
    value : float
        Its value.
    organ : str
        Organ file, or SMALL_ORGAN.
    quick : bool
        Whether times are shorter.
    """

    axis: str
    value: float
    integrator: str
    local_region: str
    organ: str
    quick: bool = False

    def at(self, axis: str, default: float) -> float:
        """Return the cell's value when it lies on that axis, else the default."""
        return self.value if self.axis == axis else default

    @property
    def judged(self) -> bool:
        """Whether it must not fail: an integrator meant for use, substeps from the critical step."""
        return self.integrator != "explicit" and self.axis != "step"

    @property
    def brief(self) -> bool:
        """Whether a tick takes hundreds of substeps, so that little time can be simulated."""
        return self.integrator == "explicit"

    @property
    def name(self) -> str:
        """Name in messages."""
        return f"{self.axis} {self.value:g}, {self.integrator}, region {self.local_region}"


def axes_named(names: str) -> list[str]:
    """Return the axes of a list with commas; `force` and `depth` stand for all of their kind, `all` for every axis.

    Raises UserError for an unknown one.
    """
    chosen: list[str] = []
    for name in names.split(","):
        found = [axis for axis in AXES if name in (axis, axis.split("_")[0], "all")]
        if not found:
            raise UserError(f"--axes: unknown axis '{name}'; choose from {', '.join(AXES)}, force, all")
        chosen += [axis for axis in found if axis not in chosen]
    return chosen


def cells_of(axes: list[str], organ: str, quick: bool, regions: Sequence[str] = LOCAL_REGIONS) -> list[Cell]:
    """Return every cell of the axes, in the order of the map; the slow explicit integrator has fewer values.

    axes: names of axes; organ: organ file, or SMALL_ORGAN; quick: whether times are shorter; regions: local regions to
    try.
    """
    return [
        Cell(axis, value, integrator, region, organ, quick)
        for axis in axes
        for integrator in INTEGRATORS
        for region in regions
        for value in values_of(AXES[axis], integrator, quick)
    ]


def values_of(axis: Axis, integrator: str, quick: bool) -> tuple[float, ...]:
    """Return the values of an axis; the explicit integrator has those of --quick, or every second of these."""
    if integrator == "explicit":
        return axis.quick[::2] if quick else axis.quick
    return axis.quick if quick else axis.values
