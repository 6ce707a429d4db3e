"""Environments for learning: what Gymnasium requires, seeds, rewards, and the same copies alone and in a vector."""

import warnings

import numpy as np
import pytest

from helpers.drawing import require_drawing
from helpers.scenes import ball_of_cells
from tissue_sim.errors import UserError

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env  # noqa: E402

import tissue_sim.environments  # noqa: E402, F401
from tissue_sim.environments.copies import TaskCopies  # noqa: E402
from tissue_sim.environments.observations import SIZE, VIEW, Camera  # noqa: E402
from tissue_sim.environments.registration import NAMES  # noqa: E402
from tissue_sim.environments.tasks import HELD, RADIUS  # noqa: E402
from tissue_sim.organ.organ import Organ  # noqa: E402
from tissue_sim.rendering.pinhole import Pinhole, matrix_of  # noqa: E402


def organ_for(task):
    return Organ.shipped("kidney_tumour") if task == "Palpate" else ball_of_cells()


def vector_of(task="Press", count=3, **options):
    return gymnasium.make_vec(f"tissue_sim/{task}-v0", num_envs=count, organ=organ_for(task), **options)


def played(env, seed, steps, actions_seed=0):
    """Observations, rewards and ends of a vector environment under random actions."""
    seen, _ = env.reset(seed=seed)
    random, found = np.random.default_rng(actions_seed), [seen]
    for _ in range(steps):
        actions = random.uniform(-1.0, 1.0, env.action_space.shape)
        seen, reward, terminated, truncated, _ = env.step(actions)
        found += [seen, {"reward": reward, "terminated": terminated, "truncated": truncated}]
    return found


def assert_same(some, others):
    for one, other in zip(some, others, strict=True):
        for name, values in one.items():
            np.testing.assert_array_equal(values, other[name])


@pytest.mark.parametrize("task", ["Press", pytest.param("Retract", marks=pytest.mark.extended)])
def test_gymnasiums_checker_finds_nothing(task):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*infinity.*|.*symmetric and normalized.*|.*check_env.*")
        env = gymnasium.make(f"tissue_sim/{task}-v0", organ=organ_for(task))
        check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.extended
@pytest.mark.parametrize("task", ["Palpate", "Hold", "Cut"])
def test_gymnasiums_checker_finds_nothing_in_the_others(task):
    check_env(gymnasium.make(f"tissue_sim/{task}-v0", organ=organ_for(task)).unwrapped, skip_render_check=True)


@pytest.mark.parametrize(
    "task", [task if task == "Press" else pytest.param(task, marks=pytest.mark.extended) for task in NAMES]
)
def test_a_vector_environment_keeps_its_spaces(task):
    env = vector_of(task, observation="surface")
    seen, info = env.reset(seed=1)
    assert info == {}
    assert env.num_envs == 3
    assert env.metadata["autoreset_mode"] is gymnasium.vector.AutoresetMode.NEXT_STEP
    assert seen in env.observation_space
    env.action_space.seed(1)
    for _ in range(3):
        seen, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert seen in env.observation_space
        assert reward.shape == terminated.shape == truncated.shape == info["success"].shape == (3,)
        assert terminated.dtype == truncated.dtype == np.bool_
    env.close()


def test_seeds_repeat_to_the_last_bit_on_any_number_of_threads():
    some, others = (played(vector_of(threads=threads), 7, 8) for threads in (1, 2))
    assert_same(some, others)
    other_seed = played(vector_of(), 8, 1)
    assert np.any(other_seed[0]["goal"] != some[0]["goal"])


def test_an_environment_does_what_its_copy_in_a_vector_does():
    vector, single = vector_of(count=2), gymnasium.make("tissue_sim/Press-v0", organ=ball_of_cells())
    many, _ = vector.reset(seed=3)
    one, _ = single.reset(seed=4)  # the second copy takes the seed plus one
    random = np.random.default_rng(0)
    for _ in range(6):
        assert all(np.array_equal(one[name], many[name][1]) for name in one)
        action = random.uniform(-1.0, 1.0, (2, 3))
        many, rewards, *_ = vector.step(action)
        one, reward, *_ = single.step(action[1])
        assert reward == rewards[1]


def press_on(env, seen):
    """Go to the place from outside and press, by a controller that reads the observations alone."""
    goal, pose, wrench = seen["goal"], seen["pose"], seen["wrench"]
    outward, offset = goal[:, 3:6], pose[:, :3] - goal[:, :3]
    along = np.sum(offset * outward, axis=1, keepdims=True)
    beside = offset - along * outward
    short = goal[:, 6:] - np.sum(wrench[:, :3] * outward, axis=1, keepdims=True)
    return np.clip(-40.0 * beside / 0.05 - np.clip(0.8 * short, -0.3, 0.3) * outward, -1.0, 1.0)


def test_a_press_of_the_wanted_force_ends_the_episode():
    env = vector_of(count=2)
    seen, _ = env.reset(seed=5)
    ends = np.zeros(2, dtype=int)
    for step in range(150):
        seen, reward, terminated, _, _ = env.step(press_on(env, seen))
        ends[(ends == 0) & terminated] = step + 1
        if ends.all():
            break
    assert np.all(ends > HELD)
    assert reward[terminated].min() > -0.6


