"""The learning curves of the policies that ship, from their files, and what they reach in new episodes."""

import json
from pathlib import Path

import matplotlib.pyplot as plt

FOLDER = Path(__file__).resolve().parents[2] / "config" / "policies"
TASKS = ("press", "hold", "cut", "palpate", "retract")

figure, axes = plt.subplots(1, len(TASKS), figsize=(14, 3.2), layout="constrained")
for task, axis in zip(TASKS, axes, strict=True):
    about = json.loads((FOLDER / f"{task}.json").read_text())["about"]
    curve, reached = about["curve"], about["held_out"]
    for name, label in (("best", "best policy of a generation"), ("mean", "mean of its policies")):
        axis.plot([one["steps"] / 1000 for one in curve], [one[name] for one in curve], label=label)
    axis.axhline(reached["learned"]["return"], color="grey", linestyle=":", label="learned, new episodes")
    axis.set(title=task.capitalize(), xlabel="environment steps (1000)")
    print(
        f"{task.capitalize()}: {curve[-1]['steps']} steps, {curve[-1]['seconds']:.0f} s of processor time; return"
        f" {reached['untrained']['return']:.1f} before and {reached['learned']['return']:.1f} after, goal met"
        f" {100 * reached['untrained']['met']:.0f} and {100 * reached['learned']['met']:.0f} %"
    )
axes[0].set_ylabel("return of an episode")
axes[0].legend(fontsize=8)
figure.savefig("learning_curves.png", dpi=100)
