"""What smoothing between poses costs and gives, by ticks."""

import pytest

from helpers.scenes import ball
from tissue_sim.bench import smoothing
from tissue_sim.contact.scene import Scene


@pytest.fixture(scope="module")
def found():
    return {(fraction, rate): smoothing.one(ball(2), fraction, rate) for fraction in (1.0, 0.0) for rate in (500, 50)}


def test_half_of_a_step_arrives_after_half_of_the_time_between_poses(found):
    """At 50 Hz a tool takes 20 ticks to a pose, or one: half of the force, a contact's way, is half of the way."""
    assert found[1.0, 50].half - found[0.0, 50].half == pytest.approx(9, abs=2)
    assert found[1.0, 500].half - found[0.0, 500].half <= 1
    assert found[0.0, 50].half <= 3


def test_without_it_the_force_goes_in_steps(found):
    """As many times larger as there are ticks between poses, less what the tissue's own inertia adds to both."""
    assert 3.0 < found[0.0, 50].step / found[1.0, 50].step < 40.0
    assert found[1.0, 500].step == pytest.approx(found[1.0, 50].step, rel=0.5)


def test_a_force_that_is_a_tenth_too_large_makes_steps_that_are(found, monkeypatch):
    plain = Scene.wrenches.fget
    monkeypatch.setattr(Scene, "wrenches", property(lambda scene: 1.1 * plain(scene)))
    wrong = smoothing.one(ball(2), 1.0, 500)
    assert wrong.step == pytest.approx(1.1 * found[1.0, 500].step, rel=1e-6)
    assert wrong.half == found[1.0, 500].half, "half of a larger step arrives as soon"


def test_the_table_has_every_figure(found):
    head, *rows = smoothing.table(smoothing.as_json(list(found.values())))
    assert len(rows) == len(found)
    assert all(len(row) == len(head) for row in rows)
    assert rows[0] == ["500", "1", str(found[1.0, 500].half), f"{1e3 * found[1.0, 500].step:.1f}"]
