"""Tasks: what is drawn for an episode, what is rewarded, and when it is done. All are computed for many copies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Ints, Longs, Mask
from tissue_sim.contact.attachments import Breathing
from tissue_sim.contact.grasp import Grasp, at_lower_pole, lower_pole
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.errors import UserError
from tissue_sim.organ.inclusions import inclusions_of
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_file

RATE, STEP = 1000.0, 0.02  # Hz of ticks; s of an environment step
RADIUS = 0.008  # m of the finger
NEAR, HELD = 0.003, 10  # m beside the place; steps in a row after which it is reached
PRECISION = 0.05  # of the force
FOUND, TOUCH = 0.008, 0.05  # m from the tumour's nearest surface point; N that counts as touching
LIFT = 0.004  # m by which tissue is to be lifted
HINGE, TOOTHED = 0.06, 1.0  # m from the tips of the jaws; friction of toothed ones, as in config/gripper.yaml
TILT = 0.3  # rad by which a gripper comes from another side than that of the pole, at most
USUAL = 0.11  # m, length of the kidney, for which the depth of a grasp is
DECLARED, WRONG = 10.0, 3.0  # reward for the right place, and penalty for a wrong one
SEARCH = 0.01  # penalty of a step of a search at most: all 300 cost no more than giving up at once by a wrong answer


class Draw(NamedTuple):
    """What is drawn for one episode; lengths in m, in the organ's frame."""

    place: Floats  # (3,) on the surface
    outward: Floats  # (3,)
    wanted: float  # N of force, of a cut m of depth, of a grasp m of width
    start: Floats  # (3,) of the tool
    stiffness: float  # factor
    half: Floats = np.zeros(3)  # (3,) from there to an end of the line of a cut
    turned: Floats = np.array([0.0, 0.0, 0.0, 1.0])  # (4,) of the tool, xyzw
    angle: float = 0.0  # rad between its jaws


class Now(NamedTuple):
    """What is judged after a step, of n copies, in the organs' frames."""

    place: Floats  # (n, 3) m
    outward: Floats  # (n, 3)
    wanted: Floats  # (n,) N, the force to be reached
    tip: Floats  # (n, 3) m, where the tool is
    pushed: Floats  # (n,) N that pushes the hand out
    force: Floats  # (n,) N, size of the force
    lifted: Floats  # (n,) m by which the tissue at the place has moved outwards
    declared: Mask  # (n,) whether the last action says: here it is


class Judged(NamedTuple):
    """Result of a step."""

    reward: Floats  # (n,)
    is_good: Mask  # (n,) whether the goal is met at present
    is_over: Mask  # (n,) whether the episode ends here whatever follows


class Task:
    """Press: reach a force at a place. Others change what differs."""

    organ, actions = "kidney", 3  # the shipped organ; velocity, and what else a step takes
    has_jaws, declares = False, False  # whether the last action moves jaws, or says: here it is
    has_blade = False
    ends = True  # whether an episode ends where the goal is met for HELD steps
    shift = 0.005  # m by which the organ is moved at most, along each axis
    shows_goal = True

    def scene(self, organ: Organ) -> Scene:
        """Return the scene of the task.

        Parameters
        ----------
        organ : Organ
            The organ.
        """
        return Scene(organ, [self.tool()], rate=RATE, ticks_a_set=round(STEP * RATE))

    def tool(self) -> Tool:
        """Return its tool."""
        return Tool("finger", radius=RADIUS)

    def draw(self, random: np.random.Generator, organ: Organ) -> Draw:
        """Return an episode.

        Parameters
        ----------
        random : np.random.Generator
            Source of what is drawn.
        organ : Organ
            The organ.
        """
        node = random.choice(accessible(organ))
        place, outward = organ.surface_positions[node], organ.surface_normals[node]
        beside = 0.004 * random.uniform(-1.0, 1.0, 3)
        start = place + (RADIUS + random.uniform(0.004, 0.008)) * outward + beside - (beside @ outward) * outward
        return Draw(place, outward, random.uniform(0.15, 0.5), start, np.exp(random.uniform(-0.4, 0.4)))

    def judge(self, now: Now) -> Judged:
        """Return reward and success.

        Parameters
        ----------
        now : Now
            What there is after a step.
        """
        off = np.abs(now.pushed - now.wanted) / now.wanted
        beside = distance_beside(now)
        reward = -np.minimum(off, 1.0) - np.minimum(beside / 0.01, 1.0)
        return Judged(reward, (off < PRECISION) & (beside < NEAR), np.zeros(len(off), dtype=np.bool_))


