"""Every message type in and out, transforms and tf: one node with a tool for each, and its bag."""

import os
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import Pose, PoseStamped, TransformStamped, Wrench, WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation
from std_msgs.msg import Float64MultiArray
from visualization_msgs.msg import Marker, MarkerArray

from helpers.ros.clients import LATCHED, MOMENT, Client
from helpers.ros.processes import FAKE_TF, UNHURRIED, poke_path, running_node, shipped
from helpers.ros.replaying import repeated
from tissue_sim.ros.bags.recording import Recording
from tissue_sim.ros.shared.tool_messages import POSE_TYPES

TURN = Rotation.from_euler("zyx", (90.0, 20.0, -35.0), degrees=True)  # of a device's base in the base frame
OFFSET = np.array([0.2, -0.3, 0.1])
ORGAN = np.array([0.5, 0.1, -0.2])  # the organ in the base frame
ORGAN_ELSEWHERE = np.array([-0.2, 0.3, 0.4])
HELD = Rotation.from_euler("xyz", (40.0, 10.0, 160.0), degrees=True)
DEPTH = 0.003


def numbers(values) -> str:
    return "[" + ", ".join(repr(float(value)) for value in values) + "]"


BASE_POSE = numbers([*OFFSET, *TURN.as_quat()])
PARAMETERS = (
    "tools:=[plain, named, odometry, led, pen]",
    "base_frame:=world",
    f"organ_pose:={numbers([*ORGAN, 0.0, 0.0, 0.0, 1.0])}",
    *("plain.frame_id:=arm_base", "plain.pose_type:=Pose", "plain.wrench_type:=Wrench", "plain.force_type:=Wrench"),
    "plain.external_cf:=plain/external_cf",
    f"plain.base_pose:={BASE_POSE}",
    *("named.frame_id:=arm_base", "named.pose_type:=TransformStamped", "named.wrench_type:=Float64MultiArray"),
    *("named.array_length:=7", "named.wrench_frame:=body", "named.reliable:=true", f"named.base_pose:={BASE_POSE}"),
    *("odometry.pose_type:=Odometry", "odometry.motion_scale:=0.5", "odometry.frame_id:=world"),
    f"odometry.wrench_rotation:={numbers(TURN.as_quat())}",
    "led.frame_id:=elsewhere",
    "pen.wrench_frame:=body",
    UNHURRIED,
)


def six(wrench: Wrench) -> np.ndarray:
    force, torque = wrench.force, wrench.torque
    return np.array([force.x, force.y, force.z, torque.x, torque.y, torque.z])