def test_an_episode_is_truncated_and_begins_anew_in_the_next_step():
    env = vector_of(count=2, max_episode_steps=4)
    first, _ = env.reset(seed=2)
    none = np.zeros((2, 3), dtype=np.float32)
    ends = [env.step(none)[3].tolist() for _ in range(4)]
    assert ends == [[False] * 2] * 3 + [[True] * 2]
    seen, reward, terminated, truncated, _ = env.step(none)
    assert reward.tolist() == [0.0, 0.0]
    assert not terminated.any() | truncated.any()
    assert np.all(seen["goal"][:, 6] != first["goal"][:, 6]), "another force is wanted"
    assert [env.step(none)[3].tolist() for _ in range(4)] == ends


def test_the_organs_place_and_stiffness_are_drawn():
    copies = TaskCopies("Press", 4, ball_of_cells())
    copies.begin(np.arange(4), [np.random.default_rng(seed) for seed in range(4)])
    surface = copies.surface()
    middles = surface.mean(axis=1)
    assert len(np.unique(middles[:, 0])) == 4
    spans = [np.linalg.norm(one[0] - one[10]) for one in surface]
    np.testing.assert_allclose(spans, spans[0], rtol=1e-5)
    factors = [one.simulation.settings.stiffness_scale for one in copies.batch._scenes]
    assert len(set(factors)) == 4
    assert 0.6 < min(factors) < max(factors) < 1.5


def test_a_find_ends_the_episode_right_or_wrong():
    copies = TaskCopies("Palpate", 2)
    copies.begin(np.arange(2), [np.random.default_rng(seed) for seed in range(2)])
    assert "goal" not in copies.observe()
    right = copies._place[0] + (RADIUS - 0.005) * copies._outward[0]
    for fraction in np.linspace(0.0, 1.0, 30):
        copies._tip[0] = copies._place[0] + (RADIUS + 0.004 - fraction * 0.009) * copies._outward[0]
        stepped = copies.step(np.zeros((2, 4)))
    np.testing.assert_allclose(copies._tip[0], right, atol=1e-9)
    assert not stepped.terminated.any()
    stepped = copies.step(np.array([[0.0, 0.0, 0.0, 1.0]] * 2))
    assert stepped.terminated.all()
    assert stepped.succeeded.tolist() == [True, False]
    assert stepped.reward[0] > 9.0
    assert -3.1 < stepped.reward[1] <= -3.0


def test_what_is_not_there_is_named():
    with pytest.raises(UserError, match="no task 'Sew'; choose one of Press, Palpate, Retract, Hold, Cut"):
        TaskCopies("Sew", 1)
    copies = TaskCopies("Palpate", 1, ball_of_cells())
    with pytest.raises(UserError, match="has no tumour to palpate"):
        copies.begin(np.arange(1), [np.random.default_rng(0)])


@pytest.mark.parametrize("task", ["Press", pytest.param("Retract", marks=pytest.mark.extended)])
def test_images_repeat_show_the_tool_and_follow_the_seed(task):
    require_drawing()
    some, others = (played(vector_of(task, 2, observation="image", threads=threads), 7, 3) for threads in (1, 2))
    assert_same(some, others)
    images = some[0]["image"]
    assert images.shape == (2, 64, 64, 3)
    assert images.dtype == np.uint8
    assert np.any(images[0] != images[1]), "each copy has its own tool and place"
    assert np.any(images != played(vector_of(task, 2, observation="image"), 8, 0)[0]["image"])
    env = vector_of(task, 2, observation="image")
    seen, _ = env.reset(seed=7)
    assert seen in env.observation_space
    single = gymnasium.make(f"tissue_sim/{task}-v0", organ=organ_for(task), observation="image")
    one, _ = single.reset(seed=8)
    np.testing.assert_array_equal(one["image"], seen["image"][1])
    check_env(single.unwrapped, skip_render_check=True)


def test_an_environment_is_rendered_as_gymnasium_asks():
    require_drawing()
    env = gymnasium.make("tissue_sim/Press-v0", organ=ball_of_cells(), render_mode="rgb_array")
    check_env(env.unwrapped)
    env.reset(seed=1)
    before = env.render()
    assert before.shape == (480, 480, 3)
    env.step(np.ones(3, dtype=np.float32))
    assert np.any(env.render() != before), "the tool has moved"


def test_an_image_shows_the_organ_where_the_observations_have_it():
    """The camera stands still in the environment's frame: the organ's middle is where its surface's middle is."""
    require_drawing()
    copies = TaskCopies("Press", 2, ball_of_cells())
    copies.begin(np.arange(2), [np.random.default_rng(seed) for seed in range(2)])
    camera = Camera(copies)
    eye, lens = camera._pose, Pinhole.of_view(SIZE, SIZE, VIEW)
    for image, surface in zip(camera.pictures(), copies.surface(), strict=True):
        rows, columns = np.nonzero(image[..., 0].astype(int) - image[..., 1] > 50)  # tissue
        in_camera = np.linalg.inv(matrix_of(eye)) @ np.append(surface.mean(axis=0), 1.0)
        expected = lens.project(in_camera[None, :3])[0]
        np.testing.assert_allclose([np.median(columns), np.median(rows)], expected, atol=2.5)


def test_another_observation_is_named():
    with pytest.raises(UserError, match="no observation 'sound'; choose one of pose, surface, image"):
        vector_of(observation="sound")
