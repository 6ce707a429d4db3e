"""What an organ may measure: real ones pass, a leak doesn't."""

import numpy as np
import pytest

from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.image import Volume
from tissue_sim.organ.segmenting.anatomy import ORGANS, anatomy_of, measure_shape, misfits, narrowest


def solid(*balls, size=(80, 80, 160), bar=None):
    """Balls (centre, radius) mm on a 2 mm grid, joined by a bar of radius `bar` along z."""
    z, y, x = (
        2.0 * np.arange(n)[tuple(slice(None) if k == a else None for k in range(3))] for a, n in enumerate(size[::-1])
    )
    mask = np.zeros(size[::-1], dtype=bool)
    for (cx, cy, cz), radius in balls:
        mask |= (x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2 <= radius**2
    if bar:
        low, high = balls[0][0][2], balls[1][0][2]
        mask |= ((x - balls[0][0][0]) ** 2 + (y - balls[0][0][1]) ** 2 <= bar**2) & (z > low) & (z < high)
    return Volume(mask, np.full(3, 2.0), np.zeros(3), np.eye(3), "solid")


def test_measures_of_a_ball():
    shape = measure_shape(solid(((80, 80, 100), 40.0)))
    assert shape.volume == pytest.approx(4 / 3 * np.pi * 40**3 * 1e-3, rel=0.01)
    assert shape.longest == pytest.approx(80.0, abs=3.0)
    assert shape.solidity > 0.95


def test_bounds_name_what_is_wrong():
    ball = solid(((80, 80, 100), 60.0))
    assert any("volume of 90" in line and "at most 350 mL" not in line for line in misfits(ball, 30.0, "kidney"))
    assert any("mean of -25 HU (at least 0)" in line for line in misfits(ball, -25.0, "kidney"))
    assert misfits(ball, 50.0, None) == ()
    assert misfits(ball, 50.0, "any") == ()


def test_two_bodies_on_a_neck_are_a_leak_for_any_organ():
    pair = solid(((80, 80, 80), 40.0), ((80, 80, 200), 35.0), bar=8.0)
    assert 12.0 < 2.0 * narrowest(pair) < 20.0
    assert any("neck" in line for line in misfits(pair, 40.0, None))
    assert narrowest(solid(((80, 80, 80), 40.0), ((80, 80, 130), 35.0))) == 0.0


def test_an_unknown_organ_is_reported():
    with pytest.raises(UserError, match="--organ spline is unknown; choose one of kidney, liver"):
        anatomy_of("spline")


def test_bounds_are_ranges():
    for organ in ORGANS.values():
        for low, high in (organ.volume, organ.longest, organ.intensity):
            assert low < high
        assert 0.0 < organ.solidity < 1.0
