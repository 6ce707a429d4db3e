"""Units of length, however a header spells them."""

import pytest

from tissue_sim.organ.length_units import is_organ, metres


@pytest.mark.parametrize(
    ("spelling", "expected"),
    [
        ("mm", 1e-3),
        (" MM ", 1e-3),
        ("cm", 1e-2),
        ("m", 1.0),
        ("meter", 1.0),
        ("um", 1e-6),
        ("µm", 1e-6),  # the micro sign
        ("μm", 1e-6),  # the Greek letter
        ("microns", 1e-6),
        ("nm", 1e-9),
        ("inches", 0.0254),
        ("millimetres", 1e-3),
        ("pixel", None),
        ("s", None),
        ("", None),
    ],
)
def test_spellings(spelling, expected):
    assert metres(spelling) == expected


def test_sizes_of_organs():
    assert [is_organ(size) for size in (0.004, 0.005, 1.0, 1.1, float("nan"))] == [False, True, True, False, False]
