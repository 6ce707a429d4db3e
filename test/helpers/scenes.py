"""Small organs that tests share: a ball with a short chain of atoms, and the kidney that ships."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import trimesh

from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.organ.cell_mesh import with_cells
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import AS_BUILT, shipped_organ
from tissue_sim.organ.topology import assemble_like, assemble_organ

RADIUS = 0.03  # m, of the ball

assembled = cache(assemble)


@cache
def ball(subdivisions: int = 1, held: bool = True, turned: bool = True, **tissue: float) -> Organ:
    """A ball of tissue around the origin with five medial atoms on its z axis; its lower cap is held.

    subdivisions 1: 42 surface nodes, edges of 17 mm; 2: 162, 9 mm; 3: 642, 4 mm.
    """
    mesh = trimesh.creation.icosphere(subdivisions, RADIUS)
    if turned:  # a little, so that nothing lies along an axis by accident
        mesh.apply_transform(trimesh.transformations.euler_matrix(0.3, 0.2, 0.1))
    surface = np.asarray(mesh.vertices)
    atoms = np.zeros((5, 3))
    atoms[:, 2] = np.linspace(-0.4, 0.4, 5) * RADIUS
    return assemble_organ(
        name="ball",
        surface_positions=surface,
        surface_triangles=mesh.faces,
        atom_positions=atoms,
        atom_radius=RADIUS - np.abs(atoms[:, 2]),
        atom_parent=np.arange(-1, 4),
        fixed=np.flatnonzero(surface[:, 2] < -0.7 * RADIUS) if held else (),
        provenance={"source": "test"},
        **tissue,
    )


def changed(organ: Organ, **factors: float) -> Organ:
    """The organ with some of its arrays (mass, damping, ...) scaled; 0 switches a part off."""
    arrays: dict[str, Any] = {name: factor * getattr(organ, name) for name, factor in factors.items()}
    return replace(organ, **arrays)


@cache
def free_ball(subdivisions: int = 1) -> Organ:
    """A ball that nothing holds and nothing damps: internal forces alone."""
    return changed(ball(subdivisions, held=False), damping=0.0, return_stiffness=0.0)


@cache
def kidney() -> Organ:
    """The organ that ships, as built: with the paper's 48 atoms."""
    return Organ.load(shipped_organ(AS_BUILT))


@cache
def filled(organ: Organ, count: int) -> Organ:
    """The organ reassembled with `count` interior atoms."""
    return assemble_like(organ, name="filled", interior_atoms=count, provenance=None)


@cache
def ball_of_cells(subdivisions: int = 3, interior_atoms: int = 300) -> Organ:
    """A ball with atoms in a layer under its surface, and cells between all of them."""
    organ = assemble_like(ball(subdivisions), interior_atoms=interior_atoms, interior_layer=0.7, provenance=None)
    return with_cells(organ)


def near(organ, *directions):
    """Surface nodes outermost in some directions from the organ's middle."""
    offset = organ.surface_positions - organ.surface_positions.mean(axis=0)
    return [int(np.argmax(offset @ direction)) for direction in directions]


@cache
def fold(gap: float = 0.006, radius: float = 0.006, leg: float = 0.02) -> Organ:
    """A tube of tissue bent to a U whose legs, along z, are `gap` m apart; the bend below is held."""
    bend = radius + 0.5 * gap  # m, of its axis
    turn = np.linspace(-np.pi, 0.0, 9)
    up = np.linspace(0.0, leg, 10)[1:]
    legs = [np.stack([np.full(9, side * bend), np.zeros(9), up], axis=1) for side in (-1.0, 1.0)]
    axis = np.concatenate(
        [legs[0][::-1], np.stack([bend * np.cos(turn), 0.0 * turn, bend * np.sin(turn)], axis=1), legs[1]]
    )
    along = np.gradient(axis, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    aside = np.array([0.0, 1.0, 0.0])
    out = np.cross(along, aside)
    m, count = 10, len(axis)
    angle = np.linspace(0.0, 2.0 * np.pi, m, endpoint=False)
    rings = axis[:, None] + radius * (np.cos(angle)[:, None] * aside + np.sin(angle)[:, None] * out[:, None])
    ends = axis[[0, -1]] + 0.5 * radius * along[[0, -1]] * [[-1.0], [1.0]]
    surface = np.concatenate([rings.reshape(-1, 3), ends])
    here = np.arange(m)
    there = (here + 1) % m
    quads = [(r * m + here, r * m + there, (r + 1) * m + there, (r + 1) * m + here) for r in range(count - 1)]
    triangles = [np.stack(corners, axis=1) for a, b, c, d in quads for corners in ((a, b, c), (a, c, d))]
    triangles += [np.stack([np.full(m, count * m), there, here], axis=1)]
    triangles += [np.stack([np.full(m, count * m + 1), (count - 1) * m + here, (count - 1) * m + there], axis=1)]
    mesh = trimesh.Trimesh(surface, np.concatenate(triangles), process=False)
    if mesh.volume < 0.0:
        mesh.invert()
    chosen = np.arange(1, count - 1, 2)
    return assemble_organ(
        name="fold",
        surface_positions=surface,
        surface_triangles=mesh.faces,
        atom_positions=axis[chosen],
        atom_radius=np.full(len(chosen), radius),
        atom_parent=np.arange(-1, len(chosen) - 1),
        fixed=np.flatnonzero(surface[:, 2] < -0.6 * bend),
        provenance={"source": "test"},
    )


def uneven(organ: Organ, seed: int = 0) -> Organ:
    """The organ with cells of many stiffnesses."""
    organ = with_cells(organ)
    factor = np.exp(np.random.default_rng(seed).normal(size=(2, len(organ.cell_mu))))
    return replace(organ, cell_mu=factor[0] * organ.cell_mu, cell_lambda=factor[1] * organ.cell_lambda)
