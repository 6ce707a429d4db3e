"""An organ of 20,000 points reaches its viewers."""

import itertools
import os
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from rclpy.qos import qos_profile_sensor_data
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from visualization_msgs.msg import MarkerArray

from helpers.patience import LIMIT
from helpers.ros.clients import LATCHED, Client
from helpers.ros.processes import UNHURRIED, start_node
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.topology import assemble_organ
from tissue_sim.ros.shared.client import cloud_array
from tissue_sim.ros.shared.dds import PROFILE_VARIABLES

FREQUENCY = 45  # pieces that an edge of the icosahedron is cut into: 10 f^2 + 2 points


@pytest.mark.parametrize("reach", ["LOCALHOST", "SUBNET"])
def test_the_profile_gives_large_shared_memory(reach):
    """Fast DDS reads the file, and drops what it doesn't understand without an error: look at what it made."""
    code = (
        "import os, time; before = set(os.listdir('/dev/shm'))\n"
        "from tissue_sim.ros.shared.client import client_node\n"
        "with client_node('x', 'x'):\n"
        "    print(max(os.path.getsize('/dev/shm/' + f) for f in set(os.listdir('/dev/shm')) - before))\n"
    )
    environment = {key: value for key, value in os.environ.items() if key not in PROFILE_VARIABLES}
    environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = reach
    made = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=LIMIT, check=False
    )
    assert int(made.stdout.split()[-1]) > 16e6, made.stderr


def geodesic_sphere(frequency: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (10 f^2 + 2, 3) and triangles of a unit sphere."""
    solid = trimesh.creation.icosahedron()
    lattice = [(i, j) for i in range(frequency + 1) for j in range(frequency + 1 - i)]
    index = {place: number for number, place in enumerate(lattice)}
    weights = np.array([(i, j, frequency - i - j) for i, j in lattice]) / frequency
    local = [
        triangle
        for i, j in index
        if i + j < frequency
        for triangle in (
            [(index[i, j], index[i + 1, j], index[i, j + 1])]
            + ([(index[i + 1, j], index[i + 1, j + 1], index[i, j + 1])] if i + j < frequency - 1 else [])
        )
    ]
    points = np.concatenate([weights @ solid.vertices[face] for face in solid.faces])
    faces = np.concatenate([np.array(local) + k * len(weights) for k in range(len(solid.faces))])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    _, first, which = np.unique(points.round(6), axis=0, return_index=True, return_inverse=True)
    mesh = trimesh.Trimesh(points[first], which.ravel()[faces], process=False)
    mesh.fix_normals()
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def large_organ() -> Organ:
    """An egg of 20,252 points and 12 atoms, 10 cm long."""
    points, triangles = geodesic_sphere(FREQUENCY)
    atoms = np.linspace(-0.035, 0.035, 12)
    return assemble_organ(
        name="egg",
        surface_positions=points * (0.03, 0.02, 0.05),
        surface_triangles=triangles,
        atom_positions=np.stack([0 * atoms, 0 * atoms, atoms], axis=1),
        atom_radius=np.full(12, 0.015),
        atom_parent=np.arange(-1, 11),
        fixed=np.flatnonzero(points[:, 1] > 0.9),
    )


def client_points(raw: bytes) -> np.ndarray:
    return cloud_array(deserialize_message(raw, PointCloud2))


@pytest.mark.slow
def test_a_large_organ_reaches_its_viewers_whole(tmp_path):
    organ = large_organ()
    assert 20_000 <= organ.n_surface <= 21_000
    organ.save(tmp_path / "egg.npz")
    # Soft tissue needs fewer substeps: what is tested is what is sent.
    words = [
        f"organ_file:={tmp_path / 'egg.npz'}",
        "tools:=[left]",
        "stiffness_scale:=0.02",
        "marker_rate:=20.0",
        UNHURRIED,
    ]
    node = start_node(tmp_path, *words)
    client = Client(markers=False)
    received = {"mesh": [], "markers": [], "surface": []}
    try:
        for name, kind, qos in (
            ("mesh", Mesh, LATCHED),
            ("markers", MarkerArray, LATCHED),
            ("surface", PointCloud2, qos_profile_sensor_data),
        ):
            client.node.create_subscription(kind, f"/tissue_sim/{name}", received[name].append, qos, raw=True)
        assert client.spin_until(lambda: all(received.values())), {k: len(v) for k, v in received.items()}
        assert len(deserialize_message(received["mesh"][0], Mesh).vertices) == organ.n_surface
        cloud = deserialize_message(received["surface"][0], PointCloud2)
        assert cloud.width == organ.n_surface
        assert len(received["markers"][0]) > 72 * len(organ.surface_triangles)
        # In motion: what is sent arrives, whole.
        top = np.array([0.0, -0.02, 0.0])
        for fraction in np.linspace(0.0, 1.0, 100):
            client.ask(top + [0.0, -0.008 + 0.012 * fraction, 0.0])
        rest = client_points(received["surface"][0])
        for name in ("markers", "surface"):
            received[name].clear()
        pressed = itertools.count()

        def moves():
            client.ask(top + [0.0, 0.004 + 0.001 * np.sin(0.05 * next(pressed)), 0.0])
            return min(len(received["markers"]), len(received["surface"])) > 20

        assert client.spin_until(moves), {name: len(found) for name, found in received.items()}
        assert len(received["markers"][-1]) > 72 * len(organ.surface_triangles)
        moved = client_points(received["surface"][-1])
        assert len(moved) == organ.n_surface
        assert np.abs(moved - rest).max() > 1e-3
    finally:
        client.close()
        assert node.stop() == 0, node.text()
