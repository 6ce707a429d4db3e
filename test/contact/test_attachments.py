"""Scenes of several organs: what they hang on, the breath that carries them, tools that touch several."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import RADIUS, ball, changed
from tissue_sim.contact.attachments import Attachment, Breathing
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.errors import UserError

TOOL = [Tool("ball", "sphere", radius=0.005)]
TOP = int(np.argmax(ball(2).surface_positions[:, 2]))


def moved(organ, way):
    parts = ("surface_positions", "atom_positions", "interior_positions")
    return replace(organ, **{part: getattr(organ, part) + way for part in parts})


def pair(gap=0.002):
    """Two balls side by side along x, with a gap between them."""
    return [ball(2), moved(ball(2), [2.0 * RADIUS + gap, 0.0, 0.0])]


def test_a_ligament_shares_its_stiffness_by_area_and_is_slack_at_rest():
    scene = Scene(pair(), TOOL, attachments=[Attachment((0, 1), 100.0, within=0.01)])
    links = scene.joined.links
    assert len(links.slack) > 3
    assert links.stiffness.sum() == pytest.approx(100.0)
    assert 0.001 < links.slack.min() <= links.slack.max() <= 0.01
    for _ in range(5):
        scene.step()
    assert all(simulation.asleep for simulation in scene.simulations)


def test_who_pulls_at_one_organ_pulls_at_the_other():
    hung = [changed(organ, return_stiffness=0.0) for organ in pair()]  # so that nothing but the clamp holds them
    scene = Scene(hung, TOOL, attachments=[Attachment((0, 1), 100.0, within=0.01, damping=0.1)])
    first, second = scene.simulations
    for _ in range(1500):
        first.apply_force([TOP], [[-0.1, 0.0, 0.0]])
        scene.step()
    assert (first.positions - first.model.rest)[TOP, 0] < -1e-3
    drawn = second.reactions().sum(axis=0)  # of its clamp, against what the ligament pulls
    np.testing.assert_allclose(drawn, scene.joined.links.force.sum(axis=0), atol=1e-4)
    assert drawn[0] > 0.005
    scene.reset()
    assert all(simulation.asleep for simulation in scene.simulations)


def test_a_breath_lifts_an_organ_and_draws_at_what_hangs_on_it():
    scene = Scene(
        pair(),
        TOOL,
        attachments=[Attachment((0, 1), 100.0, within=0.01, damping=0.1)],
        breathing=Breathing(60.0, [0.0, 0.0, 0.008]),
        breathes=[1.0, 0.0],
    )
    for _ in range(500):
        scene.step()
    np.testing.assert_allclose(scene.offsets, [[0.0, 0.0, 0.008], [0.0, 0.0, 0.0]], atol=1e-6)
    second = scene.simulations[1]
    assert (second.positions - second.model.rest)[:, 2].max() > 1e-3
    assert second.state.count.faults == 0


def test_a_point_that_breathes_draws_an_organ_that_does_not():
    top = ball(2).surface_positions[TOP]
    point = Attachment((0, None), 5.0, nodes=[TOP], point=top + [0.0, 0.0, 0.01], moves=1.0)
    scene = Scene(pair(), TOOL, attachments=[point], breathing=Breathing(30.0, [0.0, 0.0, 0.01]))
    for _ in range(1000):
        scene.step()
    organ = scene.simulation
    stretch = np.linalg.norm(top + [0.0, 0.0, 0.02] - organ.positions[TOP]) - 0.01
    assert np.linalg.norm(scene.joined.links.force[0]) == pytest.approx(5.0 * stretch, rel=0.01)


def test_a_tool_between_two_organs_feels_both():
    wrenches = []
    for organs in (pair(0.008), pair(0.008)[:1], pair(0.008)[1:]):
        scene = Scene(organs, TOOL)
        between = np.array([RADIUS + 0.004, 0.0, 0.0])
        for tick in range(300):
            scene.move(0, between + [0.0, 0.0, 0.04 * (1.0 - min(1.0, tick / 200.0))])
            scene.step()
        wrenches.append(scene.wrenches[0, :3].copy())
    both, left, right = wrenches
    assert left[0] > 0.005
    assert right[0] < -0.005
    np.testing.assert_allclose(both, left + right, atol=1e-6)


def test_what_a_hand_feels_of_several_organs_is_clamped_as_one():
    scene = Scene(pair(0.002), TOOL)
    for simulation in scene.simulations:
        simulation.settings.force_clamp = 0.05
    for tick in range(300):
        scene.move(0, [RADIUS + 0.001, 0.001, 0.04 * (1.0 - min(1.0, tick / 200.0))])
        scene.step()
    each = [np.linalg.norm(one.state.wrench[0, :3]) for one in scene.simulations]
    assert max(each) <= 0.05 * (1.0 + 1e-9)
    assert 0.0 < np.linalg.norm(scene.wrenches[0, :3]) <= 0.05 * (1.0 + 1e-9)


@pytest.mark.parametrize(
    ("attachment", "expected"),
    [
        (Attachment((0, 5), 10.0, within=0.1), "there are 2"),
        (Attachment((0, 0), 10.0, within=0.1), "there are 2"),
        (Attachment((0, 1), 10.0, within=1e-4), "joins nothing"),
        (Attachment((0, 1), -1.0, within=0.1), "out of range"),
        (Attachment((0, None), 1.0, within=0.1), "or a point"),
        (Attachment((0, 1), 1.0, nodes=[[0, 99_999]]), "don't exist"),
    ],
)
def test_an_attachment_that_can_not_be_is_named(attachment, expected):
    with pytest.raises(UserError, match="attachment 0") as found:
        Scene(pair(), TOOL, attachments=[attachment])
    assert expected in str(found.value)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"breathing": Breathing(0.5, [0, 0, 0.01])}, "breathing rate"),
        ({"breathing": Breathing(15.0, [0, 0])}, "three numbers"),
        ({"breathing": Breathing(15.0, [0, 0, 9.0])}, "three numbers"),
        ({"breathing": Breathing(15.0, [0, 0, 0.01]), "breathes": [1.0]}, "1 numbers for 2 organs"),
        ({"local_region": "modal", "attachments": [Attachment((0, 1), 1.0, within=0.01)]}, "local region off"),
        ({"integrator": "explicit", "attachments": [Attachment((0, 1), 1.0, within=0.01)]}, "symplectic"),
    ],
)
def test_what_does_not_fit_together_is_reported(options, expected):
    with pytest.raises(UserError, match=expected):
        Scene(pair(), TOOL, **options)


def test_substeps_that_links_ask_for_follow_the_settings():
    """Twice the tick takes twice the substeps, or one more; a stiffer organ no fewer."""
    hung = Attachment((0, None), 1e6, within=0.01, point=ball(2).surface_positions[TOP])
    scene = Scene(ball(2), TOOL, attachments=[hung])
    settings = scene.simulation.settings
    least = int(settings.least_substeps)
    assert least > settings.substeps
    settings.tick_time = 2e-3
    scene.joined.set_substeps()
    assert 2 * least - 1 <= settings.least_substeps <= 2 * least
    settings.tick_time, settings.stiffness_scale = 1e-3, 100.0
    scene.joined.set_substeps()
    assert settings.least_substeps > least
