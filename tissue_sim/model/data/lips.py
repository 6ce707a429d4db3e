"""Lips of cuts: points of both walls that coincided before the cut, as the kernels read them."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.model.data.records import Record, Records, Vector

ENDS = 2  # nodes of the cell edge on which a point lies


class LipContact(Record):
    """Point whose two sides touch in a substep, or nearly do."""

    node: Annotated[Longs, (2 * ENDS,)]  # those of the upper side, then those of the lower one
    weight: Annotated[Floats, (2 * ENDS,)]  # of each in the gap; negative on the lower side
    normal: Vector  # from the lower side to the upper one
    least: float  # m, the least gap allowed
    stiffness: float  # N s/m, the impulse that opens it by a metre
    pressed: float  # N s, impulse so far
    most: float  # N s, largest impulse allowed


class Lips(NamedTuple):
    """Points at q places on the walls of cuts; none in an uncut organ. The upper side is the positive one."""

    upper: Longs  # (q, ENDS) nodes between which each lies on that side
    lower: Longs  # (q, ENDS) those of the other side: the other copy of each, or the same node where both sides meet
    weight: Floats  # (q, ENDS) the same on both sides
    slide: Floats  # (q,) m by which the sides may have slid along each other and still touch
    triangles: Longs  # (f, 3) of the upper wall, between places; counter-clockwise seen from the lower one
    place: Floats  # (2, q, 3) buffer: where they are on the upper side and on the lower one, m
    normal: Floats  # (2, q, 3) buffer: that of the wall there, m^2, from the lower side to the upper one
    contacts: Records  # (q,) LipContact: buffer
    counts: Longs  # (3,) searches so far; places that touched in the last substep; places that were listed in it


def make_lips(places: int = 0, triangles: int = 0) -> Lips:
    """Return lips of zeros.

    Parameters
    ----------
    places : int, optional
        Number of places.
    triangles : int, optional
        Number of triangles.
    """

    def longs(*shape: int) -> Longs:
        return np.zeros(shape, dtype=np.int64)

    return Lips(
        upper=longs(places, ENDS),
        lower=longs(places, ENDS),
        weight=np.zeros((places, ENDS)),
        slide=np.zeros(places),
        triangles=longs(triangles, 3),
        place=np.zeros((2, places, 3)),
        normal=np.zeros((2, places, 3)),
        contacts=LipContact.rows(longs(places * LipContact.words())),
        counts=longs(3),
    )
