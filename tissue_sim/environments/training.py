"""Learning of a policy's weights by evolution (CMA-ES, Hansen 2016), and what the policy reaches in new episodes."""

from __future__ import annotations

import time
from typing import NamedTuple

import gymnasium
import numpy as np

from tissue_sim import progress
from tissue_sim.array_types import Floats, Mask
from tissue_sim.environments.policies import Learned, Policy, policy_class
from tissue_sim.environments.registration import NAMES, PREFIX
from tissue_sim.environments.tasks import task_of
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ

HELD_OUT = 1_000_000  # seed of the first new episode, beyond those that are learned from
LARGEST_SEED = 1000


class Plan(NamedTuple):
    """How much is learned from."""

    generations: int = 12
    candidates: int = 10  # policies of a generation
    each: int = 3  # episodes of each
    steps: int = 100  # of an episode at most
    episodes: int = 40  # new ones, at the end
    sigma: float = 0.5  # standard deviation of the first weights


PLANS = {
    "Press": Plan(),
    "Hold": Plan(),
    "Retract": Plan(each=4, steps=200, sigma=0.3),
    "Palpate": Plan(generations=10, each=6, steps=300, episodes=120, sigma=0.25),
    "Cut": Plan(steps=120),
}


class Played(NamedTuple):
    """What n agents did in an episode each."""

    returns: Floats  # (n,) sum of rewards
    is_met: Mask  # (n,) whether it ended with success
    fraction: Floats  # (n,) of its steps in which the goal was met
    steps: int  # of all agents together


class Generation(NamedTuple):
    """A point of a learning curve: returns of an episode, in the mean over a policy's."""

    mean: float
    best: float
    steps: int  # environment steps so far
    seconds: float  # of the processor, so far


def played(env: gymnasium.vector.VectorEnv, policy: Policy, weights: Floats, seeds: list[int], steps: int) -> Played:
    """Play an episode with each copy of an environment.

    Parameters
    ----------
    env : gymnasium.vector.VectorEnv
        The environment, of n copies.
    policy : Policy
        The policy, of as many agents.
    weights : Floats, shape (n, w) or (w,)
        Their weights.
    seeds : list[int]
        Seeds (n,) of the episodes.
    steps : int
        Steps of an episode at most.
    """
    seen, _ = env.reset(seed=seeds)  # type: ignore[arg-type]  # a list of seeds, as VectorEnv's subclasses take it
    policy.forget(np.arange(len(seeds)))
    plays, is_met = np.ones(len(seeds), dtype=np.bool_), np.zeros(len(seeds), dtype=np.bool_)
    returns, good, done = np.zeros(len(seeds)), np.zeros(len(seeds)), np.zeros(len(seeds))
    for _ in range(steps):
        seen, reward, terminated, truncated, info = env.step(policy.act(weights, seen))
        returns += np.where(plays, reward, 0.0)
        good += plays & info["success"]
        done += plays
        is_met |= plays & terminated & info["success"]
        plays &= ~(terminated | truncated)
        if not plays.any():
            break
    return Played(returns, is_met, good / done, int(done.sum()))


def learn(task: str, plan: Plan, seed: int = 1, organ: Organ | None = None, threads: int = 0) -> Learned:
    """Learn a policy; its `about` holds the learning curve and what it reaches in new episodes.

    Parameters
    ----------
    task : str
        The task.
    plan : Plan
        How much is learned from.
    seed : int, optional
        Seed of candidates and episodes, 0 to LARGEST_SEED.
    organ : Organ | None, optional
        Another organ than the task's.
    threads : int, optional
        As in SceneBatch.

    Raises
    ------
    UserError
        For a task without a policy, for a seed out of range, and without the package cma.
    """
    made = policy_class(task)
    if not 0 <= seed <= LARGEST_SEED:
        raise UserError(f"seed {seed} is outside 0..{LARGEST_SEED}")
    try:
        import cma
    except ImportError:
        raise UserError("learning needs cma: pip install 'tissue_sim[learn]'") from None
    count = plan.candidates * plan.each
    env = gymnasium.make_vec(f"{PREFIX}{task}-v0", num_envs=count, organ=organ, threads=threads)
    # Seed 0 would be drawn from the clock.
    options = {"popsize": plan.candidates, "seed": seed + 1, "verbose": -9}
    strategy = cma.CMAEvolutionStrategy(list(made.start), plan.sigma, options)
    policy, curve, steps, began = made(count, organ), list[Generation](), 0, time.process_time()
    for generation in progress.steps(range(plan.generations), f"learning {task}"):
        weights = np.array(strategy.ask())
        first = (seed * 1000 + generation) * plan.each  # the same episodes for all candidates
        seeds = [first + number for number in range(plan.each)] * plan.candidates
        one = played(env, policy, np.repeat(weights, plan.each, axis=0), seeds, plan.steps)
        score = one.returns.reshape(plan.candidates, plan.each).mean(axis=1)
        strategy.tell(list(weights), list(-score))
        steps += one.steps
        curve.append(Generation(float(score.mean()), float(score.max()), steps, time.process_time() - began))
    best = np.array(strategy.result.xfavorite)  # the middle of the last candidates
    env.close()
    about: JsonObject = {"seed": seed, "plan": plan._asdict(), "curve": [one._asdict() for one in curve]}
    about["held_out"] = {
        "learned": held_out(task, best, plan, organ, threads),
        "untrained": held_out(task, np.array(made.start), plan, organ, threads),
    }
    return Learned(task, best, about)


def held_out(task: str, weights: Floats, plan: Plan, organ: Organ | None = None, threads: int = 0) -> dict[str, float]:
    """Return what a policy reaches in new episodes: mean return, fraction met, and steps that are needed.

    Parameters
    ----------
    task : str
        The task.
    weights : Floats, shape (w,)
        The policy's weights.
    plan : Plan
        Tells how many.
    organ : Organ | None, optional
        As in `learn`.
    threads : int, optional
        As in SceneBatch.
    """
    env = gymnasium.make_vec(
        f"{PREFIX}{task}-v0", num_envs=plan.episodes, organ=organ, threads=threads, max_episode_steps=NAMES[task]
    )
    seeds = [HELD_OUT + number for number in range(plan.episodes)]
    one = played(env, policy_class(task)(plan.episodes, organ), weights, seeds, NAMES[task])
    env.close()
    # A task that doesn't end where its goal is met is to be met all the time.
    met = one.is_met if task_of(task).ends or task_of(task).declares else one.fraction
    return {"return": float(one.returns.mean()), "met": float(np.mean(met)), "episodes": plan.episodes}
