"""Stands in for the node where a test is about a program beside it: a ball with a moving bump, and its services.

Arguments: --record-folder DIR (default: no bag is named), --smaller (another organ),
--dies-after S, --still (the bump does not move). Runs until SIGINT or SIGTERM.
"""

import argparse
import signal
import sys
import time
from pathlib import Path

import numpy as np
import rclpy
import trimesh
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, PoseStamped, WrenchStamped
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import PointCloud2, PointField
from shape_msgs.msg import Mesh, MeshTriangle
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker, MarkerArray

STREAM = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def ball(smaller: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) m and triangles (t, 3) of an egg, 10 cm long."""
    mesh = trimesh.creation.icosphere(subdivisions=2 if smaller else 3, radius=1.0)
    return np.asarray(mesh.vertices) * (0.03, 0.02, 0.05), np.asarray(mesh.faces)


def cloud(columns: np.ndarray) -> PointCloud2:
    names = ("x", "y", "z", "radius", "parent")[: columns.shape[1]]
    return PointCloud2(
        height=1,
        width=len(columns),
        fields=[PointField(name=n, offset=4 * i, datatype=PointField.FLOAT32, count=1) for i, n in enumerate(names)],
        point_step=4 * columns.shape[1],
        row_step=4 * columns.size,
        data=columns.astype("<f4").tobytes(),
        is_dense=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--record-folder")
    parser.add_argument("--smaller", action="store_true")
    parser.add_argument("--still", action="store_true")
    parser.add_argument("--dies-after", type=float)
    args, _ = parser.parse_known_args()
    stop = []
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.append(True))
    node = rclpy.create_node("tissue_sim")
    vertices, triangles = ball(args.smaller)
    mesh = node.create_publisher(Mesh, "~/mesh", LATCHED)
    mesh.publish(
        Mesh(
            vertices=[Point(x=x, y=y, z=z) for x, y, z in vertices.tolist()],
            triangles=[MeshTriangle(vertex_indices=row) for row in triangles.astype(np.uint32)],
        )
    )
    surface = node.create_publisher(PointCloud2, "~/surface", STREAM)
    skeleton = node.create_publisher(PointCloud2, "~/skeleton", STREAM)
    tools = node.create_publisher(MarkerArray, "~/tools", STREAM)
    report = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
    recording = ""
    if args.record_folder:
        recording = str(Path(args.record_folder) / "bag")
        Path(recording).mkdir(parents=True)
    force = {"left": 0.0, "right": 0.0}
    poses = {"left": 0, "right": 0}
    places = {}

    def answer(tool, publisher):
        def on_pose(pose):
            poses[tool] += 1
            places[tool] = pose.pose.position
            wrench = WrenchStamped(header=pose.header)
            force[tool] = 0.5 if abs(pose.pose.position.y) < 0.024 else 0.0
            wrench.wrench.force.y = -force[tool]
            publisher.publish(wrench)

        return on_pose

    for tool in force:
        servo = node.create_publisher(WrenchStamped, f"{tool}/servo_cf", STREAM)
        node.create_subscription(PoseStamped, f"{tool}/measured_cp", answer(tool, servo), STREAM)

    def on_reset(_, response):
        response.success, response.message = True, "the organ was reset to rest"
        return response

    def on_record(request, response):
        response.success, response.message = request.data, "/tmp/bag" if request.data else "nothing was being recorded"
        return response

    node.create_service(Trigger, "~/reset", on_reset)
    node.create_service(SetBool, "~/record", on_record)
    started = time.monotonic()

    def show():
        phase = 0.0 if args.still else 2.0 * (time.monotonic() - started)
        centre = np.array([0.0, -0.02, 0.02 * np.sin(phase)])
        near = np.exp(-np.sum((vertices - centre) ** 2, axis=1) / (2 * 0.01**2))
        surface.publish(cloud(vertices + near[:, None] * (0.0, 0.012, 0.0)))
        atoms = np.linspace(-0.04, 0.04, 12)
        skeleton.publish(
            cloud(np.stack([0 * atoms, 0 * atoms, atoms, 0 * atoms + 0.01, np.arange(-1, len(atoms) - 1)], axis=1))
        )

        markers = []
        for tool in force:
            place = places.get(tool, Point())
            action = Marker.ADD if tool in places else Marker.DELETE
            sphere = Marker(ns=tool, type=Marker.SPHERE, action=action)
            sphere.scale.x = sphere.scale.y = sphere.scale.z = 0.01
            sphere.pose.position = place
            end = Point(x=place.x, y=place.y - 0.03 * force[tool], z=place.z)
            action = Marker.ADD if force[tool] else Marker.DELETE
            markers += [sphere, Marker(ns=tool, id=1, type=Marker.ARROW, action=action, points=[place, end])]
        tools.publish(MarkerArray(markers=markers))

    def tell():
        values = {
            "tick_rate_hz": 1000.0,
            "tick_p50_us": 210.0,
            "tick_p99_us": 480.0,
            "overruns": 3,
            "active_nodes": 642,
            "contact_count": 7,
            "force_n": sum(force.values()),
            "recording": recording,
            "region": "whole",
            **{f"{tool}.state": "fresh" if poses[tool] else "none" for tool in force},
            **{f"{tool}.force_n": force[tool] for tool in force},
        }
        status = DiagnosticStatus(name="tissue_sim: physics", message="running")
        status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        report.publish(DiagnosticArray(status=[status]))

    node.create_timer(1 / 60, show)
    node.create_timer(0.5, tell)
    print("up", flush=True)
    while not stop:
        rclpy.spin_once(node, timeout_sec=0.05)
        if args.dies_after is not None and time.monotonic() - started > args.dies_after:
            sys.exit("stand_in: error: the disk is on fire")
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
