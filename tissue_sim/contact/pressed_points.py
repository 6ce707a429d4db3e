"""Contact points that press on the tissue at present: their places, and the normals of the tools there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.contact.gap import gap_and_normal
from tissue_sim.model.contact.poses import set_frame
from tissue_sim.model.data.shapes import Shapes
from tissue_sim.model.data.state import State


class PressedPoints(NamedTuple):
    """Points of k contacts that press on the tissue."""

    entries: Longs  # (k,) of the contact set
    bodies: Longs  # (k,) bodies that they touch
    places: Floats  # (k, 3) m
    normals: Floats  # (k, 3) of the bodies, outward


def pressed_points(state: State, shapes: Shapes) -> PressedPoints:
    """Return the points that press on the tissue.

    Parameters
    ----------
    state : State
        State of the simulation.
    shapes : Shapes
        Shapes of the tools.
    """
    contacts = state.contacts
    pressed = np.flatnonzero(state.contact_pressed[0, : int(contacts.header.points)] > 0.0)
    bodies = contacts.body[pressed]
    places = np.einsum("kc,kcx->kx", contacts.weight[pressed], state.position[contacts.node[pressed]])
    normals = np.zeros_like(places)
    write_normals(shapes, bodies, state.body_pose, places, np.zeros(12), normals)
    return PressedPoints(pressed, bodies, places, normals)


def warm_up(shapes: Shapes) -> None:
    """Compile the kernels, which are the same for all shapes.

    Parameters
    ----------
    shapes : Shapes
        Shapes of the tools.
    """
    write_normals(
        shapes, np.zeros(0, dtype=np.int64), np.zeros((1, 7)), np.zeros((0, 3)), np.zeros(12), np.zeros((0, 3))
    )


@kernel
def write_normals(shapes: Shapes, bodies: Longs, poses: Floats, places: Floats, frame: Floats, normals: Floats) -> None:
    """Write the outward normals of bodies at places near their surfaces.

    Parameters
    ----------
    shapes : Shapes
        Shapes of the tools.
    bodies : Longs, shape (k,)
        The bodies.
    poses : Floats, shape (B, 7)
        Poses of all bodies.
    places : Floats, shape (k, 3), m
        The places.
    frame : Floats, shape (12,)
        Buffer.
    normals : Floats, shape (k, 3)
        Receives the normals.
    """
    origin, r = frame[:3], frame[3:]
    for index in range(len(bodies)):
        body, place, normal = bodies[index], places[index], normals[index]
        set_frame(poses[body], origin, r)
        dx, dy, dz = place[0] - origin[0], place[1] - origin[1], place[2] - origin[2]
        lx, ly = r[0] * dx + r[3] * dy + r[6] * dz, r[1] * dx + r[4] * dy + r[7] * dz
        lz = r[2] * dx + r[5] * dy + r[8] * dz
        _, normal[0], normal[1], normal[2] = gap_and_normal(shapes, body, r, lx, ly, lz)
