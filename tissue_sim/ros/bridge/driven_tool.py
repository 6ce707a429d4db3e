"""A tool of a running node that an agent moves: as in the environment that it learned in, but in real time."""

from __future__ import annotations

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from tissue_sim.array_types import Floats, Mask
from tissue_sim.contact.tools import Tool
from tissue_sim.environments.blade_path import BladePath, Line, moved_blade
from tissue_sim.environments.policies import Learned
from tissue_sim.environments.steering import Sensed, clipped, declared, moved_jaws, moved_tip, observation_of
from tissue_sim.environments.tasks import HELD, STEP, Judged, Now, Task, task_of
from tissue_sim.errors import UserError
from tissue_sim.ros.bridge.scripted_tool import ScriptedTool
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.qos import RELIABLE
from tissue_sim.ros.shared.tool_link import ToolLink

POSES = 5  # of a step: a bridge sends more often than an agent decides
CLEAR = 0.006  # m from the surface to the tool at the beginning
AWAY = 0.03  # m outwards to which it goes in the end
ANSWERED = 3  # poses outside that the node answers before it begins: a tool whose first pose is inside is held off


class Goal(NamedTuple):
    """What an agent is to do."""

    node: int  # of the surface, at the place
    rest: Floats  # (3,) m, where that node is at rest
    place: Floats  # (3,) m
    outward: Floats  # (3,)
    wanted: float  # N of force, m of the width between jaws, or m of the depth of a cut
    turn: Floats = np.array([0.0, 0.0, 0.0, 1.0])  # (4,) of the tool, xyzw
    angle: float = 0.0  # rad between its jaws at the beginning
    half: Floats = np.zeros(3)  # (3,) m from the place to an end of the line of a cut


class Done(NamedTuple):
    """What it did."""

    is_met: bool  # the goal was met for as many steps as in the environment, or the agent said: here it is, or finished
    steps: int
    fraction: float  # of the steps in which the goal was met
    late: int  # steps that began more than a tenth of a step late
    tip: Floats  # (3,) m, where the tool was in the end
    force: Floats  # (3,) N on the hand then
    path: BladePath | None = None  # of the blade of a cut


