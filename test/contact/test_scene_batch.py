"""Copies of a scene in a batch: each does what the scene does alone, to the last bit."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import RADIUS, ball_of_cells, near
from tissue_sim.contact.attachments import Breathing
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.scene_batch import SceneBatch, pieces
from tissue_sim.contact.tools import Tool
from tissue_sim.errors import UserError

STILL = (0.0, 0.0, 0.0, 1.0)
TICKS = 10  # in a step of these tests
FINGER = Tool("finger", radius=0.008)


def scene_of(*tools, **options):
    return Scene(ball_of_cells(), list(tools) or [FINGER], ticks_a_set=TICKS, **options)


def course(seed, count, tools=1, depth=0.004):
    """Poses (count, tools, 7) of tools that dip into the ball from one side, each its own way."""
    random = np.random.default_rng(seed)
    ways = random.normal(size=(tools, 3)) + [0.0, 0.0, 2.0]
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    poses = np.zeros((count, tools, 7))
    poses[..., 6] = 1.0
    far = RADIUS + 0.008 + 0.003 - (0.003 + depth) * np.sin(np.linspace(0.0, np.pi, count)) ** 2
    poses[..., :3] = far[:, None, None] * ways
    return poses


def alone(scene, poses, angle=0.0):
    """Step a scene along poses (count, tools, 7); return its wrenches and its state's words."""
    wrenches = []
    for each in poses:
        for tool, pose in enumerate(each):
            scene.move(tool, pose[:3], pose[3:], angle)
        scene.step(TICKS)
        wrenches.append(scene.wrenches.copy())
    return np.array(wrenches), [one.state.words.copy() for one in scene.simulations]


def together(batch, poses, angle=0.0):
    """Step a batch along poses (n, count, tools, 7); return its wrenches (n, count, tools, 6)."""
    wrenches = []
    for each in np.swapaxes(poses, 0, 1):
        batch.move(each, angle)
        batch.step(TICKS)
        wrenches.append(batch.wrenches)
    return np.swapaxes(wrenches, 0, 1)


def states_of(batch, copy):
    return [one.state.words for one in batch._scenes[copy].simulations]


def assert_as_alone(make, poses, angle=0.0, threads=2):
    """Each copy of a batch is moved another way, and compared with a scene that goes that way alone."""
    batch = SceneBatch(make(), len(poses), threads=threads)
    found = together(batch, poses, angle)
    for copy, way in enumerate(poses):
        wrenches, states = alone(make(), way, angle)
        np.testing.assert_array_equal(found[copy], wrenches)
        for own, words in zip(states_of(batch, copy), states, strict=True):
            np.testing.assert_array_equal(own, words)
    return found


def test_a_copy_does_what_the_scene_does_alone():
    wrenches = assert_as_alone(scene_of, np.array([course(seed, 30) for seed in range(5)]))
    assert np.all(np.linalg.norm(wrenches[..., :3], axis=-1).max(axis=(1, 2)) > 0.05), "all of them press"
    assert len(np.unique(wrenches[:, 15, 0, 0])) == 5, "each its own way"


@pytest.mark.parametrize("threads", [1, 3])
def test_the_number_of_threads_changes_no_bit(threads):
    poses = np.array([course(seed, 12) for seed in range(7)])
    some, others = SceneBatch(scene_of(), 7, threads=threads), SceneBatch(scene_of(), 7, threads=2)
    np.testing.assert_array_equal(together(some, poses), together(others, poses))
    np.testing.assert_array_equal(some.save(), others.save())


def test_copies_of_tissue_that_stiffens_share_nothing_that_changes():
    scene = Scene(replace(ball_of_cells(), stiffening=20.0), [FINGER])
    copies = SceneBatch(scene, 2)._scenes
    first, second = (one.simulation.model.tissue for one in copies)
    for name in ("rows", "work", "compressed_cells", "stiff", "shortening"):
        assert not np.shares_memory(getattr(first, name), getattr(second, name)), name


@pytest.mark.extended
def test_capsules_and_grippers_do_what_they_do_alone():
    tools = Tool("probe", "capsule", radius=0.006, length=0.05), Tool("jaws", "gripper", radius=0.004, length=0.02)
    poses = np.array([course(seed, 16, tools=2) for seed in range(3)])
    assert_as_alone(lambda: scene_of(*tools), poses, angle=0.4)


