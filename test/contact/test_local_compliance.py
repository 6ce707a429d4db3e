"""What tissue between nodes gives way by: closed forms, and forces that don't depend on how finely points lie."""

import dataclasses
import math

import numpy as np
import pytest

from helpers.pressing import given, lead, line, press
from helpers.scenes import ball, kidney
from tissue_sim.contact import contact_lattice
from tissue_sim.contact.local_compliance import (
    LAYER,
    OF_BALLS,
    OF_OTHERS,
    STRETCHED,
    extra_compliance_between_nodes,
    local_compliance,
    max_yielding,
)
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.organ.tool_resolution import mean_edge
from tissue_sim.organ.topology import node_area


def test_it_is_that_of_a_wave_as_long_as_an_edge():
    organ = ball(3)
    normal, across = local_compliance(organ, 1.0).T
    area = node_area(organ.surface_positions, organ.surface_triangles)
    nu = organ.poisson_ratio
    edge = np.sqrt(2.0 * area / math.sqrt(3.0))
    np.testing.assert_allclose(normal * area * organ.youngs_modulus / (1.0 - nu**2) * math.pi, edge, rtol=1e-12)
    np.testing.assert_allclose(across / normal, (2.0 - nu) / (2.0 - 2.0 * nu), rtol=1e-12)
    longest = np.linalg.norm(np.diff(organ.surface_positions[organ.surface_triangles[:, :2]], axis=1), axis=2)
    assert edge.mean() == pytest.approx(longest.mean(), rel=0.05)


def test_a_fine_tool_sinks_in_as_a_flat_punch_does_and_one_between_the_points_not_at_all():
    organ = ball(2)
    fine, area = 1e-4, node_area(organ.surface_positions, organ.surface_triangles)
    stiffness = organ.youngs_modulus / (1.0 - organ.poisson_ratio**2)
    # A punch's 1 / (2 a E*), of as many points as its area has.
    np.testing.assert_allclose(
        local_compliance(organ, fine)[:, 0], math.pi * fine**2 / area / (2.0 * fine * stiffness), rtol=1e-12
    )
    for give in (OF_BALLS, OF_OTHERS):
        assert max_yielding(give, organ, 0.004, 0.0005) == give.most * 0.004
        assert max_yielding(give, organ, 0.004, 0.003) == pytest.approx(0.004 - give.covered * STRETCHED * 0.003)
        assert max_yielding(give, organ, 0.001, 0.003) == 0.0
        assert max_yielding(give, organ, 1.0, 0.003) == LAYER * mean_edge(organ)


def test_nothing_of_a_triangle_is_farther_from_its_corners_than_covered():
    rng = np.random.default_rng(0)
    inside = rng.dirichlet(np.ones(3), 400)
    for corner in rng.standard_normal((200, 3, 2)):
        longest = np.linalg.norm(corner - np.roll(corner, 1, axis=0), axis=1).max()
        apart = np.linalg.norm((inside @ corner)[:, None] - corner, axis=2).min(axis=1)
        assert apart.max() < OF_BALLS.covered * longest


def test_points_between_nodes_give_way_by_more():
    organ = ball(3)
    corner = organ.surface_positions[organ.surface_triangles]
    edges = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2)
    edge = edges.mean()
    assert extra_compliance_between_nodes(OF_BALLS, organ, 3.0 * edge) == OF_BALLS.between
    assert extra_compliance_between_nodes(OF_BALLS, organ, 0.5 * edge) == pytest.approx(0.5 * OF_BALLS.between)
    assert extra_compliance_between_nodes(OF_OTHERS, organ, edge) == 0.0, "of shafts and jaws"
    scene = Scene(organ, [Tool("finger", radius=2.0 * edge)])
    press(scene, 0.5 * edge, hold=1)
    found = scene.contacts
    parts = contact_lattice.divisions_of(edges.max() / (OF_BALLS.spacing * 2.0 * edge))
    nodes = parts**2 * local_compliance(organ, 2.0 * edge)
    assert {1, 2, 3} >= set(np.count_nonzero(found.weight, axis=1)) > {1}
    for node, weight, compliance in zip(found.node, found.weight, found.compliance, strict=True):
        mean = sum(fraction * nodes[which] for fraction, which in zip(weight, node, strict=True))
        more = 1.0 + OF_BALLS.between * (1.0 - sum(fraction**2 for fraction in weight))
        np.testing.assert_allclose(compliance, more * mean, rtol=1e-12)


def test_a_small_ball_feels_the_same_over_a_node_as_between_nodes():
    """Over the middle of a triangle the force was a third larger, as its points could yield no farther."""
    organ = kidney()
    corners = organ.surface_positions[organ.surface_triangles[973]]  # where the kidney is flat
    inwards = np.cross(corners[2] - corners[0], corners[1] - corners[0])
    inwards /= np.linalg.norm(inwards)
    radius = 0.5 * np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).mean()
    forces = []
    for place in (corners[0], corners[:2].mean(axis=0), corners.mean(axis=0)):
        scene = Scene(organ, [Tool("finger", radius=radius)], ticks_a_set=4)
        start, end = (place + inwards * (deep - radius) for deep in (-0.001, 0.8 * radius))
        forces.append(-lead(scene, 0, line(start, end, 600), hold=200)[-1] @ inwards)
    assert min(forces) > 0.0
    assert max(forces) / min(forces) < 1.2


def test_an_organ_of_unknown_stiffness_gives_way_by_nothing():
    organ = dataclasses.replace(ball(2), youngs_modulus=0.0)
    assert not local_compliance(organ, 0.005).any()


def pressed(friction=0.2, depth=0.003, radius=0.007):
    scene = Scene(kidney(), [Tool("finger", radius=radius)])
    scene.simulation.settings.friction = friction
    force = press(scene, depth, hold=300)[-1, 2]
    return scene, force


def test_points_lie_as_deep_in_the_tool_as_their_force_makes_the_tissue_give():
    scene, _ = pressed(friction=0.0)
    state = scene.simulation.state
    touching = np.flatnonzero(state.contact_pressed[0, : state.contacts.header.points] > 0.0)
    assert len(touching) > 5
    points = np.einsum("ij,ijk->ik", state.contacts.weight[touching], state.position[state.contacts.node[touching]])
    deep = 0.007 - np.linalg.norm(points - state.body_pose[0, :3], axis=1)
    assert deep.max() > 1e-4
    np.testing.assert_allclose(deep, given(scene)[touching], atol=5e-6)


def test_force_depends_on_neither_the_spacing_of_points_nor_on_friction(monkeypatch):
    """Tissue that can't be compressed hardly cares whether a ball sticks (Johnson 1985, section 5.4)."""
    _, force = pressed()
    _, sticking = pressed(friction=10.0)
    assert sticking == pytest.approx(force, rel=0.08)
    monkeypatch.setattr(contact_lattice, "MIN_DIVISIONS", 4)
    _, fine = pressed()
    assert fine == pytest.approx(force, rel=0.06)
