"""Command `tissue_sim learn`: learn a policy for a task, and say what it reaches in new episodes."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from tissue_sim.errors import UserError
from tissue_sim.interrupts import leaving
from tissue_sim.organ.organ import Organ
from tissue_sim.outputs import check_file

if TYPE_CHECKING:
    from tissue_sim.environments.policies import Learned

TASKS = ("Press", "Palpate", "Retract", "Hold", "Cut")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("task", metavar="TASK", choices=TASKS, help=f"one of {', '.join(TASKS)}")
    parser.add_argument("--out", metavar="POLICY", help="file (.json) to write the policy to")
    parser.add_argument("--organ", metavar="ORGAN", help="organ file (.npz) (default: the task's)")
    parser.add_argument("--generations", type=int, help="generations of policies (default: the task's)")
    parser.add_argument("--episodes", type=int, help="new episodes at the end (default: the task's)")
    parser.add_argument("--seed", type=int, default=1, help="seed of policies and episodes")
    parser.add_argument("--threads", type=int, default=0, help="threads; 0 for one on each core")
    parser.add_argument("--plot", metavar="PICTURE", help="picture (.png) of the learning curve to write")


def run(args: argparse.Namespace) -> int:
    """Learn; return 0."""
    for name in ("generations", "episodes"):
        if getattr(args, name) is not None and not 1 <= getattr(args, name) <= 10_000:
            raise UserError(f"--{name} {getattr(args, name)} is outside 1..10000")
    if args.out is not None:
        check_file("--out", Path(args.out), ".json", "the policy")
    if args.plot is not None:
        check_file("--plot", Path(args.plot), ".png", "the picture")
    try:
        from tissue_sim.environments.training import PLANS, learn
    except ImportError as error:
        raise UserError(f"learning needs {error.name}: pip install 'tissue_sim[learn]'") from None
    plan = PLANS[args.task]
    plan = plan._replace(
        generations=args.generations or plan.generations,
        episodes=args.episodes or plan.episodes,
    )
    organ = None if args.organ is None else Organ.load(args.organ)
    with leaving("no policy was written"):
        learned = learn(args.task, plan, args.seed, organ, args.threads)
    for line in lines_of(learned):
        print(line)
    if args.out is not None:
        learned.save(args.out)
        print(f"-> {args.out}")
    if args.plot is not None:
        plot(learned, args.plot)
        print(f"-> {args.plot}")
    return 0


def lines_of(learned: Learned) -> list[str]:
    """Return the learning curve and what is reached, as lines of text."""
    lines = [f"{'generation':>10} {'steps':>8} {'processor s':>12} {'mean return':>12} {'best return':>12}"]
    for number, one in enumerate(learned.about["curve"]):
        lines.append(f"{number:10d} {one['steps']:8d} {one['seconds']:12.1f} {one['mean']:12.2f} {one['best']:12.2f}")
    for name, one in learned.about["held_out"].items():
        lines.append(
            f"{name}: goal met in {100.0 * one['met']:.0f} % of {'the steps of ' if learned.task == 'Hold' else ''}"
            f"{one['episodes']} new episodes, return {one['return']:.2f}"
        )
    return lines


def plot(learned: Learned, path: str) -> None:
    """Draw the learning curve of a policy into a picture.

    Raises UserError without matplotlib, and where it can't be written.
    """
    try:
        import matplotlib.pyplot as plt
    except ImportError:
        raise UserError("--plot needs matplotlib: pip install 'tissue_sim[learn]'") from None
    curve = learned.about["curve"]
    figure, axis = plt.subplots(figsize=(6, 4), layout="constrained")
    for name, label in (("best", "best policy of a generation"), ("mean", "mean of its policies")):
        axis.plot([one["steps"] for one in curve], [one[name] for one in curve], label=label)
    axis.set(xlabel="environment steps", ylabel="return of an episode", title=learned.task)
    axis.legend()
    try:
        figure.savefig(path, dpi=100)
    except (OSError, ValueError) as error:
        raise UserError(f"cannot write {path}: {error}") from None
    plt.close(figure)
