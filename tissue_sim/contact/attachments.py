"""Attachments of organs to each other or to points, each with many links, and the breathing that moves them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats, Longs
from tissue_sim.errors import UserError
from tissue_sim.model.data.links import POINT, Links, make_links
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.breathing import Breath
from tissue_sim.model.stepping.ligament_links import compute_link_bounds
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.topology import node_area


@dataclass(frozen=True)
class Attachment:
    """Ligament: links that pull and never push, from surface nodes of one organ to another organ or a point.

    Attributes
    ----------
    organs : tuple[int, int | None]
        Numbers of two organs of a scene, or of one and None.
    stiffness : float
        N/m, the sum over its links, divided among them in proportion to the area around their nodes.
    damping : float
        N s/m, likewise.
    within : float
        Distance, m, up to which nodes are joined with the nearest one of the other organ; alternative to `nodes`.
    nodes : ArrayLike | None
        Nodes of both organs, shape (k, 2), or of the organ that is joined with `point`, shape (k,).
    point : ArrayLike | None
        Point, shape (3,), m.
    slack : float | None
        Length, m, up to which links don't pull; None for that at rest.
    moves : float
        Motion of the point with the breath, as a factor.
    """

    organs: tuple[int, int | None]
    stiffness: float
    damping: float = 0.0
    within: float = 0.0
    nodes: ArrayLike | None = None
    point: ArrayLike | None = None
    slack: float | None = None
    moves: float = 0.0


@dataclass(frozen=True)
class Breathing:
    """Breathing that moves clamps and points by a displacement, from exhaled to inhaled.

    Attributes
    ----------
    rate : float
        Breaths per minute; 0 for one that follows external input.
    way : ArrayLike
        Displacement, shape (3,), m.
    """

    rate: float
    way: ArrayLike

    def breath(self) -> Breath:
        """Return the record for the kernels. Raises UserError for numbers out of range."""
        way = np.asarray(self.way, dtype=np.float64)
        if self.rate != 0.0 and not 1.0 <= self.rate <= 120.0:
            raise UserError(f"a breathing rate of {self.rate:g} a minute is outside 1..120")
        if way.shape != (3,) or not np.all(np.abs(way) <= 0.2):
            raise UserError(f"the breathing displacement is {self.way!r}; expected: three numbers of up to 0.2 m")
        breath = Breath.new()
        breath.period, breath.follows = 60.0 / self.rate if self.rate else 0.0, self.rate == 0.0
        breath.x, breath.y, breath.z = way
        return breath


def links_of(attachments: Sequence[Attachment], simulations: Sequence[Simulation]) -> Links:
    """Return the links of all attachments.

    Parameters
    ----------
    attachments : Sequence[Attachment]
        Attachments of the organs.
    simulations : Sequence[Simulation]
        Simulations of the organs.

    Raises
    ------
    UserError
        For an attachment that joins nothing or is invalid; the message gives its number.
    """
    for simulation in simulations:
        if attachments and simulation.local_region != "off":
            raise UserError(
                f"organ '{simulation.organ.name}' has a local region, but attachments need the whole organ; use"
                " local region off"
            )
        if attachments and simulation.integrator != "symplectic":
            raise UserError(f"attachments need integrator symplectic, not {simulation.integrator}")
    organs = [simulation.organ for simulation in simulations]
    parts = [_nodes_of(one, organs, number) for number, one in enumerate(attachments)]
    links, first = make_links(sum(map(len, parts))), 0
    for one, nodes in zip(attachments, parts, strict=True):
        rows = slice(first, first + len(nodes))
        first = rows.stop
        near, far = one.organs
        links.organ[rows], links.node[rows] = (near, POINT if far is None else far), nodes
        ends = np.stack([organs[near].surface_positions[nodes[:, 0]], _far_ends(one, organs, nodes)])
        if far is None:
            links.point[rows, 1], links.moves[rows, 1] = ends[1], one.moves
        area = node_area(organs[near].surface_positions, organs[near].surface_triangles)[nodes[:, 0]]
        links.stiffness[rows] = one.stiffness * area / area.sum()
        links.damping[rows] = one.damping * area / area.sum()
        links.slack[rows] = np.linalg.norm(ends[1] - ends[0], axis=1) if one.slack is None else one.slack
    if len(links.slack):
        compute_link_bounds(links, [simulation.model.inverse_mass for simulation in simulations])
    return links


def _far_ends(one: Attachment, organs: Sequence[Organ], nodes: Longs) -> Floats:
    if one.organs[1] is None:
        return np.broadcast_to(np.asarray(one.point, dtype=np.float64), (len(nodes), 3))
    return organs[one.organs[1]].surface_positions[nodes[:, 1]]


def _nodes_of(one: Attachment, organs: Sequence[Organ], number: int) -> Longs:
    """Return the nodes (l, 2) of an attachment's links."""
    near, far = one.organs
    name = f"attachment {number}"
    if not 0 <= near < len(organs) or (far is not None and (not 0 <= far < len(organs) or far == near)):
        raise UserError(f"{name} is between organs {near} and {far}; there are {len(organs)}, from 0")
    if not (0.0 < one.stiffness <= 1e6 and 0.0 <= one.damping <= 1e4):
        raise UserError(f"{name}: stiffness {one.stiffness:g} N/m or damping {one.damping:g} N s/m is out of range")
    if (far is None) != (one.point is not None):
        raise UserError(f"{name} needs either another organ or a point")
    if one.nodes is None:
        if far is None:
            reach = np.linalg.norm(organs[near].surface_positions - np.asarray(one.point), axis=1)
            ends = np.flatnonzero(reach <= one.within)
            found = np.stack([ends, np.zeros_like(ends)], axis=1)
        else:
            reach, other = cKDTree(organs[far].surface_positions).query(organs[near].surface_positions)
            joined = np.flatnonzero(reach <= one.within)
            found = np.stack([joined, other[joined]], axis=1)
    else:
        found = np.asarray(one.nodes, dtype=np.int64)
        if far is None:
            found = np.stack([found.ravel(), np.zeros(found.size, dtype=np.int64)], axis=1)
    if not len(found):
        raise UserError(f"{name} joins nothing: no nodes within {one.within:g} m; make 'within' larger, or name nodes")
    limits = organs[near].n_surface, 1 if far is None else organs[far].n_surface
    if found.ndim != 2 or found.shape[1] != 2 or np.any(found < 0) or np.any(found >= limits):
        raise UserError(f"{name} names surface nodes that don't exist")
    return found.astype(np.int64)
