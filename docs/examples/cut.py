"""Cut a kidney, pull the lips apart with two fingers, and release them."""

import matplotlib.pyplot as plt
import numpy as np

from tissue_sim import Organ, Scene, Tool

scene = Scene(Organ.shipped("kidney"), [Tool("left", radius=0.005), Tool("right", radius=0.005)])
edge = np.array([[0.055, 0.0, 0.0], [0.075, 0.0, 0.0]])  # m, beside the lateral side
print(scene.cut("kidney", edge, direction=[0.0, 1.0, 0.0], depth=0.03))

sides = {"left": np.array([0.0, 0.0, -1.0]), "right": np.array([0.0, 0.0, 1.0])}
near = np.linalg.norm(scene.surface_positions()[:, [0, 2]] - edge.mean(axis=0)[[0, 2]], axis=1) < 0.01
front = edge.mean(axis=0) * [1, 0, 1] + [0.0, scene.surface_positions()[near, 1].min() - 0.005, 0.0]  # touches
path = [(-0.004, 0.007, 1), (0.005, 0.007, 400), (0.005, 0.02, 600), (-0.03, 0.03, 400)]
surface, drawn = scene.simulation.cut_organ.surface, []
before = path[0]
for depth, apart, ticks in path:  # m into the tissue, m from the cut
    for share in np.arange(1, ticks + 1) / ticks:
        into, aside = before[0] + share * (depth - before[0]), before[1] + share * (apart - before[1])
        for name, side in sides.items():
            scene.move(name, front + [0.0, into, 0.0] + aside * side)
        scene.step()
    drawn.append(surface.at(scene.simulation.positions))
    before = depth, apart
    print(f"fingers {1e3 * apart:.0f} mm from the cut: {np.round(scene.wrench('left')[:3], 3)} N on the left one")

figure, axes = plt.subplots(1, 3, figsize=(10, 4), subplot_kw={"projection": "3d"}, layout="constrained")
for axis, title, points in zip(axes, ("pressed", "pulled apart", "released"), drawn[1:], strict=True):
    shown = axis.plot_trisurf(*points.T, triangles=surface.triangles, linewidth=0.2, edgecolor="grey", cmap="YlOrRd")
    shown.set(array=(surface.wall > 0).astype(float), clim=(-0.5, 1.5))
    axis.set(title=title, xlim=(0.045, 0.085), ylim=(-0.05, -0.01), zlim=(-0.02, 0.02))
    axis.view_init(elev=10, azim=-80)
    axis.set_axis_off()
figure.savefig("cut.png", dpi=100)
