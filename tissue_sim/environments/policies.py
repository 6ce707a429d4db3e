"""Policies of few weights, one for each task: what an agent does, by its observations alone; and their files.

Each is a controller whose gains and thresholds are weights. n agents act at once, each by weights of its own, so that
candidates are compared in one vector environment. Lengths are counted in cm, as weights of about 1 are learned best.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tissue_sim.array_types import Array, Floats, Longs, Mask
from tissue_sim.environments.belief import TOUCH, Belief, shape_of
from tissue_sim.environments.steering import TURN
from tissue_sim.environments.tasks import HINGE, RADIUS, Palpate
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_file

FORMAT = 1  # of a policy's file
CM = 0.01  # m
SEARCHED = 180  # steps of a search
TOUCH_TO_DECLARE = 0.06  # N, a little more than what counts as touching
LEAK = 0.98  # of a sum over steps, from one to the next
Seen = Mapping[str, Array]  # observations of n agents, by name


class Policy:
    """Press: keep above the place, and push by what the force lacks. Others change what differs."""

    task = "Press"
    weights: tuple[str, ...] = ("beside", "lack", "far")
    start: tuple[float, ...] = (0.0, 0.0, 0.0)  # weights that learning begins with

    def __init__(self, count: int = 1, organ: Organ | None = None) -> None:  # only some know the organ
        self.memory = np.zeros((count, 4))  # of each agent, zero when its episode begins

    def forget(self, agents: Longs) -> None:
        """Begin new episodes of some agents."""
        self.memory[agents] = 0.0

    def act(self, weights: Floats, seen: Seen) -> Floats:
        """Return the actions (n, a) of n agents.

        Parameters
        ----------
        weights : Floats, shape (n, w) or (w,)
            Their weights.
        seen : Seen
            Their observations.
        """
        w = np.broadcast_to(weights, (len(seen["pose"]), len(self.weights))).T
        beside, outward, along = places(seen)
        push = self._push(w, np.clip(lacking(seen), -1.0, 1.0)) + w[2] * (along > 0.9 * CM)
        return np.clip(w[0][:, None] * beside / CM + push[:, None] * outward, -1.0, 1.0)

    def _push(self, w: Floats, lack: Floats) -> Floats:
        """Return the speed outwards (n,), 1 for the fastest, by the part of the force that lacks."""
        return np.asarray(w[1] * lack)


class HoldPolicy(Policy):
    """Hold: as Press, and by the sum and the change of what the force lacked: breathing doesn't end."""

    task = "Hold"
    weights = (*Policy.weights, "sum", "change")
    start = (0.0,) * 5

    def _push(self, w: Floats, lack: Floats) -> Floats:
        """Return the speed outwards (n,), also by the sum and the change of the missing force once there is one."""
        changed = np.where(self.memory[:, 2] > 0.0, lack - self.memory[:, 1], 0.0)
        self.memory[:, 0] = LEAK * self.memory[:, 0] + lack * (lack < 1.0)
        self.memory[:, 1], self.memory[:, 2] = lack, 1.0
        return np.asarray(w[1] * lack + w[3] * self.memory[:, 0] / 10.0 + w[4] * changed)


class RetractPolicy(Policy):
    """Retract: go down beside the pole with open jaws, close them on a part of its width, and lift."""

    task = "Retract"
    weights = ("beside", "approach", "depth", "close", "closed", "lift")
    start = (-1.0, 0.5, 0.0, 0.5, 0.0, 0.4)  # set by hand: by chance, tissue is never grasped and lifted

    def act(self, weights: Floats, seen: Seen) -> Floats:
        """Return the actions (n, 4)."""
        w = np.broadcast_to(weights, (len(seen["pose"]), len(self.weights))).T
        beside, outward, along = places(seen)
        above = along / CM + 2.0 * (1.0 + w[2])
        width, closes, lifts = seen["goal"][:, 6], self.memory[:, 0] > 0.0, self.memory[:, 1] > 0.0
        # The tips are two hinge lengths times the sine of half the angle apart.
        wide = 2.0 * np.arcsin(np.clip(0.5 * (1.0 + w[4]) * width / (2.0 * HINGE), 0.0, 1.0))
        more = seen["angle"][:, 0] - wide
        self.memory[:, 0] = np.maximum(self.memory[:, 0], above < 0.1)
        self.memory[:, 1] = np.maximum(self.memory[:, 1], closes & (more < 0.01))
        rise = np.where(lifts, w[5], np.where(closes, 0.0, -np.maximum(w[1], 0.0) * np.minimum(above, 1.0)))
        jaws = np.where(closes, -np.maximum(w[3], 0.0) * more / 0.04, 0.0)
        velocity = w[0][:, None] * beside / CM + rise[:, None] * outward
        return np.clip(np.column_stack([velocity, jaws]), -1.0, 1.0)


