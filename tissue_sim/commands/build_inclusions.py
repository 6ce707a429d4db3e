"""The option --inclusion of `tissue_sim build`: what it says."""

from __future__ import annotations

from collections.abc import Sequence

from tissue_sim.errors import UserError
from tissue_sim.organ.inclusions import check_stiffness


def parse_inclusions(given: Sequence[str], label: str | None) -> dict[str, float]:
    """Return the stiffness factor of each label.

    given: values of the option, N:TIMES each; label: label of the organ itself. Returns factors by label. Raises
    UserError where a value isn't N:TIMES, or a label occurs twice.
    """
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