@pytest.mark.extended
def test_a_contact_set_of_every_tick_is_found_as_alone():
    def make():
        return Scene(ball_of_cells(), [FINGER], rate=500.0)

    assert_as_alone(make, np.array([course(seed, 10) for seed in range(2)]))


def test_what_only_the_finder_can_do_is_left_to_it():
    """A needle, for which the surface is too coarse, and a finger that is dropped into the middle and slips."""
    needle = Tool("needle", "capsule", radius=0.0006, length=0.02)
    assert_as_alone(lambda: scene_of(needle), np.array([course(seed, 8, depth=0.012) for seed in range(2)]))
    poses = course(3, 8, depth=0.004)
    poses[4:, 0, :3] = [0.0, 0.0, 0.4 * RADIUS]
    batch, scene = SceneBatch(scene_of(), 2, threads=1), scene_of()
    wrenches = together(batch, np.array([poses, poses]))
    np.testing.assert_array_equal(wrenches[1], alone(scene, poses)[0])


@pytest.mark.extended
def test_joined_organs_do_what_they_do_alone():
    def make():
        return scene_of(breathing=Breathing(rate=60.0, way=(0.0, 0.0, 0.004)), breathes=[1.0])

    wrenches = assert_as_alone(make, np.array([course(seed, 12) for seed in range(3)]))
    assert np.all(np.linalg.norm(wrenches[..., :3], axis=-1).max(axis=(1, 2)) > 0.05)


def test_the_scene_stays_as_it_is():
    scene = scene_of()
    before = scene.simulation.state.words.copy()
    batch = SceneBatch(scene, 2, threads=1)
    together(batch, np.array([course(seed, 6) for seed in range(2)]))
    np.testing.assert_array_equal(scene.simulation.state.words, before)


def test_a_batch_goes_on_where_the_scene_was():
    poses = course(1, 20)
    scene = scene_of()
    alone(scene, poses[:12])
    batch = SceneBatch(scene, 2, threads=1)
    np.testing.assert_array_equal(together(batch, np.array([poses[12:]] * 2))[1], alone(scene, poses[12:])[0])


def test_copies_are_reset_one_by_one():
    poses = np.array([course(seed, 10) for seed in range(3)])
    batch = SceneBatch(scene_of(), 3, threads=1)
    first = together(batch, poses)
    batch.reset([False, True, False])
    rest = ball_of_cells().surface_positions
    moved = np.abs(batch.surface_positions() - rest).max(axis=(1, 2))
    assert moved[1] == 0.0
    assert min(moved[0], moved[2]) > 1e-6
    again = together(batch, poses)
    np.testing.assert_array_equal(again[1], first[1])
    assert np.any(again[0] != first[0]), "it still moved when the tool came again"


def test_saved_copies_go_on_to_the_last_bit_in_any_batch_of_the_scene():
    poses = np.array([course(seed, 16) for seed in range(2)])
    batch = SceneBatch(scene_of(), 2, threads=1)
    batch.set_stiffness([[2.0], [0.5]])
    together(batch, poses[:, :8])
    saved = batch.save()
    wrenches = together(batch, poses[:, 8:])
    other = SceneBatch(scene_of(), 3, threads=2)
    together(other, poses[[1, 1, 1]])
    other.restore(saved, [2, 0])
    np.testing.assert_array_equal(together(other, poses[[1, 0, 0], 8:])[[2, 0]], wrenches)


@pytest.mark.extended
def test_saved_joined_copies_go_on_to_the_last_bit():
    poses = np.array([course(seed, 12) for seed in range(2)])
    breathing = Breathing(rate=60.0, way=(0.0, 0.0, 0.004))
    batch = SceneBatch(scene_of(breathing=breathing, breathes=[1.0]), 2, threads=1)
    together(batch, poses[:, :6])
    saved, wrenches = batch.save(), together(batch, poses[:, 6:])
    batch.reset()
    batch.restore(saved)
    np.testing.assert_array_equal(together(batch, poses[:, 6:]), wrenches)


