"""The option --inclusion of `tissue_sim build`: what it says, and the surfaces around the labels that it names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from tissue_sim.errors import UserError
from tissue_sim.organ.build_record import Progress
from tissue_sim.organ.inclusions import Inclusion, check_stiffness

if TYPE_CHECKING:
    from tissue_sim.organ.imaging.image import Volume


def parse_inclusions(given: Sequence[str], label: str | None = None) -> dict[str, float]:
    """How many times as stiff each label is. Raises UserError for what isn't N:TIMES, or a label that comes twice."""
    found: dict[str, float] = {}
    for text in given:
        part, _, times = text.rpartition(":")
        try:
            stiffness = float(times)
        except ValueError:
            stiffness, part = 0.0, ""
        if not part:
            raise UserError(f"--inclusion {text} is not a label and a factor; write it as 2:5")
        if part in found or part == label:
            raise UserError(f"--inclusion {text}: label {part} is given twice")
        check_stiffness(stiffness)
        found[part] = stiffness
    return found


def surrounded(parts: Sequence[Volume], wanted: Mapping[str, float], progress: Progress) -> tuple[Inclusion, ...]:
    """Inclusions around what each label covers, in the order of their masks."""
    from tissue_sim.organ.surfaces.inclusion_surface import surround

    found: list[Inclusion] = []
    for mask, (label, stiffness) in zip(parts, wanted.items(), strict=True):
        inclusions, specks = surround(replace(mask, name=f"label {label}"), stiffness)
        found += inclusions
        if specks:
            progress.say(f"omitted {specks} specks of label {label}")
    return tuple(found)
