"""Cut into the lower pole of the kidney with scissors: the area of the cut while they close, and its walls."""

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

from tissue_sim import Organ, Scene, Tool

organ = Organ.shipped("kidney")
scene = Scene(organ, [Tool("scissors", shape="scissors", radius=0.0015, length=0.06, height=0.008)])
scene.simulation.settings.toughness = 30.0  # J/m^2
points = organ.surface_positions
out, aside, front = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
out *= -np.sign(out[2])  # past the lower pole
pole = points[points @ out > np.max(points @ out) - 0.025] @ np.stack([out, aside, front]).T  # its last 25 mm
low, high = pole.min(axis=0), pole.max(axis=0)
tips = np.array([low[0], *(0.5 * (low + high)[1:])]) @ [out, aside, front]  # in its middle, 25 mm deep
# z of the scissors points out of their tips, here into the pole: the hinge is 60 mm behind. The blades close along x.
turn = Rotation.from_matrix(np.column_stack([front, np.cross(-out, front), -out])).as_quat()
jaws = scene.tools.tools[0].jaws
gaps, areas = np.arange(0.045, 0.0, -4e-5), []  # m between the tips; 40 um in each tick of 1 ms are 40 mm/s
for gap in gaps:
    scene.move("scissors", tips, turn, angle=jaws.angle(gap))
    scene.step()
    areas.append(sum(cut.area for cut in scene.simulation.cuts))
print(scene.simulation.cuts[0])
figure = plt.figure(figsize=(9, 4), layout="constrained")
axis = figure.add_subplot(121, xlabel="distance between the tips (mm)", ylabel="area of the cut (mm²)")
axis.plot(1e3 * gaps, 1e6 * np.array(areas))
axis.invert_xaxis()
axis = figure.add_subplot(122, projection="3d")
surface = scene.simulation.cut_organ.surface
opened = surface.at(scene.simulation.positions)
shown = axis.plot_trisurf(*opened.T, triangles=surface.triangles, linewidth=0)
shown.set_facecolor(np.where(surface.wall[:, None] > 0, [0.6, 0.1, 0.1, 1.0], [0.9, 0.6, 0.5, 0.1]))
axis.set_box_aspect(np.ptp(opened, axis=0), zoom=1.1)
axis.view_init(elev=-10, azim=-60)
axis.set_axis_off()
figure.savefig("scissors.png", dpi=100)
