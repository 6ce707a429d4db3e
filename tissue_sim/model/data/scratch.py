"""Working memory, which a tick would otherwise have to allocate."""

from __future__ import annotations

from typing import NamedTuple

from tissue_sim.array_types import Floats, Ints, Longs, Singles
from tissue_sim.model.data.blocks import Blocks
from tissue_sim.model.data.records import Record, Records


class Plan(Record):
    """Plan of a tick."""

    substeps: int
    handled: bool  # a hand touches, pulls or prescribes nodes; links, other organs and weight don't count
    forced: bool  # anything pulls or prescribes nodes
    whole: bool  # the whole organ moves
    regional: bool  # a region of cells moves
    is_checked: bool  # its last substep is checked for oscillation
    coarse: bool  # its steps are coarse, with the larger masses that they need
    mass_scaled: bool  # nodes of compressed cells are heavier, see stepping.mass_scaling


class MobilityKey(Record):
    """Values for which the mobilities were computed."""

    step: float  # s; 0: for nothing yet
    damping: float
    inertia: float
    prescriptions: int  # State.status.prescriptions
    coarse: bool
    mass_scaled: bool  # as in Plan


class Scratch(NamedTuple):
    """Working arrays of a tick; only the region's lists are used after it."""

    plan: Plan
    force: Floats  # (n, 3) N
    impulse: Floats  # (T, 6) N s on the tissue
    slew_part: Floats  # (T,) fraction of each tool's slew limit that applies to this organ
    mobility: Floats  # (n,) 1/kg
    mass: Floats  # (n,) kg, 0 where held
    push: Floats  # (3n,) s/kg, and
    shrink: Floats  # (3n,), of integrators.symplectic_euler_whole
    mobility_key: MobilityKey  # settings and masses that they were computed for
    coarse: Floats  # (n,) factors on the nodes' masses in coarse steps, and
    mass_factor: Floats  # (n,) in all others, and
    last_mass_factor: Floats  # (n,) in the tick before
    velocity_before: Floats  # (n, 3) m/s, at the beginning of its last substep
    origin: Floats  # (T, 3) m at the substep's end
    rotation: Floats  # (T, 9)
    last_origin: Floats  # (T, 3) at its beginning
    last_rotation: Floats  # (T, 9)
    held: Floats  # (T, 7) pose in which it is held at the substep's end
    goal: Floats  # (T, 7) pose that it would have then, if it may move there
    before: Floats  # (T, 7) pose that it had before
    fraction: Floats  # (T,) of the distance between these that it may move
    give: Floats  # (T,) m / (N s), displacement of a coupled tool by an impulse; 0 for a rigid one
    active: Records  # (N,) ActiveContact: contact points resolved in this substep
    work: Floats  # (9 BLOCK,)
    blade_rows: Records  # (S,) BladeRow: places of blades resolved in this substep
    blade_stretch: Floats  # (9,) buffer: a deformation gradient, and
    blade_back: Floats  # (9,) its inverse
    blade_way: Floats  # (3,) buffer for vectors, and
    blade_at: Floats  # (3,)
    blade_weight: Floats  # (8,) buffer for barycentric weights
    compressed: Records  # (S,) CompressedCell: cells resolved in this substep
    n_compressed: Longs  # (1,) how many
    candidates: Longs  # (C,) contact points that may touch in this tick
    candidate_gap: Floats  # (C,) m, least distance from the tools
    candidate_speed: Floats  # (C,) m/s, at which this distance may shrink by the tool's motion
    n_candidates: Longs  # (1,) their number
    wall: Longs  # (C,) contact points on mostly fixed nodes
    wall_depth: Floats  # (C,) m, see walls.measure_walls, with
    wall_pose: Floats  # (T, 7) poses of the bodies
    wall_push: Floats  # (T, 3) m that walls have moved each body in this substep, towards the tissue
    wall_arm: Floats  # (T, 3) m from each body's origin to where
    wall_before: Floats  # (T, 6) N s and N m s on the tissue and walls before this substep
    n_walls: Longs  # (1,) number of contact points on mostly fixed nodes
    walls_measured: Longs  # (1,) 1 where their depths are those of this tick
    # Lists of the region. new_node, previous_hop (n,): nodes that are new in it, and the hops they had.
    new_node: Ints
    previous_hop: Longs
    region_node: Ints  # (n,)
    moved_node: Ints  # (n,) those with mass
    n_moved: Longs  # (1,) how many
    boundary_node: Ints  # (n,)
    edges: Blocks
    links: Blocks
    cells: Blocks
    edge_slopes: Floats  # their rows of Model.reduction
    link_slopes: Floats
    cell_slopes: Floats
    edge_mark: Longs
    link_mark: Longs
    cell_mark: Longs
    node_mark: Longs
    stamp: Longs  # (1,) value of marks in the present lists
    stale: Longs  # (1,) 1 when the region's lists must be made again
    # Of the modal region: m modes, r = 3 MOST_BOUNDARY rows, d = 3 MOST_DRIVE columns.
    drive_node: Ints  # (n,) nodes of the region, then those at its edge
    drive: Floats  # (n, 3) N
    drive_rows: Singles  # (d, m) modes at the loads
    edge_rows: Singles  # (d + m, r) effect of each load and each mode at the edge
    edge_load: Singles  # (d + m,) amount of each
    edge_move: Singles  # (r,) m
    mode_sum: Singles  # (m,)
    mode_rest: Floats  # (m,)
    mode_move: Floats  # (m,)
    propagator: Floats  # (5, m)
    propagator_key: Floats  # (3,)
    field: Floats  # (3n,) m
