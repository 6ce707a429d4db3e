"""The organ's markers against ROS's own serialisation, and their kernels against NumPy."""

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from visualization_msgs.msg import Marker, MarkerArray

from helpers.ros.processes import shipped
from tissue_sim.rendering.appearance import SHADES
from tissue_sim.ros.node.output.markers import ARROW_LENGTH, OrganMarkers, all_finite, write_displacement
from tissue_sim.ros.shared.shown_organ import ShownOrgan

CENTRE = np.array([[0.1, 0.2, 0.3], [0.0, 0.0, 0.0]])
WRENCH = np.zeros((2, 6))
WRENCH[0, :3] = (0.0, 0.0, 2.0)


def message_of(organ, positions, fraction=None):
    """What a viewer gets, and the same written by ROS."""
    template = OrganMarkers("organ", {"": ShownOrgan(organ)}, 2, coloured=fraction is not None)
    raw = template.message(3_000_000_007, positions, CENTRE, WRENCH, fraction)
    read = deserialize_message(raw, MarkerArray)
    assert len(serialize_message(read)) == len(raw), "nothing but what the markers say"
    return read.markers


def points_of(marker):
    return np.array([(p.x, p.y, p.z) for p in marker.points])


def moved(organ):
    return organ.rest_positions + np.random.default_rng(3).normal(scale=0.001, size=organ.rest_positions.shape)


def test_positions_and_forces_are_shown():
    organ = shipped()
    positions = moved(organ)
    surface, skeleton, left, right = message_of(organ, positions)
    assert np.array_equal(points_of(surface), positions[organ.surface_triangles.ravel()])
    child = np.flatnonzero(organ.atom_parent >= 0)
    atoms = positions[organ.n_surface :][: organ.n_atoms]
    assert np.array_equal(points_of(skeleton)[0::2], atoms[child])
    assert np.array_equal(points_of(skeleton)[1::2], atoms[organ.atom_parent[child]])
    assert (left.action, right.action) == (Marker.ADD, Marker.DELETE)
    assert points_of(left) == pytest.approx(CENTRE[0] + [[0.0, 0.0, 0.0], ARROW_LENGTH * WRENCH[0, :3]])
    for marker in (surface, skeleton, left, right):
        assert (marker.header.stamp.sec, marker.header.stamp.nanosec) == (3, 7)
    assert len(surface.colors) == 0


def test_an_arrow_goes_with_its_force_and_comes_back():
    organ = shipped()
    template = OrganMarkers("organ", {"": ShownOrgan(organ)}, 2)
    for force, action in ((0.0, Marker.DELETE), (0.5, Marker.ADD), (1e-5, Marker.DELETE)):
        wrench = np.full((2, 6), 0.0)
        wrench[1, 0] = force
        raw = template.message(1, organ.rest_positions, CENTRE, wrench)
        assert deserialize_message(raw, MarkerArray).markers[-1].action == action


def test_all_are_deleted_in_the_end():
    gone = deserialize_message(OrganMarkers("organ", {"": ShownOrgan(shipped())}, 2).deletion(), MarkerArray)
    assert [marker.action for marker in gone.markers] == [Marker.DELETE] * 4


def test_corners_have_the_colours_of_their_nodes():
    organ = shipped()
    fraction = np.random.default_rng(4).uniform(-0.0, 1.5, size=len(organ.rest_positions))
    surface = message_of(organ, organ.rest_positions, fraction)[0]
    shown = np.array([(c.r, c.g, c.b, c.a) for c in surface.colors])
    nodes = organ.surface_triangles.ravel()
    assert np.array_equal(shown, SHADES[(np.minimum(fraction, 1.0) * (len(SHADES) - 1)).astype(int)][nodes])


def test_displacement_is_the_distance_from_rest():
    organ = shipped()
    fraction = np.zeros(len(organ.rest_positions))
    write_displacement(fraction, moved(organ), organ.rest_positions, 0.01)
    twin = np.linalg.norm(moved(organ) - organ.rest_positions, axis=1) / 0.01
    assert np.abs(fraction - twin).max() < 1e-12


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", [0, 7, -1])
def test_one_value_that_is_not_finite_is_found(value, place):
    positions = moved(shipped())
    assert all_finite(positions)
    positions.reshape(-1)[place] = value
    assert not all_finite(positions)
