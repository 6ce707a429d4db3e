"""Who hears the node, and by which variable."""

from xml.etree import ElementTree

import pytest

from helpers.paths import ROOT
from helpers.ros.processes import HERE, READY
from helpers.ros.two_machines import ADDRESS, two_machines
from tissue_sim.ros.shared import dds
from tissue_sim.ros.shared.dds import CHOSEN_BY_HAND, LOCAL_PROFILE, PROFILE, PROFILE_VARIABLES, REACH

LOOK_AROUND = str(HERE / "look_around.py")


@pytest.mark.parametrize(
    ("set_by_user", "profile", "expected"),
    [
        ({}, LOCAL_PROFILE, "on this machine only"),
        ({REACH: ""}, LOCAL_PROFILE, "on this machine only"),
        ({REACH: "LOCALHOST"}, LOCAL_PROFILE, "on this machine only"),
        ({"ROS_LOCALHOST_ONLY": "1"}, LOCAL_PROFILE, "on this machine only"),
        ({REACH: "SUBNET"}, PROFILE, "in the whole subnet"),
        ({REACH: "OFF"}, PROFILE, "by no other program"),
        ({REACH: "SYSTEM_DEFAULT"}, PROFILE, "as the middleware is configured"),
        ({"ROS_LOCALHOST_ONLY": "0"}, PROFILE, "in the whole subnet"),
        ({"ROS_STATIC_PEERS": "10.0.0.2"}, PROFILE, "in the whole subnet and by ROS_STATIC_PEERS"),
        ({REACH: "LOCALHOST", "ROS_STATIC_PEERS": "10.0.0.2"}, PROFILE, "on this machine and by ROS_STATIC_PEERS"),
        ({"ROS_DISCOVERY_SERVER": "10.0.0.2:11811"}, PROFILE, "through ROS_DISCOVERY_SERVER"),
    ],
)
def test_the_range_is_narrowed_only_where_the_user_says_nothing(set_by_user, profile, expected):
    environment = dict(set_by_user)
    dds.prepare(environment)
    chosen = {REACH: "LOCALHOST"} if not any(set_by_user.values()) else set_by_user
    assert environment == chosen | dict.fromkeys(PROFILE_VARIABLES, str(ROOT / profile))
    assert f"discoverable {expected}" in dds.describe_discovery(environment)


def test_a_profile_or_transports_of_the_users_are_kept():
    for chosen in ({PROFILE_VARIABLES[1]: "/mine.xml"}, {CHOSEN_BY_HAND: "UDPv4"}):
        environment = dict(chosen)
        dds.prepare(environment)
        assert environment == chosen | {REACH: "LOCALHOST"}


def test_a_profile_that_a_parent_chose_for_another_range_is_chosen_anew():
    environment = {}
    dds.prepare(environment)
    environment[REACH] = "SUBNET"
    dds.prepare(environment)
    assert {environment[name] for name in PROFILE_VARIABLES} == {str(ROOT / PROFILE)}


def test_both_profiles_differ_in_the_interfaces_and_in_what_is_announced_alone():
    """On loopback every 0.2 s: programs of ROS's default range would discover the node too late there."""
    trees = [ElementTree.parse(ROOT / name).getroot() for name in (PROFILE, LOCAL_PROFILE)]
    lists = "{*}transport_descriptors/{*}transport_descriptor"
    for descriptor in trees[1].findall(lists):
        for found in descriptor.findall("{*}interfaceWhiteList"):
            assert [address.text for address in found] == ["127.0.0.1"]
            descriptor.remove(found)
    for builtin in trees[1].findall("{*}participant/{*}rtps/{*}builtin"):
        (period,) = builtin.findall("{*}discovery_config/{*}leaseAnnouncement")
        assert [part.text for part in period] == ["0", "200000000"]
        trees[1].find("{*}participant/{*}rtps").remove(builtin)
    plain, local = ([(item.tag, item.attrib, (item.text or "").strip()) for item in tree.iter()] for tree in trees)
    assert plain == local


@pytest.mark.extended
def test_a_node_is_heard_on_its_machine_alone_until_the_switch_is_set(tmp_path, monkeypatch):
    for name in (REACH, *PROFILE_VARIABLES):
        monkeypatch.delenv(name, raising=False)
    program = ("-m", "tissue_sim.ros.node.program", "--ros-args", "-p", "rate:=100.0")
    with two_machines(tmp_path) as (here, there, start):
        node = start(here, "node", *program)
        wide = start(here, "wide", *program, "-r", "__ns:=/wide", **{REACH: "SUBNET"})
        node.wait_for(READY)
        wide.wait_for(READY)
        assert (
            "discoverable on this machine only; ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET extends that to the subnet"
            in node.text()
        )
        assert "discoverable in the whole subnet" in wide.text()

        # ROS's own defaults on the same machine, which are those of rviz2 and ros2; the other machine; and the other
        # machine that names this one.
        beside = start(here, "beside", LOOK_AROUND, "/tissue_sim", "/wide/tissue_sim")
        far = start(there, "far", LOOK_AROUND, "/wide/tissue_sim")
        naming = start(there, "naming", LOOK_AROUND, "/wide/tissue_sim", ROS_STATIC_PEERS=ADDRESS)
        for process in (beside, far, naming):
            assert process.wait() == 0, process.text()
        assert " /tissue_sim " in beside.text()
        assert " /tissue_sim" not in far.text()
        assert " /tissue_sim" not in naming.text()
        assert node.stop() == 0, node.text()
        assert wide.stop() == 0, wide.text()
