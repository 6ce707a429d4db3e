"""Coarse steps of organs that no hand is near: their masses, when they are taken, and the shapes that they lead to."""

import numpy as np

from helpers.scenes import ball, ball_of_cells
from tissue_sim.contact.attachments import Attachment
from tissue_sim.contact.scene_file import SceneFile
from tissue_sim.contact.tools import Tool
from tissue_sim.model.elasticity.frequency import largest_frequency
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.coarse_steps import masses_for
from tissue_sim.organ.placement import placed

APART = 0.2  # m
ORGAN = ball_of_cells(2, 60)  # which takes two substeps
TOP = int(np.argmax(ORGAN.surface_positions[:, 2]))
PULL = [[0.03, 0.0, 0.02]]  # N


def hanging(organ=ORGAN, tools=(), stiff=20.0):
    """Two organs that are attached to each other."""
    ligament = Attachment((0, 1), stiff, nodes=[[TOP, TOP]], slack=APART - 1e-4)
    organs = organ, placed(organ, (APART, 0.0, 0.0))
    file = SceneFile(("one", "two"), organs, (1.0, 1.0), (0.0, 0.0), (ligament,), None, 0.0, (0.0, 0.0, 0.0))
    return file.scene(list(tools))


def pulled(scene, ticks=600, coarse=True):
    """Shapes of the second organ, while the first one is pulled away from it, ever more for half of the time."""
    joined = scene.joined
    if not coarse:
        joined.coarse.square[:] = 0.0
    shapes = []
    for tick in range(ticks):
        joined.simulations[0].apply_force([TOP], -min(1.0, 2.0 * tick / ticks) * np.array(PULL))
        joined.step()
        shapes.append(joined.simulations[1].positions - joined.simulations[1].model.rest)
    return np.array(shapes)


def test_masses_allow_the_step_and_are_no_more_than_they_need_to_be():
    simulation, step = Simulation(ORGAN), 1.15e-3
    model = simulation.model
    factor, frequency = masses_for(model, step)
    assert 2.0 / simulation.frequency < step <= 2.0 / frequency < 1.1 * step
    heavier = model._replace(inverse_mass=model.inverse_mass / factor)
    assert largest_frequency(heavier) == frequency
    assert np.all(factor >= 1.0)
    uniform = (step * simulation.frequency / 2.0) ** 2
    mass = 1.0 / model.inverse_mass[model.moving]
    assert 1.0 < (factor[model.moving] @ mass) / mass.sum() < uniform, "less than if all nodes were made heavier alike"


def test_an_organ_that_no_hand_is_on_takes_one_substep_and_comes_to_the_same_shape():
    scenes = hanging(), hanging()
    found, wanted = pulled(scenes[0]), pulled(scenes[1], coarse=False)
    some, fine = (scene.joined for scene in scenes)
    assert list(fine.coarse.ticks) == [0, 0], "a fault that lets none take them shows here and in the bench's time"
    assert some.coarse.ticks[0] == 0, "a hand is on it"
    assert some.coarse.ticks[1] > 500
    assert some.simulations[0].state.status.substeps == 2
    assert some.simulations[1].state.status.substeps == 1
    size = np.abs(wanted).max()
    assert size > 1e-4
    assert np.abs(found - wanted).max() < 0.05 * size
    assert np.abs(found[-1] - wanted[-1]).max() < 0.002 * size, "at rest, masses have no effect"


def test_a_tool_that_is_near_makes_it_take_all_of_its_substeps():
    scene = hanging(tools=[Tool("ball", "sphere", radius=0.005)])
    top = ORGAN.surface_positions[TOP] + (APART, 0.0, 0.0)
    ticks = []
    for above in (0.1, 0.006, 0.004):  # m, of the ball's middle; it touches at the last
        for tick in range(310):
            scene.move(0, top + (0.0, 0.0, above))
            scene.joined.simulations[0].apply_force([TOP], -min(1.0, tick / 100.0) * np.array(PULL))
            scene.step()
            if tick == 299:
                before = int(scene.joined.coarse.ticks[1])
        ticks.append(int(scene.joined.coarse.ticks[1]) - before)
    assert ticks[0] == 10
    assert ticks[2] == 0
    assert scene.simulations[1].state.contacts.header.points > 0


def test_springs_and_organs_in_motion_take_all_of_their_substeps():
    assert not hanging(ball(2)).joined.coarse.square.any()
    assert not hanging(stiff=1e4).joined.coarse.square.any(), "ligaments that require short steps"
    joined = hanging().joined
    joined.simulations[1].velocities[TOP] = 0.02  # m/s
    joined.simulations[1].state.status.asleep = False
    joined.step()
    assert joined.coarse.ticks[1] == 0