class DrivenTool:
    """A tool, its wrench in the organ's frame, and the surface.

    below: what comes before the topics of the organ; rest: points of its surface at rest, and their normals, shapes (n,
    3) m and (n, 3).
    """

    def __init__(self, node: Node, target: str, link: ToolLink, below: str, rest: tuple[Floats, Floats]) -> None:
        self._has_jaws = link.tool.has_jaws
        self._tool = ScriptedTool(node, link, self._has_jaws)
        topic = f"/{target}/{link.tool.name}/wrench"
        self._wrenches = client.NewestMessage(node, WrenchStamped, topic, RELIABLE)
        self._surface = client.NewestMessage(node, PointCloud2, f"{below}surface", client.stream_qos())
        self.wrench, self.answers = np.zeros(6), 0
        self._moved = np.zeros((0, 3))
        self._turn, self._angle = np.array([0.0, 0.0, 0.0, 1.0]), 0.0
        self._blade, self._rest = np.zeros(1), rest

    def meet(self, start: Floats, goal: Goal, longest: float, stop: client.Stop) -> bool:
        """Hold the tool outside until the node answers; return whether it does within some s."""
        if self._has_jaws:
            self._turn, self._angle = goal.turn, goal.angle

        def is_connected() -> bool:
            self._send(start)
            return self.answers >= ANSWERED

        return bool(client.wait_until(is_connected, longest, stop))

    def drive(self, learned: Learned, goal: Goal, start: Floats, steps: int, stop: client.Stop) -> Done:
        """Let an agent move the tool, until its goal is met as in its environment, or for so many steps.

        goal: what it is to do; start (3,) m: where the tool is; steps: steps of 20 ms at most.
        """
        task, tip, held, met, late, count = task_of(learned.task), start, 0, 0, 0, 0
        path = BladePath(Line(goal.place, goal.half, goal.outward, goal.wanted)) if task.has_blade else None
        self._blade = np.zeros(1)
        learned.begin()
        began = time.monotonic()
        while count < steps and not stop:
            late += time.monotonic() > began + (count + 0.1) * STEP
            seen = observation_of(task, self._sensed(tip, goal))
            given = clipped(learned.act({name: one[0] for name, one in seen.items()}))[None]
            before, tip = tip, moved_tip(tip[None], start[None], given[:, :3])[0]
            opened = moved_jaws(np.array([self._angle]), given)[0] if task.has_jaws else 0.0
            before_angle = self._angle
            for part in range(1, POSES + 1):
                fraction = part / POSES
                self._angle = before_angle + fraction * (opened - before_angle)
                self._send(before + fraction * (tip - before), began + (count + fraction) * STEP)
            count += 1
            if path is None:
                judged = self._judge(task, goal, tip, declared(task, given))
            else:
                self._blade = moved_blade(self._blade, given)
                judged = self._note(path, tip, declared(task, given))
            held = held + 1 if judged.is_good[0] else 0
            met += bool(judged.is_good[0])
            if judged.is_over[0] or (task.ends and held >= HELD):
                return Done(True, count, met / count, late, tip, self.wrench[:3], path)
        return Done(not task.ends and held >= HELD, count, met / max(count, 1), late, tip, self.wrench[:3], path)

    def leave(self, tip: Floats, goal: Goal) -> None:
        """Take the tool out of the tissue."""
        began, count = time.monotonic(), 50 * POSES
        for part in range(1, count + 1):
            self._send(tip + part / count * AWAY * goal.outward, began + part / POSES * STEP)

    def _send(self, tip: Floats, due: float = 0.0) -> None:
        """Send a pose when it is due, and take what has come."""
        if (ahead := due - time.monotonic()) > 0.0:
            time.sleep(ahead)
        stamp = time.time_ns()
        self._tool.open(stamp, self._angle)
        self._tool.publish(stamp, np.concatenate([tip, self._turn]))
        for message in self._wrenches.take_all():
            force, torque = message.wrench.force, message.wrench.torque
            self.wrench = np.array([force.x, force.y, force.z, torque.x, torque.y, torque.z])
            self.answers += 1

    def _sensed(self, tip: Floats, goal: Goal) -> Sensed:
        return Sensed(
            pose=np.concatenate([tip, self._turn])[None],
            wrench=self.wrench[None],
            angle=np.array([self._angle]),
            place=goal.place[None],
            outward=goal.outward[None],
            wanted=np.array([goal.wanted]),
            half=goal.half[None],
            blade=self._blade,
        )

    def _note(self, path: BladePath, tip: Floats, says: Mask) -> Judged:
        """Note where the blade is; the cut itself is judged when it is made."""
        moved, force = self._surface_now(), float(np.linalg.norm(self.wrench[:3]))
        if len(moved) == len(self._rest[0]):
            path.note(tip, float(self._blade[0]), force, moved, self._rest)
        return Judged(np.zeros(1), np.zeros(1, dtype=np.bool_), says)

    def _surface_now(self) -> Floats:
        """Return the newest points (n, 3) m of the surface; none before they come."""
        if (surface := self._surface.take()) is not None:
            self._moved = client.cloud_array(surface)[:, :3].astype(np.float64)
        return self._moved

    def _judge(self, task: Task, goal: Goal, tip: Floats, says: Mask) -> Judged:
        moved = self._surface_now()
        there = moved[goal.node] if goal.node < len(moved) else goal.rest
        force = self.wrench[:3]
        return task.judge(
            Now(
                place=goal.place[None],
                outward=goal.outward[None],
                wanted=np.array([goal.wanted]),
                tip=tip[None],
                pushed=np.array([force @ goal.outward]),
                force=np.array([np.linalg.norm(force)]),
                lifted=np.array([(there - goal.rest) @ goal.outward]),
                declared=says,
            )
        )


def check_tool(task: Task, tool: Tool, node: str) -> None:
    """Raise UserError where a node's tool isn't the one that a task was learned with."""
    wanted = task.tool()
    if wanted.has_jaws:
        # A node may have its meshes in another folder.
        if (tool.shape, Path(tool.mesh).name, tool.length) != (wanted.shape, Path(wanted.mesh).name, wanted.length):
            raise UserError(
                f"tool '{tool.name}' of /{node} isn't the gripper that the policy was learned with: start the node with"
                " --params-file config/gripper.yaml"
            )
    elif tool.shape != wanted.shape or abs(tool.radius - wanted.radius) > 1e-6:
        raise UserError(
            f"tool '{tool.name}' of /{node} is a {tool.shape} with a radius of {1e3 * tool.radius:g} mm; the policy was"
            f" learned with another one: start the node with -p {tool.name}.shape:={wanted.shape}"
            f" -p {tool.name}.radius:={wanted.radius:g}"
        )
