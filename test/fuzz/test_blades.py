"""Random knives, cautery hooks and scissors through an organ: no force above the clamp, nothing that is not finite."""

import warnings
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from helpers.fuzz.examples import examples
from tissue_sim import Organ, Scene, Tool
from tissue_sim.model.stepping.state_check import check_state
from tissue_sim.ros.bags.suite.small_kidney import make_small_kidney

REACH = 0.06  # m about the organ's centre
FASTEST = 1.0  # m/s, of a tool
TOOLS = (
    Tool("tool", shape="blade", radius=0.001, length=0.02),
    Tool("tool", shape="blade", radius=0.0005, length=0.04, height=0.03),
    Tool("tool", shape="blade", radius=0.002, length=0.01, cautery_speed=0.02, cautery_stiffening=10.0),
    Tool("tool", shape="scissors", radius=0.001, length=0.03),
)

pytestmark = [pytest.mark.extended, pytest.mark.timeout(0)]


class Motion(NamedTuple):
    """Where a blade is moved, through all places; each with the tool's z axis, and the angle of scissors."""

    places: list[tuple[tuple[float, float, float], tuple[float, float, float], float]]
    speed: float  # m/s


def vectors(most):
    return st.tuples(*[st.floats(-most, most)] * 3)


motions = st.builds(
    Motion,
    st.lists(st.tuples(vectors(REACH), vectors(3.0), st.floats(0.0, 1.2)), min_size=2, max_size=4),
    st.floats(0.02, FASTEST),
)
pauses = st.integers(60, 1200)  # ticks without poses
acts = st.lists(st.one_of(motions, motions, motions, pauses, st.just("reset")), min_size=1, max_size=5)


@cache
def kidney() -> Organ:
    return make_small_kidney()


@cache
def made(number: int) -> Scene:
    return Scene(kidney(), [TOOLS[number]])


@examples(6)
@given(
    number=st.integers(0, len(TOOLS) - 1),
    toughness=st.floats(0.0, 200.0),
    stiffness=st.sampled_from([0.0, 0.0, 200.0, 2000.0]),  # N/m of the coupling; 0: rigid
    acts=acts,
)
def test_nothing_is_lost(number, toughness, stiffness, acts):
    scene, centre = made(number), kidney().surface_positions.mean(axis=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # cuts that can't be opened are reported
        for act in acts:
            settings = scene.simulation.settings
            settings.toughness, settings.coupling_stiffness, settings.coupling_damping = toughness, stiffness, 1.0
            if act == "reset":
                scene.reset()
                assert not scene.simulation.cuts
                assert not scene.simulation.state.blades.embedded.any()
            elif isinstance(act, int):
                scene.step(act)
                assert not scene.wrench("tool").any()
            else:
                _move(scene, act, centre)
            scene.step(20)
            check_state(scene.simulation.state)
            assert np.isfinite(scene.simulation.positions).all()
        scene.reset()
    np.testing.assert_array_equal(scene.simulation.positions, kidney().rest_positions)


def _move(scene, motion, centre):
    points = np.array([place for place, _, _ in motion.places]) + centre
    turns = Rotation.from_rotvec([turn for _, turn, _ in motion.places])
    times = np.arange(len(points), dtype=float)
    turned, angles = Slerp(times, turns), [angle for _, _, angle in motion.places]
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    for time in np.linspace(0.0, times[-1], max(2, min(2000, round(1000 * length / motion.speed)))):
        place = [np.interp(time, times, points[:, axis]) for axis in range(3)]
        scene.move("tool", place, turned(time).as_quat(), angle=float(np.interp(time, times, angles)))
        scene.step()
        force = np.linalg.norm(scene.wrench("tool")[:3])
        assert force <= scene.simulation.settings.force_clamp * (1.0 + 1e-9)
        assert np.isfinite(scene.simulation.state.blades.rest).all()
