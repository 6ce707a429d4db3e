"""`tissue_sim view --layout`: what it prints names the topics that a node really has."""

import json
import re

import pytest
import yaml

from helpers.paths import CONFIG
from helpers.patience import wait_for
from helpers.ros.clients import Client
from helpers.ros.processes import Process, running_node
from tissue_sim.cli import main
from tissue_sim.ros.viewer import layout
from tissue_sim.ros.viewer.layout import LAYOUTS, fitted


@pytest.fixture
def printed(capsys):
    """What is printed of a layout for a node."""

    def one(kind, node):
        assert main(["view", "--layout", kind, "--node", node]) == 0
        return capsys.readouterr()

    return one


def topics_in(kind, text):
    if kind == "rviz":
        return {display["Topic"]["Value"] for display in yaml.safe_load(text)["Visualization Manager"]["Displays"]}
    panels = json.loads(text)["configById"]
    forces = {path["value"].partition(".")[0] for path in panels["Plot!force"]["paths"]}
    return forces | panels["3D!organ"]["topics"].keys()


@pytest.mark.parametrize("kind", LAYOUTS)
def test_for_the_default_node_it_is_the_file_that_ships(kind):
    shipped = (CONFIG.parent / LAYOUTS[kind]).read_text()
    load = yaml.safe_load if kind == "rviz" else json.loads
    assert load(fitted(kind, "tissue_sim")) == load(shipped)


@pytest.mark.parametrize("kind", LAYOUTS)
def test_of_a_scene_it_shows_every_organ(kind):
    text = fitted(kind, "ward/abdomen", organs=["liver", "spleen"])
    topics = topics_in(kind, text)
    assert {f"/ward/abdomen/{organ}/surface" for organ in ("liver", "spleen")} < topics
    assert "/ward/abdomen/markers" in topics
    assert "/ward/abdomen/surface" not in topics
    if kind == "rviz":
        displays = yaml.safe_load(text)["Visualization Manager"]["Displays"]
        assert [one["Name"] for one in displays] == ["Organ", "Surface of liver", "Surface of spleen", "Tools"]
        parts = {f"{organ}/{part}" for organ in ("liver", "spleen") for part in ("surface", "skeleton")}
        assert displays[0]["Namespaces"].keys() == parts | {"contacts"}


@pytest.fixture(scope="module")
def ward(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ward")
    parameters = "tools:=[probe]", "frame_id:=liver", "probe.servo_cf:=/desk/servo_cf"
    with running_node(folder, *parameters, remap=("__ns:=/ward",)) as node:
        yield node


@pytest.mark.extended
@pytest.mark.parametrize("kind", LAYOUTS)
def test_it_names_what_a_node_in_a_namespace_has(kind, ward, client, printed):
    text = printed(kind, "/ward/tissue_sim").out
    wanted = topics_in(kind, text)
    assert "/ward/tissue_sim/surface" in wanted
    assert ("/desk/servo_cf" in wanted) == (kind == "foxglove")
    wait_for(lambda: wanted <= {name for name, _ in client.node.get_topic_names_and_types()})
    frame = re.search(r'(?:Fixed Frame: |"followTf": ")(\w+)', text)[1]
    assert frame == "liver"
    assert "left" not in text
    if kind == "rviz":
        assert re.search(r"^ +probe: true$", text, re.MULTILINE)


@pytest.mark.extended
def test_without_an_answer_it_says_what_it_takes_for_granted(monkeypatch, printed):
    monkeypatch.setattr(layout, "WAIT", 0.3)
    said = printed("foxglove", "ward/nobody")
    assert said.err == "/ward/nobody doesn't answer: frame organ and tools left, right are assumed\n"
    assert "/ward/left/servo_cf" in topics_in("foxglove", said.out)
    assert "/ward/nobody/surface" in topics_in("foxglove", said.out)


@pytest.mark.extended
def test_programs_beside_the_node_are_in_its_namespace_under_names_of_their_own(ward, tmp_path):
    client = Client("/ward", markers=False)
    bridge = Process(["-m", "tissue_sim", "bridge", "--node", "ward/tissue_sim"], tmp_path / "bridge.log")
    try:
        bridge.wait_for("organ of")
        wait_for(lambda: "haptic_bridge_parameters" in client.node.get_node_names())
        spaces = {space for name, space in client.node.get_node_names_and_namespaces() if "bridge" in name}
        assert spaces == {"/ward"}
    finally:
        client.close()
        assert bridge.stop() == 0, bridge.text()
