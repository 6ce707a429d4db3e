"""Learn to press with a wanted force at a wanted place: a policy of five numbers, by evolution on 48 copies."""

import cma
import gymnasium
import matplotlib.pyplot as plt
import numpy as np

import tissue_sim.environments  # noqa: F401 - registers them

CANDIDATES, EACH, STEPS, GENERATIONS = 12, 4, 100, 12  # policies, copies of each, steps of 20 ms
env = gymnasium.make_vec("tissue_sim/Press-v0", num_envs=CANDIDATES * EACH)


def actions(w, seen):
    """Return the actions of the copies, each by its own policy's weights w (n, 5, 1)."""
    goal, outward, wrench = seen["goal"], seen["goal"][:, 3:6], seen["wrench"]
    way = seen["pose"][:, :3] - goal[:, :3]  # m, from the place to the tool
    along = np.sum(way * outward, axis=1, keepdims=True)
    lack = 1.0 - np.sum(wrench[:, :3] * outward, axis=1, keepdims=True) / goal[:, 6:]  # of the wanted force
    push = w[:, 1] * np.clip(lack, -1.0, 1.0) + w[:, 2] * along / 0.01 + w[:, 3] + w[:, 4] * (along > 0.008)
    return np.clip(w[:, 0] * (way - along * outward) / 0.01 + push * outward, -1.0, 1.0)


strategy = cma.CMAEvolutionStrategy(5 * [0.0], 0.5, {"popsize": CANDIDATES, "seed": 1, "verbose": -9})
best, mean = [], []
for generation in range(GENERATIONS):
    weights, total = np.array(strategy.ask()), 0.0
    seen, _ = env.reset(seed=1000 * generation)
    for _ in range(STEPS):
        seen, reward, *_ = env.step(actions(np.repeat(weights, EACH, axis=0)[:, :, None], seen))
        total += reward / STEPS
    score = total.reshape(CANDIDATES, EACH).mean(axis=1)
    strategy.tell(list(weights), list(-score))
    best, mean = [*best, score.max()], [*mean, score.mean()]
    print(f"generation {generation}: reward a step {mean[-1]:.3f} in the mean, {best[-1]:.3f} at best")
np.save("learn_press.npy", strategy.result.xfavorite)
plt.plot(np.transpose([best, mean]))
plt.legend(["best policy", "mean of the policies"])
plt.gca().set(xlabel="generation", ylabel="reward a step")
plt.savefig("learn_press.png", dpi=100)