class Tools(Client):
    """A publisher and a subscription for each tool, of its types."""

    def __init__(self) -> None:
        super().__init__()
        self.answers: dict[str, list[np.ndarray]] = {"plain": [], "named": [], "odometry": [], "led": [], "pen": []}
        self.axes: dict[str, str] = {}  # by tool, the frame that its newest wrench names
        node, best_effort = self.node, qos_profile_sensor_data
        types = {"plain": Pose, "named": TransformStamped, "odometry": Odometry}
        types |= {"led": PoseStamped, "pen": PoseStamped}
        self.poses = {
            tool: node.create_publisher(kind, f"{tool}/measured_cp", 10 if tool == "named" else best_effort)
            for tool, kind in types.items()
        }
        self.forces = node.create_publisher(Wrench, "plain/external_cf", best_effort)
        self.tf = node.create_publisher(TransformStamped, "/tf_static", LATCHED)
        self.frames: dict[tuple[str, str], np.ndarray] = {}  # parent, child: the newest pose (7,) from tf
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for topic, qos in (("/tf_static", latched), ("/tf", 10)):
            node.create_subscription(TransformStamped, topic, self._on_transform, qos)
        keep = {tool: wrenches.append for tool, wrenches in self.answers.items()}
        subscribe = node.create_subscription
        subscribe(Wrench, "plain/servo_cf", lambda m: keep["plain"](six(m)), best_effort)
        subscribe(Float64MultiArray, "named/servo_cf", lambda m: keep["named"](np.array(m.data)), 10)
        for tool in ("odometry", "led", "pen"):
            subscribe(WrenchStamped, f"{tool}/servo_cf", partial(self._on_stamped, tool), best_effort)

    def _on_stamped(self, tool: str, message: WrenchStamped) -> None:
        self.axes[tool] = message.header.frame_id
        self.answers[tool].append(six(message.wrench))

    def turn_to_organ(self, frame: str) -> Rotation:
        """From the axes of a frame to the organ's, as tf has them."""
        if frame == "organ":
            return Rotation.identity()
        if ("organ", frame) in self.frames:
            return Rotation.from_quat(self.frames["organ", frame][3:])
        of_organ, of_frame = (Rotation.from_quat(self.frames["world", one][3:]) for one in ("organ", frame))
        return of_organ.inv() * of_frame

    def _on_transform(self, message: TransformStamped) -> None:
        offset, turn = message.transform.translation, message.transform.rotation
        pose = np.array([offset.x, offset.y, offset.z, turn.x, turn.y, turn.z, turn.w])
        self.frames[message.header.frame_id, message.child_frame_id] = pose

    def send(self, tool: str, place: np.ndarray, turn: Rotation, frame: str = "") -> None:
        """Publish a pose in a tool's own frame."""
        stamp = self.stamp()
        pose = Pose()
        pose.position.x, pose.position.y, pose.position.z = map(float, place)
        rotation = pose.orientation
        rotation.x, rotation.y, rotation.z, rotation.w = map(float, turn.as_quat())
        message = POSE_TYPES[
            {"plain": "Pose", "named": "TransformStamped", "odometry": "Odometry"}.get(tool, "PoseStamped")
        ].message()
        if tool == "plain":
            message = pose
        elif tool == "named":
            message.header.frame_id, message.child_frame_id = "arm_base", "a_stylus"
            translation = message.transform.translation
            translation.x, translation.y, translation.z = map(float, place)
            message.transform.rotation = rotation
        elif tool == "odometry":
            message.header.frame_id, message.child_frame_id, message.pose.pose = "world", "hand", pose
        else:
            message.header.frame_id, message.pose = frame, pose
        if hasattr(message, "header"):
            message.header.stamp = stamp
        self.poses[tool].publish(message)

    def press(self, tool: str, to_device, turn: Rotation, frame: str = "", force=None) -> np.ndarray:
        """Press with a tool from outside to DEPTH, into an organ that rests; the mean of the last ten wrenches, (6,).

        to_device takes m in the organ's frame to the device's own.
        """
        self.reset()
        touch, inward = poke_path(shipped())
        wrenches = self.answers[tool]

        def hold(depth: float) -> None:
            """A pose, until it is answered or a moment has passed."""
            before = len(wrenches)
            self.send(tool, to_device(touch + depth * inward), turn, frame)
            if force is not None:
                self.forces.publish(force)
            self.spin_until(lambda: len(wrenches) > before, MOMENT)

        def is_settled() -> bool:
            hold(DEPTH)
            newest = np.array([np.linalg.norm(one[:3]) for one in wrenches[arrived:][-20:]])
            return len(wrenches) > arrived + 40 and bool(np.ptp(newest) < 0.01 * newest.mean())

        assert self.spin_until(lambda: hold(-0.008) or len(wrenches) > 0), "poses get no answer"
        for depth in np.linspace(-0.008, DEPTH, 200):
            hold(depth)
        arrived = len(wrenches)
        assert self.spin_until(is_settled), wrenches[-20:]
        pressed = np.array(wrenches[-10:]).mean(axis=0)
        for depth in np.linspace(DEPTH, -0.05, 20):  # gone before the next tool comes
            hold(depth)
        return pressed


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    folder = tmp_path_factory.mktemp("types")
    path = os.pathsep.join(filter(None, [str(FAKE_TF), os.environ.get("PYTHONPATH")]))
    with running_node(folder, *PARAMETERS, f"record_folder:={folder}", PYTHONPATH=path) as process:
        yield process


@pytest.fixture(scope="module")
def tools(node):
    tools = Tools()
    assert tools.spin_until(lambda: all(p.get_subscription_count() for p in tools.poses.values()))
    yield tools
    tools.close()


@pytest.mark.extended
def test_frame_that_tf_does_not_know_is_refused_by_name(node, tools):
    def refused():
        tools.send("led", np.ones(3), HELD, frame="moon")
        return "led.refused.unknown_frame" in tools.diagnostics

    assert tools.spin_until(refused)
    line = next(line for line in node.text().splitlines() if "'moon'" in line)
    assert "expected 'elsewhere' (parameter led.frame_id sets another one); tf has no transform from it to" in line
    assert "does not exist" in line


