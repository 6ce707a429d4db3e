"""Units of length as files spell them, and how long organs are."""

from __future__ import annotations

UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "um": 1e-6, "in": 0.0254}  # metres, by the names that options have
ORGAN_SIZE = (0.005, 1.0)  # m, longest side

_NANOMETRE = 1e-9
_SPELLINGS = {
    "µm": "um",  # the micro sign, and the Greek letter
    "μm": "um",
    "micron": "um",
    "inch": "in",
    "inche": "in",
    "nanometer": "nm",
    "nanometre": "nm",
    "micrometer": "um",
    "micrometre": "um",
    "millimeter": "mm",
    "millimetre": "mm",
    "centimeter": "cm",
    "centimetre": "cm",
    "meter": "m",
    "metre": "m",
}


def metres(unit: str) -> float | None:
    """Return the metres in a unit of length as a header spells it.

    Parameters
    ----------
    unit : str
        Name of the unit; singular or plural, in any case.

    Returns
    -------
    float | None
        Metres in the unit; None for an unknown unit.
    """
    name = unit.strip().lower()
    name = _SPELLINGS.get(name.removesuffix("s"), name)
    return (UNITS | {"nm": _NANOMETRE}).get(name)


def is_organ(size: float) -> bool:
    """Return whether an organ can be of this size.

    Parameters
    ----------
    size : float, m
        Longest side.

    Returns
    -------
    bool
        True within ORGAN_SIZE.
    """
    return ORGAN_SIZE[0] <= size <= ORGAN_SIZE[1]
