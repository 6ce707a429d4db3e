"""Presses that are fast, late or in one jump: none is lost, by ticks; and the benchmark finds those that are."""

import json
from typing import NamedTuple

import numpy as np
import pytest

from helpers.ros.processes import UNHURRIED
from helpers.scenes import kidney
from tissue_sim.bench.presses import (
    HELD_TICKS,
    Form,
    Motion,
    Pressed,
    as_json,
    at_place,
    forms,
    locations_on,
    motions,
    reference,
    text,
)
from tissue_sim.cli import main
from tissue_sim.contact.finder import ContactFinder
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.organ.winding import inside
from tissue_sim.progress import Task
from tissue_sim.ros.probes.press_probe import force_in_the_end

TOOLS = {
    "sphere, 2 mm": Tool("left", radius=0.002),
    "sphere, 5 mm": Tool("left", radius=0.005),
    "capsule, 3 mm": Tool("left", "capsule", radius=0.003, length=0.05),
    "gripper, 3 mm": Tool("left", "gripper", radius=0.003, length=0.02),
}
FAST = Motion(0.8, 500.0), Motion(5.0, 30.0), Motion(0.0, 500.0, 0.002), Motion(0.0, 500.0, 0.05)


class Ticks:
    """A hand that presses by ticks, as `presser.Presser` does by the clock; a contact set every 4 ms."""

    gap, state = 0.0, "fresh"

    def __init__(self, tool, friction=None):
        self.scene = Scene(kidney(), [tool], ticks_a_set=4)
        if friction is not None:
            self.scene.simulation.settings.friction = friction

    def press(self, poses, rate):
        self.scene.reset()
        for pose in poses:
            self.scene.move(0, pose[:3], pose[3:])
            for _ in range(round(1e3 / rate)):
                self.scene.step()
        self.last = pose
        return self.scene.wrenches[0, :3].copy()

    def hold_on(self, ticks):
        for _ in range(ticks):
            self.scene.move(0, self.last[:3], self.last[3:])
            self.scene.step()
        return self.scene.wrenches[0, :3].copy()


def pressed(name, tried, count=2, friction=None, radii=None):
    """Forces of presses; radii: how deep, of the tool's radius, instead of the benchmark's depth."""
    form = next(one for one in forms() if one.name == name)
    if radii is not None:
        form = Shallow(*form, radii)
    presser = Ticks(TOOLS[name], friction)
    found = []
    for place in locations_on(kidney(), count):
        found += at_place(presser, form, place, tried, Task("presses", None))
    return found


class Shallow(NamedTuple):
    """A form that is pressed in by some radii."""

    name: str
    parameters: tuple[str, ...]
    radius: float
    ahead: float
    radii: float

    @property
    def depth(self):
        return self.radii * self.radius


EXTENDED = ("sphere, 5 mm", "capsule, 3 mm", "gripper, 3 mm")  # larger than the small sphere


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.extended] if name in EXTENDED else []) for name in TOOLS]
)
def test_no_press_is_lost(name):
    found = pressed(name, FAST)
    assert len(found) >= len(FAST)
    figures = as_json(found)
    assert figures["all"]["lost"] == 0
    assert figures["all"]["median_off_percent"] < 10.0


def test_friction_alone_remembers_how_a_tool_came():
    """Without it every press ends with the slow one's force; with it, a radius deep, nearly."""
    free = as_json(pressed("sphere, 5 mm", FAST[::3], count=1, friction=0.0))
    assert free["all"]["worst_off_percent"] < 1.0
    held = as_json(pressed("sphere, 5 mm", FAST[::3], count=1, radii=1.0))
    assert 0.5 < held["all"]["worst_off_percent"] < 5.0


def test_a_hand_that_falls_through_is_found(monkeypatch):
    """As without a proxy: sets that claim to reach everywhere, and nothing that puts a tool back."""
    find = ContactFinder.find

    def far_reaching(self, position, query):
        found = find(self, position, query)
        found.reach[:], found.n_points[:] = 1e3, 0
        return found

    monkeypatch.setattr(ContactFinder, "find", far_reaching)
    monkeypatch.setattr(ContactFinder, "_way_out", lambda *_: None)
    figures = as_json(pressed("sphere, 5 mm", FAST[-1:]))
    assert figures["all"]["lost"] > 0
    assert not figures["bounds"][0]["met"]


def one(force, slow=(1.0, 0.0, 0.0)):
    return Pressed("kidney", "sphere, 5 mm", "0.8 m/s, 500 Hz", np.array(slow), np.array(force))


