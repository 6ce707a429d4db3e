"""Local compliance of tissue under a contact point between the surface's nodes, which the mesh can't resolve.

A half-space yields to a pressure wave of length L by pressure times L / (pi E*), with E* = E / (1 - nu^2) (Johnson,
Contact Mechanics, 1985, chapter 3). Nodes represent waves longer than an edge; shorter ones, of which a small finger's
pressure consists, are represented by a foundation of springs under the contact points, as soft as for waves of an
edge's length. Across the normal it is softer by the factor (2 - nu) / (2 (1 - nu)) (Mindlin 1949).

A mesh yields less between its nodes than at them, so that the force of a ball as large as an edge depends on its place;
therefore the compliance is larger there (`extra_compliance_between_nodes`). For shafts and jaws it is smaller
(`ComplianceLimits`), as tissue would otherwise slip from under their edges.
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

STRETCHED = 1.15  # largest stretch of the distance between points under a tool
LAYER = 0.5  # largest yielding of tissue between nodes, in mean edges: with less, a deep pinch is too stiff
MAX_POISSON_RATIO = 0.5


class ComplianceLimits(NamedTuple):
    """Limits of the local compliance for a kind of tool.

    Attributes
    ----------
    spacing : float
        Largest spacing of contact points, relative to the tool's smallest radius.
    most : float
        Largest yielding of tissue, relative to that radius.
    covered : float
        Largest distance of a place from contact points, relative to their spacing.
    between : float
        Fraction by which tissue yields more between nodes.
    """

    spacing: float
    most: float
    covered: float
    between: float


# No place in a triangle is farther from its corners than 1 / sqrt(3) of its longest side, to which a fifth is added.
# Under a point load the shipped kidney yields by 0.71 of its nodes' displacement in the middle of an edge, and by 0.64
# in that of a triangle; for balls of 0.5 to 3 edges, at nodes and between, 0.5 gives the smallest error
# (docs/models.md).
OF_BALLS = ComplianceLimits(spacing=0.45, most=0.8, covered=0.7, between=0.5)
OF_OTHERS = ComplianceLimits(spacing=0.75, most=0.5, covered=1.0, between=0.0)


def max_yielding(limits: ComplianceLimits, organ: Organ, smallest: float, spacing: Floats) -> Floats:
    """Return the largest yielding (t,), m, of tissue with which a tool doesn't slip between points, spacing (t,), m.

    smallest: radius of the finest feature of the tool, m. Waves that nodes don't represent deform a layer under the
    surface, LAYER of an edge deep, and the yielding is not larger than that.
    """
    slips = smallest - limits.covered * STRETCHED * spacing
    return np.clip(slips, 0.0, min(limits.most * smallest, LAYER * mean_edge(organ)))


def extra_compliance_between_nodes(limits: ComplianceLimits, organ: Organ, smallest: float) -> float:
    """Return the fraction by which tissue yields more between nodes, to be multiplied by 1 - sum of squared weights.

    For tools smaller than a triangle, most of the yielding is local and independent of the nodes.

    Parameters
    ----------
    limits : ComplianceLimits
        Limits for the tool.
    organ : Organ
        The organ.
    smallest : float, m
        Smallest radius of the tool.
    """
    return limits.between * min(1.0, smallest / mean_edge(organ))


def local_compliance(organ: Organ, smallest: float) -> Floats:
    """Return the compliance of the area of each surface node, along the normal and across it.

    It is limited by the compliance for a flat punch with the tool's smallest radius. The result is zero for an organ
    without a Young's modulus.

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
    edge = np.sqrt(2.0 / math.sqrt(3.0) * area)  # of equilateral triangles with the same area per node
    layer = np.minimum(edge / math.pi, 0.5 * math.pi * smallest)
    stiffness = modulus / (1.0 - nu**2) * stiffness_at(inclusions_of(organ), organ.surface_positions)
    normal = layer / (stiffness * area)
    return np.stack([normal, (2.0 - nu) / (2.0 * (1.0 - nu)) * normal], axis=1)
