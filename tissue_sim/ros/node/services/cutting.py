"""Cutting an organ while the node runs: the path on ~/cut_path, the service ~/cut, and the cuts so far on ~/cuts."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from nav_msgs.msg import Path
from std_srvs.srv import Trigger

from tissue_sim.array_types import Floats
from tissue_sim.contact.blade_cuts import BladeCuts
from tissue_sim.contact.quaternions import rotate
from tissue_sim.errors import UserError
from tissue_sim.model.cutting.cut import CutReport
from tissue_sim.model.cutting.sheet import Sheet
from tissue_sim.model.joined import Joined
from tissue_sim.model.simulation import Simulation
from tissue_sim.ros.bags.organ_recorder import OrganRecorder
from tissue_sim.ros.node.contact.contact_worker import ContactWorker
from tissue_sim.ros.node.services.cut_process import CutProcess, Ending
from tissue_sim.ros.node.services.simulation_parts import Prepared, SomeCut
from tissue_sim.ros.node.settings.live_settings import LiveSettings
from tissue_sim.ros.node.shared.deferred_service import DeferredService, Work
from tissue_sim.ros.node.shared.guarded_node import GuardedNode
from tissue_sim.ros.node.shared.served_organ import ServedOrgan
from tissue_sim.ros.shared.frames import Frames, UnknownFrame
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.qos import LATCHED, RELIABLE
from tissue_sim.ros.shared.report import Report

PARALLEL = 1e-3  # by which the directions of a path's poses may differ
BLADE_PERIOD = 0.02  # s, after which it is seen whether blades have cut
HEALED = "the organ was reset while its cut was computed, and is uncut; call the service again"


class _Asked(NamedTuple):
    """A cut that the service was asked for, and the description of what was cut, once it is there."""

    polyline: Floats  # (m, 3) m
    direction: Floats  # (3,)
    depth: float  # m
    made: Future[str]

    def is_same(self, polyline: Floats, direction: Floats, depth: float) -> bool:
        """Return whether it is the same cut, which isn't there yet."""
        same_path = np.array_equal(self.polyline, polyline) and np.array_equal(self.direction, direction)
        return same_path and self.depth == depth and not self.made.done()


