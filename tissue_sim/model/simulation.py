"""Simulation of an organ with one variant of the model, advanced by `step()`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tissue_sim.arguments import floats_of
from tissue_sim.array_types import Floats, Longs
from tissue_sim.errors import UserError
from tissue_sim.handles import handle
from tissue_sim.model.cutting.carry import NO_PLAN, CarryPlan, carry, carry_plan
from tissue_sim.model.cutting.cut import CutOrgan, CutReport, cut_again, without_cuts
from tissue_sim.model.cutting.cut_cells import Sides, cut_cells_of, sides_of
from tissue_sim.model.cutting.cut_surface import CutSurface
from tissue_sim.model.cutting.lips import lips_of
from tissue_sim.model.cutting.masses import fastest_mode
from tissue_sim.model.cutting.sheet import Sheet, sheet_of
from tissue_sim.model.data.blades import no_cut_cells
from tissue_sim.model.data.contact_set import ContactSet
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.records import words_of
from tissue_sim.model.data.settings import INTEGRATORS, LOCAL_REGIONS, LocalRegion, Settings, default_settings
from tissue_sim.model.data.shapes import NO_TOOLS, Shapes
from tissue_sim.model.data.state import Region, State, make_state, state_like, take_fields
from tissue_sim.model.data.world import make_world
from tissue_sim.model.elasticity.assembly import assemble, model_of
from tissue_sim.model.elasticity.energy import Energy, energy_of
from tissue_sim.model.elasticity.frequency import largest_frequency
from tissue_sim.model.elasticity.gravity import acceleration_of
from tissue_sim.model.regions.region_tables import possible_region, with_region_tables
from tissue_sim.model.stepping.critical_step import REGION_STEP, SAFETY, longest_step_with, model_step, substeps_for
from tissue_sim.model.stepping.equilibrium import residuals, settle
from tissue_sim.model.stepping.relaxation import unrelaxed_factor
from tissue_sim.model.stepping.scratch import make_scratch
from tissue_sim.model.stepping.state_check import check_state
from tissue_sim.model.stepping.tick import tick
from tissue_sim.model.stepping.world import (
    free_world,
    load_world,
    pose_world,
    prescribe_world,
    push_world,
    reset_world,
    touch_world,
    update_hidden_nodes,
)
from tissue_sim.organ.normals import surface_normals
from tissue_sim.organ.organ import Organ


class Simulation:
    """A deformable organ stepped at a fixed rate; `step()` allocates nothing and takes no lock.

    Parameters
    ----------
    organ : Organ
        The organ.
    model : str, optional
        surface, volume or hybrid, as in the paper, or cells; auto selects cells if the organ has them, otherwise
        hybrid.
    rate : float, Hz, optional
        Ticks per second.
    local_region : str, optional
        off; frozen (the paper's: only two layers around a small load move; for springs only); modal (one or two layers
        move by their springs or cells, the rest as a linear body; below 200 Hz the whole organ moves); or auto (modal
        while the load is small and hardly bends its surroundings, otherwise the whole model; always the whole model for
        organs of up to region_tables.MAX_WHOLE_CELLS cells).
    shapes : Shapes, optional
        The rigid tools that may touch it.
    integrator : str, optional
        symplectic (Euler with implicit nodal damping) or explicit (the paper's forward Euler: short steps).
    substeps : int | None, optional
        Number of substeps in a tick, instead of the one from the critical step.
    gravity : ArrayLike, shape (3,), m/s^2, optional
        Gravity in the organ's frame.
    shape_gravity : ArrayLike | None, shape (3,), m/s^2, optional
        Gravity under which the organ has its shape; by default `gravity`, so that it rests in that shape. The unloaded
        shape of cells is computed from it.

    Raises
    ------
    UserError
        When a name, a rate or a number is out of range.
    """

    def __init__(
        self,
        organ: Organ,
        *,
        model: str = "auto",
        rate: float = 1000.0,
        local_region: str = "off",
        shapes: Shapes = NO_TOOLS,
        integrator: str = "symplectic",
        substeps: int | None = None,
        gravity: ArrayLike = (0.0, 0.0, 0.0),
        shape_gravity: ArrayLike | None = None,
    ) -> None:
        if not 1.0 <= rate <= 100_000.0:
            raise UserError(f"rate {rate:g} Hz is outside 1..100000")
        if local_region not in LOCAL_REGIONS:
            raise UserError(f"unknown local region '{local_region}'; choose one of {', '.join(LOCAL_REGIONS)}")
        if integrator not in INTEGRATORS:
            raise UserError(f"unknown integrator '{integrator}'; choose one of {', '.join(INTEGRATORS)}")
        if substeps is not None and not 1 <= substeps <= 10_000:
            raise UserError(f"{substeps} substeps are outside 1..10000")
        model = model_of(organ) if model == "auto" else model
        local_region = possible_region(organ, model, local_region)
        if len(shapes.blades.body) and (model != "cells" or local_region != "off"):
            raise UserError(
                f"a blade cuts model cells with local_region off, not model {model} with local_region {local_region};"
                " calibrate the organ, set local_region to off, or take a tool of another shape"
            )
        self.organ = organ
        self.cut_organ: CutOrgan | None = None  # its cuts and its surface, after `cut`
        self.carry_plan: CarryPlan = NO_PLAN  # how it continues the simulation from which it was cut
        self.origin: Longs = np.zeros(0, dtype=np.int64)  # (n,) node of that simulation which each node replaces
        self.local_region = local_region
        self.variant = model
        self.rate = float(rate)
        self.shapes = shapes
        self.integrator = integrator
        self._fixed_substeps = substeps
        self.settings = default_settings(1.0 / rate, local_region, integrator)
        pulled = acceleration_of(gravity, "gravity")
        borne = pulled if shape_gravity is None else acceleration_of(shape_gravity, "shape_gravity")
        assembled = assemble(organ, model, borne)
        self.model: Model = with_region_tables(assembled, local_region)
        self.set_gravity(pulled)
        # No tool can move tissue farther than the organ's own size.
        self.settings.runaway_span = float(np.linalg.norm(np.ptp(self.model.rest, axis=0)))
        n_bodies, n_modes = len(shapes.kind), len(self.model.reduction.frequency)
        relaxes = len(self.model.relaxation) > 0
        sizes = n_modes, len(self.model.cells), len(shapes.blades.body)
        self.state: State = make_state(organ.n_nodes, n_bodies, *sizes, relaxes)
        self.frequency = largest_frequency(self.model) * math.sqrt(unrelaxed_factor(self.model))
        self.set_substeps()
        self.scratch = make_scratch(self.model, n_bodies, len(shapes.blades.body))
        if len(shapes.blades.body) and not organ.n_virtual:  # those of a cut organ come by open_cuts
            self.model = self.model._replace(cut_cells=cut_cells_of(organ))
        self.refer()
        self.reset()

    def __repr__(self) -> str:
        state = "asleep" if self.asleep else "awake"
        return f"<Simulation of '{self.organ.name}': {self.variant}, {self.rate:g} Hz, {self.time:.3f} s, {state}>"

    def refer(self) -> None:
        """Make new handles of the arrays for the kernels, at the start and whenever `model` was replaced."""
        self.world = handle(make_world(self.model, self.state, self.shapes, self.settings, self.scratch))

    # results -----------------------------------------------------------------------------------
    @property
    def positions(self) -> Floats:
        """Nodes' positions (n, 3) m: surface nodes, medial atoms, interior nodes; the live array, not a copy.

        Reading it brings the nodes outside a modal region up to date.
        """
        status = self.state.status
        if status.region == Region.MODAL and status.shown != status.tick and not self.asleep:
            update_hidden_nodes(self.world)
        return self.state.position

    @property
    def surface_positions(self) -> Floats:
        """Return the positions of the surface nodes, (n_surface, 3) m: a view of `positions`."""
        return self.positions[: self.organ.n_surface]

    @property
    def surface_normals(self) -> Floats:
        """Return the outward unit normals of the deformed surface, (n_surface, 3)."""
        return surface_normals(self.surface_positions, self.organ.surface_triangles)

    @property
    def velocities(self) -> Floats:
        """Nodes' velocities (n, 3) m/s, the live array."""
        return self.state.velocity

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return float(self.state.status.tick) / self.rate

    @property
    def asleep(self) -> bool:
        """Whether the organ is at rest and untouched, so that ticks cost nothing."""
        return bool(self.state.status.asleep)

    @property
    def cuts(self) -> tuple[CutReport, ...]:
        """Return the report of each cut, in order."""
        return self.cut_organ.reports if self.cut_organ else ()

    # actions -----------------------------------------------------------------------------------
    def cut(self, polyline: ArrayLike, direction: ArrayLike, depth: float) -> Simulation:
        """Return a simulation that continues this one with a cut in the organ; this one remains as it is.

        The cut is the sheet that a straight or curved blade sweeps, in the organ's rest coordinates. See `cut_again`.

        Parameters
        ----------
        polyline : ArrayLike, shape (m, 3), m
            The blade's edge where it touches the surface, or above it: two points or more.
        direction : ArrayLike, shape (3,)
            Direction in which the edge is moved; of any length.
        depth : float, m
            Distance by which it is moved.

        Returns
        -------
        Simulation
            With `cuts`, `cut_organ`, an `organ` that has virtual nodes, and the state of this one.

        Raises
        ------
        UserError
            For an organ without cells, with a local region or a shape under gravity, and for a cut that is out of
            range, misses the organ, is too shallow, or meets an earlier one.
        """
        made = self.prepared_cut(polyline, direction, depth)
        made.continue_from(self)
        return made

    def prepared_cut(self, polyline: ArrayLike, direction: ArrayLike, depth: float) -> Simulation:
        """Return the cut organ's simulation at rest, without reading the state: this one may be running.

        Parameters
        ----------
        polyline : ArrayLike, shape (m, 3), m
            The blade's edge, as in `cut`.
        direction : ArrayLike, shape (3,)
            Direction in which it is moved.
        depth : float, m
            Distance by which it is moved.

        Returns
        -------
        Simulation
            With the `carry_plan` that lets it continue this one.

        Raises
        ------
        UserError
            As `cut` does.
        """
        return self.prepared_sheet(sheet_of(self.uncut_organ, polyline, direction, depth))

    @property
    def uncut_organ(self) -> Organ:
        """The organ without its cuts."""
        return self.cut_organ.uncut if self.cut_organ else self.organ

    def prepared_sheet(self, sheet: Sheet) -> Simulation:
        """Return the simulation at rest of the organ cut along a sheet, as `prepared_cut` does.

        Parameters
        ----------
        sheet : Sheet
            The sheet.

        Returns
        -------
        Simulation
            With the `carry_plan` that lets it continue this one.

        Raises
        ------
        UserError
            As `cut` does.
        """
        if self.variant != "cells":
            raise UserError(f"model {self.variant} can't be cut; use model cells, which a calibrated organ has")
        if self.local_region != "off" or self.model.shape_gravity.any():
            raise UserError("a cut needs local_region off, and shape_gravity [0, 0, 0] where there is gravity")
        before = self.cut_organ or without_cuts(self.organ)
        after = cut_again(before, sheet)
        made = Simulation(
            after.organ,
            model="cells",
            rate=self.rate,
            shapes=self.shapes,
            integrator=self.integrator,
            substeps=self._fixed_substeps,
        )
        made.open_cuts(after.surface, sides_of(after))
        made.take_settings(self.settings)
        made.frequency = max(made.frequency, fastest_mode(after.organ) * math.sqrt(unrelaxed_factor(made.model)))
        made.set_substeps()
        made.plan_from(self, after.origin(before))
        # The frequency of an organ that was cut before was already computed by Lanczos' method.
        own = before.frequency * math.sqrt(unrelaxed_factor(self.model))
        frequency = self.frequency if self.cut_organ else max(self.frequency, own)
        report = after.reports[-1]._replace(
            critical_step_before=self._critical_step(frequency),
            critical_step_after=made.critical_step,
        )
        made.cut_organ = after._replace(reports=(*after.reports[:-1], report))
        return made

    def open_cuts(self, surface: CutSurface, sides: Sides | None = None) -> None:
        """Let the lips of cuts touch each other, and blades move between them.

        Parameters
        ----------
        surface : CutSurface
            Surface of the cut organ.
        sides : Sides | None, optional
            Its cells on both sides; without them no blade moves in these cuts.
        """
        self.model = self.model._replace(lips=lips_of(surface, self.organ.rest_positions))
        if len(self.shapes.blades.body):
            cells = no_cut_cells() if sides is None else cut_cells_of(self.organ, sides)
            self.model = self.model._replace(cut_cells=cells)
        self.refer()

    def return_from(self, cut: Simulation) -> None:
        """Reset, with the settings of a simulation that was cut from this one, and plan how to continue that one.

        Parameters
        ----------
        cut : Simulation
            That simulation, which may be running.
        """
        self._renew()
        self.take_settings(cut.settings)
        self.plan_from(cut, np.arange(self.organ.n_nodes))

    def _renew(self) -> None:
        """Reset to the initial state, with new state and working memory, to which nothing else refers."""
        self.state = state_like(self.state)
        self.scratch = make_scratch(self.model, len(self.shapes.kind), len(self.shapes.blades.body))
        if self.model.tissue is not None:
            self.model.tissue.stiff[:] = 0
            self.model.tissue.shortening[:] = 1
        self.refer()
        self.reset()

    def plan_from(self, before: Simulation, origin: Longs) -> None:
        """Plan how this simulation continues one of the same organ with other cuts.

        Parameters
        ----------
        before : Simulation
            That simulation, which may be running.
        origin : Longs, shape (n,)
            Node of that simulation which each node replaces.
        """
        self.origin = origin
        own = min(self.organ.n_uncut, before.organ.n_uncut)
        self.carry_plan = carry_plan(before.state, self.state, origin, own, self.organ.mass)

    def continue_from(self, before: Simulation) -> None:
        """Continue from the state of the simulation from which this one was cut, without loads on its virtual nodes.

        Parameters
        ----------
        before : Simulation
            That simulation.
        """
        state = self.state
        carry(before.state.words, state.words, self.carry_plan)
        for kind, listed in (("loaded", state.loaded_node), ("prescribed", state.prescribed_node)):
            kept = [node for node in listed[: getattr(state.status, kind)] if node < self.organ.n_uncut]
            listed[: len(kept)] = kept
            setattr(state.status, kind, len(kept))
        self.forget_scratch()

    def forget_scratch(self) -> None:
        """Invalidate working memory that belongs to another state."""
        self.scratch.stale[0] = 1
        self.scratch.mobility_key.step = 0.0  # the state may prescribe other nodes, as often

    def apply_force(self, nodes: ArrayLike, forces: ArrayLike) -> None:
        """Add forces to nodes for the coming tick.

        Parameters
        ----------
        nodes : ArrayLike, shape (k,)
            Indices of the nodes.
        forces : ArrayLike, shape (k, 3), N
            Force on each.

        Raises
        ------
        UserError
            When nodes are out of range or forces are not finite.
        """
        load_world(self.world, *self._at_nodes(nodes, forces, "forces"))

    def set_gravity(self, gravity: ArrayLike) -> None:
        """Set the gravity in the organ's frame.

        Parameters
        ----------
        gravity : ArrayLike, shape (3,), m/s^2
            The gravity.

        Raises
        ------
        UserError
            When it is not three finite numbers of at most gravity.MOST_GRAVITY together.
        """
        settings = self.settings
        settings.gravity_x, settings.gravity_y, settings.gravity_z = acceleration_of(gravity, "gravity")

    def prescribe(self, nodes: ArrayLike, positions: ArrayLike, ticks: int = 1) -> None:
        """Move nodes evenly to positions within some ticks, and hold them there until `free`.

        Fixed nodes of the organ may be among them.

        Parameters
        ----------
        nodes : ArrayLike, shape (k,)
            Indices of the nodes.
        positions : ArrayLike, shape (k, 3), m
            Final position of each node.
        ticks : int, optional
            Number of ticks after which they arrive.

        Raises
        ------
        UserError
            When nodes are out of range or positions are not finite.
        """
        index, values = self._at_nodes(nodes, positions, "positions")
        if ticks < 1:
            raise UserError(f"{ticks} ticks are less than 1")
        prescribe_world(self.world, index, values, ticks)

    def free(self) -> None:
        """Release prescribed nodes; fixed nodes of the organ stay where they are until `reset`."""
        free_world(self.world)

    def reactions(self) -> Floats:
        """Return the forces that hold prescribed and fixed nodes against the elastic and external forces on them.

        Inertia is neglected, so they are valid for an organ at rest, or nearly so; they are 0 at all other nodes.

        Returns
        -------
        Floats
            shape (n, 3), N
        """
        force = residuals(self)
        if len(self.state.relaxing):
            force += self.state.unrelaxed
        held = np.ones(len(force), dtype=bool)
        held[self.model.moving] = False
        held[self.state.prescribed_node[: self.state.status.prescribed]] = True
        force[~held] = 0.0
        return -force

    def _at_nodes(self, nodes: ArrayLike, given: ArrayLike, name: str) -> tuple[NDArray[np.int64], Floats]:
        """Check and return nodes (k,) and the given vectors (k, 3), one at each."""
        index = np.atleast_1d(np.asarray(nodes, dtype=np.int64))
        values = floats_of(given)
        if values.size != 3 * len(index) or values.shape[-1] != 3:
            raise UserError(f"{name} has shape {values.shape}, expected ({len(index)}, 3) for {len(index)} nodes")
        values = np.ascontiguousarray(values.reshape(len(index), 3))
        if not np.all(np.isfinite(values)):
            raise UserError(f"{name} must be finite")
        if len(index) and (index.min() < 0 or index.max() >= len(self.state.position)):
            raise UserError(f"nodes must lie in 0..{len(self.state.position) - 1}")
        return index, values

    def take_pose(self, body: int, pose: Floats, sequence: int, stamp: int = 0) -> None:
        """Apply the newest pose of a tool's body.

        Parameters
        ----------
        body : int
            Index of the body.
        pose : Floats, shape (7,), m and a unit quaternion xyzw
            The pose.
        sequence : int
            Number of the pose.
        stamp : int, ns, optional
            Time of the pose, from which the tool's speed follows; 0 when it is unknown, and the time of arrival counts.
        """
        pose_world(self.world, body, pose, stamp, sequence)

    def take_force(self, body: int, force: Floats, sequence: int) -> None:
        """Apply the newest external force on the tissue at the tip of a body.

        Parameters
        ----------
        body : int
            Index of the body.
        force : Floats, shape (3,), N
            The force.
        sequence : int
            Number of the force.
        """
        push_world(self.world, body, force, sequence)

    def take_contacts(self, found: ContactSet, sequence: int) -> None:
        """Apply a contact set.

        Parameters
        ----------
        found : ContactSet
            The contact set.
        sequence : int
            Number of the set.
        """
        touch_world(self.world, found, sequence)

    def step(self, ticks: int = 1) -> None:
        """Advance by some ticks of 1/rate seconds."""
        for _ in range(ticks):
            tick(self.world)

    def reset(self) -> None:
        """Return to the rest shape, asleep, without tools; the counters continue."""
        reset_world(self.world)

    @property
    def critical_step(self) -> float:
        """Longest stable step of the integrator for the present stiffness and damping, s."""
        return self._critical_step(self.frequency)

    def _critical_step(self, frequency: float) -> float:
        """Return the critical step, s, for a largest frequency of the unscaled model, rad/s."""
        scale, damping = float(self.settings.stiffness_scale), float(self.settings.damping_scale)
        return model_step(self.model, frequency, scale, damping, self.integrator)

    @property
    def energy(self) -> Energy:
        """Kinetic and elastic energy, J; the latter includes the energy of unrelaxed forces."""
        energy, scale = energy_of(self.model, self.positions, self.velocities), float(self.settings.stiffness_scale)
        return energy._replace(elastic=energy.elastic * scale + float(self.state.relaxing.energy.sum()))

    def set_substeps(self) -> None:
        """Compute the substeps from the critical step, after the stiffness, the damping or the rate changed."""
        settings = self.settings
        longest = self.longest_step
        settings.substeps = self._fixed_substeps or substeps_for(settings.tick_time, longest)
        settings.region_substeps = settings.substeps
        settings.region_inertia = 1.0
        if self.integrator == "symplectic" and settings.local_region in (LocalRegion.MODAL, LocalRegion.AUTO):
            most = math.ceil(settings.tick_time / REGION_STEP)
            if settings.region_substeps > most and not self._fixed_substeps:
                settings.region_substeps = most
                settings.region_inertia = (settings.tick_time / (most * SAFETY * longest)) ** 2

    @property
    def longest_step(self) -> float:
        """Longest substep allowed, s: the critical step, or the limit by the tools for a softer organ."""
        return min(self.critical_step, longest_step_with(self.shapes, self.variant == "cells") / SAFETY)

    def take_settings(self, settings: Settings) -> None:
        """Apply settings of an earlier run, which is repeated.

        Parameters
        ----------
        settings : Settings
            The settings.
        """
        words_of(self.settings)[:] = words_of(settings)

    def restore(self, fields: Mapping[str, NDArray[Any]]) -> None:
        """Continue from the fields of a state (state.fields_of).

        Parameters
        ----------
        fields : Mapping[str, NDArray[Any]]
            Arrays of the fields, by name.

        Raises
        ------
        UserError
            When they don't fit.
        """
        before = self.state.words.copy()
        try:
            take_fields(self.state, fields)
            check_state(self.state)
            if np.any(
                (self.state.blades.cell < 0) | (self.state.blades.cell >= max(1, len(self.model.cut_cells.nodes)))
            ):
                raise ValueError("its blades are in cells that the organ doesn't have")
        except ValueError as error:
            self.state.words[:] = before
            raise UserError(str(error)) from None
        self.forget_scratch()

    def settle(
        self, forces: Floats, tolerance: float = 1e-3, longest: float = 20.0, ramp: float = 0.0
    ) -> tuple[Floats, bool]:
        """Return the displacements at rest under surface forces, and whether the organ settled; see equilibrium.settle.

        Parameters
        ----------
        forces : Floats, shape (n_surface, 3), N
            Force on each surface node.
        tolerance : float, optional
            Residual force over load at which the organ counts as settled.
        longest : float, s, optional
            Simulated time after which settling is abandoned.
        ramp : float, s, optional
            Time in which the forces grow to their value.

        Returns
        -------
        tuple[Floats, bool]
            Displacements, shape (n_surface, 3), m, and True if it settled.
        """
        return settle(self, forces, tolerance, longest, ramp)
