"""Pictures of a camera over ROS, and what a ray through a pixel meets."""

import numpy as np

from helpers.patience import wait_for
from tissue_sim.rendering.pinhole import look_at

EYE, GOAL = (0.12, -0.08, 0.05), (0.066, 0.039, -0.002)  # m, of a usual camera at the kidney
POSE = look_at(EYE, GOAL)
LOOKING = (f"--eye={','.join(map(str, EYE))}", f"--look-at={','.join(map(str, GOAL))}")


def stamp_of(message):
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def together(boxes):
    """One message of each topic, all of the same picture."""
    kept = {topic: {} for topic in boxes}

    def complete():
        for topic, box in boxes.items():
            kept[topic] |= {stamp_of(message): message for message in box.take_all()}
        common = set.intersection(*(set(one) for one in kept.values()))
        return {topic: one[max(common)] for topic, one in kept.items()} if common else None

    return wait_for(complete, lambda: f"no picture with all of these: { {t: len(one) for t, one in kept.items()} }")


def pixels(message):
    kind, channels = {"rgb8": (np.uint8, 3), "32FC1": (np.float32, 1), "mono8": (np.uint8, 1)}[message.encoding]
    assert message.step == message.width * channels * np.dtype(kind).itemsize
    return np.frombuffer(bytes(message.data), kind).reshape(message.height, message.width, channels).squeeze()


def first_hit(origin, direction, vertices, triangles):
    """Distance along a ray to a surface (Moeller and Trumbore, 1997); infinite where it misses."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    across = np.cross(direction, c - a)
    area = np.einsum("ij,ij->i", b - a, across)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("ij,ij->i", origin - a, across) / area
        turned = np.cross(origin - a, b - a)
        v = turned @ direction / area
        far = np.einsum("ij,ij->i", c - a, turned) / area
    return min(far[(u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (far > 0.0)], default=np.inf)
