"""Recording of a scene: a node of its own, and a sender over DDS that advances /clock from step to step."""

from __future__ import annotations

import json
import math
import os
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from nav_msgs.msg import Path as PathMessage
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.bags.suite.scenes import STEP, Blade, Scene, Step
from tissue_sim.ros.bridge.scripted_tool import ScriptedTool
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.children import Child
from tissue_sim.ros.shared.tool_link import ToolLink

FIRST_TIME = 1.0  # s on /clock when the scene begins
PACE = 0.01  # s of wall time for each step: two contact searches fit in
QUIET = 0.5  # s of wall time before the first step and after the last, for the bag's state and its end
PATIENCE = 300.0  # s
NODE = "tissue_sim"
RATES = {"marker_rate": "2.0", "contact_rate": "250.0"}


def record(scene: Scene, organ: Organ, organ_file: Path, target: Path) -> dict[str, int]:
    """Record a scene.

    target: folder of the bag. Returns how many inputs the node refused, by kind. Raises UserError when the node ends,
    or doesn't answer.
    """
    folder = target.with_name(f"{target.name}.new")
    shutil.rmtree(folder, ignore_errors=True)
    values = {"use_sim_time": "true", "record": "true", "record_folder": json.dumps(str(folder))}
    # Paths as they are given: a bag holds its parameters, and a relative path is the same on every machine.
    values |= {"organ_file": json.dumps(str(organ_file))} | RATES | scene.as_parameters()
    words = [word for name, value in values.items() for word in ("-p", f"{name}:={value}")]
    node = Child("node", [sys.executable, "-m", "tissue_sim.ros.node.program", "--ros-args", *words], os.environ)
    try:
        with client.client_node("scene", NODE) as sender:
            refused = _Sender(sender, scene, node).play(organ)
    finally:
        node.stop()
    _keep(folder, target)
    return refused