class Hold(Task):
    """Hold a force against breathing, for the whole episode."""

    ends = False

    def scene(self, organ: Organ) -> Scene:
        """Return a scene whose organ breathes: 8 mm along its z axis, 15 breaths a minute."""
        return Scene(
            organ,
            [self.tool()],
            rate=RATE,
            ticks_a_set=round(STEP * RATE),
            breathing=Breathing(rate=15.0, way=(0.0, 0.0, 0.008)),
            breathes=[1.0],
        )


class Palpate(Task):
    """Find the tumour by touch: press, move on, and say where it is."""

    organ, actions, declares = "kidney_tumour", 4, True
    ends = False
    shift = 0.015
    shows_goal = False

    @staticmethod
    def node_over_tumour(organ: Organ) -> int:
        """Return the surface node nearest to the tumour.

        Parameters
        ----------
        organ : Organ
            The organ.

        Raises
        ------
        UserError
            Where there is none.
        """
        inclusions = inclusions_of(organ)
        if not inclusions:
            raise UserError(f"organ '{organ.name}' has no tumour to palpate; take one with an inclusion")
        apart = np.linalg.norm(organ.surface_positions - np.mean(inclusions[0].positions, axis=0), axis=1)
        return int(np.argmin(apart))

    def draw(self, random: np.random.Generator, organ: Organ) -> Draw:
        """Return an episode: the place is the surface point nearest to the tumour."""
        node = self.node_over_tumour(organ)
        drawn = super().draw(random, organ)
        return drawn._replace(place=organ.surface_positions[node], outward=organ.surface_normals[node])

    def judge(self, now: Now) -> Judged:
        """Return reward and success: the nearer the better, and the right or wrong place at the end."""
        beside = np.linalg.norm(now.tip - now.place - RADIUS * now.outward, axis=1)
        is_here = (beside < FOUND) & (now.force > TOUCH)
        final = np.where(now.declared, np.where(is_here, DECLARED, -WRONG), 0.0)
        return Judged(-SEARCH * np.minimum(beside / 0.05, 1.0) + final, is_here & now.declared, now.declared)


