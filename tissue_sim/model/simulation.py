"""The object that users touch: an organ, a model variant, and `step()`."""

from __future__ import annotations

import math
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from tissue_sim.errors import UserError
from tissue_sim.model import state as st
from tissue_sim.model.assembly import Model, assemble
from tissue_sim.model.contact_constraint import MOST_NEAR
from tissue_sim.model.hops import hop_table
from tissue_sim.model.inputs import reset_state
from tissue_sim.model.modal_region import place_outside
from tissue_sim.model.modes import lowest_modes
from tissue_sim.model.shapes import SPHERE, Shapes
from tissue_sim.model.stability import largest_frequency, substeps_for
from tissue_sim.model.state import Floats, State, StateBuffer
from tissue_sim.model.tick import Scratch, elastic_forces, tick
from tissue_sim.organ.organ import Organ

LocalRegion = Literal["off", "frozen", "modal", "auto"]
LOCAL_REGIONS: tuple[str, ...] = get_args(LocalRegion)

NO_TOOLS = Shapes(
    kind=np.zeros(0, dtype=np.int64),
    size=np.zeros((0, 2)),
    plane=np.zeros((0, 4)),
    plane_start=np.zeros(1, dtype=np.int64),
)


class Simulation:
    """A deformable organ stepped at a fixed rate. `step()` allocates nothing and takes no lock.

    organ: the organ; model: surface, volume or hybrid; rate: ticks a second, Hz;
    local_region: off; frozen (the paper's: two layers around a small load move alone); modal (they move,
    the rest follows the organ's modes); auto (modal while the load is small, else the whole model);
    shapes: the rigid tools that may touch it; return_target: where return springs pull to, the rest position
    or the boundary that the skeleton, as it stands, has implied (once a tick; not with a modal region, whose
    modes are those about rest).
    Raises UserError for a name or rate out of range.
    """

    def __init__(
        self,
        organ: Organ,
        model: str = "hybrid",
        rate: float = 1000.0,
        local_region: str = "off",
        shapes: Shapes = NO_TOOLS,
        return_target: str = "rest",
    ) -> None:
        if not 1.0 <= rate <= 100_000.0:
            raise UserError(f"rate {rate:g} Hz is outside 1..100000")
        if local_region not in LOCAL_REGIONS:
            raise UserError(f"unknown local region '{local_region}'; choose one of {', '.join(LOCAL_REGIONS)}")
        self.organ = organ
        if return_target != "rest" and local_region in ("modal", "auto"):
            raise UserError(f"return target {return_target} goes with local region off or frozen, not {local_region}")
        self.model: Model = assemble(organ, model, return_target)
        if local_region != "off":
            self.model = self.model._replace(hops=hop_table(self.model))
        if local_region in ("modal", "auto"):
            modes = lowest_modes(self.model)
            self.model = self.model._replace(mode_frequency=modes.frequency, mode_shape=modes.shape)
        self.shapes = shapes
        self.rate = float(rate)
        self.buffer = StateBuffer(organ.n_nodes, len(shapes.kind), len(self.model.mode_frequency))
        self.state: State = self.buffer.state
        self.scratch = _scratch(self.model, len(shapes.kind))
        self.settings = np.zeros(st.N_SETTINGS)
        self.settings[st.TICK_TIME] = 1.0 / rate
        self.settings[st.FRICTION] = 0.6
        self.settings[st.FORCE_CLAMP] = 10.0
        self.settings[st.STALE_TIME] = 0.05
        self.settings[st.RAMP_TIME] = 0.02
        self.settings[st.STIFFNESS_SCALE] = 1.0
        self.settings[st.DAMPING_SCALE] = 1.0
        self.settings[st.LOCAL_REGION] = float(LOCAL_REGIONS.index(local_region))
        self.settings[st.REGION_FORCE] = 0.3
        # Nothing that a tool can do moves tissue by more than the organ's own size.
        self.settings[st.LAST_GOOD_SPAN] = float(np.linalg.norm(np.ptp(self.model.rest, axis=0)))
        self.frequency = largest_frequency(self.model)
        self.set_substeps()
        self.reset()

    # what users read ---------------------------------------------------------------------------
    @property
    def positions(self) -> Floats:
        """(n, 3) m: surface nodes, medial atoms, interior nodes; the live array, not a copy."""
        return self.state.position

    @property
    def velocities(self) -> Floats:
        """(n, 3) m/s, the live array."""
        return self.state.velocity

    @property
    def time(self) -> float:
        """Simulated seconds."""
        return float(self.state.count[st.TICK]) / self.rate

    @property
    def asleep(self) -> bool:
        """True while the organ rests untouched and ticks cost nothing."""
        return bool(self.state.count[st.ASLEEP])

    # what users do -----------------------------------------------------------------------------
    def apply_force(self, nodes: ArrayLike, forces: ArrayLike) -> None:
        """Add forces (k, 3) N to nodes (k,) for the coming tick.

        Raises UserError for nodes out of range or forces that are not finite.
        """
        index = np.atleast_1d(np.asarray(nodes, dtype=np.int64))
        values = np.asarray(forces, dtype=np.float64)
        if values.size != 3 * len(index) or values.shape[-1] != 3:
            raise UserError(f"forces has shape {values.shape}, expected ({len(index)}, 3) for {len(index)} nodes")
        values = values.reshape(len(index), 3)
        if not np.all(np.isfinite(values)):
            raise UserError("forces must be finite")
        if len(index) and (index.min() < 0 or index.max() >= len(self.state.position)):
            raise UserError(f"nodes must lie in 0..{len(self.state.position) - 1}")
        np.add.at(self.state.nodal_force, index, values)
        self.state.count[st.LOADED] = 1

    def step(self) -> None:
        """Advance by 1/rate seconds."""
        tick(self.model, self.state, self.shapes, self.settings, self.scratch)

    def reset(self) -> None:
        """Back to the rest shape, asleep, without tools; the counters go on."""
        reset_state(self.model, self.state, self.scratch)

    def set_substeps(self) -> None:
        """Work out the substeps from the critical step, after the stiffness or the rate changed."""
        self.settings[st.WANTED_SUBSTEPS] = substeps_for(
            self.model, self.settings[st.TICK_TIME], self.settings[st.STIFFNESS_SCALE], self.frequency
        )

    def restore(self, floats: Floats, integers: st.Longs) -> None:
        """Continue from a snapshot of the buffers; raises UserError when it doesn't fit."""
        try:
            self.buffer.copy_from(floats, integers)
        except ValueError as error:
            raise UserError(str(error)) from None
        self.scratch.stale[0] = 1

    def settle(self, forces: Floats, tolerance: float = 1e-3, longest: float = 20.0) -> tuple[Floats, bool]:
        """Displacements at rest under constant surface forces.

        forces (n_surface, 3) N. Steps from the rest shape until the residual force is under
        tolerance times the load (and the organ is all but still), or for `longest` simulated
        seconds. Returns displacements (n_surface, 3) m and whether it settled.
        """
        n_surface = self.model.n_surface
        self.reset()
        loaded = np.flatnonzero(np.any(forces != 0.0, axis=1))
        if not len(loaded):
            return np.zeros((n_surface, 3)), True
        size = float(np.linalg.norm(forces))
        state = self.state
        settled = False
        for _ in range(math.ceil(longest * self.rate / 20)):
            for _ in range(20):
                state.nodal_force[:n_surface] = forces
                state.count[st.LOADED] = 1
                self.step()
            if state.count[st.FAULTS] > 0 and not np.any(state.velocity):
                continue
            residual = self._residual(forces)
            speed = float(np.abs(state.velocity).max())
            reach = float(np.abs(state.position - self.model.rest).max())
            if residual <= tolerance * size and speed * 0.1 <= tolerance * max(reach, 1e-9):
                settled = not self._modes_move(tolerance)
                if settled:
                    break
        if state.count[st.REGION] == st.MODAL:
            place_outside(self.model, state)
        return state.position[:n_surface] - self.model.rest[:n_surface], settled

    def _modes_move(self, tolerance: float) -> bool:
        """True while the modes of a modal region are on their way."""
        if self.state.count[st.REGION] != st.MODAL:
            return False
        speed, reach = (np.linalg.norm(a) for a in (self.state.mode_velocity, self.state.mode_position))
        return bool(speed * 0.1 > tolerance * reach)

    def _residual(self, forces: Floats) -> float:
        """Norm of the force left on the nodes that may move, N."""
        force = np.zeros_like(self.model.rest)
        elastic_forces(self.model, self.state.position, force)
        force *= self.settings[st.STIFFNESS_SCALE]
        force[: self.model.n_surface] += forces
        nodes = self.model.moving
        if self.state.count[st.REGION] != st.WHOLE:
            nodes = self.scratch.region_node[: self.state.count[st.REGION_NODES]]
        return float(np.linalg.norm(force[nodes]))