class _Sender:
    def __init__(self, node: Node, scene: Scene, child: Child) -> None:
        self._node, self._child, self._scene = node, child, scene
        self._made = scene.made_tools()
        links = [ToolLink.by_default(tool.name, "organ") for tool in self._made]
        self._tools = [
            ScriptedTool(node, link, link_tool.has_jaws) for link, link_tool in zip(links, self._made, strict=True)
        ]
        stream = client.stream_qos()
        self._poses = node.create_publisher(PoseStamped, links[0].topics.names["measured_cp"], stream)
        forces = [f"{tool.name}/external_cf" for tool in self._made if scene.pushes]
        self._forces = [node.create_publisher(WrenchStamped, name, stream) for name in forces]
        self._clock = node.create_publisher(Clock, "/clock", QoSProfile(depth=1))
        self._reports = client.NewestMessage(node, DiagnosticArray, "/diagnostics", QoSProfile(depth=10))
        self._time = FIRST_TIME

    def play(self, organ: Organ) -> dict[str, int]:
        """Send all steps; return what was refused."""
        self._wait_for(self._is_connected)
        self._wait_for(self._reports.take)  # it ticks, so its kernels are compiled
        time.sleep(QUIET)
        self._publish_time()
        due = time.monotonic()
        for step in self._scene.steps(organ, self._made):
            due = self._cut(step.cut, due) if step.cut is not None else due
            self._send(step)
            due = self._advance(due)
        time.sleep(QUIET)
        self._reports.take_all()
        report = self._wait_for(lambda: client.physics_status(self._reports.take_all(), NODE))
        return {key: int(value) for key, value in report.items() if ".refused." in key}

    def _advance(self, due: float) -> float:
        """Let a step's time pass; return when it was over, monotonic s."""
        due = max(due + PACE, time.monotonic() + 0.5 * PACE)
        time.sleep(max(0.0, due - 0.5 * PACE - time.monotonic()))
        self._time += STEP
        self._publish_time()
        time.sleep(max(0.0, due - time.monotonic()))
        return due

    def _cut(self, blade: Blade, due: float) -> float:
        """Have the organ cut, while time passes; return when that is done, monotonic s."""
        path = PathMessage()
        path.header.frame_id = "organ"
        for point in blade.edge.tolist():
            pose = PoseStamped()
            place, turn = pose.pose.position, pose.pose.orientation
            place.x, place.y, place.z = point
            turn.x, turn.y, turn.z, turn.w = blade.pose.tolist()
            path.poses.append(pose)
        paths = self._node.create_publisher(PathMessage, f"/{NODE}/cut_path", QoSProfile(depth=1))
        service = self._node.create_client(Trigger, f"/{NODE}/cut")
        self._wait_for(lambda: paths.get_subscription_count() and service.service_is_ready())
        paths.publish(path)
        time.sleep(QUIET)
        answer = service.call_async(Trigger.Request())
        while not answer.done():
            due = self._advance(due)
            rclpy.spin_once(self._node, timeout_sec=0.0)
        if not answer.result().success:
            raise UserError(f"the organ was not cut: {answer.result().message}")
        return due

    def _is_connected(self) -> bool:
        publishers = [self._poses, self._clock, *self._forces]
        return all(tool.has_subscribers for tool in self._tools) and all(
            one.get_subscription_count() for one in publishers
        )

    def _wait_for[Answer](self, ask: Callable[[], Answer | None]) -> Answer:
        end = time.monotonic() + PATIENCE
        while not (found := ask()):
            if self._child.exit_code is not None:
                raise UserError(f"the node ended by itself, {self._child.last_words()}")
            if time.monotonic() > end:
                raise UserError(f"the node did not answer for {PATIENCE:g} s")
            time.sleep(0.02)
        return found

    def _publish_time(self) -> None:
        self._clock.publish(Clock(clock=Time(nanoseconds=self._stamp).to_msg()))

    @property
    def _stamp(self) -> int:
        return round(1e9 * self._time)

    def _send(self, step: Step) -> None:
        for tool, angle in step.angles.items():
            self._tools[tool].open(self._stamp, angle)
        if step.angles:
            time.sleep(0.2 * PACE)  # the jaws open with the next pose
        for tool, pose in step.poses.items():
            self._tools[tool].publish(self._stamp, pose)
        for tool, force in step.forces.items():
            message = WrenchStamped()
            message.header.frame_id, message.header.stamp = "organ", Time(nanoseconds=self._stamp).to_msg()
            message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = map(float, force)
            self._forces[tool].publish(message)
        for kind in step.refused:
            self._poses.publish(bad_pose(kind, self._stamp))


def bad_pose(kind: str, stamp: int) -> bytes:
    """Return a pose that the node refuses for a reason, by the name under which it counts that; stamp in ns."""
    message = PoseStamped()
    message.header.frame_id, message.header.stamp = "organ", Time(nanoseconds=stamp).to_msg()
    message.pose.position.x, message.pose.orientation.w = 0.5, 1.0
    if kind == "nan_pose":
        message.pose.position.x = math.nan
    elif kind == "zero_quaternion":
        message.pose.orientation.w = 0.0
    elif kind == "unknown_frame":
        message.header.frame_id = "elsewhere"
    elif kind == "no_stamp":
        message.header.stamp = Time(nanoseconds=0).to_msg()
    elif kind == "backward_stamp":
        message.header.stamp = Time(nanoseconds=stamp // 2).to_msg()
    elif kind == "far_pose":
        message.pose.position.x = 500.0  # millimetres
    raw = bytes(serialize_message(message))
    return raw[:-20] if kind == "malformed" else raw


def _keep(folder: Path, target: Path) -> None:
    """Replace the old bag with the one that the node wrote into a folder, under its name."""
    (bag,) = folder.iterdir()
    (data,) = bag.glob("*.mcap")
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace(data.name, f"{target.name}.mcap"))
    data.rename(bag / f"{target.name}.mcap")
    shutil.rmtree(target, ignore_errors=True)
    bag.rename(target)
    folder.rmdir()