def test_stiffness_is_that_of_each_copy():
    poses = np.array([course(0, 16)] * 3)
    batch = SceneBatch(scene_of(), 3, threads=1)
    batch.set_stiffness([[1.0], [2.0], [2.0]])
    wrenches = together(batch, poses)
    np.testing.assert_array_equal(wrenches[1], wrenches[2])
    assert np.linalg.norm(wrenches[1, 8, 0, :3]) > 1.3 * np.linalg.norm(wrenches[0, 8, 0, :3])


def test_surfaces_and_poses_are_those_of_each_copy():
    organ = ball_of_cells()
    top = organ.surface_positions[near(organ, [0.0, 0.0, 1.0])[0]]
    batch = SceneBatch(scene_of(), 2, threads=1)
    batch.move([[*(top + [0.0, 0.0, 0.008]), *STILL]], copies=[1])
    batch.step(TICKS)
    np.testing.assert_array_equal(batch.poses[1, 0], [*(top + [0.0, 0.0, 0.008]), *STILL])
    for pose in np.linspace([0.0, 0.0, 0.008], [0.0, 0.0, 0.004], 10):
        batch.move([[*(top + pose), *STILL]], copies=[1])
        batch.step(TICKS)
    surfaces = batch.surface_positions("ball")
    np.testing.assert_array_equal(surfaces[0], organ.surface_positions)
    assert surfaces[1, :, 2].max() < top[2] - 0.0015


def test_a_copy_of_a_kidneys_size_takes_two_megabytes_at_most():
    scene = scene_of()
    few, many = SceneBatch(scene, 1), SceneBatch(scene, 3)
    assert few.bytes_a_copy == many.bytes_a_copy
    nodes, cells = scene.simulation.organ.n_nodes, len(scene.simulation.organ.cell_nodes)
    # What grows with an organ is at most this for each node; the shipped kidney has 1788.
    assert few.bytes_a_copy < 400_000 + 700 * nodes + 40 * cells
    assert 400_000 + 700 * 1788 + 40 * 7902 < 2_000_000
    shared = few._scenes[0].simulation.model
    assert shared.tissue.constants is many._scenes[2].simulation.model.tissue.constants


@pytest.mark.parametrize(
    ("use", "message"),
    [
        (lambda batch: batch.move([[0.0] * 7]), "poses have quaternions that are not of length 1"),
        (lambda batch: batch.move([[np.nan] * 7]), "poses must be finite"),
        (lambda batch: batch.move(np.zeros((3, 1, 7))), r"poses have shape \(3, 1, 7\); expected: \(2, 1, 7\)"),
        (lambda batch: batch.reset([2]), "no such copies of 2"),
        (lambda batch: batch.reset([0.5]), "no such copies of 2"),
        (lambda batch: batch.step(-1), "-1 ticks are less than 0"),
        (lambda batch: batch.set_stiffness(0.0), "factors of stiffness must be greater than 0"),
        (lambda batch: batch.restore(np.zeros((2, 5), dtype=np.int64)), r"expected: int64 of shape \(2, \d+\)"),
        (lambda batch: batch.surface_positions("liver"), "no organ 'liver'; choose ball"),
    ],
)
def test_wrong_use_is_reported_in_one_line(use, message):
    batch = SceneBatch(scene_of(), 2, threads=1)
    before = batch.save()
    with pytest.raises(UserError, match=message):
        use(batch)
    np.testing.assert_array_equal(batch.save(), before)


def test_a_batch_needs_copies_and_threads():
    with pytest.raises(UserError, match="a batch of 0 copies"):
        SceneBatch(scene_of(), 0)
    with pytest.raises(UserError, match="a batch on -1 threads"):
        SceneBatch(scene_of(), 1, threads=-1)
    assert repr(SceneBatch(scene_of(), 2, threads=1)) == (
        "<SceneBatch of 2 x ball; finger (sphere); 1000 Hz, 1 thread>"
    )


@pytest.mark.parametrize(("count", "threads"), [(1, 1), (3, 2), (32, 2), (33, 4), (100, 64)])
def test_pieces_hold_every_copy_and_become_small_towards_the_end(count, threads):
    sizes = pieces(count, threads)
    assert sum(sizes) == count
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[0] <= max(1, count / threads)
    assert sizes[-1] == 1, "the copy that is done first waits for one copy at most"
