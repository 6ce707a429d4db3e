"""One organ of a recording in its replay."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.contact.finder import ContactFinder, ContactQuery
from tissue_sim.contact.tools import ToolSet
from tissue_sim.contact.touched_surface import TouchedSurface
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.model.cutting.cut_surface import CutSurface
from tissue_sim.model.data.contact_set import ContactSet
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.bags.organ_recording import OrganRecording
from tissue_sim.ros.bags.recorded_cut import RecordedCut
from tissue_sim.ros.bags.recording import Recording
from tissue_sim.ros.shared.shown_organ import ShownOrgan


class ToolInputs(NamedTuple):
    """Poses (7,), stamps, ns, and forces (3,) N of each body, by sequence."""

    poses: list[dict[int, Floats]]
    stamps: list[dict[int, int]]
    forces: list[dict[int, Floats]]

    @classmethod
    def of(cls, recording: Recording, tools: ToolSet) -> ToolInputs:
        """Return the inputs of each body: a tool's own, or those of a gripper's jaws, whose first one takes forces."""
        made = cls([], [], [])
        for tool, bodies in enumerate(tools.bodies):
            poses, angles = recording.poses[tool], recording.angles[tool]
            placed = {n: tools.poses(tool, pose, angles.get(n, 0.0)) for n, pose in poses.items()}
            made.poses.extend({n: at[k] for n, at in placed.items()} for k in range(len(bodies)))
            made.stamps.extend(recording.stamps[tool] for _ in bodies)
            made.forces.extend([recording.forces[tool], *({} for _ in bodies[1:])])
        return made


class Taken(NamedTuple):
    """What a tick applied besides inputs."""

    reset: bool
    contact_set: bool


class ShownSurface(NamedTuple):
    """Surface of an organ at a tick, with the walls of its cuts."""

    positions: Floats  # (p, 3) m
    rest: Floats  # (p, 3) m
    triangles: Ints  # (t, 3)


class OrganPlayer:
    """A simulation that applies what the journal names."""

    def __init__(
        self, recording: OrganRecording, organ: Organ, config: JsonObject, tools: ToolSet, tool_inputs: ToolInputs
    ) -> None:
        parameters = config["parameters"]
        nodes = len(recording.state["position"])
        if nodes != organ.n_nodes:
            raise UserError(
                f"the bag was recorded with an organ of {nodes} nodes, '{organ.name}' has {organ.n_nodes}: replay"
                " it with an organ of the same nodes, such as another calibration of the recorded organ"
            )
        self.recording, self.n_surface, self._tool_inputs = recording, organ.n_surface, tool_inputs
        self.tools = tools
        self._new_simulation = partial(
            Simulation,
            model=parameters["model"],
            rate=parameters["rate"],
            local_region=parameters["local_region"],
            shapes=tools.shapes,
            integrator=parameters.get("integrator", "symplectic"),
            shape_gravity=config["shape_gravity"],
        )
        self.simulation = self._new_simulation(organ)
        self.cut_surface: CutSurface | None = None
        self.version = 0  # number of the newest cut in the replay
        self._cuts = {cut.tick: cut for cut in recording.cuts if cut.tick >= 0}
        self._finders = [(0, ContactFinder(organ, tools))]  # with the number of the first set of each
        for cut in recording.cuts:
            if cut.tick < 0:  # the bag began after it, and its organ is the cut one
                self.cut_surface, self._finders = cut.surface, [(0, self._finder_of(cut))]
                if cut.surface is not None:
                    self.simulation.open_cuts(cut.surface, cut.sides)
        self.simulation.restore(recording.state)
        first = self.tick = int(self.simulation.state.status.tick)
        journal = recording.journal
        self.inputs = {
            int(row["tick"]): (row, bodies)
            for row, bodies in zip(journal["inputs"], journal["body_inputs"], strict=True)
        }
        self.found_from = {
            int(row["contact_set"]): (int(row["surface_tick"]), int(row["tool_tick"]), bodies)
            for row, bodies in zip(journal["contacts"], journal["body_contacts"], strict=True)
        }
        # Ticks whose surface, and whose tools, a contact set was found from; and these.
        self._surface_ticks = {surface for surface, _, _ in self.found_from.values()}
        self._tool_ticks = {tools for _, tools, _ in self.found_from.values()}
        self._surfaces: dict[int, Floats] = {}
        self._tools: dict[int, tuple[Floats, Longs]] = {}
        # Only the new values of a row are applied.
        before = max((tick for tick in self.inputs if tick <= first), default=None)
        if before is None:
            raise UserError("the bag doesn't record which inputs its state had used; its recording lost messages")
        self._taken = self.inputs[before]

    def begin(self, take_settings: Callable[[Settings], None]) -> None:
        """Use the settings that the state had; `take_settings` applies them."""
        settings = self.recording.settings
        start = max((number for number in settings if number <= self._taken[0]["settings"]), default=min(settings))
        take_settings(settings[start])

    def take(self, tick: int, take_settings: Callable[[Settings], None]) -> Taken | None:
        """Apply what is new in a tick's row of the journal, in the order of the node's loop.

        take_settings: applies settings. Returns None without a row.
        """
        found = self.inputs.get(tick)
        if found is None:
            return None
        row, bodies = found
        last, last_bodies = self._taken
        simulation, given = self.simulation, self._tool_inputs
        was_reset = bool(row["resets"] != last["resets"])
        if was_reset:
            simulation.reset()
        if row["settings"] != last["settings"]:
            take_settings(self._settings(int(row["settings"])))
        for body in range(len(given.poses)):
            pose, force = int(bodies["pose"][body]), int(bodies["force"][body])
            if pose != last_bodies["pose"][body]:
                at = _input(given.poses[body], pose, "pose").copy()
                at[:3] -= simulation.state.carried
                simulation.take_pose(body, at, pose, given.stamps[body][pose])
            if force != last_bodies["force"][body]:
                simulation.take_force(body, _input(given.forces[body], force, "force"), force)
        contacts = int(row["contact_set"])
        is_new = bool(contacts != last["contact_set"])
        if is_new:
            simulation.take_contacts(self._contact_set(contacts), contacts)
        self._taken = row, bodies
        return Taken(was_reset, is_new)

    def cut(self, tick: int) -> Simulation | None:
        """Return the simulation that the loop went on with in a tick, in the state of the one before.

        It has the settings with which the node has planned to go on with it.

        Call it before anything else of the tick is applied.

        Returns None in a tick without a cut.
        """
        found = self._cuts.get(tick)
        if found is None:
            return None
        before, organ = self.simulation, found.organ
        made = self._new_simulation(organ)
        origin, surface = found.origin, found.surface
        cells = len(organ.cell_nodes if found.sides is None else found.sides.below)
        inside = surface is None or bool(surface.nodes.max(initial=0) < organ.n_nodes)
        inside = inside and cells == (len(before.model.cut_cells.nodes) or cells)  # in which blades are
        if len(origin) != organ.n_nodes or not 0 <= origin.min() <= origin.max() < before.organ.n_nodes or not inside:
            raise UserError("the bag's cut doesn't fit its organ: the bag is damaged")
        made.take_settings(self.recording.plans.get(found.number, before.settings))
        if found.surface is not None:
            made.open_cuts(found.surface, found.sides)
        made.plan_from(before, found.origin)
        made.continue_from(before)
        self.simulation, self.cut_surface, self.version = made, found.surface, found.number
        self._finders.append((found.first_set, self._finder_of(found)))
        return made

    def surface_after(self, number: int) -> TouchedSurface:
        """Return the surface that the organ had after a cut, or after the reset of its cuts.

        number: number of the cut.
        """
        cut = next((cut for cut in self.recording.cuts if cut.number == number), None)
        if cut is None:
            raise UserError(f"the bag has no cut number {number}; its recording lost messages")
        return TouchedSurface(cut.organ, cut.surface)

    def _finder_of(self, cut: RecordedCut) -> ContactFinder:
        return ContactFinder(TouchedSurface(cut.organ, cut.surface), self.tools)

    def shown(self) -> ShownSurface:
        """Return the surface in its present place, with the walls of cuts."""
        shown = ShownOrgan(self.simulation.organ, self.cut_surface)
        rows = np.zeros((shown.n_rows, 3))
        shown.fill(rows, self.simulation.positions)
        positions = shown.points(rows) + self.simulation.state.carried
        return ShownSurface(positions, shown.points(shown.rest), shown.triangles)

    def keep(self, tick: int) -> None:
        """Keep what a contact set was found from: the positions of a tick, and where the tools were."""
        state = self.simulation.state
        if tick in self._surface_ticks:
            self._surfaces[tick] = self.simulation.positions.copy()
        if tick in self._tool_ticks:
            self._tools[tick] = state.body_pose.copy(), state.bodies.releases.copy()

    def surface(self) -> Floats:
        """Return the surface in its present place, (n, 3) m."""
        return np.asarray(self.simulation.positions[: self.n_surface] + self.simulation.state.carried)

    def _settings(self, sequence: int) -> Settings:
        if sequence not in self.recording.settings:
            raise UserError(f"the bag has no settings number {sequence}; its recording lost messages")
        return self.recording.settings[sequence]

    def _contact_set(self, sequence: int) -> ContactSet:
        whole = self.recording.contact_sets.get(sequence)
        if whole is not None:
            return whole
        surface, tools, bodies = self.found_from.get(sequence, (-1, -1, None))
        if bodies is None or surface not in self._surfaces or tools not in self._tools:
            raise UserError(f"the bag has no contact set number {sequence}; its recording lost messages")
        _forget_before(self._surfaces, surface)  # sets come in the order of what they were found from
        _forget_before(self._tools, tools)
        engaged, pushing = (bodies[name].astype(np.int64) for name in ("engaged", "pushing"))
        places, releases = self._tools[tools]
        query = ContactQuery(places, np.ascontiguousarray(bodies["margin"]), engaged, pushing, releases)
        finder = next(finder for first, finder in reversed(self._finders) if first <= sequence)
        return finder.find(self._surfaces[surface], query)


def _forget_before[Kept](kept: dict[int, Kept], tick: int) -> None:
    while next(iter(kept)) < tick:
        del kept[next(iter(kept))]


def _input(values: dict[int, Floats], sequence: int, what: str) -> Floats:
    if sequence not in values:
        raise UserError(f"the bag has no {what} number {sequence}; its recording lost messages")
    return values[sequence]