class OrganCutting:
    """Cuts of one organ: the newest path is cut when the service is called, in a process of its own.

    number: its number in the loop; parts: what takes up a cut organ; frames: returns the frames that a path may come
    in, as they are now; depth: returns how deep it is cut, m.
    """

    def __init__(
        self,
        node: GuardedNode,
        served: ServedOrgan,
        number: int,
        parts: CuttingParts,
        frames: Callable[[], Frames],
        depth: Callable[[], float],
    ) -> None:
        self._served, self._number, self._parts = served, number, parts
        self._frames, self._depth = frames, depth
        self._node, self._log = node, node.get_logger()
        self._name = f"organ '{served.name}'" if served.name else "the organ"
        self._uncut: Simulation | None = None  # as it was before its first cut
        self._path: tuple[Floats, Floats] | None = None  # polyline (m, 3) m, and direction (3,)
        self._refused = "no path has come: publish its points on cut_path first, with reliable QoS"
        self._asked: _Asked | None = None  # newest cut that the service was asked for
        self._busy, self._exchanging = threading.Lock(), threading.Lock()
        self._heals = self.made = self.refused = 0
        self.seconds = 0.0  # that the newest cut took
        below = served.below
        self._cuts = node.create_publisher(DiagnosticArray, f"{below}/cuts", LATCHED)
        self._subscription = node.create_subscription(Path, f"{below}/cut_path", self._on_path, RELIABLE)
        DeferredService(node, Trigger, f"{below}/cut", self._on_cut)
        self._blades = BladeCuts(served.physics.simulation, parts.coagulations)
        self._waits = False  # for the reset to take the blades out of the tissue
        if self._blades:
            node.create_timer(BLADE_PERIOD, self._follow_blades)
            threading.Thread(target=parts.process.start, daemon=True).start()  # a blade doesn't wait for it

    @property
    def cuts(self) -> Sequence[CutReport]:
        """The cuts that the organ has."""
        return self._served.physics.simulation.cuts

    def close(self) -> None:
        """End the process that makes cuts."""
        self._parts.process.close()

    def heal(self) -> None:
        """Go on with the uncut organ, in the state of the cut one: the organ is about to be reset."""
        self._heals += 1
        self._blades.forget()
        self._waits = bool(self._blades)
        if self._parts.loop.clock_stands:  # the tick that takes it up comes when /clock goes on
            if self.cuts:
                threading.Thread(target=self._heal_later, daemon=True).start()
        else:  # a cut that is being taken up now ends first
            self._exchange_uncut()

    def _heal_later(self) -> None:
        with self._node.unexpected_errors.noted():
            self._exchange_uncut(patience=float("inf"))
            self._parts.loop.reset_again()

    def _exchange_uncut(self, patience: float | None = None) -> None:
        with self._exchanging:
            uncut, cut = self._uncut, self._served.physics.simulation
            if uncut is None or not cut.cuts:
                return
            uncut.return_from(cut)
            self._parts.exchange(self._number, Prepared.of(uncut), patience)
            self._publish()

    def _on_path(self, message: Path) -> None:
        self._path = None
        try:
            self._path = self._path_of(message)
        except UserError as error:
            self.refused += 1
            self._refused = f"the newest path was refused: {error}"
            self._log.warning(f"a path for {self._name} was refused: {error}")
        else:  # soon there will be a cut
            threading.Thread(target=self._parts.process.start, daemon=True).start()

    def _path_of(self, message: Path) -> tuple[Floats, Floats]:
        """Return the polyline (m, 3) m and the direction (3,) of a path, in the organ's frame."""
        poses = [(stamped.header.frame_id or message.header.frame_id, stamped.pose) for stamped in message.poses]
        if len(poses) < 2:
            raise UserError(f"it has {len(poses)} poses; expected: the two or more points where the blade begins")
        points, directions = [], []
        for frame_id, pose in poses:
            if not frame_id:
                raise UserError("its header has no frame_id; set it to the frame that its points are in")
            try:
                to_organ = self._frames().to_organ(frame_id)
            except UnknownFrame as error:
                raise UserError(f"its frame '{frame_id}' has no transform to the organ: {error}") from None
            at, q = pose.position, pose.orientation
            numbers = (at.x, at.y, at.z, q.x, q.y, q.z, q.w)
            size = float(np.linalg.norm(numbers[3:]))
            if not np.all(np.isfinite(numbers)) or abs(size - 1.0) > PARALLEL:
                raise UserError("it has a pose that is not finite, or whose quaternion is not of length 1")
            placed = to_organ.of(numbers)
            points.append(placed[:3])
            x, y, z, w = placed[3:]
            directions.append(rotate((x, y, z, w), (0.0, 0.0, 1.0)))
        direction = np.array(directions[0])
        if np.abs(np.array(directions) - direction).max() > PARALLEL:
            raise UserError("the z axes of its poses differ; all must point where the blade is moved to")
        return np.array(points), direction

    def _on_cut(self, _: Trigger.Request, response: Trigger.Response) -> Work | None:
        path = self._path
        if path is None:
            response.success, response.message = False, self._refused
            return None
        cut = *path, self._depth()
        if self._asked is not None and self._asked.is_same(*cut):
            made = self._asked.made  # the client repeats a call whose answer takes long
            return lambda: _tell(response, made)
        if not self._busy.acquire(blocking=False):
            response.success, response.message = (
                False,
                f"another cut of {self._name} is being made, and appears on {self._cuts.topic_name}; then call again",
            )
            return None
        asked = self._asked = _Asked(*cut, Future())

        def work() -> None:
            try:
                text = self._cut(*cut)
            except Exception as error:  # of any kind: all who wait get it
                self.refused += isinstance(error, (UserError, TimeoutError))
                self._busy.release()
                asked.made.set_exception(error)
            else:
                self._busy.release()
                asked.made.set_result(text)
            _tell(response, asked.made)

        return work

    def _cut(self, polyline: Floats, direction: Floats, depth: float) -> str:
        """Cut the organ; return the cut's description."""
        begun, heals = time.monotonic(), self._heals
        before = self._served.physics.simulation
        return self._take_up(before, (polyline, direction, depth), begun, heals)

    def _take_up(self, before: Simulation, cut: SomeCut, begun: float, heals: int) -> str:
        """Cut the organ, unless it was reset since `heals`; return the cut's description."""
        made = self._parts.process.cut(before, cut)
        with self._exchanging:
            if heals != self._heals or before is not self._served.physics.simulation:
                raise UserError(HEALED)
            if not before.cuts:
                self._uncut = before
            self._parts.exchange(self._number, made)
        self.made, self.seconds = self.made + 1, time.monotonic() - begun
        text = str(made.simulation.cuts[-1])
        if len(cut) > 1:  # a blade's cut comes in many stages
            self._log.info(f"{self._name} was cut: {text}")
        self._publish()
        return text

    def _follow_blades(self) -> None:
        """Note where blades are, and open what they have cut, in a thread of its own."""
        was_in, simulation = self._blades.in_tissue, self._served.physics.simulation
        self._waits = self._waits and bool(simulation.state.bodies.cutting.any())
        if self._waits:
            return
        self._blades.note(simulation)
        if was_in and not self._blades.in_tissue and simulation.cuts:
            self._log.info(f"a blade has left {self._name}; its cut: {simulation.cuts[-1]}")
        if not self._busy.acquire(blocking=False):
            return
        heals, sheets = self._heals, []
        try:
            sheets = list(self._blades.due())
            if sheets:
                threading.Thread(target=self._open, args=(sheets, heals), daemon=True).start()
        except BaseException:
            sheets = []
            raise
        finally:
            if not sheets:
                self._busy.release()

    def _open(self, sheets: Sequence[Sheet], heals: int) -> None:
        try:
            with self._node.unexpected_errors.noted():
                for sheet in sheets:
                    if heals != self._heals:
                        break  # the organ was reset, and these cuts with it
                    try:
                        self._take_up(self._served.physics.simulation, (sheet,), time.monotonic(), heals)
                    except Ending:
                        break
                    except (UserError, TimeoutError) as error:
                        if heals == self._heals:
                            then = self._blades.refuse(sheet)
                            self._log.warning(f"a blade's cut of {self._name} was not opened: {error}; {then}")
                    else:
                        self._blades.opened(sheet)
        finally:
            self._busy.release()

    def _publish(self) -> None:
        """Publish all cuts that the organ has: a late subscriber gets them, too."""
        message = DiagnosticArray(status=[_status(number, cut) for number, cut in enumerate(self.cuts, 1)])
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.header.frame_id = self._parts.frame_id
        self._cuts.publish(message)

    def report(self, report: Report) -> None:
        """Add the organ's cuts."""
        before = f"{self._served.name}." if self._served.name else ""
        report.values |= {f"{before}cuts": len(self.cuts), f"{before}cuts_made": self.made}
        if self.made:
            report.values[f"{before}cut_seconds"] = self.seconds
        if self._blades:
            report.values[f"{before}scratches"] = self._blades.scratches
        report.problems[f"{before}cuts_refused"] = self.refused + self._blades.refused


