"""Option --inclusion of `tissue_sim build`: its syntax, and the surfaces around the labels that it names."""

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
    """Return the stiffness factor of each label.

    Parameters
    ----------
    given : Sequence[str]
        Values of the option, N:TIMES each.
    label : str | None, optional
        Label of the organ itself.

    Returns
    -------
    dict[str, float]
        Factors by label.

    Raises
    ------
    UserError
        Where a value isn't N:TIMES, or a label occurs twice.
    """
    found: dict[str, float] = {}
    for text in given:
        part, _, times = text.rpartition(":")
        try:
            stiffness = float(times)
        except ValueError:
            stiffness, part = 0.0, ""
        if not part:
            raise UserError(f"--inclusion {text} is no label and factor; write it as 2:5")
        if part in found or part == label:
            raise UserError(f"--inclusion {text}: label {part} is given twice")
        check_stiffness(stiffness)
        found[part] = stiffness
    return found


def surrounded(parts: Sequence[Volume], wanted: Mapping[str, float], progress: Progress) -> tuple[Inclusion, ...]:
    """Return inclusions around what each label covers, in the order of their masks.

    Parameters
    ----------
    parts : Sequence[Volume]
        Masks of the labels.
    wanted : Mapping[str, float]
        Stiffness factors by label, in the same order.
    progress : Progress
        Receives the lines, the progress and the results of the stages.

    Returns
    -------
    tuple[Inclusion, ...]
        The inclusions.
    """
    from tissue_sim.organ.surfaces.inclusion_surface import surround

    found: list[Inclusion] = []
    for mask, (label, stiffness) in zip(parts, wanted.items(), strict=True):
        inclusions, specks = surround(replace(mask, name=f"label {label}"), stiffness)
        found += inclusions
        if specks:
            progress.say(f"left out {specks} specks of label {label}")
    return tuple(found)
