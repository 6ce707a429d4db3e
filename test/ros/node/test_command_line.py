"""What users do with the ros2 command line: pub poses by hand, load a dump of the parameters, misspell one."""

import re
import subprocess
import sys

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rcl_interfaces.msg import Parameter
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.qos import qos_profile_sensor_data

import tissue_sim
from helpers.patience import LIMIT
from helpers.ros.clients import Client
from helpers.ros.processes import poke_path, running_node, shipped
from tissue_sim.organ.tool_resolution import points_for

MISSPELT = "organ_fil:=kidney.npz", "lef.radius:=0.004", "entirely_else:=1"


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    folder = tmp_path_factory.mktemp("by_hand")
    needle = "tools:=[left,right,needle]", "needle.radius:=0.001"
    parameters = "local_region:=off", "right.allow_empty_frame:=true", "stale_time:=5.0", *needle, *MISSPELT
    parameters += "rate:=1000", "gravity:=[0, 0, 0]", "right.allow_zero_stamp:=true", "needle.reliable:=true"
    parameters += "left.measured_cf:=somewhere", "left.links:=[]"
    with running_node(folder, *parameters) as process:
        yield process


@pytest.fixture(scope="module")
def client(node):
    client = Client(markers=False)
    client.meet()
    yield client
    client.close()


def test_an_empty_list_of_links_is_the_default(client):
    found = client.call(GetParameters, "/tissue_sim/get_parameters", GetParameters.Request(names=["left.links"]))
    assert found.values[0].string_array_value == [""]


@pytest.mark.extended
def test_off_is_a_word_and_not_yaml_s_false(node, client):
    found = client.call(GetParameters, "/tissue_sim/get_parameters", GetParameters.Request(names=["local_region"]))
    assert found.values[0].string_value == "off"


def test_false_is_off_where_a_dump_is_loaded_and_nothing_else_is(node, client):
    """`ros2 param load` reads each value of a dump once more, as YAML."""
    assert client.set_parameter("local_region", False).successful
    test_off_is_a_word_and_not_yaml_s_false(node, client)
    for value in (True, 0, "modal"):
        assert not client.set_parameter("local_region", value).successful


def test_a_misspelt_parameter_is_named_with_the_nearest(node):
    for line in (
        "parameter 'organ_fil' is unknown and has no effect; did you mean 'organ_file'?",
        "parameter 'lef.radius' is unknown and has no effect; did you mean 'left.radius'?",
        "parameter 'entirely_else' is unknown and has no effect; 'tissue_node --help' lists all",
    ):
        assert line in node.text()
    assert node.text().count("is unknown") == len(MISSPELT)


def test_the_old_name_of_a_parameter_is_reported_with_the_new_one(node):
    line = "parameter 'left.measured_cf' has no effect: its name is now 'left.external_cf', topic of external forces"
    assert node.text().count(line) == 1


def test_whole_numbers_are_taken_for_decimals(client):
    """As users write them, at the start and later."""
    assert client.set_parameter("rate", 900).successful
    assert client.set_parameter("gravity", [0, 0, 1]).successful
    request = GetParameters.Request(names=["rate", "gravity"])
    rate, gravity = client.call(GetParameters, "/tissue_sim/get_parameters", request).values
    assert (rate.double_value, list(gravity.double_array_value)) == (900.0, [0.0, 0.0, 1.0])
    assert client.set_parameter("rate", 1000.0).successful
    assert client.set_parameter("gravity", [0.0, 0.0, 0.0]).successful


def test_a_tool_too_fine_for_the_organ_is_named_with_the_points_that_would_do(node):
    organ = shipped()
    (line,) = (line for line in node.text().splitlines() if "its radius of" in line)
    assert "tool 'needle': its radius of 1 mm is below half the mean edge of organ 'kidney'" in line
    assert f"--points {points_for(organ, 0.001)} (" in line


def test_a_dump_of_its_own_parameters_can_be_loaded(client):
    names = client.call(ListParameters, "/tissue_sim/list_parameters", ListParameters.Request()).result.names
    assert {"organ_file", "tools", "organ_pose", "left.shape", "left.base_pose"} <= set(names)
    values = client.call(GetParameters, "/tissue_sim/get_parameters", GetParameters.Request(names=names)).values
    request = SetParameters.Request()
    request.parameters = [Parameter(name=name, value=value) for name, value in zip(names, values, strict=True)]
    results = client.call(SetParameters, "/tissue_sim/set_parameters", request).results
    for name, result in zip(names, results, strict=True):
        if name == "start_type_description_service":  # rclpy's own, of any node
            continue
        assert result.successful, (name, result.reason)


def test_two_poses_by_hand_give_a_force(client):
    """One outside, and after a while a fixed one inside, again and again: as docs/bridges.md has it."""
    touch, inward = poke_path(shipped())
    assert client.spin_until(lambda: client.ask(touch - 0.03 * inward) or len(client.wrenches) > 0)
    client.spin(0.5)
    assert client.spin_until(lambda: client.ask(touch + 0.002 * inward) or client.hand_force() > 0.05)
    assert client.hand_force() < 3.0


