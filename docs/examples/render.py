"""See a scene without ROS: two fingers open a cut, as pictures of an endoscope."""

import matplotlib.pyplot as plt
import numpy as np

from tissue_sim import Organ, Scene, Tool

scene = Scene(Organ.shipped("kidney"), [Tool("left", radius=0.005), Tool("right", radius=0.005)])
edge = np.array([[0.055, 0.0, 0.0], [0.075, 0.0, 0.0]])  # m
print(scene.cut("kidney", edge, direction=[0.0, 1.0, 0.0], depth=0.03))
camera = [0.066, -0.045, 0.012, -0.766, 0.0, 0.0, 0.643]  # m and quaternion xyzw: from the front, a little from above

near = np.linalg.norm(scene.surface_positions()[:, [0, 2]] - edge.mean(axis=0)[[0, 2]], axis=1) < 0.01
front = np.array([0.065, scene.surface_positions()[near, 1].min() - 0.005, 0.0])  # where the fingers touch
path = [(-0.004, 0.006, 1), (0.008, 0.006, 500), (0.008, 0.020, 600), (-0.02, 0.030, 400)]
before, pictures = path[0], []
for depth, apart, ticks in path:  # m into the tissue, m from the cut
    for fraction in np.arange(1, ticks + 1) / ticks:
        into, aside = before[0] + fraction * (depth - before[0]), before[1] + fraction * (apart - before[1])
        scene.move("left", front + [0.0, into, -aside])
        scene.move("right", front + [0.0, into, aside])
        scene.step()
    before = depth, apart
    pictures.append(scene.render(480, 480, camera))  # scene.show() opens the same on a page, to turn with the mouse
    print(f"{scene.time:.1f} s: fingers {2e3 * apart:.0f} mm apart, mean colour {pictures[-1].mean():.1f}")
plt.imsave("render.png", np.hstack(pictures[1:]))