def test_a_wrong_force_moves_the_figure():
    right = as_json([one((1.0, 0.02, 0.0))] * 3)
    assert all(bound["met"] for bound in right["bounds"])
    wrong = as_json([one((0.9, 0.0, 0.0))] * 3)
    assert wrong["all"]["median_off_percent"] == pytest.approx(10.0)
    assert [bound["met"] for bound in wrong["bounds"]] == [True, False]
    lost = as_json([one((1.0, 0.0, 0.0)), one((0.1, 0.0, 0.0))])
    assert lost["all"]["lost"] == 1
    assert [bound["met"] for bound in lost["bounds"]] == [False, True]
    assert "failed: kidney, sphere, 5 mm, 0.8 m/s, 500 Hz: 0.100 N instead of 1.000 N" in text(lost)


REPEATED = ((0.32, 0.79, 0.785), 0.79), ((0.79, 0.32, 0.79), 0.79), ((0.0, 0.0), 0.0)


@pytest.mark.parametrize(("sizes", "wanted"), REPEATED)
def test_a_slow_press_is_a_reference_when_another_repeats_it(sizes, wanted):
    presses = iter([np.array([0.0, 0.0, size]) for size in sizes])
    np.testing.assert_array_equal(reference(lambda: next(presses)), [0.0, 0.0, wanted])
    assert next(presses, None) is None


def test_slow_presses_that_never_agree_end():
    sizes = iter(range(1, 100))
    assert reference(lambda: np.array([0.0, 0.0, float(next(sizes) ** 2)]))[2] == 25.0


def test_the_force_is_that_of_the_end_however_few_wrenches_come():
    """A busy machine lets most of them go by: those of the way in are none of the end's."""
    way_in = [(0.01 * k, np.array([0.1, 0.0, 0.0])) for k in range(50)]
    held = [(0.6, np.array([0.9, 0.0, 0.0])), (0.63, np.array([1.1, 0.0, 0.0]))]
    np.testing.assert_allclose(force_in_the_end([*way_in, *held]), [1.0, 0.0, 0.0])
    np.testing.assert_array_equal(force_in_the_end([]), 0.0)


@pytest.mark.parametrize("motion", motions(), ids=lambda motion: motion.name)
def test_each_motion_ends_deep_and_stays_there(motion):
    depths = np.array(list(motion.depths(0.012)))
    assert np.all(depths[-round(0.3 * motion.rate) :] == 0.012)
    steps = np.diff(depths)
    most = motion.jump or motion.speed / motion.rate
    assert steps.max() <= most * (1.0 + 1e-9)
    if motion.jump:
        assert steps.max() == pytest.approx(motion.jump)


def test_places_are_anywhere_on_the_surface_and_ways_lead_in():
    organ = kidney()
    for place in locations_on(organ, 20):
        form = Form("", (), 0.005, 0.005)
        np.testing.assert_allclose(place.pose(form, 0.0)[:3], place.point - 0.005 * place.direction)
        within = [place.point + depth * place.direction for depth in (-1e-4, 1e-4)]
        assert inside(np.array(within), organ.rest_positions, organ.surface_triangles).tolist() == [False, True]


class Starved:
    """A presser whose loop gets no time while it presses, and then does the ticks that are waited for."""

    gap, state = 0.0, "fresh"

    def __init__(self, in_the_end):
        self.in_the_end, self.pressed, self.held = in_the_end, 0, []

    def press(self, poses, rate):
        self.pressed += 1
        return np.array([1.0 if self.pressed <= 2 else 0.0, 0.0, 0.0])  # the slow ones have a force

    def hold_on(self, ticks):
        self.held.append(ticks)
        return self.in_the_end


@pytest.mark.parametrize(("in_the_end", "lost"), [((1.0, 0.0, 0.0), 0), ((0.0, 0.0, 0.0), len(FAST))])
def test_a_press_counts_as_lost_by_ticks_and_not_by_time(in_the_end, lost):
    presser = Starved(np.array(in_the_end))
    (place,) = locations_on(kidney(), 1)
    found = at_place(presser, forms()[2], place, FAST, Task("presses", None))
    assert presser.held == [HELD_TICKS] * len(FAST)
    assert sum(one.is_lost for one in found) == lost


@pytest.mark.extended
def test_short_run_with_a_real_node(tmp_path, monkeypatch):
    (form,) = forms()[2:3]
    patient = form._replace(parameters=(*form.parameters, UNHURRIED))
    monkeypatch.setattr("tissue_sim.bench.presses.forms", lambda: [patient])
    file = tmp_path / "presses.json"
    assert main(["bench", "presses", "--places", "1", "--json", str(file)]) == 0
    found = json.loads(file.read_text())
    assert found["all"]["presses"] >= len(motions())
    assert found["all"]["lost"] == 0, found["lost"]


def test_bad_use_is_refused(capsys):
    assert main(["bench", "presses", "--places", "0"]) == 2
    assert "--places 0 is outside 1..1000" in capsys.readouterr().err
