"""Read a recorded bag as NumPy arrays: a gripper's motion and the force on the hand."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from tissue_sim import read_bag

bag = read_bag(Path(__file__).resolve().parents[2] / "bags" / "gripper")
print(bag)  # every array with its shape and unit

force, position, angle = bag["left/force"], bag["left/position"], bag["left/angle"]
(organ,) = bag.organs.values()
(surface,) = (series for name, series in bag.items() if name.endswith("/surface"))
moved = np.linalg.norm(surface.values - organ.surface_positions, axis=2).max(axis=1)  # (k,) m

rows = [
    (position.time, 1e3 * (position.values - position.values[0]), "tool moved (mm)"),
    (angle.time, np.degrees(angle.values), "jaws (degrees)"),
    (force.time, force.values, "force (N)"),
    (surface.time, 1e3 * moved, "surface moved (mm)"),
]
figure, axes = plt.subplots(len(rows), figsize=(8, 7), sharex=True, layout="constrained")
for axis, (time, values, label) in zip(axes, rows, strict=True):
    lines = axis.plot(time, values)
    axis.set_ylabel(label)
    if len(lines) == 3:
        axis.legend(lines, "xyz", loc="upper left")
axes[-1].set_xlabel("simulated time (s)")
figure.savefig("bag_arrays.png", dpi=100)
