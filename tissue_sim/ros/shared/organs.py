"""All organs of a running loop, as tools meet them."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.handles import handle
from tissue_sim.model.contact.tool_motion import MAX_FAST_SLIPS
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.runtime import mailboxes as mb
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.physics import Physics

RETURN = 0.2  # s in which forces return after the clock or the loop stood


class Organs:
    """The organs: each applies what a tool sends; a tool feels the sum. Any one thread may call a method.

    Parameters
    ----------
    loop : Loop
        The loop.

    Attributes
    ----------
    each
        The organs by their number in the loop.
    """

    def __init__(self, loop: Loop) -> None:
        self.loop = loop
        self.each = tuple(Physics(loop, organ) for organ in range(len(loop.simulations)))
        self.n_bodies = self.each[0].n_bodies
        self._output = handle(loop.joined_box.wrenches)
        self._went_on = -math.inf  # monotonic s, when ticks went on; infinite while they stand

    # in ----------------------------------------------------------------------------------------
    def post_poses(self, bodies: Sequence[int], poses: Floats, stamp: int = 0) -> int:
        """Post the newest poses of a tool's bodies, and request a tick.

        The tick is requested after all of them, as in between it would move one jaw of a gripper.

        bodies (b,): indices of the bodies; poses (b, 7) m and quaternion xyzw; stamp: their time, ns. Returns the last
        one's sequence number, the same for all organs.
        """
        for body, pose in zip(bodies, poses, strict=True):
            sequence = max([one.post_pose(body, pose, stamp) for one in self.each])
        self.loop.wake()
        return sequence

    def post_force(self, body: int, force: Floats) -> int:
        """Post the newest external force at the tip of a body; return its sequence number, the same for all.

        force (3,) N.
        """
        sequence = max([one.post_force(body, force) for one in self.each])
        self.loop.wake()
        return sequence

    # out ---------------------------------------------------------------------------------------
    def settings(self) -> Settings:
        """Return a copy of the newest settings of the first organ: those of tools and ticks are the same for all."""
        return self.each[0].settings()

    @property
    def force_clamp(self) -> float:
        """Largest published force, N."""
        return self.each[0].force_clamp

    @property
    def stale_time(self) -> float:
        """Time without input after which it is stale, s."""
        return self.each[0].stale_time

    @property
    def ramp_time(self) -> float:
        """Time in which a stale input fades, s."""
        return self.each[0].ramp_time

    @property
    def tick_time(self) -> float:
        """Simulated time of a tick, by the newest settings, s."""
        return self.each[0].tick_time

    @property
    def answers(self) -> bool:
        """Whether the loop answers, see Physics.answers."""
        return self.each[0].answers

    def wrenches(self) -> tuple[int, Floats]:
        """Return the newest tick and what tools feel of all organs, (T, 6) N, N m; see Physics.wrenches.

        Where ticks go on after the clock or the loop stood, forces return within RETURN s, with tick -1 until then: a
        tool may still be in touch, and a hand must not get a jolt.
        """
        if self.loop.standing or not self.answers:
            self._went_on = math.inf
            return -1, np.zeros((self.n_bodies, 6))
        now = time.monotonic()
        self._went_on = min(self._went_on, now)
        tick, output = self._newest()
        returned = min(1.0, (now - self._went_on) / RETURN)
        return (tick, output) if returned == 1.0 else (-1, returned * output)

    def _newest(self) -> tuple[int, Floats]:
        words = np.zeros(1 + 6 * self.n_bodies, dtype=np.int64)
        mb.take(self._output, 0, 0, words)
        return int(words[0]), words[1:].view(np.float64).reshape(self.n_bodies, 6)

    def taken(self) -> Longs:
        """Return the inputs that were applied, see Physics.taken; the same for all."""
        return self.each[0].taken()

    def hold_off(self, bodies: Sequence[int]) -> bool:
        """Return whether any organ doesn't resist one of the bodies, which appeared inside it.

        bodies: indices of the bodies.
        """
        return any(one.results().bodies.held_off[list(bodies)].any() for one in self.each)

    def bearable_force(self, bodies: Sequence[int]) -> float:
        """Return the least force, N, up to which organs let bodies be pressed that are held back since they slipped.

        It is infinite where none has. bodies: indices of the bodies.
        """
        every = [one.results().bodies for one in self.each]
        return min(
            float(np.min(some.bearable[list(bodies)], where=some.slips[list(bodies)] > MAX_FAST_SLIPS, initial=np.inf))
            for some in every
        )

    @property
    def surface_sequences(self) -> tuple[int, ...]:
        """The surface_sequence of each organ, see Physics."""
        return tuple(one.surface_sequence for one in self.each)