def test_tf_hears_where_organ_and_tools_are(node, tools):
    """What parameters place, but no frame that a driver publishes itself; and the tips, in the organ's frame."""
    turn = Rotation.from_euler("x", 0.3)
    there = np.array([0.3, 0.2, 0.1])

    def is_heard():
        tools.send("plain", in_device(there), TURN.inv() * turn)
        tools.spin(0.02)
        return ("organ", "plain_tip") in tools.frames

    assert tools.spin_until(is_heard)
    assert tools.spin_until(lambda: ("world", "arm_base") in tools.frames and ("world", "organ") in tools.frames)
    assert not any("elsewhere" in names for names in tools.frames)
    np.testing.assert_allclose(tools.frames["world", "organ"], [*ORGAN, 0.0, 0.0, 0.0, 1.0])
    np.testing.assert_allclose(tools.frames["world", "arm_base"], [*OFFSET, *TURN.as_quat()])
    np.testing.assert_allclose(tools.frames["organ", "plain_tip"], [*there, *turn.as_quat()], atol=1e-9)


def in_device(point: np.ndarray) -> np.ndarray:
    """From the organ's frame to that of a device whose base stands at TURN and OFFSET."""
    return TURN.inv().apply(point + ORGAN - OFFSET)


def is_outward(force: np.ndarray) -> bool:
    """Whether a force along the organ's axes pushes the tool back out."""
    _, inward = poke_path(shipped())
    return 0.03 < np.linalg.norm(force) < 3.0 and force @ -inward > 0.9 * np.linalg.norm(force)


@pytest.fixture(scope="module")
def bag(node, tools):
    """A bag in which each tool presses once; the last wrenches, along each device's axes."""
    assert tools.record(True).success
    wrenches = {}
    pull = Wrench()
    pull.force.x, pull.force.y, pull.force.z = map(float, TURN.inv().apply([0.0, 0.0, 0.02]))
    wrenches["plain"] = tools.press("plain", in_device, TURN.inv() * HELD, force=pull)
    wrenches["named"] = tools.press("named", in_device, TURN.inv() * HELD)
    wrenches["odometry"] = tools.press("odometry", lambda point: (point + ORGAN) / 0.5, HELD)
    assert tools.axes["odometry"] == "odometry_wrench"
    wrenches["odometry"][:3] = tools.turn_to_organ("odometry_wrench").apply(wrenches["odometry"][:3])
    transform = TransformStamped(child_frame_id="camera")
    transform.header.frame_id = "world"
    translation, rotation = transform.transform.translation, transform.transform.rotation
    translation.x, translation.y, translation.z = map(float, OFFSET)
    rotation.x, rotation.y, rotation.z, rotation.w = map(float, TURN.as_quat())
    tools.tf.publish(transform)
    wrenches["led"] = tools.press("led", in_device, TURN.inv() * HELD, frame="camera")
    assert tools.axes["led"] == "camera", "the frame of its poses, not the one that led.frame_id names"
    # The organ is registered again, while the node runs, and then as it was.
    assert tools.set_parameter("organ_pose", [*ORGAN_ELSEWHERE, *TURN.as_quat()]).successful
    wrenches["registered"] = tools.press("odometry", lambda point: (TURN.apply(point) + ORGAN_ELSEWHERE) / 0.5, HELD)
    assert tools.spin_until(lambda: np.allclose(tools.frames["world", "organ"][:3], ORGAN_ELSEWHERE)), "tf has it"
    wrenches["registered"][:3] = tools.turn_to_organ("odometry_wrench").apply(wrenches["registered"][:3])
    assert tools.set_parameter("organ_pose", [*ORGAN, 0.0, 0.0, 0.0, 1.0]).successful
    stopped = tools.record(False)
    assert stopped.success
    return stopped.message, wrenches


def test_pose_and_wrench_without_headers_in_a_base_that_is_turned(bag):
    wrench = bag[1]["plain"]
    assert is_outward(TURN.apply(wrench[:3]))


def test_transform_in_and_array_out_along_the_tools_own_axes(bag):
    values = bag[1]["named"]
    assert len(values) == 7
    assert values[6] == 0.0
    assert is_outward(HELD.apply(values[:3]))
    assert abs(values[3:6]).max() > 1e-5, "the torque about the tip comes too"


