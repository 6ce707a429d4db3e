"""Topics of a camera, or of one of a stereo pair: images in colour, distances, labels, and what the lens is."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from rclpy.publisher import Publisher

from tissue_sim.array_types import Array
from tissue_sim.rendering.offscreen import Picture
from tissue_sim.ros.camera.image_messages import COLOUR, DEPTH, LABELS, ImageTemplate, InfoTemplate, JpegTemplate
from tissue_sim.ros.camera.settings import CameraSettings
from tissue_sim.ros.camera.topic_names import COLOUR_TOPICS, DEPTH_TOPICS, LABEL_TOPICS, TOPICS
from tissue_sim.ros.shared.organ_topics import path_of
from tissue_sim.ros.shared.qos import RELIABLE

Keep = Callable[[str, int, bytes], None]  # takes a topic, a time, ns, and a message


class EyeTopics:
    """Publishers of one camera, which make only what is subscribed to or recorded.

    settings: size, lens and names; eye: left or right of a stereo pair (empty for a single camera); recorded: those of
    TOPICS that are recorded; keep: records a message.
    """

    def __init__(self, node: Node, settings: CameraSettings, eye: str, recorded: frozenset[str], keep: Keep) -> None:
        lens, frame_id = settings.lens, settings.frame_id
        self._recorded, self._keep = recorded, keep
        self._names = {topic: path_of(f"/{settings.name}", eye) + f"/{topic}" for topic in TOPICS}
        self._publishers: dict[str, Publisher] = {
            topic: node.create_publisher(kind, self._names[topic], RELIABLE) for topic, kind in TOPICS.items()
        }
        self._info = InfoTemplate(frame_id, lens, settings.baseline if eye == "right" else 0.0)
        self._images = {
            "image_raw": ImageTemplate(frame_id, lens, COLOUR),
            "depth/image_raw": ImageTemplate(frame_id, lens, DEPTH),
            "segmentation/image_raw": ImageTemplate(frame_id, lens, LABELS),
        }
        self._jpeg = JpegTemplate(frame_id, settings.quality)

    @property
    def wants(self) -> dict[str, bool]:
        """What a picture must have, as `Offscreen.take` names it."""
        groups = {"colour": COLOUR_TOPICS, "depth": DEPTH_TOPICS, "labels": LABEL_TOPICS}
        return {name: any(self._is_wanted(topic) for topic in topics) for name, topics in groups.items()}

    def send(self, stamp: int, picture: Picture) -> None:
        """Publish a picture; stamp in ns."""
        for topics, pixels in (
            (COLOUR_TOPICS, picture.colour),
            (DEPTH_TOPICS, picture.depth),
            (LABEL_TOPICS, picture.labels),
        ):
            for topic in topics:
                if pixels is not None and self._is_wanted(topic):
                    self._send(topic, stamp, pixels)

    def _is_wanted(self, topic: str) -> bool:
        return topic in self._recorded or self._publishers[topic].get_subscription_count() > 0

    def _send(self, topic: str, stamp: int, pixels: Array) -> None:
        if topic.endswith("camera_info"):
            raw = self._info.message(stamp)
        elif topic.endswith("compressed"):
            raw = self._jpeg.message(stamp, pixels)
        else:
            raw = self._images[topic].message(stamp, pixels)
        self._publishers[topic].publish(raw)
        if topic in self._recorded:
            self._keep(self._names[topic], stamp, raw)
