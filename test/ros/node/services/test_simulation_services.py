"""The services of simulation_interfaces, as a client of messages that are generated from its definitions meets them."""

import importlib
import math
import os
import shutil
import sys
import sysconfig
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import helpers.ros
from helpers.ros.clients import Client
from helpers.ros.processes import UNHURRIED, press_until_contact, running_node, shipped
from tissue_sim.ros.node.shared.guarded_node import failed

pytestmark = pytest.mark.extended

DEFINITIONS = Path(helpers.ros.__path__[0]) / "simulation_interfaces"
BASE = [0.1, 0.0, 0.2]  # m, of the organ in `world`
WORDS = (
    *("tools:=[left, right]", UNHURRIED, "base_frame:=world", "left.frame_id:=world"),
    f"organ_pose:=[{BASE[0]}, 0.0, {BASE[2]}, 0.0, 0.0, 0.0, 1.0]",
)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder of a package that is made of the definitions."""
    if shutil.which("g++") is None or not Path(sysconfig.get_path("include"), "Python.h").is_file():
        pytest.skip("there is no C++ compiler, or no header of Python's")
    if not Path(sys.prefix, "share", "rosidl_generator_py").is_dir():
        pytest.skip("ROS isn't that of the wheels, whose generators make the package")
    from helpers.ros.interfaces import make_interfaces

    folder = tmp_path_factory.mktemp("interfaces")
    make_interfaces(DEFINITIONS, folder)
    return folder


@pytest.fixture(scope="module")
def of(made):
    """Its services and messages, for this process."""
    sys.path.insert(0, str(made))
    try:
        yield importlib.import_module("simulation_interfaces.srv"), importlib.import_module("simulation_interfaces.msg")
    finally:
        sys.path.remove(str(made))
        for name in [name for name in sys.modules if name.partition(".")[0] == "simulation_interfaces"]:
            del sys.modules[name]


@pytest.fixture(scope="module")
def node(made, tmp_path_factory):
    path = os.pathsep.join(filter(None, [str(made), os.environ.get("PYTHONPATH")]))
    with running_node(tmp_path_factory.mktemp("node"), *WORDS, PYTHONPATH=path) as process:
        yield process


class Caller:
    """Calls the node's services by their names."""

    def __init__(self, of, client):
        (self.srv, self.msg), self.client = of, client

    def __call__(self, name, **fields):
        kind = getattr(self.srv, "".join(map(str.capitalize, name.split("_"))))
        return self.client.call(kind, f"{self.client.target}/{name}", kind.Request(**fields))

    def code(self, name, **fields):
        """The result's code; the message is kept."""
        result = self(name, **fields).result
        self.line = result.error_message
        return result.result

    def set_state(self, state):
        return self.code("set_simulation_state", state=self.msg.SimulationState(state=state))

    @property
    def state(self):
        answer = self("get_simulation_state")
        assert answer.result.result == self.msg.Result.RESULT_OK
        return answer.state.state

    def entities(self, **filters):
        answer = self("get_entities", filters=self.msg.EntityFilters(**filters))
        self.line = answer.result.error_message
        return answer.result.result, list(answer.entities)

    def placed(self, position, quaternion=(0.0, 0.0, 0.0, 1.0), frame=""):
        """A state at a pose in a frame."""
        state = self.msg.EntityState()
        state.header.frame_id = frame
        state.pose.position.x, state.pose.position.y, state.pose.position.z = map(float, position)
        turn = state.pose.orientation
        turn.x, turn.y, turn.z, turn.w = quaternion
        return state

    def tick(self):
        return int(self.client.report()["tick"])


@pytest.fixture(scope="module")
def call(of, node):
    client = Client()
    assert client.spin_until(lambda: client.pose.get_subscription_count() > 0 and client.surface().size > 0)
    made = Caller(of, client)
    # The first request to a service may have to be sent twice, see Participant.call: those here change nothing.
    made.code("step_simulation", steps=0)
    made.code("reset_simulation", scope=1)
    made.code("set_entity_state", entity="nobody")
    made.set_state(77)
    yield made
    client.close()


def features(call):
    kind = call.msg.SimulatorFeatures
    names = {getattr(kind, name): name for name in dir(kind) if isinstance(getattr(kind, name), int)}
    answer = call("get_simulator_features").features
    assert not answer.spawn_formats
    assert "a step is a tick" in answer.custom_info
    return {names[number] for number in answer.features}


