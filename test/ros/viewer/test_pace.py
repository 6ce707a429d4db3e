"""How fast pictures are sent to pages that are slow, or that nobody sees."""

from types import SimpleNamespace

import pytest

pytest.importorskip("viser")

from tissue_sim.rendering.organ_view import LATER
from tissue_sim.ros.viewer import pace as module
from tissue_sim.ros.viewer.pace import LOOKS, Pace


@pytest.fixture
def clock(monkeypatch):
    """Time that passes only while a page is asked."""
    now = SimpleNamespace(s=0.0)
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now.s))
    monkeypatch.setattr(module, "PROBE_EVERY", 1e6)  # a test looks by itself
    return now


def page(clock, takes, fails=None):
    """A page that answers after the given times, s, one look after the other."""
    each = iter(takes)

    def get_item(_, timeout):
        clock.s += next(each)
        if fails is not None:
            raise fails

    return SimpleNamespace(local_storage=SimpleNamespace(get_item=get_item))


def test_the_slowest_page_sets_the_pace_while_it_is_there(clock):
    """By how much its answers differ: the first one is as far away as the other."""
    pages = {1: page(clock, [0.12, 0.1] * 20), 2: page(clock, [0.1, 0.3, *[0.1] * 20])}
    pace = Pace(lambda: pages)
    pace.look()
    assert pace.picture_time == 0.0
    for _ in range(LOOKS):
        pace.look()
        assert pace.picture_time == pytest.approx(0.2 / LATER), "its slowest picture of late"
    pace.look()
    assert pace.picture_time == pytest.approx(0.02 / LATER)
    del pages[2]
    pace.look()
    assert pace.picture_time == pytest.approx(0.02 / LATER)
    pace.close()


def test_a_page_that_nobody_sees_sets_no_pace_and_one_without_a_storage_does(clock):
    pages = {1: page(clock, [0.0, 2.0], TimeoutError()), 2: page(clock, [0.05, 0.15], RuntimeError())}
    pace = Pace(lambda: pages)
    for _ in range(2):
        pace.look()
    assert pace.picture_time == pytest.approx(0.1 / LATER)
    pace.close()