class CuttingParts:
    """What goes on with an organ after a cut: the loop, the scene, the contact search, the bag and the settings.

    joined: the organs, as settings see them; contacts: contact search of all organs; recorders: part of the bag of each
    organ; settings: the settings of the organs; frame_id: frame of the organs.
    """

    def __init__(
        self,
        loop: Loop,
        joined: Joined,
        contacts: ContactWorker,
        recorders: Sequence[OrganRecorder],
        settings: LiveSettings,
        frame_id: str,
    ) -> None:
        self.loop, self._joined, self.frame_id = loop, joined, frame_id
        self._contacts, self._recorders, self._settings = contacts, recorders, settings
        self.coagulations = contacts.tools.coagulations  # of each tool
        self.process = CutProcess()

    def exchange(self, number: int, made: Prepared, patience: float | None = None) -> None:
        """Go on with a simulation that continues an organ's.

        number: number of the organ; made: the simulation, and what goes with it; patience: how long to wait for the
        tick that takes it up, None: as long as a running loop may take, s.
        """
        recorder, simulation = self._recorders[number], made.simulation
        finder = self._contacts.finder_of(number, made.surface)
        # Those that it was made with may have changed meanwhile, as the rate does on a machine that is too slow.
        simulation.take_settings(self._joined.simulations[number].settings)
        simulation.set_substeps()
        plan = self._joined.plan_exchange(number, simulation)
        # The loop goes on with its own settings, and a stiffer organ needs more substeps from its first tick on.
        self._settings.refine(number, int(simulation.settings.substeps))
        with recorder.exchanging:
            recorder.wait_for_state()
            tick = recorder.physics.exchange(simulation, plan, patience)
            recorder.cut(tick, simulation, made.file)
        self._joined.exchange(number, simulation, plan)
        self._contacts.exchange(number, finder, recorder.physics.version)
        self._settings.renew(number)


def _tell(response: Trigger.Response, made: Future[str]) -> None:
    """Answer with what a cut has become, once that is known."""
    try:
        response.message = made.result()
        response.success = True
    except (UserError, TimeoutError) as error:
        response.success, response.message = False, str(error)


def _status(number: int, cut: CutReport) -> DiagnosticStatus:
    """Return a cut as numbers by name."""
    status = DiagnosticStatus(name=f"cut {number}", message=str(cut))
    status.level = DiagnosticStatus.OK if cut.resolved else DiagnosticStatus.WARN
    x, y, z = cut.centre
    values = {
        "x_m": x,
        "y_m": y,
        "z_m": z,
        "area_m2": cut.area,
        "depth_m": cut.depth,
        "lip_m": cut.lip,
        "resolved": cut.resolved,
        "pieces": cut.pieces,
        "free_pieces": cut.free_pieces,
        "cells_cut": cut.cells_cut,
        "critical_step_s": cut.critical_step_after,
        "stiffer_cells": cut.stiffer_cells,
    }
    status.values = [KeyValue(key=key, value=f"{value:.6g}") for key, value in values.items()]
    return status
