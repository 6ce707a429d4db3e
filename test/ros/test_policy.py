"""The DDS Security policy: of sros2's form, and what real nodes do, no less and no more."""

import re
import subprocess
import sys
import time
from xml.etree import ElementTree

import pytest

from helpers.paths import CONFIG
from helpers.ros.processes import FAKE_TF, Process, running_node
from tissue_sim.ros import policy
from tissue_sim.ros.node.services.simulation_services import SERVICES
from tissue_sim.ros.shared.parameter_specs import NODE_SPECS, TOOL_SPECS

SHIPPED = (CONFIG / "sros2_policy.xml").read_text()
KINDS = ("publish", "subscribe", "reply", "request")
PATIENCE = 60.0  # s for a graph to be as it should

# sros2's policy format 0.2.0: for each element its attributes, those that must be there first, and its children.
NAME = r"(~|/)?[A-Za-z_][\w/]*"
FORM = {
    "policy": ({"version": "0.2.0"}, {}, ["enclaves"]),
    "enclaves": ({}, {}, ["enclave"]),
    "enclave": ({"path": r"/[\w/]+"}, {}, ["profiles"]),
    "profiles": ({}, {"type": ".*"}, ["profile"]),
    "profile": ({"ns": r"/[\w/]*", "node": r"\w+"}, {}, ["topics", "services", "actions"]),
    "topics": ({}, {"publish": "ALLOW|DENY", "subscribe": "ALLOW|DENY"}, ["topic"]),
    "services": ({}, {"reply": "ALLOW|DENY", "request": "ALLOW|DENY"}, ["service"]),
    "actions": ({}, {"call": "ALLOW|DENY", "execute": "ALLOW|DENY"}, ["action"]),
    "topic": ({}, {}, []),
    "service": ({}, {}, []),
    "action": ({}, {}, []),
}


def check_form(element):
    needed, others, children = FORM[element.tag]
    assert needed.keys() <= set(element.keys()), element.tag
    for name, value in element.items():
        assert re.fullmatch((needed | others).get(name, "$^"), value), (element.tag, name, value)
    assert bool(children) == bool(len(element)), element.tag
    if not children:
        assert re.fullmatch(NAME, element.text), element.text
    for child in element:
        assert child.tag in children, (element.tag, child.tag)
        check_form(child)


def defaults(**given):
    """The parameters of a node, by name."""
    values = {spec.name: spec.default for spec in NODE_SPECS} | {"tools": ["left", "right"], "organs": []} | given
    return {f"{tool}.{spec.name}": spec.default for tool in values["tools"] for spec in TOOL_SPECS} | values


def allowed(text):
    """What each enclave may do: sets of names by kind."""
    found = {}
    for enclave in ElementTree.fromstring(text.encode()).iter("enclave"):
        sets = found[enclave.get("path")] = {kind: set() for kind in KINDS}
        for kind in KINDS:
            for listed in enclave.iterfind(f".//*[@{kind}='ALLOW']"):
                sets[kind] |= {name.text for name in listed}
    return found


def seen(graph, *nodes):
    """What nodes do, as their graph has it."""
    ask = {
        "publish": graph.get_publisher_names_and_types_by_node,
        "subscribe": graph.get_subscriber_names_and_types_by_node,
        "reply": graph.get_service_names_and_types_by_node,
        "request": graph.get_client_names_and_types_by_node,
    }
    found = {kind: set() for kind in KINDS}
    known = set(graph.get_node_names_and_namespaces())
    for full in nodes:
        namespace, _, name = full.rpartition("/")
        if (name, namespace or "/") in known:
            for kind, of_node in ask.items():
                found[kind] |= {topic for topic, _ in of_node(name, namespace or "/")}
    return found


def check(graph, text, path, nodes, **unseen):
    """That an enclave allows what its nodes do and, but for what is named, nothing else."""
    wanted = {kind: names - unseen.get(kind, set()) for kind, names in allowed(text)[path].items()}
    end = time.monotonic() + PATIENCE
    while (found := seen(graph, *nodes)) != wanted and time.monotonic() < end:
        time.sleep(0.05)
    assert found == wanted


def test_the_form_is_that_of_sros2_and_others_are_reported():
    check_form(ElementTree.fromstring(SHIPPED.encode()))
    for wrong in ("<policy version='0.2.0'/>", SHIPPED.replace("0.2.0", "9"), SHIPPED.replace("ALLOW", "MAYBE", 1)):
        with pytest.raises(AssertionError):
            check_form(ElementTree.fromstring(wrong.encode()))


def test_sros2_itself_takes_it():
    """Where it is installed: apt's, that is."""
    sros2 = pytest.importorskip("sros2.policy")
    assert sros2.load_policy(CONFIG / "sros2_policy.xml") is not None


def test_the_one_that_ships_is_that_of_a_node_with_default_parameters():
    assert policy.fitted("tissue_sim", defaults()) == SHIPPED, "tissue_sim policy > config/sros2_policy.xml"


