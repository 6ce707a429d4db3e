"""How far tissue gives way under a contact point between the surface's nodes, which its mesh is too coarse to tell.

A half-space gives way to a wave of pressure of length L by pressure times L / (pi E*), with E* = E / (1 - nu^2)
(Johnson, Contact Mechanics, 1985, chapter 3). Nodes carry waves longer than an edge; the shorter ones, of which a small
finger's pressure is made, are a foundation of springs under the contact points, as soft as for waves of an edge's
length. Across the normal it is softer by (2 - nu) / (2 (1 - nu)) (Mindlin 1949).

A mesh gives way by less between its nodes than at them, and a ball as large as an edge feels where it is; so tissue
gives way by more there (`more_between`). To shafts and jaws it gives way by less (`Give`), or it would slip from under
their edges.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.organ.fineness import mean_edge
from tissue_sim.organ.inclusions import inclusions_of, stiffness_at
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.topology import node_area

STRETCHED = 1.15  # times as far as at rest, that points lie apart under a tool
LAYER = 0.5  # mean edges, that tissue between nodes gives way by at the most: with less a deep pinch is too stiff
MOST_POISSON = 0.5


class Give(NamedTuple):
    """How tissue gives way to a kind of tool.

    spacing: of the radius of the finest thing about the tool, how far contact points lie apart at most; most: of
    that radius, how far tissue gives way; covered: of how far points lie apart, what nothing between them is farther
    from one; between: by what fraction more it gives way between nodes.
    """

    spacing: float
    most: float
    covered: float
    between: float


# Nothing within a triangle is farther from its corners than 1 / sqrt(3) of its longest side, to which a fifth is added.
# Under a point load the kidney that ships gives way by 0.71 of its nodes' in the middle of an edge, 0.64 in that of a
# triangle: of balls of 0.5 to 3 edges, over nodes and between, 0.5 leaves the least error (docs/models.md).
OF_BALLS = Give(spacing=0.45, most=0.8, covered=0.7, between=0.5)
OF_OTHERS = Give(spacing=0.75, most=0.5, covered=1.0, between=0.0)


def most_give(give: Give, organ: Organ, smallest: float, spacing: Floats) -> Floats:
    """Return how far tissue may give way (t,), m; what sank in farther would slip between points spacing (t,) m apart.

    smallest: radius of the finest thing about the tool, m. Waves that nodes don't carry are of a layer under the
    surface, LAYER of an edge deep; it isn't squeezed by more than that.
    """
    slips = smallest - give.covered * STRETCHED * spacing
    return np.clip(slips, 0.0, min(give.most * smallest, LAYER * mean_edge(organ)))


def more_between(give: Give, organ: Organ, smallest: float) -> float:
    """Return by what fraction more tissue gives way between nodes, times 1 less the sum of a point's squared weights.

    smallest: radius of the finest thing about the tool, m; within a triangle what lies between nodes is most of what
    gives way at all, and knows no nodes.
    """
    return give.between * min(1.0, smallest / mean_edge(organ))


def local_compliance(organ: Organ, smallest: float) -> Floats:
    """Of each surface node (n, 2) m/N: along the normal and across it, of all the area that belongs to it.

    smallest: radius of the finest thing about the tool, m; tissue gives way to it no more than to a flat punch of that
    size. Zero for an organ that knows no Young's modulus.
    """
    modulus, nu = organ.youngs_modulus, organ.poisson_ratio
    if not modulus > 0.0 or not abs(nu) <= MOST_POISSON:
        return np.zeros((organ.n_surface, 2))
    area = np.maximum(node_area(organ.surface_positions, organ.surface_triangles), np.finfo(np.float64).tiny)
    edge = np.sqrt(2.0 / math.sqrt(3.0) * area)  # of equilateral triangles with as much area a node
    layer = np.minimum(edge / math.pi, 0.5 * math.pi * smallest)
    stiffness = modulus / (1.0 - nu**2) * stiffness_at(inclusions_of(organ), organ.surface_positions)
    normal = layer / (stiffness * area)
    return np.stack([normal, (2.0 - nu) / (2.0 * (1.0 - nu)) * normal], axis=1)