def test_an_empty_frame_is_refused_with_the_remedy_or_allowed(node, client):
    def is_refused():
        client.send_pose(np.ones(3), frame="")
        client.spin(0.02)
        return "its frame is '', expected 'organ' (parameter left.allow_empty_frame accepts it)" in node.text()

    assert client.spin_until(is_refused)
    poses = client.node.create_publisher(PoseStamped, "right/measured_cp", 10)
    message = PoseStamped()
    message.pose.position.x = 1.0

    def is_taken():
        message.header.stamp = client.stamp()
        poses.publish(message)
        client.spin(0.02)
        return client.diagnostics.get("right.poses", "0") != "0"

    assert client.spin_until(is_taken)
    assert not any(name.startswith("right.refused") for name in client.diagnostics)


def test_a_stamp_of_zero_is_refused_with_the_remedy_or_taken_as_of_its_arrival(node, client):
    line = "its stamp is 0, which marks invalid data (parameter left.allow_zero_stamp uses the time of arrival instead)"
    right = client.node.create_publisher(PoseStamped, "right/measured_cp", 10)
    message = PoseStamped()
    message.header.frame_id, message.pose.position.x = "organ", 1.0
    taken = int(client.report()["right.poses"])

    def is_reported():
        client.send_pose(np.ones(3), stamp=0.0)
        right.publish(message)
        client.spin(0.02)
        return line in node.text() and int(client.diagnostics.get("right.poses", 0)) > taken

    assert client.spin_until(is_reported)
    assert "right.refused.no_stamp" not in client.diagnostics


def test_qos_that_does_not_match_is_reported_both_ways_with_the_remedy(node, client):
    client.node.create_publisher(PoseStamped, "needle/measured_cp", qos_profile_sensor_data)
    client.node.create_subscription(WrenchStamped, "left/servo_cf", print, 10)
    for line in (
        r"the QoS on /needle/measured_cp does not match: this node requests reliable, but (/client|another node) offers"
        r" best effort: its messages are not received; set needle\.reliable:=false",
        r"the QoS on /left/servo_cf does not match: this node offers best effort, but (/client|another node) requests"
        r" reliable: it receives nothing; set left\.reliable:=true",
    ):
        assert client.spin_until(lambda line=line: re.search(line, node.text()) is not None), node.text()


WRONG_WORDS = {
    "--bogus": "argument '--bogus' is unknown; 'tissue_node --help' lists",
    "-p rate:=500.0": "'-p' is an argument of ROS, which needs --ros-args: tissue_node --ros-args -p rate:=500.0",
    "rate:=500.0": "'rate:=500.0' is an argument of ROS, which needs --ros-args: tissue_node --ros-args -p rate:=500.0",
    "--ros-args -r __ns:=/a -- more": "argument 'more' is unknown",
    "--ros-args --bogus": "ROS does not know '--bogus' behind --ros-args",
}
STARTS = """
import os, sys
from tissue_sim.ros.shared.shutdown_handler import ShutdownHandler
from tissue_sim.ros.node.serve import serve

ending = ShutdownHandler()
codes = [serve(["tissue_node", *words.split()], ending) for words in sys.argv[1:]]
os.environ["ROS_DOMAIN_ID"] = "300"
codes += [serve(["tissue_node"], ending), serve(["tissue_node", "--version"], ending)]
print(codes, flush=True)
os._exit(0)
"""


def test_wrong_words_end_with_one_line_each_and_2():
    command = [sys.executable, "-c", STARTS, *WRONG_WORDS]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT, check=False)
    lines = done.stderr.splitlines()
    for line, expected in zip(
        lines, [*WRONG_WORDS.values(), "ROS_DOMAIN_ID is '300'; expected: a number from 0 to 232"], strict=True
    ):
        assert line.startswith(f"tissue_node: error: {expected}")
    version, codes = done.stdout.splitlines()
    assert version == f"tissue_node {tissue_sim.__version__}"
    assert codes == str([2] * len(lines) + [0])


def test_help_into_a_pipe_that_closes_says_nothing_more():
    code = "import sys; sys.argv = ['tissue_node', '--help']; from tissue_sim.ros.node.program import run; run()"
    child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    child.stdout.close()
    assert child.wait(LIMIT) == 0
    assert child.stderr.read() == ""


WHILE_LOADING = """
import builtins, os, signal, sys
from tissue_sim.cli import main

signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background is started without
load = builtins.__import__

def signalled(name, *rest, **named):
    if name.partition(".")[0] == {!r}:
        os.kill(os.getpid(), signal.SIGINT)
    return load(name, *rest, **named)

builtins.__import__ = signalled
sys.exit(main({!r}))
"""


@pytest.mark.parametrize(
    ("words", "module", "code", "line"),
    [
        (["bridge"], "numpy", 0, "tissue_sim bridge: stopped; it had not begun\n"),
        (["bridge"], "shape_msgs", 0, "tissue_sim bridge: stopped; it had not begun\n"),
        (["view"], "numpy", 0, "tissue_sim view: stopped; it had not begun\n"),
        (["info", "k.npz"], "numpy", 130, "tissue_sim info: stopped\n"),
    ],
)
def test_ctrl_c_while_a_command_loads_ends_it_as_later(words, module, code, line):
    program = WHILE_LOADING.format(module, words)
    # What is imported counts as imported by the program above, so that Python would print others' deprecations.
    started = [sys.executable, "-W", "ignore::DeprecationWarning", "-c", program]
    done = subprocess.run(started, capture_output=True, text=True, timeout=LIMIT, check=False)
    assert (done.returncode, done.stderr) == (code, line)