def test_names_follow_the_nodes_parameters():
    values = defaults(tools=["arm"]) | {"arm.measured_cp": "~/pose", "arm.servo_cf": "/MTML/servo_cf"}
    values |= {"arm.external_cf": "arm/push"}
    found = allowed(policy.fitted("ward/organ", values | {"arm.shape": "gripper"}))
    assert set(found) == {f"/ward/organ{name}" for name in ("", "/bridge", "/camera", "/drive", "/viewer")}
    inward = {"/ward/organ/pose", "/ward/arm/push", "/ward/arm/gripper/measured_js"}
    assert inward < found["/ward/organ"]["subscribe"]
    assert inward < found["/ward/organ/bridge"]["publish"]
    assert "/MTML/servo_cf" in found["/ward/organ"]["publish"] & found["/ward/organ/bridge"]["subscribe"]
    others = {name for sets in found.values() for names in sets.values() for name in names}
    assert not any("left" in name for name in others if not name.startswith("/ward/camera/"))  # that is an eye


def test_a_scene_has_the_topics_of_its_organs():
    found = allowed(policy.fitted("tissue_sim", defaults(organs=["liver", "spleen"])))
    shown = {
        f"/tissue_sim/{organ}/{topic}"
        for organ in ("liver", "spleen")
        for topic in ("inclusions", "mesh", "surface", "skeleton")
    }
    assert shown < found["/tissue_sim"]["publish"] & found["/tissue_sim/viewer"]["subscribe"]
    assert {"/tissue_sim/liver/markers", "/tissue_sim/markers"} < found["/tissue_sim"]["publish"]
    assert "/tissue_sim/mesh" not in found["/tissue_sim"]["publish"]
    assert "/tissue_sim/respiration" in found["/tissue_sim"]["subscribe"]


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    """The node that ships, with its default tools and names."""
    with running_node(tmp_path_factory.mktemp("node"), "rate:=100.0") as process:
        yield process


@pytest.mark.extended
def test_the_nodes_that_ship_do_what_the_policy_allows_and_nothing_else(node, tmp_path, graph):
    # tf and simulation_interfaces aren't among the wheels, and nobody has asked for the simulation's clock.
    here = {"/tf", "/tf_static"}
    others = {f"/tissue_sim/{name}" for name in SERVICES}
    check(graph, SHIPPED, "/tissue_sim", ["/tissue_sim"], publish=here, subscribe=here | {"/clock"}, reply=others)

    bridge = Process(["-m", "tissue_sim", "bridge", "--rate", "100"], tmp_path / "bridge.log")
    nodes = ("/haptic_bridge", "/haptic_bridge_parameters")
    check(graph, SHIPPED, "/tissue_sim/bridge", nodes)
    assert bridge.stop() == 0, bridge.text()


@pytest.mark.extended
def test_a_viewer_does_what_the_policy_allows_and_nothing_else(node, graph, open_page):
    pytest.importorskip("viser")
    nodes = ("/viewer", "/viewer_parameters", "/viewer_services")
    page = open_page("left", "right")
    poses = {"/left/measured_cp", "/right/measured_cp"}
    check(graph, SHIPPED, "/tissue_sim/viewer", nodes, publish=poses)
    assert page.wait(lambda: not page.poke._box.disabled)
    page.tick(True)
    assert page.wait(lambda: page.poke._tool.held)
    check(graph, SHIPPED, "/tissue_sim/viewer", nodes, publish=poses - {"/left/measured_cp"})
    page.tick(False)


@pytest.mark.extended
def test_a_camera_does_what_the_policy_allows_and_nothing_else(node, tmp_path, graph):
    pytest.importorskip("moderngl")
    camera = Process(["-m", "tissue_sim", "camera", "--width=64", "--height=48", "--nice=0"], tmp_path / "camera.log")
    pair = {name for name in allowed(SHIPPED)["/tissue_sim/camera"]["publish"] if re.search("/left/|/right/", name)}
    described = {"/camera_tf/get_type_description"}  # only where tf is installed
    here = {"/tf", "/tf_static"}
    nodes = ("/camera", "/camera_parameters")
    check(graph, SHIPPED, "/tissue_sim/camera", nodes, publish=pair | here, subscribe=here, reply=described)
    assert camera.stop() == 0, camera.text()


@pytest.mark.extended
def test_the_command_prints_that_of_a_node_with_other_tools_and_names(tmp_path, graph):
    words = ["tools:=[arm]", "arm.shape:=gripper", "arm.length:=0.03", "arm.measured_cp:=~/pose", "rate:=100.0"]
    words += ["arm.servo_cf:=/MTML/servo_cf", "organ_pose:=[0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]", "base_frame:=table"]
    remap = ("__ns:=/ward",)
    command = [sys.executable, "-m", "tissue_sim", "policy", "--node", "ward/tissue_sim"]
    with running_node(tmp_path, *words, remap=remap, PYTHONPATH=str(FAKE_TF)):
        printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        check_form(ElementTree.fromstring(printed.encode()))
        # Frames are listened for once a pose names one.
        unseen = {"/tf", "/tf_static", "/clock"}
        others = {f"/ward/tissue_sim/{name}" for name in SERVICES}
        check(graph, printed, "/ward/tissue_sim", ["/ward/tissue_sim"], subscribe=unseen, reply=others)
