"""Watches a node as the viewer does, in small: prints when the mesh was there, and how many surfaces come a second.

Arguments: seconds to watch.
"""

import sys
import time

from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh

from tissue_sim.ros.shared import client

with client.client_node("watcher", "tissue_sim") as node:
    meshes = client.Inbox(node, Mesh, "/tissue_sim/mesh", client.latched_qos())
    surfaces = client.Inbox(node, PointCloud2, "/tissue_sim/surface", client.stream_qos())
    began = time.monotonic()
    mesh = None
    while mesh is None and time.monotonic() < began + 40.0:
        mesh = meshes.take()
        time.sleep(0.01)
    print(f"mesh {0 if mesh is None else len(mesh.vertices)} points after {time.monotonic() - began:.2f} s", flush=True)
    surfaces.take()
    count, first = 0, time.monotonic()
    while time.monotonic() < first + float(sys.argv[1]):
        count += surfaces.take() is not None
        time.sleep(0.004)
    print(f"rate {count / (time.monotonic() - first):.1f}", flush=True)