class PalpatePolicy(Policy):
    """Palpate: know the organ's shape, as from a CT, but not how it lies; feel along it, and conclude where it lies.

    The finger slides over the tissue on a circle about where the tumour should be, and a belief is updated by what it
    feels. Then it goes to where the tumour should be, and says so.
    """

    task = "Palpate"
    weights = ("speed", "force", "radius", "turns", "compliance", "patience")
    start = (0.5, 0.5, 0.5, 0.0, 0.0, 0.0)  # set by hand: a short, light search; from zero, giving up is learned

    def __init__(self, count: int = 1, organ: Organ | None = None) -> None:
        super().__init__(count, organ)
        known = Organ.shipped(Palpate.organ) if organ is None else organ
        node = Palpate.node_over_tumour(known)
        self._place, self._outward = known.surface_positions[node], known.surface_normals[node]
        self._belief = Belief(shape_of(known.surface_positions, known.surface_triangles), count, Palpate.shift, TURN)

    def forget(self, agents: Longs) -> None:
        """Begin new episodes of some agents."""
        super().forget(agents)
        self._belief.forget(agents)

    def act(self, weights: Floats, seen: Seen) -> Floats:
        """Return the actions (n, 4)."""
        w = np.broadcast_to(weights, (len(seen["pose"]), len(self.weights))).T
        # Bounded, as evolution would else press ever harder and faster, which the belief doesn't survive.
        w = np.clip(w, -1.0, 1.5)
        tips, force = (np.asarray(seen[name][:, :3], dtype=np.float64) for name in ("pose", "wrench"))
        self._belief.take(tips, force, RADIUS, 0.02 * (1.0 + w[4]))
        aim, outward, last = self._aim(w)
        size = np.linalg.norm(force, axis=1)
        normal = self._belief.outward(tips)
        normal = np.where((size > TOUCH)[:, None], force / np.maximum(size, TOUCH)[:, None], normal)
        offset = aim + RADIUS * outward - tips
        offset -= np.einsum("nx,nx->n", offset, normal)[:, None] * normal
        left = np.linalg.norm(offset, axis=1)
        push = np.clip((size - 0.1 * w[1]) / 0.05, -1.0, 1.0) * (w[1] > 0.0)
        velocity = w[0][:, None] * offset / np.maximum(left, 0.4 * CM)[:, None] + push[:, None] * normal
        self.memory[:, 0] += 1.0
        is_there = last & (left < 0.15 * CM) & (size > TOUCH_TO_DECLARE)
        return np.clip(np.column_stack([velocity, np.where(is_there, 1.0, -1.0)]), -1.0, 1.0)

    def _aim(self, w: Floats) -> tuple[Floats, Floats, Mask]:
        """Return where to go (n, 3) m, the normal there, and who (n,) has felt enough to go to the tumour."""
        place, _ = self._belief.where(self._place)
        above, _ = self._belief.where(self._place + CM * self._outward)
        outward = (above - place) / np.linalg.norm(above - place, axis=1, keepdims=True)
        first = np.cross(outward, np.where(np.abs(outward[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]]))
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        second = np.cross(outward, first)
        steps = SEARCHED * np.minimum(1.0 + w[5], 1.4)
        part = np.minimum(self.memory[:, 0] / np.maximum(steps, 1.0), 1.0)
        angle = 2.0 * np.pi * (1.0 + w[3]) * part
        last = part >= 1.0
        radius = np.where(last, 0.0, 5.0 * CM * np.maximum(w[2], 0.0))[:, None]
        return place + radius * (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second), outward, last


class CutPolicy(Policy):
    """Cut: put the blade in at one end of the line, slide to the other one, and say that it is done there."""

    task = "Cut"
    weights = ("beside", "lack", "force", "blade", "overshoot", "slow")
    start = (0.0,) * 6

    def act(self, weights: Floats, seen: Seen) -> Floats:
        """Return the actions (n, 5)."""
        w = np.broadcast_to(weights, (len(seen["pose"]), len(self.weights))).T
        goal, line = (np.asarray(seen[name], dtype=np.float64) for name in ("goal", "line"))
        outward, slides = goal[:, 3:6], self.memory[:, 0] > 0.0
        half = 0.5 * (line[:, 3:] - line[:, :3])
        end = 1.0 + w[4] / 10.0
        aim = goal[:, :3] + np.where(slides, end, -end)[:, None] * half
        offset = aim - seen["pose"][:, :3]
        offset = offset - np.einsum("nx,nx->n", offset, outward)[:, None] * outward
        is_there = np.linalg.norm(offset, axis=1) < 0.15 * CM
        force = np.linalg.norm(seen["wrench"][:, :3], axis=1)
        short = goal[:, 6] * (1.0 + w[3] / 10.0) - seen["blade"][:, 0]
        is_in = (np.abs(short) < 0.05 * CM) & (force > 0.05)
        push = -w[1] * np.clip(0.1 * (1.0 + w[2]) - force, -0.3, 0.3)
        speed = np.where(slides & (w[5] > 0.0), 1.0 / (1.0 + np.maximum(w[5], 0.0)), 1.0)
        size = np.maximum(np.linalg.norm(offset, axis=1, keepdims=True) / CM, 1.0)
        velocity = (w[0] * speed)[:, None] * offset / CM / size + push[:, None] * outward
        finished = np.where(slides & is_there, 1.0, -1.0)
        self.memory[:, 0] = np.maximum(self.memory[:, 0], is_there & is_in)
        return np.clip(np.column_stack([velocity, short / 0.1 / CM, finished]), -1.0, 1.0)


