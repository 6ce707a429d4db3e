"""Export a bag to VTU frames, and draw some of them; ParaView opens `nip.pvd` as an animation."""

import subprocess
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import matplotlib.pyplot as plt
import meshio
import numpy as np

BAG = Path(__file__).resolve().parents[2] / "bags" / "nip"

subprocess.run(["tissue_sim", "export", str(BAG), "nip.pvd", "--every", "100"], check=True)
frames: dict[float, list[str]] = {}  # files of each time
for entry in ElementTree.parse("nip.pvd").iter("DataSet"):
    frames.setdefault(float(entry.attrib["timestep"]), []).append(entry.attrib["file"])

times = sorted(frames)
chosen = [times[round(fraction * (len(times) - 1))] for fraction in (0.0, 0.25, 0.5, 0.75)]
colours = plt.get_cmap("YlOrRd").with_extremes(bad="steelblue")  # bad: of tools, which have no displacement
figure, axes = plt.subplots(1, 4, figsize=(11, 3.5), subplot_kw={"projection": "3d"}, layout="constrained")
for axis, time in zip(axes, chosen, strict=True):
    points, triangles, moved = np.zeros((0, 3)), [], []
    for file in frames[time]:
        mesh = meshio.read(file)
        triangles.append(mesh.cells_dict["triangle"] + len(points))
        points = np.vstack([points, mesh.points])
        moved.append(np.linalg.norm(mesh.point_data.get("displacement_m", np.full_like(mesh.points, np.nan)), axis=1))
    corners = np.vstack(triangles)
    shown = axis.plot_trisurf(*points.T, triangles=corners, cmap=colours, linewidth=0.2, edgecolor="grey")
    shown.set(array=1e3 * np.hstack(moved)[corners].mean(axis=1), clim=(0.0, 8.0))
    axis.set_title(f"{time:.1f} s")
    axis.set_box_aspect(np.ptp(points, axis=0), zoom=1.0)
    axis.view_init(elev=15, azim=-60)
    axis.set_axis_off()
figure.colorbar(shown, ax=axes, label="displacement (mm)", shrink=0.6)
figure.savefig("frames.png", dpi=100)
