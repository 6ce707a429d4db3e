"""The loop over organs that are joined: its ticks repeat by hand, as a replay does them."""

from functools import cache

import numpy as np

from helpers.patience import wait_for
from helpers.scenes import ball
from helpers.states import assert_same
from tissue_sim.contact.attachments import Attachment, Breathing
from tissue_sim.contact.organ_contact_finder import OrganContactFinder
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.model.data.records import copy_of
from tissue_sim.model.stepping.contact_pairs import organ_contact_set
from tissue_sim.organ.placement import placed
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.physics import Physics

RADIUS = 0.005  # m, of the tool


@cache
def organs():
    """Two balls that touch."""
    return ball(2), placed(ball(2), [0.0595, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0])


def make_scene():
    """They hang on each other, and the first one breathes."""
    scene = Scene(
        organs(),
        [Tool("left", "sphere", RADIUS)],
        attachments=[Attachment((0, 1), stiffness=5.0, damping=0.01, within=0.01, slack=0.0)],
        breathing=Breathing(60.0, (0.0, 0.0, 0.01)),
        breathes=(1.0, 0.0),
        organ_friction=0.3,
    )
    for one in scene.simulations:
        one.settings.stale_time = 1e9
    return scene


def rows_by_tick(journal):
    rows, inputs = journal
    return {int(row.tick): (row, taken[0]) for row, taken in zip(rows, inputs, strict=True)}


def by_hand(ticks, journals, poses, settings, pair_sets, pair_rows):
    """What the journals tell, fed to a scene of its own."""
    scene = make_scene()
    joined, resets = scene.joined, 0
    newest = [{"pose": 0, "settings": 1} for _ in scene.simulations]
    found = {int(row.tick): int(row.pairs) for row in pair_rows}
    for tick in range(1, ticks + 1):
        was_reset = False
        for organ, simulation in enumerate(scene.simulations):
            if tick not in journals[organ]:
                continue
            row, taken = journals[organ][tick]
            if row.resets != resets:
                simulation.reset()
                was_reset = True
            if row.settings != newest[organ]["settings"]:
                joined.take_settings(organ, settings[organ][row.settings])
            if taken.pose != newest[organ]["pose"]:
                pose = poses[taken.pose].copy()
                pose[:3] -= simulation.state.carried
                simulation.take_pose(0, pose, taken.pose)
            newest[organ] = {"pose": taken.pose, "settings": row.settings}
        if was_reset:
            resets += 1
            joined.reset()
        if tick in found:
            joined.take_pairs(pair_sets[found[tick]])
        joined.step()
    return scene


def test_ticks_of_joined_organs_repeat_by_hand_bit_for_bit():
    scene = make_scene()
    finder = OrganContactFinder(organs())
    loop = Loop(scene.joined)
    both = [Physics(loop, organ) for organ in range(2)]
    poses, pair_sets, settings = {}, {}, [{}, {}]
    positions = [np.empty_like(one.positions) for one in scene.simulations]

    def find_pairs():
        for one, out in zip(both, positions, strict=True):
            _, carried = one.positions(out)
            np.add(out, carried, out=out)
        found = finder.find(positions)
        pair_sets[loop.post_organ_contacts(found)] = organ_contact_set(found.words.copy())

    def post_pose(height):
        pose = np.array([0.0, 0.0, 0.03 + height, 0.0, 0.0, 0.0, 1.0])
        sequences = {one.post_pose(0, pose) for one in both}
        assert len(sequences) == 1
        poses[sequences.pop()] = pose

    loop.start()
    try:
        for step in range(60):
            post_pose(0.02 - 1e-4 * step)
            find_pairs()
            if step == 20:
                tilted = copy_of(scene.simulations[0].settings)
                tilted.gravity_x = 0.5
                settings[0][both[0].post_settings(tilted)] = tilted
            if step == 40:
                loop.reset()
            before = loop.ticks
            wait_for(lambda wanted=before + 5: loop.ticks >= wanted)
        words = both[0].snapshot()
        states = [words, loop.boxes[1].snapshot.copy()]
        journals = [rows_by_tick(one.journal()) for one in both]
        pair_rows = loop.joined_box.journal[: int(loop.joined_box.journal_written[0])].copy()
    finally:
        loop.stop()
    for simulation, snapshot in zip(scene.simulations, states, strict=True):
        simulation.state.words[:] = snapshot
    assert scene.simulations[0].state.carried[2] > 1e-5, "it has breathed"
    assert max(int(row.pairs) for row in pair_rows) > 30
    assert max(pairs.found[0] for pairs in pair_sets.values()) > 0, "they touch"
    again = by_hand(int(scene.simulations[0].state.status.tick), journals, poses, settings, pair_sets, pair_rows)
    assert np.abs(again.simulations[1].velocities).max() > 0.0
    for one, other in zip(again.simulations, scene.simulations, strict=True):
        assert_same(one, other)
