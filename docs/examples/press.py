"""Press a ball 10 mm into the kidney and take it out again: force over depth, and the shape at the deepest point."""

import matplotlib.pyplot as plt
import numpy as np

from tissue_sim import Organ, Scene, Tool

RADIUS, DEPTH, STEP = 0.008, 0.010, 2e-5  # m; 20 um in each tick of 1 ms are 20 mm/s

organ = Organ.shipped("kidney")
scene = Scene(organ, [Tool("finger", radius=RADIUS)])
node = np.argmax(organ.surface_positions[:, 0])  # the one farthest to the side
surface, outward = organ.surface_positions[node], organ.surface_normals[node]

way_in = np.arange(-0.002, DEPTH, STEP)
depths = np.concatenate([way_in, way_in[::-1]])  # m
forces = []
for tick, depth in enumerate(depths):
    scene.move("finger", surface + (RADIUS - depth) * outward)  # m, in the organ's frame
    scene.step()
    forces.append(scene.wrench("finger")[:3] @ outward)  # N, that pushes the hand out
    if tick == len(way_in):
        deepest = scene.surface_positions().copy()
print(f"{max(forces):.2f} N at {1e3 * DEPTH:.0f} mm")

figure = plt.figure(figsize=(9, 4), layout="constrained")
axis = figure.add_subplot(121, xlabel="depth (mm)", ylabel="force (N)")
half = len(way_in)
axis.plot(1e3 * depths[:half], forces[:half], label="in")
axis.plot(1e3 * depths[half:], forces[half:], label="out")
axis.legend()
axis = figure.add_subplot(122, projection="3d")
moved = 1e3 * np.linalg.norm(deepest - organ.surface_positions, axis=1)  # mm
shown = axis.plot_trisurf(*deepest.T, triangles=organ.surface_triangles, cmap="YlOrRd", linewidth=0.2, edgecolor="grey")
shown.set(array=moved[organ.surface_triangles].mean(axis=1), clim=(0.0, moved.max()))
figure.colorbar(shown, label="displacement (mm)", shrink=0.8)
axis.set_box_aspect(np.ptp(deepest, axis=0), zoom=1.1)
axis.view_init(elev=15, azim=20)
axis.set_axis_off()
figure.savefig("press.png", dpi=100)