def test_a_handler_that_fails_says_so_by_its_code(of):
    srv, msg = of
    for kind in (srv.StepSimulation, srv.GetEntityState, srv.SetSimulationState):
        result = failed(kind.Response(), kind.Request(), "callback failed: it broke").result
        assert (result.result, result.error_message) == (
            msg.Result.RESULT_OPERATION_FAILED,
            "callback failed: it broke",
        )


def test_features_are_those_of_the_services_that_are_served(call):
    assert features(call) == {
        *("ENTITY_STATE_GETTING", "ENTITY_STATE_SETTING", "SIMULATION_RESET", "SIMULATION_RESET_STATE"),
        *("SIMULATION_STATE_GETTING", "SIMULATION_STATE_SETTING", "SIMULATION_STATE_PAUSE"),
        *("STEP_SIMULATION_SINGLE", "STEP_SIMULATION_MULTIPLE"),
    }


def test_states_and_steps(call):
    of, result, codes = call.msg.SimulationState, call.msg.Result, call.srv.SetSimulationState.Response
    assert call.state == of.STATE_PLAYING
    assert call.set_state(of.STATE_PLAYING) == codes.ALREADY_IN_TARGET_STATE
    assert call.code("step_simulation", steps=1) == result.RESULT_OPERATION_FAILED
    assert "not paused" in call.line
    assert call.set_state(of.STATE_PAUSED) == result.RESULT_OK
    assert call.state == of.STATE_PAUSED
    assert call.set_state(of.STATE_PAUSED) == codes.ALREADY_IN_TARGET_STATE
    before = call.tick()
    for steps in (1, 25, 0):
        assert call.code("step_simulation", steps=steps) == result.RESULT_OK
        assert not call.line
    assert call.tick() == before + 26
    assert call.state == of.STATE_PAUSED

    assert call.set_state(of.STATE_STOPPED) == result.RESULT_OK
    assert call.state == of.STATE_STOPPED
    assert call.code("step_simulation", steps=1) == result.RESULT_OPERATION_FAILED
    assert "stopped" in call.line
    assert call.tick() == before + 26
    assert call.set_state(of.STATE_PAUSED) == result.RESULT_OK, "it starts paused"
    assert call.code("step_simulation") == result.RESULT_OK, "one step, by default"
    assert call.tick() == before + 27
    for state in (of.STATE_QUITTING, of.STATE_NO_WORLD, of.STATE_LOADING_WORLD, 77):
        assert call.set_state(state) == result.RESULT_FEATURE_UNSUPPORTED
    assert call.set_state(of.STATE_STOPPED) == result.RESULT_OK
    assert call.set_state(of.STATE_PLAYING) == result.RESULT_OK
    assert call.client.spin_until(lambda: call.tick() > before + 100)


def test_a_reset_brings_the_organ_back_and_refuses_what_it_cannot_reset(call):
    result, scopes = call.msg.Result, call.srv.ResetSimulation.Request
    press_until_contact(call.client, call.client.ask)
    assert call.client.spin_until(lambda: call.client.moved() > 5e-4)
    for scope in (scopes.SCOPE_DEFAULT, scopes.SCOPE_TIME, scopes.SCOPE_SPAWNED, scopes.SCOPE_ALL, 3):
        assert call.code("reset_simulation", scope=scope) == result.RESULT_FEATURE_UNSUPPORTED
        assert "SCOPE_STATE (2)" in call.line
    assert call.client.moved() > 5e-4
    assert call.code("reset_simulation", scope=scopes.SCOPE_STATE) == result.RESULT_OK
    assert call.client.spin_until(lambda: call.client.moved() < 1e-6)


