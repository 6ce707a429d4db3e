"""Finite elements with a cut: the closed form of two arms, loads on one side, lips that touch."""

import numpy as np
import pytest

from helpers.bars import bar
from tissue_sim.bench.cutting.cut_body import SAMPLES, CutBody, Sizes
from tissue_sim.calibration.fe_mesh import Grading
from tissue_sim.model.cutting.sheet import sheet_of
from tissue_sim.organ.topology import node_area

LENGTH, SIDE, ARM = 0.12, 0.02, 0.08  # m
COARSE = Sizes(0.6, 0.4, Grading())
SMALL = 1e-4  # N


@pytest.fixture(scope="module")
def organ():
    return bar(12, 0.01, 2)


@pytest.fixture(scope="module")
def sheet(organ):
    """From the free end along the bar, midway up: two arms."""
    edge = [[LENGTH, -0.002, 0.0103], [LENGTH, SIDE + 0.002, 0.0103]]
    return sheet_of(organ, edge, [-1.0, 0.0, 0.0], ARM)


@pytest.fixture(scope="module")
def body(organ, sheet):
    return CutBody(organ, sheet, COARSE)


def apart(organ, newton):
    """Opposite forces on the ends of the arms."""
    force = np.zeros((organ.n_surface, 3))
    x, _, z = organ.surface_positions.T
    for end, direction in ((SIDE, 1.0), (0.0, -1.0)):
        nodes = np.flatnonzero((np.abs(x - LENGTH) < 1e-9) & (np.abs(z - end) < 1e-9))
        force[nodes, 2] = direction * newton / len(nodes)
    return force


def compressed(organ, pressure):
    """A pressure on the arms from above and below."""
    force = np.zeros((organ.n_surface, 3))
    area = node_area(organ.surface_positions, organ.surface_triangles)
    x, _, z = organ.surface_positions.T
    for end, direction in ((SIDE, -1.0), (0.0, 1.0)):
        nodes = (x > LENGTH - ARM + 0.015) & (np.abs(z - end) < 1e-9)
        force[nodes, 2] = direction * pressure * area[nodes]
    return force


def test_two_arms_open_as_beams_on_an_elastic_foundation(organ, body):
    """Kanninen 1973: an arm is longer by 0.64 of its height, as the tissue ahead of the front yields too.

    International Journal of Fracture 9.
    """
    answer = body.linear(apart(organ, SMALL)[None])[0]
    height = 0.5 * SIDE
    inertia = SIDE * height**3 / 12.0
    wanted = 2.0 * SMALL * (ARM + 0.64 * height) ** 3 / (3.0 * organ.youngs_modulus * inertia)
    opening = np.linalg.norm(answer.opening, axis=1)[SAMPLES // 2]
    assert opening == pytest.approx(wanted, rel=0.06)
    assert answer.opening[SAMPLES // 2, 2] * np.sign(body.sheet.place(np.array([[LENGTH, 0.01, 0.02]])).across[0]) > 0.0


def test_a_load_acts_on_its_own_side(organ, body):
    force = np.zeros((organ.n_surface, 3))
    force[organ.surface_positions[:, 2] > 0.015] = [0.0, 0.0, 1.0]
    load = body.loads(force)[:, 2]
    assert load.sum() == pytest.approx(force[:, 2].sum(), rel=1e-9)
    below = (body.filling.nodes[:, 2] < 0.0095) & (body.filling.nodes[:, 0] > LENGTH - ARM + 0.01)
    assert not load[below].any()


def test_closed_mesh_is_that_of_the_uncut_organ(organ, sheet, body):
    closed = CutBody(organ, sheet, COARSE, parted=False)
    force = apart(organ, SMALL)[None]
    assert closed.n_nodes < body.n_nodes
    reach = [np.abs(one.linear(force)[0].displacement).max() for one in (closed, body)]
    assert reach[0] < 0.02 * reach[1]


@pytest.mark.extended
def test_arms_that_are_pressed_together_are_as_if_uncut(organ, sheet, body):
    """By symmetry nothing shears the plane between them, so that contact without friction is enough."""
    force = compressed(organ, 1.0)
    free, moved = next(body.settle_many(force[None]))
    assert free.closed > 0.002
    found = body.touching(force, moved)
    assert found.settled
    assert found.closed < 1e-4
    whole = next(CutBody(organ, sheet, COARSE, parted=False).settle_many(force[None]))[0]
    off = np.linalg.norm(found.displacement - whole.displacement) / np.linalg.norm(whole.displacement)
    assert off < 0.1
    assert np.linalg.norm(free.displacement) > 5.0 * np.linalg.norm(whole.displacement)


def test_lips_that_part_are_left_alone(organ, body):
    force = apart(organ, 2e-4)
    free, moved = next(body.settle_many(force[None]))
    assert free.closed == 0.0
    found = body.touching(force, moved)
    np.testing.assert_allclose(found.displacement, free.displacement, atol=2e-4 * np.abs(free.displacement).max())
