"""Bags as NumPy arrays: names, units, times, and what a replay shows at the same ticks."""

import numpy as np
import pytest

import tissue_sim
from helpers.paths import ROOT
from tissue_sim.errors import UserError
from tissue_sim.model.data.settings import Settings
from tissue_sim.ros.bags.reading import Clock, Series, read_bag

BAGS = ROOT / "bags"


@pytest.fixture(scope="module")
def bag():
    return read_bag(BAGS / "gripper")


def test_everything_has_its_name_shape_and_unit(bag):
    units = {name: one.unit for name, one in bag.items()}
    assert units == {
        "left/position": "m",
        "left/quaternion": "",
        "left/angle": "rad",
        "left/force": "N",
        "left/torque": "N m",
        "small kidney/surface": "m",
    }
    for name, one in bag.items():
        assert one.name == name
        assert len(one) == len(one.ticks) == len(one.time) == len(one.values) > 0
        assert np.all(np.diff(one.ticks) > 0)
        assert np.all(np.isfinite(one.values))
        np.testing.assert_allclose(one.time, 1e-3 * (one.ticks - bag.first_tick), atol=1e-12)
    assert bag["left/angle"].values.shape == (len(bag["left/angle"]),)
    np.testing.assert_allclose(np.linalg.norm(bag["left/quaternion"].values, axis=1), 1.0)


def test_organ_and_tools_come_with_it(bag):
    organ = bag.organs["small kidney"]
    assert bag["small kidney/surface"].values.shape[1:] == (organ.n_surface, 3)
    first = bag["small kidney/surface"].values[0] - organ.surface_positions
    assert np.linalg.norm(first, axis=1).max() < 1e-6  # float32, at rest
    assert [tool.shape for tool in bag.tools] == ["gripper"]
    assert bag.parameters["rate"] == bag.rate == 1000.0
    assert bag.version == tissue_sim.__version__


def test_a_bag_prints_what_it_holds(bag):
    lines = repr(bag).splitlines()
    assert lines[0].startswith(f"<Bag {BAGS / 'gripper'}: 3.065 s from 1000 ticks a second")
    assert len(lines) == 1 + len(bag)
    assert lines[-1].split() == ["small", "kidney/surface", "(13,", "194,", "3)", "m>"]
    assert repr(bag["left/force"]).startswith("<Series left/force: (")


def test_forces_are_those_of_the_summary():
    """The highest force of the poke, as bags/summary.txt has it."""
    text = (BAGS / "summary.txt").read_text()
    block = text[text.index("poke") :]
    highest = np.linalg.norm(read_bag(BAGS / "poke")["left/force"].values, axis=1).max()
    assert f"{highest:.3f}" in block or f"{highest:.2f}" in block


def test_values_at_a_tick_are_the_newest():
    series = Series("a", "m", np.array([3, 5, 9]), np.zeros(3), np.array([1.0, 2.0, 3.0]))
    np.testing.assert_array_equal(series.at([2, 3, 4, 5, 8, 9, 100]), [np.nan, 1.0, 1.0, 2.0, 2.0, 3.0, 3.0])


def test_external_forces_are_there_where_some_were_sent():
    bag = read_bag(BAGS / "local_force")
    pushed = bag["left/external_force"]
    assert pushed.unit == "N"
    assert np.linalg.norm(pushed.values, axis=1).max() > 0.0


def clock_of(bag, rows, lengths):
    """A clock of the bag's ticks, had its settings been changed in these (tick, settings) rows."""
    organ = bag.recording.organs[0]
    inputs = np.zeros(len(rows), dtype=organ.journal["inputs"].dtype)
    inputs["tick"], inputs["settings"] = np.array(rows).T
    settings = {}
    for number, length in lengths.items():
        settings[number] = Settings.new()
        settings[number].tick_time = length
    changed = type("Organ", (), {"journal": {"inputs": inputs}, "settings": settings})
    return Clock(type("Recording", (), {"organs": [changed], "first_tick": 10}))


def test_time_follows_a_rate_that_changes(bag):
    clock = clock_of(bag, [(8, 1), (15, 1), (20, 2), (30, 2), (40, 3)], {1: 1e-3, 2: 2e-3, 3: 1e-3})
    ticks = [10, 11, 19, 20, 21, 39, 40, 41]
    np.testing.assert_allclose(clock(ticks), [0.0, 0.001, 0.009, 0.011, 0.013, 0.049, 0.050, 0.051])
    assert clock([9])[0] == pytest.approx(-0.001)


def test_a_folder_that_is_no_bag_is_refused_in_one_line(tmp_path):
    for path in (tmp_path / "nowhere", tmp_path):
        with pytest.raises(UserError) as refused:
            read_bag(path)
        assert str(path) in str(refused.value)
        assert "\n" not in str(refused.value)