def test_entities_are_found_by_name_and_place(call):
    result, bounds = call.msg.Result, call.msg.Bounds
    organ = shipped()
    assert call.entities() == (result.RESULT_OK, [organ.name, "left", "right"])
    assert call.entities(filter="^(left|right)$") == (result.RESULT_OK, ["left", "right"])
    assert call.entities(filter="nobody") == (result.RESULT_OK, [])
    assert call.entities(filter="(") == (result.RESULT_OPERATION_FAILED, [])
    assert call.entities(categories=[call.msg.EntityCategory()])[0] == result.RESULT_FEATURE_UNSUPPORTED
    assert call.entities(tags=call.msg.TagsFilter(tags=["soft"]))[0] == result.RESULT_FEATURE_UNSUPPORTED
    assert call.entities(bounds=bounds(type=bounds.TYPE_BOX))[0] == result.RESULT_FEATURE_UNSUPPORTED

    def inside(centre, radius):
        sphere = bounds(type=bounds.TYPE_SPHERE)
        for values in (centre, (radius, 0.0, 0.0)):
            point = call.msg.EntityState().twist.linear
            point.x, point.y, point.z = map(float, values)
            sphere.points.append(point)
        return call.entities(bounds=sphere, filter=f"^{organ.name}$")

    side = organ.surface_positions[:, 0].max() + BASE[0]
    middle = organ.surface_positions.mean(axis=0) + BASE
    assert inside((side + 0.02, middle[1], middle[2]), 0.021) == (result.RESULT_OK, [organ.name])
    assert inside((side + 0.02, middle[1], middle[2]), 0.015) == (result.RESULT_OK, [])
    assert inside((0.0, 0.0, 0.0), -1.0)[0] == result.RESULT_OPERATION_FAILED
    assert call.entities(bounds=bounds(type=bounds.TYPE_SPHERE))[0] == result.RESULT_OPERATION_FAILED


def test_the_state_of_an_entity_is_its_pose_in_its_frame(call):
    result, client = call.msg.Result, call.client
    answer = call("get_entity_state", entity=shipped().name)
    assert answer.result.result == result.RESULT_OK
    assert answer.state.header.frame_id == "world"
    assert [answer.state.pose.position.x, answer.state.pose.position.z] == [BASE[0], BASE[2]]
    assert call.code("get_entity_state", entity="nobody") == result.RESULT_NOT_FOUND
    assert "left, right" in call.line
    assert call.code("get_entity_state", entity="right") == result.RESULT_OPERATION_FAILED
    assert "not received a pose" in call.line
    client.ask((0.3, 0.01, 0.02))
    assert client.spin_until(lambda: client.ask((0.3, 0.01, 0.02)) or int(client.report()["left.poses"]) > 0)
    answer = call("get_entity_state", entity="left")
    assert answer.state.header.frame_id == "organ"
    assert answer.state.header.stamp.sec > 0
    assert (answer.state.pose.position.x, answer.state.pose.position.y) == (0.3, 0.01)
    assert answer.state.pose.orientation.w == 1.0


def test_a_tool_without_a_bridge_is_placed_and_presses_with_the_steps(call):
    """In the world's frame, while the node is paused; nobody publishes poses of the right one.

    It goes its way in the ticks between two poses, whatever time the caller takes for them.
    """
    result, of = call.msg.Result, call.msg.SimulationState
    organ = shipped()
    points = organ.surface_positions
    node = int(np.argmax(points[:, 0] - 0.5 * np.abs(points[:, 2] - points[:, 2].mean())))
    assert call.code("reset_simulation", scope=2) == result.RESULT_OK
    assert call.set_state(of.STATE_PAUSED) == result.RESULT_OK
    for depth in np.linspace(-0.003, 0.004, 36):
        where = points[node] + np.array(BASE) + (0.005 - depth) * np.array([1.0, 0.0, 0.0])
        state = call.placed(where, frame="" if depth < 0.0 else "world")
        assert call.code("set_entity_state", entity="right", state=state, set_pose=True) == result.RESULT_OK, call.line
        call.client.spin(0.05)
        assert call.code("step_simulation", steps=10) == result.RESULT_OK
    answer = call("get_entity_state", entity="right")
    position = answer.state.pose.position
    np.testing.assert_allclose([position.x, position.y, position.z], where - BASE, atol=1e-12)
    assert call.client.spin_until(lambda: call.client.moved() > 1e-3)
    assert call.client.report()["right.state"] == "fresh"
    assert call.set_state(of.STATE_STOPPED) == result.RESULT_OK
    assert call.set_state(of.STATE_PLAYING) == result.RESULT_OK
    assert call.client.spin_until(lambda: call.client.moved() < 1e-6)


