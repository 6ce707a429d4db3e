"""Blades: points on their edges and flanks, their places in the tissue, and the cells that they cut."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tissue_sim.array_types import Floats, Longs
from tissue_sim.model.data.records import Record, Records, Vector

CORNERS = 4  # of a cell
LIP_NODES = 2 * CORNERS  # of the cell or of its two copies, in which a place lies


class Blades(NamedTuple):
    """Places on the edges and flanks of blades, S in all, in the frames of the bodies that they belong to."""

    body: Longs  # (S,)
    at: Floats  # (S, 3) m
    forward: Floats  # (S, 3) unit direction in which the edge cuts
    normal: Floats  # (S, 3) unit direction across the flank
    width: Floats  # (S,) m of the edge that each represents; 0 on a flank
    flank: Floats  # (S,) m^2 of both flanks, likewise
    speed: Floats  # (S,) m/s at which tissue is cut without force, as by a cautery hook; 0: it is cut by force


class BladeSample(Record):
    """Place of a blade in the tissue; its values don't count once it is outside."""

    load: float  # N on the edge before it enters, smoothed; of the first place of each body
    embedded: bool  # it is in tissue
    free: bool  # in a cut that existed when it entered: nothing is left to cut
    cell: int  # the cell of the uncut organ that holds it
    rest: Vector  # m, where it is in the organ at rest
    offset: Vector  # m in the body's frame, from the blade to the tissue that holds it, as it was when it entered
    depth: float  # m by which it has advanced since it entered, at rest
    deepest: float  # m, largest value of that
    area: float  # m^2 that it has cut since the organ was whole, at rest
    force: Vector  # N on the tissue in the last substep: forward, along the edge, across the flank


class BladeRow(Record):
    """Place of a blade in the tissue while a substep resolves it."""

    sample: int
    body: int
    node: Annotated[Longs, (LIP_NODES,)]  # of the cell's copies on both sides of a cut
    weight: Annotated[Floats, (LIP_NODES,)]  # of each between both sides
    across_weight: Annotated[Floats, (LIP_NODES,)]  # in the place that the flank touches: the middle, or one lip
    side: float  # of the lip that the flank touches, along the normal: -1 or 1; 0 where both are one
    arm: Vector  # m, from the tool's origin
    forward: Vector
    along: Vector
    normal: Vector
    back: Annotated[Floats, (9,)]  # matrix from displacements to those at rest, row by row
    borrowed: bool  # this matrix is that of another place, as its own cell is inverted
    stiffness: float  # N s/m, impulse that moves the middle by a metre
    across_stiffness: float  # likewise for the place that the flank touches
    at_front: bool  # it is at the front of its cut: beyond it there is tissue to cut
    resistance: float  # N s against cutting
    lag: float  # m by which it is behind the blade, beyond the yielding to its force, if cutting takes force
    lag_across: float  # m, likewise across the flank
    pace: float  # ratio of the distance that it cuts to the motion of the blade past the tissue
    drag: float  # N s of friction on the flank, besides that by the normal force
    most: float  # N s, the largest impulse across the flank
    pushed: Vector  # N s on the tissue in this substep: forward, along, across
    slips: bool  # the last pass has reached the limit of friction, and
    cuts: bool  # that of the resistance, or the place moves back
    area_ratio: float  # of an area in the plane of the blade, at rest to now


class CutCells(NamedTuple):
    """Cells of the uncut organ, in which blades find their places; none if nothing can be cut. c cells."""

    nodes: Longs  # (c, 4) as they are, or of the copy on the negative side of a cut
    others: Longs  # (c, 4) of the copy on the positive side
    # (c, 4) part of the mass of both copies of a corner that `others` has; 0 where they are one node. Constraints act
    # on their centre of mass: when copies separate, their forces move it no more than the whole node.
    part: Floats
    base: Floats  # (c, 4) barycentric weights of a place X at rest: base + slope X
    slope: Floats  # (c, 4, 3) 1/m
    is_cut: Longs  # (c,) 1 for those whose middle a cut has passed
    neighbour: Longs  # (c, 4) cell behind the face opposite to each corner; -1: outside
    first: Longs  # (n,) a cell around each node


def make_blades(
    body: ArrayLike = (),
    at: ArrayLike = (),
    forward: ArrayLike = (),
    normal: ArrayLike = (),
    measures: ArrayLike = (),
) -> Blades:
    """Return places of blades.

    Parameters
    ----------
    body : ArrayLike, shape (S,), optional
        Body that each belongs to.
    at : ArrayLike, shape (S, 3), m, optional
        Where each is in the body's frame.
    forward : ArrayLike, shape (S, 3), optional
        Unit direction in which the edge cuts.
    normal : ArrayLike, shape (S, 3), optional
        Unit direction across the flank.
    measures : ArrayLike, shape (S, 3), m, m^2 and m/s, optional
        `width`, `flank` and `speed` of each.
    """
    measured = np.asarray(measures, dtype=np.float64).reshape(-1, 3)
    return Blades(
        body=np.asarray(body, dtype=np.int64).reshape(-1),
        at=np.asarray(at, dtype=np.float64).reshape(-1, 3),
        forward=np.asarray(forward, dtype=np.float64).reshape(-1, 3),
        normal=np.asarray(normal, dtype=np.float64).reshape(-1, 3),
        width=measured[:, 0].copy(),
        flank=measured[:, 1].copy(),
        speed=measured[:, 2].copy(),
    )


def blade_rows(count: int) -> Records:
    """Return buffers for (count,) BladeRow records."""
    return BladeRow.rows(np.zeros(count * BladeRow.words(), dtype=np.int64))


def no_cut_cells() -> CutCells:
    """Return no cells, for an organ that no blade can cut."""
    none, weights = np.zeros((0, CORNERS), dtype=np.int64), np.zeros((0, CORNERS))
    slope, flags = np.zeros((0, CORNERS, 3)), np.zeros(0, dtype=np.int64)
    return CutCells(none, none, weights, weights, slope, none[:, 0], none, flags)
