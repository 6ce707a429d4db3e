"""Press a knife into the kidney until it cuts, and draw it out: force over depth, and the cut that it leaves."""

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

from tissue_sim import Organ, Scene, Tool

LENGTH, DEPTH, STEP = 0.02, 0.022, 4e-5  # m; 40 um in each tick of 1 ms are 40 mm/s

organ = Organ.shipped("kidney")
scene = Scene(organ, [Tool("knife", shape="blade", radius=0.0015, length=LENGTH, height=0.012)])
scene.simulation.settings.toughness = 75.0  # J/m^2
# The edge runs along -z of the knife, here the organ's z, and cuts towards its x, here the organ's y.
turn = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]).as_quat()
start = np.array([0.0705, 0.0149, -0.011])
way_in = np.arange(-0.002, DEPTH, STEP)
forces = []
for tick, depth in enumerate([*way_in, *way_in[::-1]]):
    scene.move("knife", start + [0.0, depth, 0.0], turn)
    scene.step()
    forces.append(-scene.wrench("knife")[1])  # N, that resists the cut
    if tick == len(way_in):
        cut = scene.simulation.cut_organ
        opened = cut.surface.at(scene.simulation.positions)
print(scene.simulation.cuts[0])
falls = [1.0 - min(forces[at : at + 11]) / forces[at] for at in range(len(way_in) - 10) if forces[at] > 1.0]
print(f"{max(forces):.1f} N at most, which fall by up to {100.0 * max(falls):.0f} % within 10 ms")
figure = plt.figure(figsize=(9, 4), layout="constrained")
axis = figure.add_subplot(121, xlabel="depth (mm)", ylabel="force (N)")
for name, part in (("in", forces[: len(way_in)]), ("out", forces[: len(way_in) - 1 : -1])):
    axis.plot(1e3 * way_in, part, label=name)
axis.legend()
axis = figure.add_subplot(122, projection="3d")
shown = axis.plot_trisurf(*opened.T, triangles=cut.surface.triangles, linewidth=0.1, edgecolor="grey")
shown.set_facecolor(np.where(cut.surface.wall[:, None] > 0, [0.6, 0.1, 0.1, 1.0], [0.9, 0.6, 0.5, 1.0]))
axis.set_box_aspect(np.ptp(opened, axis=0), zoom=1.0)
axis.view_init(elev=-15, azim=-75)
axis.set_axis_off()
figure.savefig("blade.png", dpi=100)