def test_tools_are_shown_in_the_organs_frame(tools):
    """Whatever the bridge's frame: where the tool touches the organ."""
    seen = []
    tools.node.create_subscription(MarkerArray, "/tissue_sim/tools", seen.append, 10)
    place, inward = poke_path(shipped())
    place = place - 0.02 * inward

    def is_there():
        tools.send("plain", in_device(place), TURN.inv() * HELD)
        return any(m.ns == "plain" and m.action == Marker.ADD for message in seen[-1:] for m in message.markers)

    assert tools.spin_until(is_there)
    (ball,) = [m for m in seen[-1].markers if m.ns == "plain" and m.type == Marker.SPHERE]
    assert ball.header.frame_id == "organ"
    assert (ball.pose.position.x, ball.pose.position.y, ball.pose.position.z) == pytest.approx(place, abs=1e-9)
    assert ball.scale.x == 0.01
    assert {m.ns for m in seen[-1].markers} == {"plain", "named", "odometry", "led", "pen"}
    # Nobody moves it any more.
    gone = tools.spin_until(lambda: all(m.action == Marker.DELETE for m in seen[-1].markers))
    assert gone, "a tool that nobody moves is still shown"


def test_odometry_with_motion_scaled_and_the_wrench_turned_into_a_frame_that_tf_has(bag):
    assert is_outward(bag[1]["odometry"][:3])


def test_frame_that_tf_knows_is_looked_up(bag):
    assert is_outward(TURN.apply(bag[1]["led"][:3]))


@pytest.mark.parametrize("frame", ["organ", "world"])
def test_the_wrench_of_a_body_names_its_tip_which_tf_has(tools, frame):
    """Whichever frame the poses come in, also where the organ's is a tool's own and stands elsewhere in the base."""
    place, turn = np.array([0.3, -0.2, 0.1]), Rotation.from_euler("y", 0.7)

    def is_heard():
        tools.send("pen", place if frame == "organ" else place + ORGAN, turn, frame=frame)
        tools.spin(0.02)
        tip = tools.frames.get(("organ", "pen_tip"))
        return tools.axes.get("pen") == "pen_tip" and tip is not None and np.allclose(tip, [*place, *turn.as_quat()])

    assert tools.spin_until(is_heard), tools.frames


def test_an_organ_that_is_registered_anew_is_where_it_is_and_bags_tell_the_tick(bag):
    assert is_outward(bag[1]["registered"][:3])
    recording = Recording.read(Path(bag[0]))
    ticks, poses = zip(*recording.registrations, strict=True)
    at_first = [*ORGAN, 0.0, 0.0, 0.0, 1.0]
    np.testing.assert_allclose(poses, [at_first, [*ORGAN_ELSEWHERE, *TURN.as_quat()], at_first])
    assert ticks[0] < recording.first_tick < ticks[1] < ticks[2]


def test_all_feel_the_same_tissue(bag):
    depth = [np.linalg.norm(wrenches[:3]) for wrenches in bag[1].values()]
    assert max(depth) < 1.5 * min(depth), bag[1]


def test_bag_holds_poses_and_forces_in_the_organs_frame_and_replays_bit_for_bit(bag, capsys):
    store = get_typestore(Stores.ROS2_JAZZY)
    touch, inward = poke_path(shipped())
    kinds, deepest = {}, {}
    with Reader(bag[0]) as reader:
        for connection, _, raw in reader.messages():
            topic = connection.topic
            if topic.endswith(("measured_cp", "external_cf", "servo_cf")):
                message = store.deserialize_cdr(raw, connection.msgtype)
                kinds[topic] = connection.msgtype
                assert message.header.frame_id == "organ", topic
                if topic.endswith("measured_cp"):
                    place = message.pose.position
                    depth = (np.array([place.x, place.y, place.z]) - touch) @ inward
                    deepest[topic] = max(deepest.get(topic, -1.0), depth)
                elif topic.endswith("external_cf"):
                    force = message.wrench.force
                    assert [force.x, force.y, force.z] == pytest.approx([0.0, 0.0, 0.02])
    for tool in ("plain", "named", "odometry", "led"):
        assert kinds[f"/tissue_sim/{tool}/measured_cp"] == "geometry_msgs/msg/PoseStamped"
        assert kinds[f"/tissue_sim/{tool}/servo_cf"] == "geometry_msgs/msg/WrenchStamped"
        assert deepest[f"/tissue_sim/{tool}/measured_cp"] == pytest.approx(DEPTH, abs=1e-6)
    assert kinds["/tissue_sim/plain/external_cf"] == "geometry_msgs/msg/WrenchStamped"
    assert repeated(bag[0], capsys).count("organ_pose: [") == 2, "both changes, with their ticks"
