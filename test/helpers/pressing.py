"""Tools led along paths into tissue, and what is seen of them."""

import numpy as np
from scipy.spatial.transform import Rotation

from helpers.states import is_finite
from tissue_sim.contact.tools import Tool
from tissue_sim.model.contact.shapes import signed_distance

PROBE = Tool("left", radius=0.008)


def top_of(organ):
    return organ.surface_positions[top_node(organ)]


def top_node(organ):
    return int(np.argmax(organ.surface_positions[:, 2]))


def poke(simulation, ticks, force=(0.1, 0.0, -0.5)):
    """Step with a force, N, on the top node."""
    for _ in range(ticks):
        simulation.apply_force(top_node(simulation.organ), force)
        simulation.step()


def lead(scene, tool, path, hold=0):
    """One pose a tick along a path (k, 3) m, then the last one again; the forces (k + hold, 3) N."""
    path = np.atleast_2d(path)
    forces = []
    for position in [*path, *[path[-1]] * hold]:
        scene.move(tool, position)
        scene.step()
        forces.append(scene.wrenches[tool, :3].copy())
    return np.array(forces)


def line(start, end, ticks):
    fraction = np.linspace(0.0, 1.0, ticks)[:, None]
    return (1.0 - fraction) * np.asarray(start) + fraction * np.asarray(end)


def press(scene, depth, ticks=60, hold=150, tool=0, radius=None):
    """Lead a round tool from 2 mm above the organ's top node to `depth` m into where it was."""
    radius = scene.tools.shapes.size[tool, 0] if radius is None else radius
    at = top_of(scene.simulation.organ) + [0.0, 0.0, radius]
    return lead(scene, tool, line(at + [0.0, 0.0, 0.002], at - [0.0, 0.0, depth], ticks), hold)


def deepest(scene, tool=0):
    """How deep the deepest surface node or contact point lies inside a tool, m, less what its force makes it give."""
    state, n_surface = scene.simulation.state, scene.simulation.organ.n_surface
    contacts = state.contacts
    rows = np.flatnonzero(contacts.body[: contacts.header.points] == tool)
    points = np.einsum("ij,ijk->ik", contacts.weight[rows], state.position[contacts.node[rows]])
    listed = contacts.node[rows][contacts.weight[rows].max(axis=1) == 1.0][:, 0]
    others = np.delete(state.position[:n_surface], listed, axis=0)
    return max([*(depths(scene, points, tool) - given(scene)[rows]), *depths(scene, others, tool)])


def depths(scene, points, tool=0):
    """How deep points (k, 3) m lie inside a tool, (k,) m."""
    pose = scene.simulation.state.body_pose[tool]
    local = Rotation.from_quat(pose[3:]).inv().apply(points - pose[:3]) if len(points) else points
    return np.array([-signed_distance(scene.tools.shapes, tool, *point)[0] for point in local])


def given(scene):
    """What the tissue between nodes gives way by at each contact point under its force, (c,) m."""
    state, settings = scene.simulation.state, scene.simulation.settings
    points, step = int(state.contacts.header.points), settings.tick_time / max(1, int(state.status.substeps))
    soft = state.contacts.compliance[:points, 0] / settings.stiffness_scale / step
    return np.minimum(soft * state.contact_pressed[0, :points], state.contacts.most_give[:points])


def is_sound(scene):
    simulation = scene.simulation
    return is_finite(simulation) and simulation.state.count.faults == 0 and np.all(np.isfinite(scene.contacts.weight))
