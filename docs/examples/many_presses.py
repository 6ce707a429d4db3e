"""Press 300 places at once, of a kidney with a tumour and of one without: the ratio of the forces shows the tumour."""

import matplotlib.pyplot as plt
import numpy as np

from tissue_sim import Organ, Scene, SceneBatch, Tool

RADIUS, DEPTH, COUNT = 0.005, 0.005, 300  # m, m, places

forces = []
for name in ("kidney", "kidney_tumour"):
    organ = Organ.shipped(name)
    nodes = np.flatnonzero(organ.surface_normals[:, 1] < -0.3)  # the front, where the tumour is
    nodes = nodes[np.linspace(0, len(nodes) - 1, COUNT).astype(int)]
    place, outward = organ.surface_positions[nodes], organ.surface_normals[nodes]
    scene = Scene(organ, [Tool("finger", radius=RADIUS)], ticks_a_set=20)  # a search for contacts every 20 ms
    batch = SceneBatch(scene, COUNT)
    print(batch)
    poses = np.zeros((COUNT, 1, 7))
    poses[..., 6] = 1.0  # quaternions xyzw
    for depth in np.linspace(-0.001, DEPTH, 15):
        poses[:, 0, :3] = place + (RADIUS - depth) * outward
        batch.move(poses)
        batch.step(20)
    forces.append(np.einsum("nx,nx->n", batch.wrenches[:, 0, :3], outward))  # N, that pushes each hand out

ratio = forces[1] / forces[0]
stiffest = 1e3 * place[ratio.argmax()]
print(f"up to {ratio.max():.2f} times the force, at {stiffest[0]:.0f}, {stiffest[1]:.0f}, {stiffest[2]:.0f} mm")
figure, axis = plt.subplots(figsize=(5, 5), layout="constrained")
shown = axis.scatter(1e3 * place[:, 0], 1e3 * place[:, 2], c=ratio, s=60, cmap="YlOrRd")
figure.colorbar(shown, label=f"force at {1e3 * DEPTH:.0f} mm with a tumour over that without")
axis.set(xlabel="x (mm)", ylabel="z (mm)", aspect="equal")
figure.savefig("many_presses.png", dpi=100)
