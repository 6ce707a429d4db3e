"""Press equally deep into tissues of different stiffness and compare the forces."""

import matplotlib.pyplot as plt
import numpy as np

from tissue_sim import Organ, Scene, Tool

RADIUS = 0.008  # m
factors = [0.25, 0.5, 1.0, 2.0, 4.0]  # times the stiffness of the kidney that ships

organ = Organ.shipped("kidney")
node = np.argmax(organ.surface_positions[:, 0])
surface, outward = organ.surface_positions[node], organ.surface_normals[node]
depths = np.linspace(-0.001, 0.008, 400)  # m, one a tick

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
highest = []
for factor in factors:
    scene = Scene(organ, [Tool("finger", radius=RADIUS)], stiffness=[factor])
    forces = []
    for depth in depths:
        scene.move("finger", surface + (RADIUS - depth) * outward)
        scene.step()
        forces.append(scene.wrench("finger")[:3] @ outward)
    highest.append(forces[-1])
    modulus = 1e-3 * factor * organ.youngs_modulus
    left.plot(1e3 * depths, forces, label=f"{modulus:g} kPa")
    print(f"{modulus:5.1f} kPa: {forces[-1]:.2f} N")

left.set(xlabel="depth (mm)", ylabel="force (N)")
left.legend(title="Young's modulus")
right.plot(1e-3 * organ.youngs_modulus * np.array(factors), highest, "o-")
right.set(xlabel="Young's modulus (kPa)", ylabel="force at 8 mm (N)")
figure.savefig("sweep.png", dpi=100)
