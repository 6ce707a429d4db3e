"""Watches a node as the viewer does, in small: says when the mesh is there, and when enough surfaces have come.

Arguments: how many surfaces that differ to wait for.
"""

import sys
from pathlib import Path

import numpy as np
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh

sys.path.insert(0, str(Path(__file__).parents[2]))
from helpers.patience import wait_for
from tissue_sim.ros.shared import client

with client.client_node("watcher", "tissue_sim") as node:
    meshes = client.NewestMessage(node, Mesh, "/tissue_sim/mesh", client.latched_qos())
    surfaces = client.NewestMessage(node, PointCloud2, "/tissue_sim/surface", client.stream_qos())
    print(f"mesh {len(wait_for(meshes.take, 'no mesh').vertices)} points", flush=True)
    newest = np.zeros(0)
    for _ in range(int(sys.argv[1])):

        def one_more(before: np.ndarray = newest) -> np.ndarray | None:
            message = surfaces.take()
            found = None if message is None else client.cloud_array(message)
            return None if found is None or np.array_equal(found, before) else [found]

        (newest,) = wait_for(one_more, "no surface moves any more")
    print(f"{sys.argv[1]} surfaces", flush=True)
