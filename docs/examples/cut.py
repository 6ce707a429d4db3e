"""Split the lower pole of a kidney, spread both halves with two grippers, and release them."""

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

from tissue_sim import Organ, Scene, Tool

tools = [Tool(name, shape="gripper", length=0.06, mesh="config/jaws/flat.obj") for name in ("left", "right")]
scene = Scene(Organ.shipped("kidney"), tools)
points = scene.surface_positions()
out, *axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
out *= -np.sign(out[2])  # past the lower pole
(aside, front), axes, end = axes, np.stack(axes), np.max(points @ out)
pole = points[points @ out > end - 0.024] @ axes.T
middle, quarter = (0.5 * (pole.min(axis=0) + pole.max(axis=0)) - [0.004, 0]) @ axes, 0.25 * np.ptp(pole[:, 0])  # m
edge = [middle + (end + 0.005) * out + side * front for side in (-0.035, 0.035)]
print(scene.cut("kidney", edge, direction=-out, depth=0.033))
turn = Rotation.from_matrix(np.column_stack([aside, np.cross(aside, out), -out])).as_quat()
path = [(0.006, 0.04, 0.036, 1), (0.006, 0, 0.036, 400), (0.004, 0, 0.011, 600), (0.011, 0, 0.011, 800)]
surface, drawn, now = scene.simulation.cut_organ.surface, [], np.zeros(3)
for *goal, ticks in [*path, (0.011, 0.05, 0.05, 600)]:  # m aside, m outside, m between the tips of the jaws
    for beside, outside, gap in np.linspace(now, goal, ticks + 1)[1:]:
        for tool, side in zip(tools, (-1, 1), strict=True):
            place = middle + side * (quarter + beside) * aside + (end - 0.024 + outside) * out
            scene.move(tool.name, place, turn, tool.jaws.angle(gap))
        scene.step()
    now = goal
    drawn.append((surface.at(scene.simulation.positions), scene.simulation.state.body_pose.copy()))
    print(f"{1e3 * goal[0]:.0f} mm aside: {scene.wrench('left')[:3] @ aside:.2f} N on the left gripper")
figure, views = plt.subplots(1, 3, figsize=(10, 4), subplot_kw={"projection": "3d"}, layout="constrained")
for axis, (shape, jaws) in zip(views, drawn[2:], strict=True):  # held, spread, released
    shown = axis.plot_trisurf(*shape.T, triangles=surface.triangles, linewidth=0.2, edgecolor="grey", cmap="YlOrRd")
    shown.set(array=(surface.wall > 0).astype(float), clim=(-0.5, 1.5))
    for jaw in jaws:
        axis.plot(*(jaw[:3] + Rotation.from_quat(jaw[3:]).apply([[0, 0, 0], [0, 0, -0.03]])).T, color="black", lw=3)
    axis.set(xlim=(0.03, 0.11), ylim=(0, 0.08), zlim=(-0.09, -0.01))
    axis.view_init(elev=-10, azim=-100)
    axis.set_axis_off()
figure.savefig("cut.png", dpi=100)
