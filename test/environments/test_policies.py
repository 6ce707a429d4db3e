"""Policies: their files, what they do by observations alone, and how they are learned."""

import json

import numpy as np
import pytest

pytest.importorskip("gymnasium")
pytest.importorskip("cma")

from helpers.scenes import ball_of_cells
from tissue_sim.cli import main
from tissue_sim.environments.copies import TaskCopies
from tissue_sim.environments.cut_copies import copies_of
from tissue_sim.environments.policies import POLICIES, Learned, policy_class
from tissue_sim.environments.registration import NAMES
from tissue_sim.environments.training import Plan, held_out, learn
from tissue_sim.errors import UserError

SMALL = Plan(generations=6, candidates=6, each=2, steps=60, episodes=6)


def test_every_task_has_a_policy():
    assert set(POLICIES) == set(NAMES)


@pytest.mark.parametrize("task", [task for task in NAMES if task != "Palpate"])
def test_a_policy_without_weights_hardly_moves_and_any_weights_give_valid_actions(task):
    copies = copies_of(task, 2, ball_of_cells())
    copies.begin(np.arange(2), [np.random.default_rng(seed) for seed in range(2)])
    made, seen = policy_class(task), copies.observe()
    still = made(2).act(np.zeros(len(made.weights)), seen)
    assert still.shape == (2, copies.task.actions)
    np.testing.assert_array_equal(still[:, :3], 0.0)
    wild = made(2).act(np.random.default_rng(1).normal(0.0, 100.0, (2, len(made.weights))), seen)
    assert np.all(np.abs(wild) <= 1.0)
    assert np.any(wild[:, :3] != 0.0)


def test_an_agent_that_begins_anew_forgets():
    policy = policy_class("Hold")(3)
    policy.memory[:] = 1.0
    policy.forget(np.array([1]))
    np.testing.assert_array_equal(policy.memory.any(axis=1), [True, False, True])


def test_a_policy_comes_back_from_its_file_to_the_last_bit(tmp_path):
    made = Learned("Press", np.random.default_rng(1).normal(size=3), {"seed": 1})
    made.save(tmp_path / "a.json")
    found = Learned.load(tmp_path / "a.json")
    assert (found.task, found.about) == ("Press", {"seed": 1})
    np.testing.assert_array_equal(found.weights, made.weights)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "there is no policy '.*'; name a file that 'tissue_sim learn' has written"),
        ("{", "cannot read policy"),
        ("[]", "is not a policy of format 1"),
        ('{"format": 1, "task": "Sew", "weights": {}}', "no policy for task 'Sew'; choose one of Press"),
        ('{"format": 1, "task": "Press", "weights": {"a": 1}}', "has weights a; expected: beside, lack, far"),
        (
            '{"format": 1, "task": "Press", "weights": {"beside": NaN, "lack": 0, "far": 0}}',
            "not finite",
        ),
    ],
)
def test_a_file_that_is_no_policy_is_refused(tmp_path, text, message):
    path = tmp_path / "a.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(UserError, match=message):
        Learned.load(path)


def test_learning_improves_and_repeats_to_the_last_bit():
    some = learn("Press", SMALL, seed=3, organ=ball_of_cells(), threads=1)
    curve = [one["mean"] for one in some.about["curve"]]
    assert len(curve) == SMALL.generations
    assert max(curve[3:]) > curve[0]
    reached = some.about["held_out"]
    assert reached["learned"]["return"] > reached["untrained"]["return"]
    others = learn("Press", SMALL._replace(generations=2), seed=3, organ=ball_of_cells(), threads=2)
    assert [one["mean"] for one in others.about["curve"]] == curve[:2]


@pytest.mark.parametrize(
    "task", [pytest.param(task, marks=[] if task == "Press" else pytest.mark.extended) for task in NAMES]
)
def test_the_policy_that_ships_reaches_what_its_file_says(task):
    """On a few of the episodes that its file was measured on; what is learned is far better than a policy untrained."""
    learned = Learned.load(task)
    said = learned.about["held_out"]
    plan = Plan(episodes=10)
    found, nothing = (
        held_out(task, weights, plan) for weights in (learned.weights, np.array(policy_class(task).start))
    )
    assert found["return"] > nothing["return"]
    assert said["learned"]["met"] > 0.65
    assert said["untrained"]["met"] < 0.1
    assert found["met"] == pytest.approx(said["learned"]["met"], abs=0.35)


def test_a_task_is_learned_by_a_command(tmp_path, capsys):
    organ, out, picture = tmp_path / "ball.npz", tmp_path / "press.json", tmp_path / "press.png"
    ball_of_cells().save(organ)
    words = ["learn", "Press", "--organ", str(organ), "--generations", "2", "--episodes", "2"]
    assert main([*words, "--out", str(out), "--plot", str(picture)]) == 0
    text = capsys.readouterr().out
    assert "learned: goal met in " in text
    assert "untrained: goal met in 0 % of 2 new episodes" in text
    result = json.loads(out.read_text())
    assert len(result["about"]["curve"]) == 2
    assert Learned.load(out).weights.shape == (3,)
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["learn", "Press", "--generations", "0"], "--generations 0 is outside 1..10000"),
        (["learn", "Press", "--seed", "-1"], "seed -1 is outside 0..1000"),
        (["learn", "Press", "--out", "/nowhere/a.json"], "folder /nowhere for the policy does not exist"),
        (["learn", "Press", "--out", "a.npz"], "--out a.npz must end in .json"),
        (["learn", "Press", "--plot", "a.txt"], "--plot a.txt must end in .png"),
        (["learn", "Press", "--organ", "none.npz"], "none.npz"),
    ],
)
def test_wrong_use_is_named(capsys, words, message):
    assert main(words) == 2
    assert message in capsys.readouterr().err


def test_a_single_agent_does_what_it_does_among_others():
    copies = TaskCopies("Press", 3, ball_of_cells())
    copies.begin(np.arange(3), [np.random.default_rng(seed) for seed in range(3)])
    weights = np.array([-1.0, -0.5, -0.3])
    many = policy_class("Press")(3).act(weights, copies.observe())
    alone = Learned("Press", weights).act({name: one[2] for name, one in copies.observe().items()})
    np.testing.assert_array_equal(alone, many[2])
