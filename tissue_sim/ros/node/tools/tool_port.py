"""Port of one tool: its input, its output, and how fresh it is."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.ros.node.input.freshness import Freshness
from tissue_sim.ros.node.input.tool_input import ToolInput
from tissue_sim.ros.node.shared.served_tool import NewestPose, ServedTool
from tissue_sim.ros.node.shared.shared_parts import SharedParts
from tissue_sim.ros.node.tools.tool_output import ToolOutput
from tissue_sim.ros.shared.frames import Frames, Placed, Transform, UnknownFrame
from tissue_sim.ros.shared.report import Report

SAY_EVERY = 1.0  # s between two lines that a tool is held off, or has slipped


class _Events[Event]:
    """Events of one kind, noted by any thread; one log line covers all that came within SAY_EVERY."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._unsaid: list[Event] = []
        self._said = -math.inf  # monotonic s of the last line
        self.count = 0

    def note(self, event: Event) -> None:
        """Count an event, whose line `due` returns."""
        with self._lock:
            self.count += 1
            self._unsaid.append(event)

    def due(self) -> tuple[Event, str] | None:
        """Return the newest event since the last line, and how many these were, as text; None while no line is due."""
        with self._lock:
            now, events = time.monotonic(), self._unsaid
            if not events or now - self._said < SAY_EVERY:
                return None
            self._said, self._unsaid = now, []
        return events[-1], f" ({len(events)} times since the last such line)" if len(events) > 1 else ""


