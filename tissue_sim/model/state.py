"""Everything that changes from tick to tick, in two flat buffers: one copy is a snapshot."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Longs

# Scalars in State.count, all 64-bit integers.
TICK = 0  # ticks done
ASLEEP = 1  # 1 while the organ is at rest and untouched
QUIET = 2  # ticks in a row that were as good as at rest
REGION = 3  # WHOLE, FROZEN or MODAL, how the last tick was solved
SUBSTEPS = 4  # substeps of the last tick
BACKOFF = 5  # factor on the substeps after a fault
ENTRIES = 6  # entries in the contact set
TOUCHING = 7  # contact points that touched in the last tick
ACTIVE = 8  # nodes that were integrated in the last tick
FAULTS = 9  # times the guard restored the last good state
ASLEEP_TICKS = 10  # ticks that were skipped asleep
FROZEN_TICKS = 11  # ticks that moved a local region alone
REGION_NODES = 12  # nodes in the local region
REGION_SPRINGS = 13
REGION_HINGES = 14
N_LOADED = 15  # nodes that nodal_force holds something for in this tick, listed in loaded_node
CLAMPED = 16  # ticks in which a wrench was cut to the clamp
CONTACT_SEQUENCE = 17  # which contact set is in use
REGION_BOUNDARY = 18  # nodes at the region's edge that follow the modes
MODAL_TICKS = 19  # ticks that moved a modal region
SNAPPED = 20  # 1 while the organ is led back from a false rest shape
SNAPS = 21  # times that it had to be
FAULT_KIND = 22  # what the guard found last: NO_FAULT, NOT_FINITE, RUNAWAY or COLLAPSED
TURNED = 23  # cells of the inside that are turned inside out
NEXT_CELL = 24  # where the rolling check of the cells goes on
ALONE = 25  # ticks in a row without touch and load
CALM = 26  # ticks in a row with a load small enough for a local region
SHOWN = 27  # tick in which the nodes outside a modal region were last put where they belong
COLLAPSING = 28  # 1 while more of the inside is turned inside out than can find back by itself
GOOD_AGE = 29  # ticks since the last good shape was kept
SLEWED = 30  # ticks in which a wrench changed no faster than it may
N_COUNT = 31

NO_FAULT, NOT_FINITE, RUNAWAY, COLLAPSED = 0, 1, 2, 3
FAULT_NAMES = ("none", "not finite", "runaway", "collapsed")

WHOLE, FROZEN, MODAL = 0, 1, 2

# Columns of State.tool_count.
AGE = 0  # ticks since the newest pose; -1 before the first one
REMAINING = 1  # ticks until the tool stands at the newest pose
FORCE_AGE = 2  # ticks since the newest external force; -1 before the first one
ENGAGED = 3  # 1 while the tool may touch: fresh, and outside the organ when it appeared
POSE_SEQUENCE = 4  # which pose is in use
FORCE_SEQUENCE = 5  # which external force is in use
N_TOOL_COUNT = 6

# Settings: parameters that may change between two ticks.
TICK_TIME = 0  # s
FRICTION = 1  # Coulomb coefficient
FORCE_CLAMP = 2  # N
STALE_TIME = 3  # s
RAMP_TIME = 4  # s
STIFFNESS_SCALE = 5
DAMPING_SCALE = 6
LOCAL_REGION = 7  # index in LOCAL_REGIONS: off, frozen, modal, auto
REGION_FORCE = 8  # N above which the region is skipped
LAST_GOOD_SPAN = 9  # m, displacement that the guard takes for runaway
WANTED_SUBSTEPS = 10  # substeps in a tick, from the critical step
INTEGRATOR = 11  # index in INTEGRATORS
REGION_SUBSTEPS = 12  # substeps in a tick of a local region, whose nodes are never stepped implicitly
FACTOR_SLOT = 13  # which of the implicit matrix' two factors is in use
REGION_INERTIA = 14  # factor on mass and damping of the nodes in a modal region, so that it needs no more substeps
FORCE_SLEW = 15  # N/s, fastest change of what a hand feels
COUPLING_STIFFNESS = 16  # N/m between hand and tool; 0: the tool is where the hand is
COUPLING_DAMPING = 17  # N s/m on the tool
N_SETTINGS = 18

MAX_ENTRIES = 2048


class State(NamedTuple):
    """Views into the two buffers. T tools, n nodes, C contact set entries."""

    position: Floats  # (n, 3) m
    velocity: Floats  # (n, 3) m/s
    good_position: Floats  # (n, 3) m, a shape that passed the guard, at most KEEP_EVERY ticks old
    nodal_force: Floats  # (n, 3) N, for the coming tick
    contact_impulse: Floats  # (n, 3) N s on the tissue in this tick, kept for the modal region
    static_load: Floats  # (n, 3) N that bends the organ outside a modal region: loads, and what its springs add
    offset: Floats  # (n, 3) m, by how much the reduced organ was off when the region was made
    blend: Floats  # (1,) share of the offset that is left
    mode_position: Floats  # (m,) sqrt(kg) m
    mode_velocity: Floats  # (m,) sqrt(kg) m/s
    tool_pose: Floats  # (T, 7) m and quaternion xyzw: where the tool is
    hand_pose: Floats  # (T, 7) where the hand holds it, on its way to the newest pose
    tool_goal: Floats  # (T, 7) the newest pose
    tool_force: Floats  # (T, 3) N, external force on the tissue at the tool's tip
    tip_weight: Floats  # (T, 3) barycentric weights of the surface point under the tip
    wrench: Floats  # (T, 6) N and N m about the tool's origin: what the hand should feel
    felt: Floats  # (T, 6) the same before it fades with a stale pose
    contact_weight: Floats  # (C, 3) barycentric weights of the contact points
    contact_normal: Floats  # (C, 3) outward unit normals of the tissue there
    contact_pressed: Floats  # (2, C) N s along the tool's normal in the last substep; row 1 is room
    contact_held: Floats  # (2, C, 3) N s across it
    count: Longs  # type: ignore[assignment]  # (N_COUNT,) hides the tuple's method, which nobody needs
    tool_count: Longs  # (T, N_TOOL_COUNT)
    tip_node: Longs  # (T, 3) nodes of the triangle under the tip, -1 when none is near
    contact_tool: Longs  # (C,)
    contact_node: Longs  # (C, 3)
    loaded_node: Longs  # (n,) the nodes that nodal_force loads in this tick
    is_loaded: Longs  # (n,) 1 for those
    is_turned: Longs  # (c,) 1 for cells of the inside that are turned inside out
    region_hop: Longs  # (n,) 0 loaded, 1, 2 hops away, -1 outside the local region


class StateBuffer:
    """The two flat buffers (`floats`, `integers`) and the `state` viewing them."""

    def __init__(self, n: int, n_tools: int, n_modes: int = 0, n_cells: int = 0) -> None:
        float_shapes: dict[str, tuple[int, ...]] = {
            "position": (n, 3),
            "velocity": (n, 3),
            "good_position": (n, 3),
            "nodal_force": (n, 3),
            "contact_impulse": (n, 3),
            "static_load": (n, 3),
            "offset": (n, 3),
            "blend": (1,),
            "mode_position": (n_modes,),
            "mode_velocity": (n_modes,),
            "tool_pose": (n_tools, 7),
            "hand_pose": (n_tools, 7),
            "tool_goal": (n_tools, 7),
            "tool_force": (n_tools, 3),
            "tip_weight": (n_tools, 3),
            "wrench": (n_tools, 6),
            "felt": (n_tools, 6),
            "contact_weight": (MAX_ENTRIES, 3),
            "contact_normal": (MAX_ENTRIES, 3),
            "contact_pressed": (2, MAX_ENTRIES),
            "contact_held": (2, MAX_ENTRIES, 3),
        }
        integer_shapes: dict[str, tuple[int, ...]] = {
            "count": (N_COUNT,),
            "tool_count": (n_tools, N_TOOL_COUNT),
            "tip_node": (n_tools, 3),
            "contact_tool": (MAX_ENTRIES,),
            "contact_node": (MAX_ENTRIES, 3),
            "loaded_node": (n,),
            "is_loaded": (n,),
            "is_turned": (n_cells,),
            "region_hop": (n,),
        }
        self.floats, float_views = _carve(float_shapes, np.float64)
        self.integers, integer_views = _carve(integer_shapes, np.int64)
        self.state = State(**float_views, **integer_views)

    def tick_of(self, integers: Longs) -> int:
        """The tick of a snapshot of the integer buffer."""
        start = (self.state.count.ctypes.data - self.integers.ctypes.data) // self.integers.itemsize
        return int(integers[start + TICK])

    def copy_from(self, floats: Floats, integers: Longs) -> None:
        """Take over a snapshot; raises ValueError when it has another size."""
        if floats.shape != self.floats.shape or integers.shape != self.integers.shape:
            raise ValueError("the snapshot belongs to another organ or other tools")
        self.floats[:] = floats
        self.integers[:] = integers


def _carve(shapes: dict[str, tuple[int, ...]], dtype: type) -> tuple[NDArray[Any], dict[str, NDArray[Any]]]:
    buffer: NDArray[Any] = np.zeros(sum(int(np.prod(shape)) for shape in shapes.values()), dtype=dtype)
    views, start = {}, 0
    for name, shape in shapes.items():
        size = int(np.prod(shape))
        views[name] = buffer[start : start + size].reshape(shape)
        start += size
    return buffer, views
