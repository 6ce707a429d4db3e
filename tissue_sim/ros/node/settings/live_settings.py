"""The simulation's settings while the node runs: the parameters, less what the machine is too slow for."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence

from tissue_sim.model.contact.virtual_coupling import passive_stiffness
from tissue_sim.model.data.records import copy_of, words_of
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.critical_step import substeps_for
from tissue_sim.ros.node.input.freshness import Freshness
from tissue_sim.ros.node.settings import degradation as degrade
from tissue_sim.ros.node.settings.coupling_ramp import EASE_EVERY, nearer
from tissue_sim.ros.node.shared.served_organ import ServedScene
from tissue_sim.ros.shared.parameters import Parameters
from tissue_sim.ros.shared.report import Report

LEAST_RATE = 50.0  # Hz
ANY_FORCE = 1e9  # N; every load is below it
# A bound on the coupling is kept while it is still allowed and not much more is, since a measured rate always varies.
ROOM, REGAINED = 0.9, 1.25  # fraction of the allowed that is used; rise of the bound that is worth a change
WORTH = 0.9  # halving the rate is worth it if it leaves at most this fraction of the substeps per second


class LiveSettings:
    """Settings from parameters and the level of degradation, computed and posted; any thread may call it.

    served: the organs; post: takes settings of an organ, by its number, to the loop; poses: how often those of each
    tool come.
    """

    def __init__(
        self,
        served: ServedScene,
        parameters: Parameters,
        post: Callable[[int, Settings], None],
        poses: Sequence[Freshness],
    ) -> None:
        self.poses = poses
        self._served, self._parameters, self._post = served, parameters, post
        self._lock = threading.Lock()
        self.level = degrade.NONE
        self._bound, self._bounded_by = math.inf, 0  # N/m of the coupling, and the tool that bounds it
        self._coupling: float | None = None  # N/m that is in use, on its way to the wanted one; None before the start
        self._wanted_coupling, self._ease_at = 0.0, -math.inf  # N/m; monotonic s of the next step on that way

    def update(self, level: int | None = None) -> None:
        """Post the settings again if they changed by a new level of degradation."""
        with self._lock:
            self.level = self.level if level is None else level
            every = [one.settings for one in self._served.simulations]
            before = [copy_of(settings) for settings in every]
            self._served.apply(self._parameters)
            self._renew_bound()
            for settings in every:
                self._give_up(settings)
            if self._coupling is None:
                self._coupling = self._wanted_coupling
            if not any(map(_differ, every, before)):
                return
            self._served.joined.set_substeps()
            for organ, (settings, old) in enumerate(zip(every, before, strict=True)):
                if _differ(settings, old):
                    self._post(organ, copy_of(settings))

    def ease(self, now: float) -> float:
        """Post the next step of a coupling that is on its way to another stiffness, when it is due.

        now: monotonic time, s. Returns the time until the next step, s; infinite where there is none.
        """
        with self._lock:
            if self._coupling is None or self._coupling == self._wanted_coupling:
                return math.inf
            if now < self._ease_at:
                return self._ease_at - now
            self._ease_at = now + EASE_EVERY
            self._coupling = nearer(self._coupling, self._wanted_coupling)
            for organ, one in enumerate(self._served.simulations):
                one.settings.coupling_stiffness = self._coupling
                self._post(organ, copy_of(one.settings))
            return EASE_EVERY

    def refine(self, organ: int, substeps: int) -> None:
        """Post an organ's settings with more substeps, before it is exchanged for one of a larger frequency.

        substeps: how many the next organ needs (fewer than there are change nothing).
        """
        with self._lock:
            settings = copy_of(self._served.simulations[organ].settings)
            if substeps > settings.substeps:
                settings.substeps = settings.region_substeps = substeps
                self._post(organ, settings)

    def renew(self, organ: int) -> None:
        """Post an organ's settings after it was exchanged for one of another largest frequency."""
        with self._lock:
            self._served.joined.set_substeps()
            self._post(organ, copy_of(self._served.simulations[organ].settings))

    def _give_up(self, settings: Settings) -> None:
        """Reduce settings where the machine is too slow or a device can't bear them."""
        settings.tick_time = self._tick_time
        self._wanted_coupling = min(float(settings.coupling_stiffness), self._bound)
        settings.coupling_stiffness = self._wanted_coupling if self._coupling is None else self._coupling
        if self.level >= degrade.REGION and self._first.local_region == "auto":
            settings.region_force = ANY_FORCE

    @property
    def _first(self) -> Simulation:
        """First simulation; all have the same rate and local region."""
        return self._served.simulations[0]

    @property
    def _tick_time(self) -> float:
        """Tick time at the level of degradation, s."""
        return float(2.0 ** degrade.halvings(self.level) / self._parameters["rate"])

    def _renew_bound(self) -> None:
        """Bound the coupling, N/m, to what the devices whose damping is known render passively."""
        allowed = [self._passive(tool) for tool in range(len(self.poses))]
        least = min(allowed, default=math.inf)
        if not self._bound <= least <= REGAINED * self._bound:
            self._bound = ROOM * least
        if allowed:
            self._bounded_by = allowed.index(least)

    def _passive(self, tool: int) -> float:
        """Return the stiffest coupling, N/m, that a tool's device renders passively.

        A tool reaches a pose within its smoothing of the time until the next is due; a tick later its force is sent,
        which takes as long back as the pose took.
        """
        poses, name = self.poses[tool], self._parameters.tools[tool]
        damping, smoothing = (self._parameters[f"{name}.{what}"] for what in ("device_damping", "smoothing"))
        return passive_stiffness(damping, poses.period, smoothing * poses.period + self._tick_time + 2.0 * poses.delay)

    @property
    def coupling_stiffness(self) -> float:
        """Stiffness between device and tool that is in use, N/m."""
        return float(self._first.settings.coupling_stiffness)

    def describe(self) -> str:
        """Return what is given up at the present level, or that nothing is."""
        words = []
        if self.level >= degrade.MARKERS and self._parameters["marker_rate"] > degrade.MARKER_RATE:
            words.append(f"markers at {degrade.MARKER_RATE:g} Hz")
        if self.level >= degrade.REGION and self._first.local_region == "auto":
            words.append("a modal region under any load")
        if degrade.halvings(self.level):
            words.append(f"{1.0 / float(self._first.settings.tick_time):g} Hz")
        return ", ".join(words) or "nothing is reduced"

    def report(self, report: Report) -> None:
        """Add what is given up, and a coupling that is softer than requested."""
        report.values |= {
            "degraded": degrade.name(self.level),
            "coupling_stiffness": self.coupling_stiffness,
            "coupling_bound": "none" if math.isinf(self._bound) else self._bound,
        }
        if self.level != degrade.NONE:
            report.warnings.append(f"degraded: {self.describe()}")
        for tool, poses in zip(self._parameters.tools, self.poses, strict=True):
            report.part(f"tool {tool}", f"{tool}.").values |= {
                "pose_rate_hz": 1.0 / poses.period if poses.counts else 0.0,
                "delay_ms": 1e3 * poses.delay,
            }
        if self._wanted_coupling < self._parameters["coupling_stiffness"]:
            report.warnings.append(self._softer())

    def _softer(self) -> str:
        """Return why the coupling is softer than requested."""
        tool, poses = self._parameters.tools[self._bounded_by], self.poses[self._bounded_by]
        return (
            f"coupling_stiffness is {self._wanted_coupling:.0f} instead of"
            f" {self._parameters['coupling_stiffness']:g} N/m: with {tool}.device_damping"
            f" {self._parameters[f'{tool}.device_damping']:g} N s/m, poses at {1.0 / poses.period:.0f} Hz and"
            f" {1e3 * poses.delay:.1f} ms old, a larger value may not be stable"
        )

    @property
    def marker_rate(self) -> float:
        """Rate of markers and surfaces, Hz."""
        wanted = float(self._parameters["marker_rate"])
        return min(wanted, degrade.MARKER_RATE) if self.level >= degrade.MARKERS else wanted

    def helps(self, level: int) -> bool:
        """Return whether a level of degradation gives anything up that the one before didn't."""
        if level == degrade.MARKERS:
            return bool(self._parameters["marker_rate"] > degrade.MARKER_RATE)
        if level == degrade.REGION:  # the other kinds of region are as small already, or have no tables
            return self._first.local_region == "auto"
        tick_time = 2.0 ** degrade.halvings(level) / self._parameters["rate"]
        return tick_time * LEAST_RATE <= 1.0 and self._work(tick_time) <= WORTH * self._work(0.5 * tick_time)

    def _work(self, tick_time: float) -> float:
        """Return the substeps per second with ticks of so many s; below one per tick, fewer ticks save none."""
        longest = min(one.longest_step for one in self._served.simulations)
        return substeps_for(tick_time, longest) / tick_time


def _differ(one: Settings, other: Settings) -> bool:
    return bool((words_of(one) != words_of(other)).any())
