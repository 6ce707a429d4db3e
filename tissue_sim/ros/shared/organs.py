"""All organs of a running loop, as tools meet them."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.handles import handle
from tissue_sim.model import mailboxes as mb
from tissue_sim.model.settings import Settings
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.physics import Physics

RETURN = 0.2  # s in which forces return after the clock or the loop stood


class Organs:
    """Each organ takes up what a tool sends; what the tool feels is the sum. Any one thread may call a method.

    each: by their number in the loop.
    """

    def __init__(self, loop: Loop) -> None:
        self.loop = loop
        self.each = tuple(Physics(loop, organ) for organ in range(len(loop.simulations)))
        self.n_bodies = self.each[0].n_bodies
        self._felt = handle(loop.joined_box.felt)
        self._went_on = -math.inf  # monotonic s, when ticks went on; infinite while they stand

    # in ----------------------------------------------------------------------------------------
    def post_poses(self, bodies: Sequence[int], poses: Floats, stamp: int = 0) -> int:
        """Post the newest poses (b, 7) of a tool's bodies, stamp in ns, and ask for a tick.

        Returns the last one's sequence number, the same of all organs. The tick is asked for after all of them, as in
        between it would move one jaw of a gripper.
        """
        for body, pose in zip(bodies, poses, strict=True):
            sequence = max([one.post_pose(body, pose, stamp) for one in self.each])
        self.loop.wake()
        return sequence

    def post_force(self, body: int, force: Floats) -> int:
        """Post the newest external force (3,) N at the tip of a body; return its sequence number, the same of all."""
        sequence = max([one.post_force(body, force) for one in self.each])
        self.loop.wake()
        return sequence

    # out ---------------------------------------------------------------------------------------
    def settings(self) -> Settings:
        """The newest settings of the first organ, a copy: what concerns tools and ticks is the same of all."""
        return self.each[0].settings()

    @property
    def stale_time(self) -> float:
        """After so many s without input it is stale."""
        return self.each[0].stale_time

    @property
    def ramp_time(self) -> float:
        """In so many s what is stale fades."""
        return self.each[0].ramp_time

    @property
    def tick_time(self) -> float:
        """Simulated time of a tick, s, by the newest settings."""
        return self.each[0].tick_time

    @property
    def answers(self) -> bool:
        """See Physics.answers."""
        return self.each[0].answers

    def wrenches(self) -> tuple[int, Floats]:
        """The newest tick and what tools feel of all organs, (T, 6) N, N m; as Physics.wrenches.

        Where ticks go on after the clock or the loop stood, forces return within RETURN s, with tick -1 until then:
        a tool may still be in touch, and a hand must not get a kick.
        """
        if self.loop.standing or not self.answers:
            self._went_on = math.inf
            return -1, np.zeros((self.n_bodies, 6))
        now = time.monotonic()
        self._went_on = min(self._went_on, now)
        tick, felt = self._newest()
        returned = min(1.0, (now - self._went_on) / RETURN)
        return (tick, felt) if returned == 1.0 else (-1, returned * felt)

    def _newest(self) -> tuple[int, Floats]:
        words = np.zeros(1 + 6 * self.n_bodies, dtype=np.int64)
        mb.take(self._felt, 0, 0, words)
        return int(words[0]), words[1:].view(np.float64).reshape(self.n_bodies, 6)

    def taken(self) -> Longs:
        """See Physics.taken; the same of all."""
        return self.each[0].taken()

    def hold_off(self, bodies: Sequence[int]) -> bool:
        """Return whether any organ doesn't resist one of the bodies, which appeared inside it."""
        return any(one.results().bodies.held_off[list(bodies)].any() for one in self.each)

    @property
    def surface_sequences(self) -> tuple[int, ...]:
        """See Physics.surface_sequence; of each."""
        return tuple(one.surface_sequence for one in self.each)
