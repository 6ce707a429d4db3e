"""An organ that relaxes is pressed and held by the model, and identification writes an organ that relaxes alike."""

from dataclasses import replace

import numpy as np
import pytest

from tissue_sim.identification.fitted_organ import KEY, with_stiffness
from tissue_sim.identification.identify import Settings, identify, lines_of
from tissue_sim.identification.measured import Hold
from tissue_sim.identification.press_curves import forget
from tissue_sim.identification.pressing import Press, ball, lead, moving_forces
from tissue_sim.identification.relaxation import Relaxation
from tissue_sim.identification.relaxing_organ import Presses, relaxing

FACTOR, FRACTION, CONSTANT = 0.63, 0.3, 1.0  # s
SPEED, DEEP, LENGTH = 0.008, 2e-3, 11.0  # m/s, m, s
FRICTION = 0.6


def measured(presses, organ):
    """Presses at a speed, and a hold at the first place, of an organ in the model."""
    measurement, _ = presses
    scene = ball(organ, measurement.radius, FRICTION)
    paths = [Press(one.place, one.direction) for one in measurement.presses]
    made = [
        one._replace(forces=moving_forces(scene, path, one.depths, SPEED), speed=SPEED)
        for one, path in zip(measurement.presses, paths, strict=True)
    ]
    scene.reset()
    time, depths, forces = [], [], []

    def note(when, depth):
        time.append(when)
        depths.append(depth)
        forces.append(-float(scene.wrenches[0, :3] @ paths[0].direction))

    for depth in np.linspace(-1e-3, DEEP, 76):
        lead(scene, paths[0], (depths[-1] if depths else -1e-3, float(depth)), SPEED)
        note((depth - DEEP) / SPEED, float(depth))
    for tick in range(1, round(1e3 * LENGTH)):
        scene.move(0, paths[0].at(DEEP))
        scene.step()
        if tick % 20 == 0:
            note(1e-3 * tick, DEEP)
    hold = Hold(made[0].name, np.array(time), np.array(depths), np.array(forces))
    return measurement._replace(presses=made, holds=[hold])


@pytest.mark.extended
def test_an_organ_that_relaxes_comes_back(organ, presses):
    """What the force shows are the tissue's numbers; the modulus is that of tissue that has relaxed."""
    truth = replace(with_stiffness(organ, FACTOR, {}), relaxation_fraction=FRACTION, relaxation_time=CONSTANT)
    found = identify(organ, measured(presses, truth), Settings(friction=FRICTION, with_map=False))
    assert found.rate_effects.relaxation.fraction == pytest.approx(FRACTION, abs=0.03)
    assert found.organ.relaxation_fraction == pytest.approx(FRACTION, abs=0.02)
    assert found.organ.relaxation_time == pytest.approx(CONSTANT, rel=0.1)
    assert found.organ.youngs_modulus == pytest.approx(truth.youngs_modulus, rel=0.04)
    assert found.modulus > 1.1 * truth.youngs_modulus, "presses are over before the tissue has relaxed"
    assert found.organ.provenance[KEY]["youngs_modulus_pa"] == pytest.approx(found.modulus)
    assert "relaxation is in the organ file" in "\n".join(lines_of(found))


def test_what_an_organ_cannot_hold_is_reported(organ, presses):
    given = Presses(*presses, np.zeros(4), 1.0, FRICTION)
    for one in (Relaxation(0.3, 100.0, 0.01, 1.0, 1, 0.0), Relaxation(0.95, 1.0, 0.01, 0.1, 1, 0.0)):
        same, line = relaxing(organ, one, given, forget)
        assert same is organ
        assert "an organ relaxes by 90 % at most, with a time constant of 0.01 to 60 s" in line
    assert relaxing(organ, None, given, forget) == (organ, "")
