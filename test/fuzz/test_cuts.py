"""Random blades, presses and resets: every cut is made or refused with a reason, and nothing is lost or not finite."""

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.fuzz.examples import examples
from helpers.fuzz.mutations import ODD_FLOATS
from tissue_sim import Organ, Scene, Tool, UserError
from tissue_sim.model.stepping.state_check import check_state
from tissue_sim.organ.surface_checks import signed_volume
from tissue_sim.ros.bags.suite.small_kidney import make_small_kidney

REACH = 0.1  # m about the organ's centre
FASTEST = 1.0  # m/s, of a tool

pytestmark = [pytest.mark.extended, pytest.mark.timeout(0)]


class Blade(NamedTuple):
    """A cut."""

    polyline: list[tuple[float, float, float]]  # m from the organ's centre
    direction: tuple[float, float, float] | None  # None: to the centre
    depth: float  # m


class Motion(NamedTuple):
    """Where a tool is moved: from a place to another, m from the organ's centre."""

    start: tuple[float, float, float]
    end: tuple[float, float, float]


def vectors(most):
    return st.tuples(*[st.floats(-most, most)] * 3)


blades = st.builds(
    Blade, st.lists(vectors(REACH), min_size=2, max_size=4), st.none() | vectors(1.0), st.floats(1e-3, 0.15)
)
motions = st.builds(Motion, vectors(REACH), vectors(REACH))
odd = st.builds(
    Blade,
    st.lists(st.tuples(*[ODD_FLOATS] * 3), min_size=0, max_size=3),
    st.tuples(*[ODD_FLOATS] * 3),
    ODD_FLOATS,
)
acts = st.lists(st.one_of(blades, blades, motions, motions, odd, st.just("reset")), min_size=2, max_size=6)


@cache
def kidney() -> Organ:
    return make_small_kidney()


@cache
def made() -> Scene:
    return Scene(kidney(), [Tool("ball", radius=0.006)], gravity=[0.0, 0.0, 0.0])


@examples(6)
@given(acts=acts)
def test_nothing_is_lost(acts):
    scene, centre = made(), kidney().surface_positions.mean(axis=0)
    for act in acts:
        if act == "reset":
            scene.reset()
            assert not scene.simulation.cuts
        elif isinstance(act, Blade):
            _cut(scene, act, centre)
        else:
            _move(scene, act, centre)
        _check(scene)
    scene.reset()
    np.testing.assert_array_equal(scene.simulation.positions, kidney().rest_positions)


def _cut(scene, blade, centre):
    before, polyline = scene.simulation, np.array(blade.polyline).reshape(-1, 3)
    direction = -polyline.mean(axis=0) if blade.direction is None else blade.direction
    try:
        scene.cut(0, polyline + centre, direction, blade.depth)
    except UserError:
        assert scene.simulation is before, "what is refused changes nothing"
        return
    simulation = scene.simulation
    surface = simulation.cut_organ.surface
    uncut = signed_volume(kidney().surface_positions, kidney().surface_triangles)
    rest = surface.at(simulation.organ.rest_positions)
    assert signed_volume(rest, surface.triangles) == pytest.approx(uncut, rel=1e-4), "the surface is closed"
    assert simulation.model.inverse_mass.min() >= 0.0
    mass = kidney().mass.sum()
    assert simulation.organ.mass.sum() == pytest.approx(mass, rel=1e-9)


def _move(scene, motion, centre):
    start, end = np.array(motion.start) + centre, np.array(motion.end) + centre
    ticks = max(2, round(1000 * float(np.linalg.norm(end - start)) / FASTEST))
    for fraction in np.linspace(0.0, 1.0, ticks):
        scene.move("ball", start + fraction * (end - start))
        scene.step()
        force = np.linalg.norm(scene.wrench("ball")[:3])
        assert force <= scene.simulation.settings.force_clamp * (1.0 + 1e-9)


def _check(scene):
    scene.step(20)
    check_state(scene.simulation.state)
    assert np.isfinite(scene.simulation.positions).all()
    assert np.isfinite(scene.wrench("ball")).all()
