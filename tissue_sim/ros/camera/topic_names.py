"""Names of a camera's topics below its own name, and the names of its nodes; they need no library that draws."""

from __future__ import annotations

from sensor_msgs.msg import CameraInfo, CompressedImage, Image

# By what a picture must have for them, with the classes of the messages.
COLOUR_TOPICS: dict[str, type] = {
    "image_raw": Image,
    "image_raw/compressed": CompressedImage,
    "camera_info": CameraInfo,
}
DEPTH_TOPICS: dict[str, type] = {"depth/image_raw": Image, "depth/camera_info": CameraInfo}
LABEL_TOPICS: dict[str, type] = {"segmentation/image_raw": Image, "segmentation/camera_info": CameraInfo}
TOPICS = COLOUR_TOPICS | DEPTH_TOPICS | LABEL_TOPICS
POSE = "pose"  # a PoseStamped, of a stereo pair one
EYES = ("left", "right")  # of a stereo pair
CAMERA = "camera"  # name of a camera, unless another one is chosen
NODES = ("", "_parameters", "_tf")  # ends of the names of its nodes
