"""Two kidneys and a ligament between them: push one aside, and the other one is pulled along."""

import matplotlib.pyplot as plt
import numpy as np

from tissue_sim import Attachment, Organ, Scene, Tool, placed

kidney = Organ.shipped("kidney")
low, high = kidney.surface_positions.min(axis=0), kidney.surface_positions.max(axis=0)
organs = [kidney, placed(kidney, [high[0] - low[0] + 0.004, 0.0, 0.0])]  # m, 4 mm beside it
ligament = Attachment((0, 1), stiffness=300.0, within=0.01)  # N/m; joins nodes up to 10 mm apart, slack at rest
scene = Scene(organs, [Tool("finger", radius=0.006)], attachments=[ligament])

upper = np.flatnonzero(kidney.surface_positions[:, 2] > low[2] + 0.75 * (high[2] - low[2]))
node = upper[np.argmin(kidney.surface_positions[upper, 0])]  # of the second, on the side of the first
start = organs[1].surface_positions[node] - [0.008, 0.0, 0.0]
for tick in range(1000):
    scene.move("finger", start + [min(3e-5 * tick, 0.022), 0.0, 0.0])  # m: 20 mm into its side
    scene.step()
surfaces = [scene.surface_positions(number) for number in range(2)]
moved = [1e3 * np.linalg.norm(at - organ.surface_positions, axis=1) for at, organ in zip(surfaces, organs, strict=True)]
print(f"pushed {moved[1].max():.1f} mm, pulled along {moved[0].max():.1f} mm, {scene.wrench('finger')[0]:.2f} N")

points = np.vstack([*surfaces, start + [[0.022, 0.0, 0.0]]])
triangles = np.vstack([kidney.surface_triangles, kidney.surface_triangles + kidney.n_surface])
in_order = {"projection": "3d", "computed_zorder": False}  # the finger is drawn over the organs
figure, axis = plt.subplots(figsize=(7, 5), subplot_kw=in_order, layout="constrained")
shown = axis.plot_trisurf(*points.T, triangles=triangles, cmap="YlOrRd", linewidth=0.2, edgecolor="grey")
shown.set(array=np.hstack([*moved, 0.0])[triangles].mean(axis=1), clim=(0.0, 10.0))
axis.scatter(*points[-1], s=500, color="steelblue", depthshade=False, zorder=3)
figure.colorbar(shown, label="displacement (mm)", shrink=0.6)
axis.set_box_aspect(np.ptp(points, axis=0), zoom=1.1)
axis.view_init(elev=10, azim=-90)
axis.set_axis_off()
figure.savefig("two_organs.png", dpi=100)