def sphere_tools(radius: ArrayLike) -> Shapes:
    """Shapes of spherical tools, one for each radius, m."""
    radii = np.atleast_1d(np.asarray(radius, dtype=np.float64))
    return Shapes(
        kind=np.full(len(radii), SPHERE, dtype=np.int64),
        size=np.stack([radii, np.zeros(len(radii))], axis=1),
        plane=np.zeros((0, 4)),
        plane_start=np.zeros(len(radii) + 1, dtype=np.int64),
    )


def _scratch(model: Model, n_tools: int) -> Scratch:
    n, s, h = len(model.rest), len(model.spring_first), len(model.angular_nodes)

    def empty(*shape: int, dtype: Any = np.float64) -> Any:
        return np.zeros(shape, dtype=dtype)

    return Scratch(
        force=empty(n, 3),
        impulse=empty(n_tools, 6),
        mobility=empty(n),
        origin=empty(n_tools, 3),
        rotation=empty(n_tools, 9),
        last_origin=empty(n_tools, 3),
        last_rotation=empty(n_tools, 9),
        start_pose=empty(n_tools, 7),
        load=empty(n, 3),
        mode_load=empty(len(model.mode_frequency)),
        mark=empty(n, dtype=np.int64),
        boundary_node=empty(n, dtype=np.int32),
        near_entry=empty(MOST_NEAR, dtype=np.int64),
        near_normal=empty(MOST_NEAR),
        near_tangent=empty(MOST_NEAR, 3),
        region_node=empty(n, dtype=np.int32),
        region_first=empty(s, dtype=np.int32),
        region_second=empty(s, dtype=np.int32),
        region_rest_length=empty(s),
        region_stiffness=empty(s),
        region_angular_nodes=empty(h, 4, dtype=np.int32),
        region_angular_weight=empty(h, 4),
        region_angular_rest=empty(h),
        region_angular_stiffness=empty(h),
        region_angular_least_area=empty(h),
        stale=empty(1, dtype=np.int64),
    )