POLICIES: dict[str, type[Policy]] = {
    one.task: one for one in (Policy, PalpatePolicy, RetractPolicy, HoldPolicy, CutPolicy)
}


def places(seen: Seen) -> tuple[Floats, Floats, Floats]:
    """Return offsets (n, 3) m of the tool from the line outwards from the place, the normal, and distances along it."""
    goal = np.asarray(seen["goal"], dtype=np.float64)
    outward, offset = goal[:, 3:6], seen["pose"][:, :3] - goal[:, :3]
    along = np.einsum("nx,nx->n", offset, outward)
    return offset - along[:, None] * outward, outward, along


def lacking(seen: Seen) -> Floats:
    """Return the part (n,) of the wanted force that is missing."""
    goal = np.asarray(seen["goal"], dtype=np.float64)
    return np.asarray(1.0 - np.einsum("nx,nx->n", seen["wrench"][:, :3], goal[:, 3:6]) / goal[:, 6])


def policy_class(task: str) -> type[Policy]:
    """Return the policy of a task. Raises UserError for a task without one."""
    if task not in POLICIES:
        raise UserError(f"no policy for task '{task}'; choose one of {', '.join(POLICIES)}")
    return POLICIES[task]


class Learned:
    """A policy of one agent, with weights that were learned.

    Parameters
    ----------
    task : str
        Its task.
    weights : Floats, shape (w,)
        Its weights.
    about : JsonObject, optional
        How it was learned, for its file.
    """

    def __init__(self, task: str, weights: Floats, about: JsonObject | None = None) -> None:
        self.task, self.weights, self.about = task, np.asarray(weights, dtype=np.float64), about or {}
        self._policy = policy_class(task)(1)

    def begin(self) -> None:
        """Begin an episode."""
        self._policy.forget(np.zeros(1, dtype=np.int64))

    def act(self, seen: Seen) -> Floats:
        """Return the action (a,) by the observations of a single environment, or of a tool over ROS."""
        return self._policy.act(self.weights, {name: np.asarray(one)[None] for name, one in seen.items()})[0]

    def save(self, path: str | Path) -> None:
        """Write it to a JSON file.

        Raises
        ------
        UserError
            Where it can't be written.
        """
        names = type(self._policy).weights
        named = dict(zip(names, self.weights.tolist(), strict=True))
        record = {"format": FORMAT, "task": self.task, "weights": named, "about": self.about}
        try:
            Path(path).write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
        except OSError as error:
            raise UserError(f"cannot write {path}: {error.strerror}") from None

    @classmethod
    def load(cls, name: str | Path) -> Learned:
        """Read a policy.

        Parameters
        ----------
        name : str | Path
            Its file, or the name of a task whose policy ships.

        Raises
        ------
        UserError
            Where there is none, or it isn't one.
        """
        path = Path(name) if Path(name).is_file() else shipped_file(f"config/policies/{str(name).lower()}.json")
        if path is None:
            raise UserError(f"there is no policy '{name}'; name a file that 'tissue_sim learn' has written")
        try:
            record = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise UserError(f"cannot read policy {name}: {error}") from None
        if (
            not isinstance(record, dict)
            or record.get("format") != FORMAT
            or not isinstance(record.get("weights"), dict)
        ):
            raise UserError(f"{name} is not a policy of format {FORMAT}; learn it again with 'tissue_sim learn'")
        wanted = policy_class(str(record.get("task"))).weights
        if tuple(record["weights"]) != wanted:
            raise UserError(f"policy {name} has weights {', '.join(record['weights'])}; expected: {', '.join(wanted)}")
        weights = np.array([record["weights"][one] for one in wanted], dtype=np.float64)
        if not np.isfinite(weights).all():
            raise UserError(f"policy {name} has weights that are not finite")
        return cls(record["task"], weights, record.get("about"))
