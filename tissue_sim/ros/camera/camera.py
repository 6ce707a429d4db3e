"""The camera's work for each picture: take the newest of everything, draw it, publish what has subscribers."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile

from tissue_sim.array_types import Floats
from tissue_sim.json_types import JsonObject
from tissue_sim.rendering.offscreen import Offscreen
from tissue_sim.rendering.pinhole import beside
from tissue_sim.ros.camera.bag import CameraBag
from tissue_sim.ros.camera.seen_scene import FIRST_ORGAN, SeenLigaments, SeenOrgan, SeenTools
from tissue_sim.ros.camera.settings import CameraSettings
from tissue_sim.ros.camera.topic_names import POSE, TOPICS
from tissue_sim.ros.camera.topics import EyeTopics
from tissue_sim.ros.camera.viewpoint import Viewpoint
from tissue_sim.ros.node.input.tf_lookup import tf_installed
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.messages import NumbersTemplate
from tissue_sim.ros.shared.node_parameters import NodeParameters
from tissue_sim.ros.shared.organ_topics import path_of
from tissue_sim.ros.shared.parameter_specs import ORGANS
from tissue_sim.ros.shared.qos import RELIABLE
from tissue_sim.ros.shared.tool_messages import N_POSE

REPORT_EVERY = 1.0  # s
SECOND = 1_000_000_000  # ns


class Camera:
    """A camera beside the node `target`; `update` is called for each picture.

    settings: the camera; viewpoint: where it is; bag: folder of a bag, and those of TOPICS that it holds, of each eye.
    """

    def __init__(
        self,
        node: Node,
        target: str,
        settings: CameraSettings,
        viewpoint: Viewpoint,
        bag: tuple[Path, frozenset[str]] | None = None,
    ) -> None:
        self._node, self._target, self._settings, self._viewpoint = node, target, settings, viewpoint
        recorded = bag[1] if bag is not None else frozenset[str]()
        self._pose_topic = f"/{settings.name}/{POSE}"
        self.drawn = Offscreen(settings.lens, settings.light, settings.samples)
        self.bag = None if bag is None else CameraBag(bag[0], self._bagged(recorded))
        keep = self.bag.keep if self.bag is not None else _forget
        self._eyes = [EyeTopics(node, settings, eye, recorded, keep) for eye in settings.eyes]
        self._poses = node.create_publisher(PoseStamped, self._pose_topic, RELIABLE)
        self._pose_template: NumbersTemplate | None = None
        self._own_reports = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._reports = client.NewestMessage(node, DiagnosticArray, "/diagnostics", QoSProfile(depth=10))
        self._registrations: str | None = None
        self._parameters = NodeParameters(node, target)
        self._organs = [SeenOrgan(node, self.drawn, target, "", FIRST_ORGAN)]
        self._tools = SeenTools(node, self.drawn, target)
        self._ligaments = SeenLigaments(node, self.drawn, target)
        self._broadcast: TfBroadcast | None = None
        if tf_installed():
            from tissue_sim.ros.node.output.tf_broadcast import TfBroadcast

            self._broadcast = TfBroadcast(node)
        self._frame_id = ""
        self._stamp, self._stamped = 0, 0.0  # ns, of the newest surface; monotonic s, when it came
        self.pictures, self._took = 0, [0.0]  # s that the pictures since the last report took
        self._reported = time.monotonic()

    def update(self) -> bool:
        """Take what has come; draw and publish what is wanted; return whether anything was."""
        began = time.monotonic()
        self._take(began)
        self._report(began)
        wanted = [eye.wants for eye in self._eyes]
        if not any(any(wants.values()) for wants in wanted):
            return False
        rest = [one.rest for one in self._organs if one.rest is not None]
        if len(rest) < len(self._organs) or not self._stamp:
            return False
        pose = self._viewpoint.pose(np.concatenate(rest))
        if pose is None:
            return False
        # The state that is seen, or at rest, when nothing new comes, so much later.
        stamp = self._stamp + (0 if self._stamped == began else round((began - self._stamped) * SECOND))
        for number, (eye, wants) in enumerate(zip(self._eyes, wanted, strict=True)):
            if any(wants.values()):
                seen_from = beside(pose, self._settings.baseline) if number else pose
                eye.send(stamp, self.drawn.take(seen_from, **wants))
        self._report_pose(stamp, pose)
        self.pictures += 1
        self._took.append(time.monotonic() - began)
        return True

    def close(self) -> None:
        """Free the memory of the graphics processor, and end the bag."""
        self.drawn.close()
        if self.bag is not None:
            self.bag.close()

    # inside --------------------------------------------------------------------------------------
    def _bagged(self, recorded: frozenset[str]) -> dict[str, type]:
        below = [path_of(f"/{self._settings.name}", eye) for eye in self._settings.eyes]
        found = {f"{base}/{topic}": TOPICS[topic] for base in below for topic in TOPICS if topic in recorded}
        return found | {self._pose_topic: PoseStamped}

    def _take(self, now: float) -> None:
        """Take what has come of organs, tools and parameters."""
        values = self._parameters.poll()
        if values is not None:
            self._use(values)
        for organ in self._organs:
            if organ.take():
                self._stamp, self._stamped, self._frame_id = organ.stamp, now, organ.frame_id
        self._tools.take()
        self._ligaments.take()

    def _use(self, values: JsonObject) -> None:
        names = tuple(values.get(ORGANS, ())) or ("",)
        if names != tuple(one.name for one in self._organs):
            for one in self._organs:
                one.remove()
            self._organs = [
                SeenOrgan(self._node, self.drawn, self._target, name, FIRST_ORGAN + number)
                for number, name in enumerate(names)
            ]
        self._tools.use(values.get("tools", ()))
        self._viewpoint.use(values)

    def _report_pose(self, stamp: int, pose: Floats) -> None:
        """Publish where the picture was taken from, and the frame on tf, where that is installed."""
        if self._pose_template is None:
            self._pose_template = NumbersTemplate(PoseStamped(), N_POSE, self._frame_id)
        raw = self._pose_template.message(stamp, pose)
        self._poses.publish(raw)
        if self.bag is not None:
            self.bag.keep(self._pose_topic, stamp, raw)
        if self._broadcast is not None:
            self._broadcast.move(stamp, {self._settings.frame_id: (self._frame_id, pose.tolist())})

    def _report(self, now: float) -> None:
        """Ask for the parameters again where the organ was registered again; publish how the pictures go."""
        lasted = now - self._reported
        if lasted < REPORT_EVERY:
            return
        status = client.newest_status(self._reports.take_all(), self._target)
        if status is not None:
            registrations = {item.key: item.value for item in status.values}.get("registrations")
            if registrations != self._registrations and self._registrations is not None:
                self._parameters.ask()
            self._registrations = registrations
        rate, mean = (len(self._took) - 1) / lasted, sum(self._took) / max(len(self._took) - 1, 1)
        values = {"rate_hz": f"{rate:.1f}", "picture_ms": f"{1e3 * mean:.2f}", "pictures": str(self.pictures)}
        values["drawn_by"] = self.drawn.drawn_by
        own = DiagnosticStatus(name=f"{self._settings.name}: pictures", message="running" if rate else "idle")
        own.values = [KeyValue(key=key, value=value) for key, value in values.items()]
        message = DiagnosticArray(status=[own])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._own_reports.publish(message)
        self._took, self._reported = [0.0], now


def _forget(topic: str, stamp: int, message: bytes) -> None:
    """Record nothing."""
