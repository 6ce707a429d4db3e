"""Command `tissue_sim camera`: an endoscope's pictures of a running node, as images over ROS 2."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tissue_sim import progress
from tissue_sim.errors import UserError
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.organ_topics import path_of

if TYPE_CHECKING:
    from rclpy.node import Node

    from tissue_sim.ros.camera.settings import CameraSettings
    from tissue_sim.ros.camera.viewpoint import Viewpoint

IDLE_TIME = 0.2  # s between two checks without subscribers
RECORDED = ("image_raw/compressed", "camera_info")
RECORDED_DEPTH = ("depth/image_raw", "depth/camera_info", "segmentation/image_raw", "segmentation/camera_info")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add = parser.add_argument
    add("--node", type=client.node_name, default="tissue_sim", help="name of the node that is seen")
    add("--name", type=_name, default="camera", help="name of the camera, with which its topics begin")
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--pose", type=_numbers(7), help="its pose in the organ's frame: x,y,z (m), quaternion x,y,z,w")
    place.add_argument("--eye", type=_numbers(3), help="its position in the organ's frame, x,y,z (m), with --look-at")
    place.add_argument("--pose-topic", metavar="TOPIC", help="topic of its pose, a PoseStamped")
    place.add_argument("--tf", metavar="FRAME", help="frame of tf whose pose it has")
    add("--look-at", type=_numbers(3), help="point x,y,z (m) in the organ's frame that --eye looks at")
    add(
        "--axes",
        choices=("optical", "body"),
        default="optical",
        help="axes of --pose, --pose-topic and --tf: x right, y down, z forward, or x forward, y left, z up",
    )
    add("--frame-id", help="optical frame in the images' headers (default: <name>_optical_frame)")
    add("--width", type=int, default=640, help="of the images, pixels")
    add("--height", type=int, default=480, help="of the images, pixels")
    add("--field-of-view", type=client.number(1.0, 150.0, "degrees"), default=60.0, help="across the width, degrees")
    add("--rate", type=client.number(0.1, 240.0, "Hz"), default=30.0, help="pictures per second, Hz")
    add(
        "--baseline",
        type=client.number(0.0, 0.2, "m"),
        default=0.0,
        help="distance from the left camera of a stereo pair to the right one, m; 0: one camera",
    )
    add("--quality", type=int, choices=range(1, 101), metavar="1..100", default=90, help="quality of JPEG images")
    add("--samples", type=int, choices=(1, 2, 4), default=1, help="samples of a pixel that smooth edges")
    add("--no-shadows", action="store_true", help="draw no shadows")
    add("--brightness", type=client.number(0.01, 100.0, ""), default=1.0, help="factor on the brightness")
    add(
        "--reach",
        type=client.number(0.005, 2.0, "m"),
        help="distance from the light at which tissue is exposed well, m (default: 0.12)",
    )
    add("--record", metavar="BAG", help="new folder for a bag of the compressed images")
    add("--record-depth", action="store_true", help="with --record, the images of depth and segmentation, too")
    add(
        "--nice",
        type=int,
        choices=range(20),
        metavar="0..19",
        help="niceness of its process (default: SCHED_IDLE, it runs only while no other process does)",
    )


def run(args: argparse.Namespace) -> int:
    """Publish pictures until SIGINT or SIGTERM; return 0, or 1 when a bag could not be written to its end."""
    settings = settings_of(args)
    stand_back(args.nice)
    with client.Stop() as stop, client.client_node(args.name, args.node) as node:
        from tissue_sim.ros.camera.camera import Camera

        recorded = None
        if args.record is not None:
            recorded = Path(args.record), frozenset(RECORDED + (RECORDED_DEPTH if args.record_depth else ()))
        camera = Camera(node, args.node, settings, viewpoint_of(args, node, settings), recorded)
        progress.report_by(None)
        print(
            f"/{settings.name}: {settings.lens.width} x {settings.lens.height} at {settings.rate:g} Hz, drawn by"
            f" {camera.drawn.drawn_by}; drawn when there are subscribers",
            flush=True,
        )
        period = 1.0 / settings.rate
        try:
            client.repeat(stop, lambda: period if camera.update() else min(IDLE_TIME, period))
        finally:
            camera.close()
        if camera.bag is not None and camera.bag.problem:
            sys.stderr.write(f"tissue_sim: error: {camera.bag.problem}\n")
            return 1
    return 0


def stand_back(nice: int | None) -> None:
    """Let other processes go first, before any thread is made, as each has its own priority.

    nice: niceness, 0 to 19, None for what is behind all of these: it runs while the processor has nothing else to do.
    """
    if nice is None:
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    else:
        os.nice(nice)


def settings_of(args: argparse.Namespace) -> CameraSettings:
    """Return the camera that the arguments describe.

    Raises UserError when they don't fit together, or nothing can be drawn.
    """
    try:
        from tissue_sim.rendering.offscreen import Light
        from tissue_sim.ros.camera.settings import CameraSettings
    except ImportError as error:
        raise UserError(f"the camera needs {error.name}: pip install 'tissue_sim[camera]'") from None
    from tissue_sim.rendering.pinhole import Pinhole

    if (args.eye is None) != (args.look_at is None):
        raise UserError("--eye and --look-at belong together; give both")
    if args.record_depth and args.record is None:
        raise UserError("--record-depth chooses what --record writes; name a bag with --record")
    if args.record is not None and Path(args.record).exists():
        raise UserError(f"{args.record} is there already; name a new folder with --record")
    usual = Light()
    return CameraSettings(
        name=path_of(args.node.rpartition("/")[0], args.name).strip("/"),
        frame_id=args.frame_id or f"{args.name}_optical_frame",
        lens=Pinhole.of_view(args.width, args.height, args.field_of_view),
        light=Light(
            reach=args.reach or usual.reach,
            exposure=args.brightness * usual.exposure,
            shadows=not args.no_shadows,
        ),
        rate=args.rate,
        baseline=args.baseline,
        quality=args.quality,
        samples=args.samples,
    )


def viewpoint_of(args: argparse.Namespace, node: Node, settings: CameraSettings) -> Viewpoint:
    """Return the source of the camera's pose that the arguments choose."""
    from tissue_sim.rendering.pinhole import look_at
    from tissue_sim.ros.camera.viewpoint import AXES, Fixed, FromTf, FromTopic
    from tissue_sim.ros.shared.frames import Transform

    axes = AXES[args.axes]
    if args.pose_topic is not None:
        return FromTopic(node, args.pose_topic, axes, lambda line: print(line, file=sys.stderr, flush=True))
    if args.tf is not None:
        return FromTf(node, args.tf, axes)
    if args.eye is not None:
        return Fixed(settings.lens, look_at(args.eye, args.look_at))
    if args.pose is None:
        return Fixed(settings.lens)
    try:
        placed = Transform.of_pose(args.pose).after(axes)
    except ValueError as error:
        raise UserError(f"--pose {error}") from None
    return Fixed(settings.lens, np.array([*placed.translation, *placed.rotation]))


def _name(text: str) -> str:
    """Convert an argument to a name without a namespace: the camera is in that of the node."""
    if not (text.isidentifier() and text.isascii()):
        raise argparse.ArgumentTypeError(f"'{text}' is not a name ({client.WANTED})")
    return text


def _numbers(count: int) -> Callable[[str], tuple[float, ...]]:
    """Return an argparse type: so many numbers, separated by commas."""

    def convert(text: str) -> tuple[float, ...]:
        try:
            found = tuple(float(word) for word in text.split(","))
        except ValueError:
            found = ()
        if len(found) != count or not np.isfinite(found).all():
            raise argparse.ArgumentTypeError(f"'{text}' is not {count} numbers with commas between them")
        return found

    return convert
