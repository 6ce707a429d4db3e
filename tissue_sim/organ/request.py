"""What an organ is asked for with, whatever it is made from."""

from __future__ import annotations

from dataclasses import dataclass, field

from tissue_sim.array_types import Ints
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.inclusions import Inclusion
from tissue_sim.organ.refinement import Refinement

MOST_ATOMS = 48
SPARSE = 0.4  # of the surface's mean edge; cells between atoms that are closer are slivers


@dataclass(frozen=True)
class Request:
    """Options with which an organ is built, the same for every kind of input.

    atoms: medial atoms, None for MOST_ATOMS, or fewer where those would lie closer than SPARSE of a surface edge, as in
    a body without a long axis. branches: `auto` or `none`, as skeleton.extract has it. organ: the one whose bounds a
    segmentation must keep, None for those of any organ; accept: build it although it is outside of them, or although
    the organ's volume differs from that of the input. interior_atoms: further atoms along the spokes. refinement: where
    points are added to the `points` of the even surface.
    """

    name: str
    points: int = 994
    atoms: int | None = None
    branches: str = "auto"
    interior_atoms: int = 0
    organ: str | None = None
    accept: bool = False
    fixed: str | Ints = "z<0.1"
    youngs_modulus: float = 10_000.0  # Pa
    poisson_ratio: float = 0.45
    density: float = 1060.0  # kg/m^3
    inclusions: tuple[Inclusion, ...] = ()
    refinement: Refinement = Refinement()
    provenance: JsonObject = field(default_factory=dict)
