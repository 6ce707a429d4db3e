"""What people do with the ros2 command line: pub poses by hand, load a dump of the parameters, misspell one."""

import subprocess
import sys

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.msg import Parameter
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters

from helpers.patience import LIMIT
from helpers.ros.clients import Client
from helpers.ros.processes import poke_path, running_node, shipped
from tissue_sim.organ.fineness import points_for

MISSPELT = "organ_fil:=kidney.npz", "lef.radius:=0.004", "entirely_else:=1"


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    folder = tmp_path_factory.mktemp("by_hand")
    needle = "tools:=[left,right,needle]", "needle.radius:=0.001"
    parameters = "local_region:=off", "right.allow_empty_frame:=true", "stale_time:=5.0", *needle, *MISSPELT
    with running_node(folder, *parameters) as process:
        yield process


@pytest.fixture(scope="module")
def client(node):
    client = Client(markers=False)
    assert client.spin_until(lambda: client.pose.get_subscription_count() > 0 and client.diagnostics)
    yield client
    client.close()


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
        "parameter 'organ_fil' is unknown and changes nothing; did you mean 'organ_file'?",
        "parameter 'lef.radius' is unknown and changes nothing; did you mean 'left.radius'?",
        "parameter 'entirely_else' is unknown and changes nothing; 'tissue_node --help' lists all",
    ):
        assert line in node.text()
    assert node.text().count("is unknown") == len(MISSPELT)


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
        return "its frame is '', expected 'organ' (parameter left.allow_empty_frame takes it for that)" in node.text()

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
    ("words", "module", "code"),
    [
        (["bridge"], "numpy", 0),
        (["bridge"], "shape_msgs", 0),
        (["view"], "numpy", 0),
        (["info", "k.npz"], "numpy", 130),
    ],
)
def test_ctrl_c_while_a_command_loads_ends_it_as_later(words, module, code):
    program = WHILE_LOADING.format(module, words)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=LIMIT, check=False)
    assert (done.returncode, done.stderr) == (code, "")
