"""Build an organ from an STL file, calibrate it, and press on it before and after."""

import matplotlib.pyplot as plt
import numpy as np
import trimesh

from tissue_sim import Organ, Scene, Tool, build, calibrate

# An STL file of a bean, 80 mm long; yours takes its place.
bean = trimesh.creation.icosphere(subdivisions=4).apply_scale([20.0, 24.0, 40.0])
bean.vertices[:, 0] -= 0.006 * bean.vertices[:, 2] ** 2
bean.export("bean.stl")

built = build("bean.stl", unit="mm", points=120, youngs_modulus=6000.0)  # Pa; its lowest tenth is fixed
calibrated = calibrate(built, aim="fast", cases=100, evaluations=20, smooth=4, sharp=1)  # few, to be quick
calibrated.save("bean.npz")
print(built, calibrated, sep="\n")
error = calibrated.provenance["calibration"]["held_out"]["smooth"]["mean_percent"]


def press(organ: Organ, deepest: float = 0.008) -> tuple[np.ndarray, list[float]]:
    """Return depths, m, and forces, N, of a ball that is pressed into the organ's side."""
    scene = Scene(organ, [Tool("finger", radius=0.01)])
    node = np.argmax(organ.surface_positions[:, 0])
    surface, outward = organ.surface_positions[node], organ.surface_normals[node]
    depths, forces = np.arange(-0.001, deepest, 2e-5), []
    for depth in depths:
        scene.move("finger", surface + (0.01 - depth) * outward)
        scene.step()
        forces.append(scene.wrench("finger")[:3] @ outward)
    return depths, forces


figure, axis = plt.subplots(figsize=(6, 4), layout="constrained")
for organ, label in ((built, "springs, as built"), (calibrated, f"cells, calibrated: {error:.1f} % mean error")):
    depths, forces = press(organ)
    axis.plot(1e3 * depths, forces, label=label)
axis.set(xlabel="depth (mm)", ylabel="force (N)")
axis.legend()
figure.savefig("own_organ.png", dpi=100)
