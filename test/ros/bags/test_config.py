"""A bag's configuration: what it lacks, or has of another type, is named."""

import copy
import json
import math

import pytest

from helpers.paths import ROOT
from tissue_sim.ros.bags.config import check_config, read_config
from tissue_sim.ros.bags.differences import Described, differences
from tissue_sim.ros.bags.recording import Recording, tools_of

NEEDED = ["format", "package_version", "organ", "organ.name", "organ.digest", "parameters", "parameters.rate"]
NEEDED += ["parameters.model", "parameters.local_region", "parameters.left.radius", "parameters.left.length"]
NEEDED += ["parameters.left.shape", "parameters.left.mesh", "shape_gravity", "tools", "topics", "first"]


@pytest.fixture(scope="module")
def whole():
    return Recording.read(ROOT / "bags" / "poke").config


def placed(config, name):
    """A copy, the object in it that has a name, and its key there."""
    config = copy.deepcopy(config)
    where, _, key = name.partition(".")
    return (config, config[where], key) if key else (config, config, where)


def check(config):
    check_config(read_config(json.dumps(config)))


def test_that_of_a_recording_passes(whole):
    check(whole)
    for name in ("parameters.integrator", "parameters.return_target"):  # of a version before them
        config, owner, key = placed(whole, name)
        del owner[key]
        check(config)


def test_the_heat_of_a_tool_comes_back_and_older_bags_have_cold_tools(whole):
    config = copy.deepcopy(whole)
    heat = {"cautery_speed": 0.02, "cautery_stiffening": 4.0, "cautery_spread": 0.002}
    config["parameters"] |= {f"left.{name}": value for name, value in heat.items()}
    check(config)
    assert tools_of(config)[0].coagulation == (4.0, 0.002)
    assert tools_of(whole)[0].coagulation.stiffening == 1.0
    config["parameters"]["left.cautery_stiffening"] = "hot"
    with pytest.raises(ValueError, match=r"'parameters\.left\.cautery_stiffening' is of another type"):
        check(config)


@pytest.mark.parametrize("name", NEEDED)
def test_what_it_lacks_is_named(whole, name):
    config, owner, key = placed(whole, name)
    del owner[key]
    with pytest.raises(ValueError, match=f"has no '{name}'"):
        check(config)


@pytest.mark.parametrize("name", [*NEEDED, "topics.left/servo_cf", "first./left/servo_cf", "parameters.integrator"])
@pytest.mark.parametrize(
    "value", [None, True, [[]], [1, 2], 1e999, math.nan, "x" * 100_000, {"a": []}, 10**400], ids=lambda v: str(v)[:10]
)
def test_what_is_of_another_type_is_named(whole, name, value):
    config, owner, key = placed(whole, name)
    if isinstance(owner.get(key), dict) and isinstance(value, dict):
        return
    owner[key] = value
    with pytest.raises(ValueError, match=f"its configuration('s| lacks) '{name.partition('.')[0]}") as caught:
        check(config)
    assert len(str(caught.value)) < 200


def test_springs_that_follow_the_skeleton_are_refused(whole):
    config, owner, key = placed(whole, "parameters.return_target")
    owner[key] = "rest"
    check(config)
    owner[key] = "implied"
    with pytest.raises(ValueError, match="record it again"):
        check(config)


@pytest.mark.parametrize("rate", [0, -1.0])
def test_a_rate_that_is_none_is_named(whole, rate):
    config, owner, key = placed(whole, "parameters.rate")
    owner[key] = rate
    with pytest.raises(ValueError, match=r"'parameters\.rate' is of another type"):
        check(config)


@pytest.mark.parametrize("text", ["null", "[]", "3", "", "{", '{"format": "3"}'])
def test_what_is_no_configuration_is_refused(text):
    with pytest.raises(ValueError, match=r"."):
        read_config(text)


def test_the_same_tool_twice_is_refused(whole):
    with pytest.raises(ValueError, match="'tools' is of another type"):
        check({**whole, "tools": ["left", "left"]})


def test_strange_names_leave_lines_as_they_are(whole):
    config = copy.deepcopy(whole)
    config["parameters"]["frame_id"] = "a\n\x1b[31mb" + "x" * 1000
    for line in differences(Described.recorded(whole), Described.recorded(config, "in b")):
        assert line.isprintable()
        assert len(line) < 500