def test_a_tool_is_where_its_frame_says_also_once_the_organ_is_registered_anew(call):
    """The same pose in the organ's frame, from a bridge and placed; one in the world's stays there."""
    client, result = call.client, call.msg.Result
    away, turn = np.array([0.3, 0.05, -0.1]), Rotation.from_euler("x", 0.4)
    elsewhere, registered = np.array([0.3, -0.1, 0.2]), Rotation.from_euler("z", 90.0, degrees=True)

    def place(entity, *given):
        state = call.placed(*given)
        assert call.code("set_entity_state", entity=entity, state=state, set_pose=True) == result.RESULT_OK, call.line

    def pose_of(tool):
        state = call("get_entity_state", entity=tool).state
        assert state.header.frame_id == "organ"
        position, turned = state.pose.position, state.pose.orientation
        place = np.array([position.x, position.y, position.z])
        return place, Rotation.from_quat([turned.x, turned.y, turned.z, turned.w])

    def check(tool, position, rotation):
        found, turned = pose_of(tool)
        np.testing.assert_allclose(found, position, atol=1e-12)
        assert (turned * rotation.inv()).magnitude() < 1e-9

    def is_there():
        client.ask(away, quaternion=turn.as_quat())
        return np.allclose(pose_of("left")[0], away, atol=1e-12)

    assert client.spin_until(is_there)
    place("right", away, turn.as_quat(), "organ")
    check("left", away, turn)
    check("right", away, turn)
    place(shipped().name, elsewhere, registered.as_quat())
    check("right", away, turn)
    for is_stale in (False, True):
        place("right", away, turn.as_quat(), "world")
        check("right", registered.inv().apply(away - elsewhere), registered.inv() * turn)
        if is_stale:
            assert client.set_parameter("stale_time", 0.05).successful
            assert client.spin_until(lambda: client.report()["right.state"] == "stale")
        place(shipped().name, BASE)
        check("right", away - BASE, turn)
        place(shipped().name, elsewhere, registered.as_quat())
    place(shipped().name, BASE)
    assert client.set_parameter("stale_time", 5.0).successful


def test_what_cannot_be_placed_is_refused_by_its_code(call):
    result, invalid = call.msg.Result, call.srv.SetEntityState.Response.INVALID_POSE
    away = (0.3, 0.0, 0.0)

    def code(entity, state, **flags):
        return call.code("set_entity_state", entity=entity, state=state, **{"set_pose": True} | flags)

    assert code("left", call.placed(away)) == result.RESULT_OPERATION_FAILED
    assert call.line == "tool 'left' is moved by its bridge, which publishes /left/measured_cp"
    assert code("nobody", call.placed(away)) == result.RESULT_NOT_FOUND
    assert code("right", call.placed(away, frame="moon")) == result.RESULT_NOT_FOUND
    assert "moon" in call.line
    assert code("right", call.placed(away, (0.0, 0.0, 0.0, 0.0))) == invalid
    assert code("right", call.placed((math.nan, 0.0, 0.0))) == invalid
    assert code("right", call.placed((150.0, 0.0, 0.0))) == invalid
    moving = call.placed(away)
    moving.twist.linear.x = 0.1
    assert code("right", moving, set_twist=True) == result.RESULT_OPERATION_FAILED
    assert "twist" in call.line
    assert code("right", moving, set_twist=False) == result.RESULT_OK, "it isn't to be set"
    assert code("right", call.placed(away), set_pose=False) == result.RESULT_OK
    assert code(shipped().name, call.placed(away, frame="organ")) == result.RESULT_OPERATION_FAILED
    assert code(shipped().name, call.placed(away, (0.0, 0.0, 0.0, 0.0))) == invalid
    assert code(shipped().name, call.placed(BASE)) == result.RESULT_OK, "where it is"


def test_with_a_clock_of_others_nothing_is_paused_and_features_say_so(call):
    """The last one: ticks wait for /clock then."""
    of, result = call.msg.SimulationState, call.msg.Result
    assert call.client.set_parameter("use_sim_time", True).successful
    assert features(call) == {
        *("ENTITY_STATE_GETTING", "ENTITY_STATE_SETTING", "SIMULATION_RESET", "SIMULATION_RESET_STATE"),
        "SIMULATION_STATE_GETTING",
    }
    assert call.client.spin_until(lambda: call.state == of.STATE_PAUSED), "there is no /clock"
    for state in (of.STATE_PLAYING, of.STATE_STOPPED):
        assert call.set_state(state) == result.RESULT_FEATURE_UNSUPPORTED
        assert "/clock" in call.line
    assert call.code("step_simulation", steps=1) == result.RESULT_FEATURE_UNSUPPORTED
    assert call.client.set_parameter("use_sim_time", False).successful
    assert call.client.spin_until(lambda: call.state == of.STATE_PLAYING)
