"""Local compliance of tissue under a contact point between the surface's nodes, which the mesh can't resolve.

A half-space yields to a wave of pressure of length L by pressure times L / (pi E*), with E* = E / (1 - nu^2) (Johnson,
Contact Mechanics, 1985, chapter 3). Nodes represent waves longer than an edge; the shorter ones, of which a small
finger's pressure consists, are a foundation of springs under the contact points, as soft as for waves of an edge's
length. Across the normal it is softer by (2 - nu) / (2 (1 - nu)) (Mindlin 1949).

A mesh yields less between its nodes than at them, and the force of a ball as large as an edge depends on its place; so
tissue yields more there (`extra_compliance_between_nodes`). To shafts and jaws it yields less (`ComplianceLimits`), or
it would slip from under their edges.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.organ.inclusions import inclusions_of, stiffness_at
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.tool_resolution import mean_edge
from tissue_sim.organ.topology import node_area

STRETCHED = 1.15  # largest stretch of the distance of points under a tool
LAYER = 0.5  # mean edges, by which tissue between nodes yields at most: with less a deep pinch is too stiff
MAX_POISSON_RATIO = 0.5


class ComplianceLimits(NamedTuple):
    """Parameters of how tissue yields to a kind of tool.

    Attributes
    ----------
    spacing : float
        Largest distance of contact points, relative to the smallest radius about the tool.
    most : float
        Largest yielding of tissue, relative to that radius.
    covered : float
        Largest distance of a place from contact points, relative to the distance of points.
    between : float
        Fraction by which tissue yields more between nodes.
    """

    spacing: float
    most: float
    covered: float
    between: float


# No place in a triangle is farther from its corners than 1 / sqrt(3) of its longest side, to which a fifth is added.
# Under a point load the kidney that ships yields by 0.71 of its nodes' displacement in the middle of an edge, 0.64 in
# that of a triangle; for balls of 0.5 to 3 edges, over nodes and between, 0.5 gives the least error (docs/models.md).
OF_BALLS = ComplianceLimits(spacing=0.45, most=0.8, covered=0.7, between=0.5)
OF_OTHERS = ComplianceLimits(spacing=0.75, most=0.5, covered=1.0, between=0.0)


def max_yielding(limits: ComplianceLimits, organ: Organ, smallest: float, spacing: Floats) -> Floats:
    """Return how far tissue may give way (t,), m; what sank in farther would slip between points spacing (t,) m apart.

    smallest: radius of the finest feature of the tool, m. Waves that nodes don't carry are of a layer under the
    surface, LAYER of an edge deep; it isn't compressed by more than that.
    """
    slips = smallest - limits.covered * STRETCHED * spacing
    return np.clip(slips, 0.0, min(limits.most * smallest, LAYER * mean_edge(organ)))


def extra_compliance_between_nodes(limits: ComplianceLimits, organ: Organ, smallest: float) -> float:
    """Return by what fraction tissue yields more between nodes, times 1 less the sum of a point's squared weights.

    Within a triangle the yielding between nodes is most of all yielding and is independent of the nodes.

    Parameters
    ----------
    limits : ComplianceLimits
        How tissue yields to the tool.
    organ : Organ
        The organ.
    smallest : float, m
        Smallest radius about the tool.
    """
    return limits.between * min(1.0, smallest / mean_edge(organ))


def local_compliance(organ: Organ, smallest: float) -> Floats:
    """Return the compliance of the area of each surface node, along the normal and across it.

    Tissue yields to a tool at most as to a flat punch of its smallest radius. The result is zero for an organ without a
    Young's modulus.

    Parameters
    ----------
    organ : Organ
        The organ.
    smallest : float, m
        Smallest radius about the tool.

    Returns
    -------
    Floats, shape (n, 2), m/N
        Compliance.
    """
    modulus, nu = organ.youngs_modulus, organ.poisson_ratio
    if not modulus > 0.0 or not abs(nu) <= MAX_POISSON_RATIO:
        return np.zeros((organ.n_surface, 2))
    area = np.maximum(node_area(organ.surface_positions, organ.surface_triangles), np.finfo(np.float64).tiny)
    edge = np.sqrt(2.0 / math.sqrt(3.0) * area)  # of equilateral triangles with as much area a node
    layer = np.minimum(edge / math.pi, 0.5 * math.pi * smallest)
    stiffness = modulus / (1.0 - nu**2) * stiffness_at(inclusions_of(organ), organ.surface_positions)
    normal = layer / (stiffness * area)
    return np.stack([normal, (2.0 - nu) / (2.0 * (1.0 - nu)) * normal], axis=1)
