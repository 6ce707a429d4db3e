"""The benchmark of blades: its energies balance, and show a planted friction that nothing accounts for."""

import pytest

from helpers.slabs import slab
from tissue_sim.bench.cutting.blade import as_json, cut, place, text

TOUGHNESS, DEPTH = 20.0, 0.02


def test_a_blade_begins_on_the_surface_and_points_into_the_organ():
    start, into, _ = place(slab())
    assert start[2] == pytest.approx(0.03, abs=0.01)
    assert into[2] < -0.5


@pytest.mark.extended
def test_work_is_accounted_for_but_for_a_planted_friction():
    run = cut(slab(), TOUGHNESS, DEPTH)
    assert abs(run.rest) < 0.05
    assert run.opened > 1
    assert run.area > 5e-5
    assert cut(slab(), TOUGHNESS, DEPTH, friction=1500.0).rest > 0.1
    found = as_json([run])
    assert "20" in text(found)
    assert len(found["bounds"]) == 4
