"""Runs a recording again, tick by tick and without DDS."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from tqdm import tqdm

from tissue_sim.array_types import Floats
from tissue_sim.contact.finder import ContactFinder
from tissue_sim.contact.tools import ToolSet
from tissue_sim.errors import UserError
from tissue_sim.model.contact_set import ContactSet
from tissue_sim.model.settings import Settings
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.bags.comparing import Shown
from tissue_sim.ros.bags.recording import Recording, recorded_organ, tools_of


@dataclass
class Replayed:
    """What a replay shows at the ticks that it was asked for, and what it took up."""

    wanted: Shown  # those of the ticks that were asked for which the replay came by
    shown: Shown
    ticks: int = 0
    inputs: int = 0
    contact_sets: int = 0


def replay(recording: Recording, organ: Organ | None = None, wanted: Shown | None = None) -> Replayed:
    """Feed the recorded inputs at the ticks that took them up; show what is wanted, by default what the bag shows.

    organ: instead of the recorded one.
    """
    player = Player(recording, organ or recorded_organ(recording))
    return player.run(recording.shown() if wanted is None else wanted)


class Player:
    """A simulation that takes up what a recording's journal names; it runs once."""

    def __init__(self, recording: Recording, organ: Organ) -> None:
        parameters = recording.config["parameters"]
        self.recording, self.n_surface = recording, organ.n_surface
        self.tools = ToolSet(tools_of(recording.config))
        self.simulation = Simulation(
            organ,
            model=parameters["model"],
            rate=parameters["rate"],
            local_region=parameters["local_region"],
            shapes=self.tools.shapes,
            return_target=parameters.get("return_target", "rest"),
            integrator=parameters.get("integrator", "symplectic"),
            shape_gravity=recording.config["shape_gravity"],
        )
        self.poses = self._body_poses()
        self.stamps = [
            stamps for bodies, stamps in zip(self.tools.bodies, recording.stamps, strict=True) for _ in bodies
        ]
        self.forces = self._body_forces()
        self.simulation.restore(recording.state)
        self.state = self.simulation.state
        self.finder = ContactFinder(organ.rest_positions, organ.surface_triangles, organ.n_surface, self.tools)
        first = self.tick = int(self.state.status.tick)
        journal = recording.journal
        self.inputs = {
            int(row["tick"]): (row, bodies)
            for row, bodies in zip(journal["inputs"], journal["body_inputs"], strict=True)
        }
        self.found_from = {
            int(row["contact_set"]): (int(row["surface_tick"]), bodies)
            for row, bodies in zip(journal["contacts"], journal["body_contacts"], strict=True)
        }
        self.needed = {tick for tick, _ in self.found_from.values()}  # ticks whose surface a contact set was found from
        self.kept: dict[int, Floats] = {}
        self.nowhere = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (len(self.poses), 1))
        # Only what is new in a row is taken up again.
        before = max((tick for tick in self.inputs if tick <= first), default=None)
        if before is None:
            raise UserError("the bag doesn't tell what its state had taken up; its recording lost messages")
        self.taken = self.inputs[before]

    def _body_poses(self) -> list[dict[int, Floats]]:
        """Poses of each body by sequence: a tool's own, or those of a gripper's jaws."""
        made: list[dict[int, Floats]] = []
        for tool, bodies in enumerate(self.tools.bodies):
            poses, angles = self.recording.poses[tool], self.recording.angles[tool]
            placed = {n: self.tools.poses(tool, pose, angles.get(n, 0.0)) for n, pose in poses.items()}
            made += [{n: at[k] for n, at in placed.items()} for k in range(len(bodies))]
        return made

    def _body_forces(self) -> list[dict[int, Floats]]:
        """Forces at each body's tip by sequence: a tool's first body takes them."""
        made: list[dict[int, Floats]] = []
        for tool, bodies in enumerate(self.tools.bodies):
            made += [self.recording.forces[tool], *({} for _ in bodies[1:])]
        return made

    def _wrench(self, tool: int, recorded: Floats) -> Floats:
        """A tool's wrench, (6,). Of a gripper the force: its torque is about a pose that the journal lacks."""
        bodies = self.tools.bodies[tool]
        if len(bodies) == 1:
            return np.asarray(self.state.wrench[bodies[0]])
        return np.concatenate([self.state.wrench[bodies, :3].sum(axis=0), recorded[3:]])

    def run(self, wanted: Shown, watch: Callable[[int], None] | None = None) -> Replayed:
        """Go through the recording, and show what is wanted of its ticks; watch is called after each tick."""
        last = max(self.tick, self.recording.last_tick)
        wanted = wanted.within(self.tick + 1, last)
        shown = Shown(
            wanted.tools,
            wanted.wrench_ticks,
            [np.zeros_like(wrenches) for wrenches in wanted.wrenches],
            wanted.surface_ticks,
            np.zeros_like(wanted.surfaces),
        )
        wrench_at: dict[int, list[tuple[int, int]]] = defaultdict(list)  # tick -> tool, index
        for tool, ticks in enumerate(wanted.wrench_ticks):
            for index, tick in enumerate(ticks.tolist()):
                wrench_at[tick].append((tool, index))
        surface_at: dict[int, list[int]] = defaultdict(list)  # a slow loop may be shown twice in a tick
        for index, tick in enumerate(wanted.surface_ticks.tolist()):
            surface_at[tick].append(index)
        n_surface, n_points = self.n_surface, wanted.surfaces.shape[1]
        if len(wanted.surfaces) and n_points != n_surface:
            raise UserError(f"the bag's surfaces have {n_points} points, the organ has {n_surface}: another organ")
        result = Replayed(wanted, shown)
        settings = self.recording.settings
        start = max((number for number in settings if number <= self.taken[0]["settings"]), default=min(settings))
        self.simulation.take_settings(settings[start])
        for tick in tqdm(range(self.tick + 1, last + 1), disable=None, desc="replay", unit="tick", mininterval=0.5):
            row = self.inputs.get(tick)
            if row is not None:
                self._take(*row, result)
                result.inputs += 1
            self.simulation.step()
            result.ticks += 1
            if watch is not None:
                watch(tick)
            if tick in self.needed:
                self.kept[tick] = self.simulation.positions.copy()
            for tool, index in wrench_at.get(tick, ()):
                shown.wrenches[tool][index] = self._wrench(tool, wanted.wrenches[tool][index])
            for index in surface_at.get(tick, ()):
                shown.surfaces[index] = self.simulation.positions[:n_surface]
        return result

    def _take(self, row: np.ndarray, bodies: np.ndarray, result: Replayed) -> None:
        """Take up what is new in a journal row, in the order of the node's loop."""
        last, last_bodies = self.taken
        simulation = self.simulation
        if row["resets"] != last["resets"]:
            simulation.reset()
        if row["settings"] != last["settings"]:
            simulation.take_settings(self._settings(int(row["settings"])))
        for body in range(len(self.poses)):
            pose, force = int(bodies["pose"][body]), int(bodies["force"][body])
            if pose != last_bodies["pose"][body]:
                at = self._input(self.poses[body], pose, "pose")
                simulation.take_pose(body, at, pose, self.stamps[body][pose])
            if force != last_bodies["force"][body]:
                simulation.take_force(body, self._input(self.forces[body], force, "force"), force)
        contacts = int(row["contact_set"])
        if contacts != last["contact_set"]:
            result.contact_sets += 1
            simulation.take_contacts(self._contact_set(contacts), contacts)
        self.taken = row, bodies

    def _settings(self, sequence: int) -> Settings:
        if sequence not in self.recording.settings:
            raise UserError(f"the bag lacks settings number {sequence}; its recording lost messages")
        return self.recording.settings[sequence]

    def _input(self, values: dict[int, Floats], sequence: int, what: str) -> Floats:
        if sequence not in values:
            raise UserError(f"the bag lacks {what} number {sequence}; its recording lost messages")
        return values[sequence]

    def _contact_set(self, sequence: int) -> ContactSet:
        whole = self.recording.contact_sets.get(sequence)
        if whole is not None:
            return whole
        tick, bodies = self.found_from.get(sequence, (-1, None))
        if bodies is None or tick not in self.kept:
            raise UserError(f"the bag lacks contact set number {sequence}; its recording lost messages")
        while next(iter(self.kept)) < tick:  # sets come in the order of their surfaces
            del self.kept[next(iter(self.kept))]
        poses = self.nowhere.copy()
        for body, number in enumerate(bodies["pose"].tolist()):
            if number:
                poses[body] = self._input(self.poses[body], number, "pose")
        engaged, pushing = (bodies[name].astype(np.int64) for name in ("engaged", "pushing"))
        return self.finder.find(self.kept[tick], poses, np.ascontiguousarray(bodies["margin"]), engaged, pushing)
