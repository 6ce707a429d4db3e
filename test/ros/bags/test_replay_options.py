"""What `tissue_sim replay` prints and writes beside whether a bag repeats."""

import json
import sys
from xml.etree import ElementTree

import pytest
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from helpers.paths import ROOT
from helpers.planting import most_moved, with_one_stiffer
from tissue_sim.cli import main
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.ros.bags.recording import Recording

BAG = ROOT / "bags" / "poke"


@pytest.fixture(scope="module")
def organ():
    return Recording.read(BAG).organs[0].organ()


def copied(target, config=lambda found: found, force=lambda x, index: x):
    """The bag with another configuration, or another x-force by a message's index among the tools' wrenches."""
    store, wrenches = get_typestore(Stores.ROS2_JAZZY), 0
    with Reader(BAG) as reader, Writer(target, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        names = {one.topic: one.msgtype for one in reader.connections}
        connections = {name: writer.add_connection(name, kind, typestore=store) for name, kind in names.items()}
        for connection, stamp, raw in reader.messages():
            name, kind = connection.topic, connection.msgtype
            message = store.deserialize_cdr(raw, kind)
            if name.endswith("/config"):
                message.data = json.dumps(config(json.loads(message.data)))
            elif name.endswith("/servo_cf"):
                message.wrench.force.x = force(message.wrench.force.x, wrenches)
                wrenches += 1
            writer.write(connections[name], stamp, store.serialize_cdr(message, kind))
    return target


def test_another_organ_is_named_and_deviates_from_a_tick_on(tmp_path, capsys, organ):
    """One cell, or spring, a percent stiffer."""
    with_one_stiffer(organ, most_moved(Recording.read(BAG), organ)).save(tmp_path / "stiff.npz")
    report = tmp_path / "junit.xml"
    words = ["replay", str(BAG), "--organ", str(tmp_path / "stiff.npz"), "--junit", str(report)]
    assert main(words) == 1
    out = capsys.readouterr().out
    assert out.startswith(f"organ: recorded {organ.name} ({organ.digest()[:12]}), replayed with {organ.name} (")
    assert "FAILED: deviation above force 1e-06 N" in out
    tick = int(out.rpartition("from tick ")[2].split()[0])
    suite = ElementTree.parse(report).getroot()[0]
    cases = {case.get("name"): case for case in suite.iter("testcase")}
    assert cases.keys() == {"force", "torque", "position"}
    failures = [case.find("failure").get("message") for case in cases.values() if case.find("failure") is not None]
    assert min(int(text.split("from tick ")[1].split()[0]) for text in failures) == tick
    assert suite.get("failures") == str(len(failures))
    assert "organ: recorded" in suite.findtext("system-out")


def test_an_organ_of_other_nodes_is_refused_with_both_numbers(capsys, organ):
    other = Organ.load(shipped_organ())
    assert main(["replay", str(BAG), "--organ", str(shipped_organ())]) == 2
    error = capsys.readouterr().err
    assert f"an organ of {organ.n_nodes} nodes, '{other.name}' has {other.n_nodes}: replay it with an organ of" in error
    assert error.count("\n") == 1


def test_junit_of_a_bag_that_repeats(tmp_path):
    assert main(["replay", str(BAG), "--junit", str(tmp_path / "junit.xml")]) == 0
    root = ElementTree.parse(tmp_path / "junit.xml").getroot()
    assert (root.get("tests"), root.get("failures")) == ("3", "0")
    assert not list(root.iter("failure"))


def test_another_version_is_named(tmp_path, capsys):
    other = copied(tmp_path / "other", config=lambda found: found | {"package_version": "0.0.7"})
    assert main(["replay", str(other)]) == 0
    assert "package: recorded tissue_sim 0.0.7, replayed with tissue_sim " in capsys.readouterr().out


def test_two_bags_of_the_same_inputs(tmp_path, capsys):
    """The other one has another parameter, and one wrench that differs."""

    def changed(found):
        return found | {"parameters": found["parameters"] | {"friction": 0.25, "record_folder": "elsewhere"}}

    other = copied(tmp_path / "other", changed, lambda x, index: x + (0.5 if index == 500 else 0.0))
    assert main(["replay", str(BAG), "--against", str(other)]) == 1
    out = capsys.readouterr().out
    assert f"parameter friction: in {BAG} 0.6, in {other} 0.25\n" in out
    assert "record_folder" not in out
    assert "are in both bags, 0 ticks later in the other one" in out
    assert "largest deviation: force 0.5 N (tick " in out
    assert main(["replay", str(BAG), "--against", str(BAG)]) == 0


def test_a_picture_in_a_folder_or_a_file(tmp_path, capsys):
    assert main(["replay", str(BAG), "--plot", str(tmp_path / "pictures")]) == 0
    assert (tmp_path / "pictures" / f"{BAG.name}.png").read_bytes().startswith(b"\x89PNG")
    assert main(["replay", str(BAG), "--plot", str(tmp_path / "one.png")]) == 0
    assert (tmp_path / "one.png").is_file()
    assert "one.png: picture" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--junit", "/nowhere/a.xml"], "cannot write /nowhere/a.xml"),
        (["--plot", "/dev/null/pictures"], "cannot make the folder"),
        (["--against", "/nowhere"], "does not exist"),
    ],
)
def test_refusals_take_one_line(capsys, words, said):
    assert main(["replay", str(BAG), *words]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_a_picture_needs_matplotlib(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main(["replay", str(BAG), "--plot", "a.png"]) == 2
    assert "--plot needs matplotlib" in capsys.readouterr().err
