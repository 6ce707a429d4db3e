"""The force on a held tool relaxes as the tissue does: the local compliance of the contact relaxes with it."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball_of_cells
from tissue_sim.calibration.cases import surface_of
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool

FRACTION, TIME = 0.3, 0.25  # s
RADIUS, DEEP, RAMP, CLEAR = 0.007, 2e-3, 40, 1e-3  # m, m, ticks, m
TICK = 1e-3  # s
HELD = np.arange(200, 700, 50)  # ticks, when the ball that was stopped swings no more


def held_forces(organ, friction):
    """Forces of a ball that is pressed in within RAMP ticks and held."""
    scene = Scene(organ, [Tool("ball", radius=RADIUS)], ticks_a_set=4)
    scene.simulation.settings.friction = friction
    surface = surface_of(organ)
    node = int(surface.normal[:, 2].argmax())
    out, found = surface.normal[node], []
    for tick in range(HELD[-1] + RAMP + 1):
        deep = min(-CLEAR + (CLEAR + DEEP) * tick / RAMP, DEEP)
        scene.move(0, surface.positions[node] + (RADIUS - deep) * out)
        scene.step()
        if tick - RAMP in HELD:
            found.append(float(scene.wrenches[0, :3] @ out))
    return np.array(found)


@pytest.mark.parametrize(("friction", "tolerance"), [(0.0, 2e-3), (0.6, 8e-3)])
def test_a_held_ball_relaxes_as_the_standard_linear_solid(friction, tolerance):
    """In a body whose moduli all relax alike, the force at a constant depth is the elastic one times the tissue's."""
    organ = ball_of_cells()
    elastic = held_forces(organ, friction)
    relaxing = held_forces(replace(organ, relaxation_fraction=FRACTION, relaxation_time=TIME), friction)
    in_tissue = TICK * RAMP * DEEP / (CLEAR + DEEP)
    since = TICK * HELD + 0.4 * in_tissue  # the mean age of a force that grows as depth to the power 1.5
    wanted = 1.0 + FRACTION / (1.0 - FRACTION) * np.exp(-since / TIME)
    assert wanted[0] > 1.15, "it begins before the tissue has relaxed"
    np.testing.assert_allclose(relaxing / elastic, wanted, rtol=tolerance)