class Retract(Task):
    """Grasp the lower pole and lift it, to expose what lies beside it."""

    actions, has_jaws = 4, True

    def scene(self, organ: Organ) -> Scene:
        """Return a scene with the friction of toothed jaws."""
        scene = super().scene(organ)
        scene.simulation.settings.friction = TOOTHED
        return scene

    def tool(self) -> Tool:
        """Return a gripper with flat jaws."""
        jaws = shipped_file("config/jaws/flat.obj")
        if jaws is None:
            raise UserError("the jaws of Retract, config/jaws/flat.obj, are missing; install tissue_sim again")
        return Tool("jaws", "gripper", length=HINGE, mesh=str(jaws))

    def grasp(self, surface: Floats, triangles: Ints | Longs, out: Floats) -> Grasp:
        """Return how an organ is grasped at its lower pole.

        Parameters
        ----------
        surface : Floats, shape (n, 3), m
            Its surface at rest.
        triangles : Ints | Longs, shape (t, 3)
            Corner indices.
        out : Floats, shape (3,)
            Unit direction that the gripper comes from.

        Raises
        ------
        UserError
            Where the jaws can't take hold of it.
        """
        scale = min(1.0, float(np.ptp(surface @ out)) / USUAL)
        try:
            return at_lower_pole(surface, triangles, self.tool().jaws, scale, out)
        except ValueError as error:
            raise UserError(f"the organ can't be grasped: {error}") from None

    def draw(self, random: np.random.Generator, organ: Organ) -> Draw:
        """Return an episode: the place is the end of the pole, as the gripper comes to it."""
        pole, second, third = lower_pole(organ.surface_positions)
        aside = TILT * np.sqrt(random.uniform()) * np.exp(1j * random.uniform(0.0, 2.0 * np.pi))
        out = pole + np.tan(aside.real) * second + np.tan(aside.imag) * third
        grasp = self.grasp(organ.surface_positions, organ.surface_triangles, out / np.linalg.norm(out))
        place = grasp.place + grasp.depth * grasp.out
        beside = 0.004 * random.uniform(-1.0, 1.0, 3)
        start = place + random.uniform(0.004, 0.008) * grasp.out + beside - (beside @ grasp.out) * grasp.out
        factor = np.exp(random.uniform(-0.4, 0.4))
        return Draw(place, grasp.out, grasp.width, start, factor, turned=grasp.turn, angle=grasp.opened)

    def judge(self, now: Now) -> Judged:
        """Return reward and success: what is missing of the lift, and the tool's distance beside the place."""
        # A grasp has to press in first, which is no worse than nothing.
        short = np.clip((LIFT - now.lifted) / LIFT, 0.0, 1.0)
        beside = np.minimum(distance_beside(now) / 0.02, 1.0)
        return Judged(-short - 0.2 * beside, short == 0.0, np.zeros(len(short), dtype=np.bool_))


class Cut(Task):
    """Cut along a line to a depth: slide a guard over the tissue, below which a blade protrudes; see CutCopies."""

    actions, declares, has_blade = 5, True, True
    ends = False

    def tool(self) -> Tool:
        """Return the guard, which slides on the tissue and meets its force; the blade itself meets no resistance."""
        return Tool("guard", radius=0.002)

    def draw(self, random: np.random.Generator, organ: Organ) -> Draw:
        """Return an episode: the middle of a line on the surface, its half, the depth, and where the guard begins."""
        drawn = super().draw(random, organ)
        across = np.cross(drawn.outward, random.normal(size=3))
        half = random.uniform(0.008, 0.012) * across / np.linalg.norm(across)
        return drawn._replace(half=half, wanted=random.uniform(0.008, 0.014))

    def judge(self, now: Now) -> Judged:
        """Raise NotImplementedError: a cut is judged by its whole path, as CutCopies does."""
        raise NotImplementedError


TASKS: dict[str, type[Task]] = {"Press": Task, "Palpate": Palpate, "Retract": Retract, "Hold": Hold, "Cut": Cut}


def task_of(name: str) -> Task:
    """Return a task by its name.

    Parameters
    ----------
    name : str
        Its name.

    Raises
    ------
    UserError
        For one that isn't there.
    """
    if name not in TASKS:
        raise UserError(f"no task '{name}'; choose one of {', '.join(TASKS)}")
    return TASKS[name]()


def accessible(organ: Organ) -> Longs:
    """Return surface nodes (k,) that tools may be sent to: the half farthest from what is fixed.

    Parameters
    ----------
    organ : Organ
        The organ.
    """
    surface = organ.surface_positions
    fixed = organ.fixed[organ.fixed < organ.n_surface]
    held = surface[fixed] if len(fixed) else surface.mean(axis=0)[None]
    apart = np.linalg.norm(surface[:, None] - held[None], axis=2).min(axis=1)
    return np.argsort(-apart, kind="stable")[: organ.n_surface // 2]


def distance_beside(now: Now) -> Floats:
    """Return how far tools lie beside the line that leads outwards from their places, (n,) m.

    Parameters
    ----------
    now : Now
        What there is after a step.
    """
    offset = now.tip - now.place
    along = np.einsum("nx,nx->n", offset, now.outward)
    return np.asarray(np.linalg.norm(offset - along[:, None] * now.outward, axis=1))