class ToolPort:
    """A tool's input and output, joined: a pose is answered by the wrench of the tick that applies it.

    Where no tick comes, as a clock or the loop stands, it is answered at once.

    woken: set when there is something new to find contacts for.
    """

    def __init__(self, parts: SharedParts, tool: ServedTool, woken: threading.Event) -> None:
        node, organs = parts.node, parts.organs
        self._tool, self._organs, self._woken = tool, organs, woken
        self._answered = 0  # sequence number of the pose
        self._log = node.get_logger()
        self._was_slow = False
        self._held_off = _Events[str]()  # organs that it appeared in
        self._slips = _Events[float]()  # N, that it is pressed with at most from then on
        self.pose_freshness, self.force_freshness = Freshness(parts.clock, organs), Freshness(parts.clock, organs)
        self.output = ToolOutput(node, tool, organs, parts.recorder)
        freshness = self.pose_freshness, self.force_freshness
        self.input = ToolInput(parts, tool, freshness, self._came, woken.set)

    @property
    def name(self) -> str:
        """Name of the tool."""
        return self._tool.name

    @property
    def bodies(self) -> list[int]:
        """Which of all rigid bodies are the tool's."""
        return self._tool.bodies

    @property
    def newest(self) -> NewestPose:
        """Newest pose that was applied."""
        return self.input.newest

    @property
    def extents(self) -> Floats:
        """Radii (b,) m of the balls about the origins of its bodies that enclose them."""
        return np.asarray(self._tool.tools.shapes.extent[self.bodies])

    def place(self, frame_id: str, pose: Sequence[float]) -> None:
        """Apply a pose in a frame, as if its bridge had sent it, but without motion_scale.

        pose (7,) m and quaternion xyzw. Raises UserError while a bridge publishes; UnknownFrame when nothing leads from
        the frame to the organ; Refused when the pose can't be used.
        """
        if self.input.bridges:
            raise UserError(f"tool '{self.name}' is moved by its bridge, which publishes {self.input.topic}")
        tool = self._tool
        to_organ = Transform() if frame_id == tool.organ_frame else tool.frames.to_organ(frame_id).scaled(1.0)
        self.input.place(to_organ.of(pose), frame_id, to_organ)

    def renew_frames(self, frames: Frames) -> None:
        """Lead poses to the organ as other frames do, from the next one on, and wrenches at once.

        A tool that no bridge moves stays where it is in the frame that its pose came in. To be called by the executor's
        thread, which takes the poses.
        """
        self._tool.frames.become(frames)
        newest = self.input.newest
        with suppress(UnknownFrame):  # one that tf no longer has: the next pose is refused
            to_organ = frames.to_organ(newest.frame_id)
            if self.input.poses and not self.input.bridges:
                self._stay(newest, to_organ.scaled(1.0))
            else:
                self.input.newest = newest._replace(to_organ=to_organ)
            self.output.renew(self.input.newest)

    def _stay(self, newest: NewestPose, to_organ: Transform) -> None:
        """Take a pose up again in its frame, from which another transform leads to the organ now."""
        pose = to_organ.of(newest.to_organ.scaled(1.0).inverse().of(newest.pose.tolist()))
        if self.pose_freshness.is_fresh:
            self.input.place(pose, newest.frame_id, to_organ)
        else:  # the ticks have forgotten it
            self.input.move_newest(np.array(pose), to_organ)

    def moving_frames(self, pose: NewestPose) -> Placed:
        """Return the frames that a pose of the tool places."""
        return self._tool.moving_frames(pose)

    def wrench(self, of_bodies: Floats) -> Floats:
        """Return the tool's wrench about its origin, in the organ's axes.

        of_bodies (B, 6) N and N m: wrenches of all bodies. Returns (6,) N and N m.
        """
        return self._tool.wrench(of_bodies, self.newest)

    def state(self) -> str:
        """Return disabled, none, fresh, stale, slipped (until it touches no more) or held_off (until it has left)."""
        if not self.input.enabled:
            return "disabled"
        if self.input.poses == 0:
            return "none"
        if not self.pose_freshness.is_fresh:
            return "stale"
        if self._organs.hold_off(self.bodies):
            return "held_off"
        return "slipped" if self._organs.bearable_force(self.bodies) < math.inf else "fresh"

    def note_inactive(self, organ: str) -> None:
        """Log that the tool appeared inside an organ, and is not resisted until it has been outside.

        Where that happens many times a second, as with poses that come more seldom than `stale_time`, one line covers
        all of them.
        """
        self._held_off.note(organ)
        self._log_inactive()

    def _log_inactive(self) -> None:
        """Log that the tool was held off since the last such line, at most once in SAY_EVERY."""
        if due := self._held_off.due():
            organ, times = due
            self._log.warning(
                f"tool '{self.name}' is inactive (held_off): it appeared inside {organ} and exerts no force until"
                " it has been outside; send a pose outside first, and the next one within stale_time"
                f" ({self._organs.stale_time:g} s){times}"
            )

    def note_slipped(self, bearable: float) -> None:
        """Log that the tool slipped into an organ; one line covers several within SAY_EVERY.

        bearable: N, with which it is pressed at most from then on.
        """
        self._slips.note(bearable)
        self._log_slipped()

    def _log_slipped(self) -> None:
        """Log that the tool slipped since the last such line, at most once in SAY_EVERY."""
        if due := self._slips.due():
            bearable, times = due
            self._log.warning(self._slipped(bearable) + times)

    def _too_slow(self) -> str:
        """Return a line about poses that are stale before the next one comes; log it once when that begins."""
        gap, was_slow = self.pose_freshness.too_slow, self._was_slow
        self._was_slow = gap > 0.0
        if gap == 0.0:
            return ""
        line = (
            f"tool '{self.name}': poses arrive {1.0 / gap:.0f} times a second, but each is stale after stale_time,"
            f" {self._organs.stale_time:g} s: the force fades in between, and inside the organ the tool becomes"
            f" inactive (held_off); send poses more often, or set stale_time to {math.ceil(20.0 * gap) / 10.0:g}"
        )
        if not was_slow:
            self._log.warning(line)
        return line

    def _slipped(self, bearable: float) -> str:
        """Return a line about a tool that has slipped into an organ. bearable: N, with which it is pressed at most."""
        clamp = self._organs.force_clamp
        published = f"; its published force is clamped to {clamp:.3g} N (force_clamp)" if bearable > clamp else ""
        return (
            f"tool '{self.name}' slipped into the tissue: it was pressed deeper than the surface can bear, and"
            f" presses on it with at most {bearable:.2g} N until it has been outside{published}"
        )

    def report(self, report: Report) -> None:
        """Add the state, the force, the poses that came and what was refused."""
        self._log_inactive()
        self._log_slipped()
        own = report.part(f"tool {self.name}", f"{self.name}.")
        own.state = self.state()
        if own.state == "held_off":
            own.warnings.append(
                f"tool '{self.name}' is inactive (held_off): it is inside the organ, and exerts no force until it"
                " has been outside"
            )
        if line := self._too_slow():
            own.warnings.append(line)
        if own.state == "slipped":
            own.warnings.append(self._slipped(self._organs.bearable_force(self.bodies)))
        own.values |= {
            "state": own.state,
            "force_n": self.output.force,
            "poses": self.input.poses,
            "passed_over": self.input.passed_over,
            "damped_forces": self.output.device.damped,
        }
        refused = self.input.refused | ({"nan_wrench": self.output.not_finite} if self.output.not_finite else {})
        own.problems["held_off"] = self._held_off.count
        own.problems |= {f"refused.{why}": count for why, count in sorted(refused.items())}
        report.values["force_n"] = report.values.get("force_n", 0.0) + self.output.force  # of all tools

    def answer(self, taken: int) -> None:
        """Publish the newest wrench, unless the pose of this number, which a tick applied, is not new."""
        if taken not in (0, self._answered):
            self._answered = taken
            self.output.answer(self.newest)

    def _came(self) -> None:
        """Handle a new pose; those that ticks apply are answered by `wrench_replies.WrenchReplies`."""
        if self._organs.loop.standing or not self._organs.answers:
            self.output.answer(self.newest)
            self._woken.set()
