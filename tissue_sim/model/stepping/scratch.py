"""Working memory: what a tick would otherwise allocate."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from tissue_sim.model.contact.constraint import MOST_NEAR
from tissue_sim.model.contact.volume_limit import MOST_SQUEEZED
from tissue_sim.model.data.blocks import BLOCK, empty_blocks
from tissue_sim.model.data.contact_set import MOST_POINTS
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.records import Record
from tissue_sim.model.elasticity.cells import CONSTANTS
from tissue_sim.model.regions.modal_region import MOST_BOUNDARY, MOST_DRIVE


class Plan(Record):
    """Plan of a tick."""

    substeps: int
    handled: bool  # a hand touches, pulls or leads nodes, not a link, another organ or the weight
    forced: bool  # anything pulls or leads nodes
    whole: bool  # the whole organ moves
    regional: bool  # a region of cells moves
    looking: bool  # its last substep is checked for oscillation
    coarse: bool  # its steps are coarse, with the larger masses that they need


class Scratch(NamedTuple):
    """Working arrays of a tick; nothing in them outlives it except the region's lists."""

    plan: Plan
    force: Any  # (n, 3) N
    impulse: Any  # (T, 6) N s on the tissue
    mobility: Any  # (n,) 1/kg
    push: Any  # (3n,) s/kg, and
    shrink: Any  # (3n,), of integrators.symplectic_euler_whole
    mobility_key: Any  # (5,) settings that they were computed for
    coarse: Any  # (n,) factors on the nodes' masses in coarse steps
    velocity_before: Any  # (n, 3) m/s, at the beginning of its last substep
    origin: Any  # (T, 3) m at the substep's end
    rotation: Any  # (T, 9)
    last_origin: Any  # (T, 3) at its beginning
    last_rotation: Any  # (T, 9)
    held: Any  # (T, 7) where it is held at the substep's end
    goal: Any  # (T, 7) where it would be then, if it may move there, and
    before: Any  # (T, 7) where it was
    fraction: Any  # (T,) of that way, which it may move
    give: Any  # (T,) m, yielding of a tool to an impulse of 1 N s
    near_entry: Any  # (N,) contact points resolved in this substep
    near_normal: Any  # (N,) N s
    near_tangent: Any  # (N, 3) N s
    near_began: Any  # (N, 3) m, yielding of tissue across the normal when the substep began
    near_plane: Any  # (N, 11) the tool there; see contact_constraint.gather_contacts
    near_soft: Any  # (N, 4) the tissue there; see contact_constraint.soften
    near_node: Any  # (N, 3) its nodes, their
    near_weight: Any  # (N, 3) weights, and
    near_move: Any  # (N, 3) 1/kg, the velocity that an impulse on the point gives them
    work: Any  # (9 BLOCK,)
    squeezed: Any  # (S, 6) cells resolved in this substep; see squeezed.find_compressed_cells
    squeezed_node: Any  # (S, 4)
    squeezed_slope: Any  # (S, 4, 3) 1/m, of their volume by each node
    squeezing: Any  # (1,) how many
    watched: Any  # (C,) contact points that may touch in this tick
    watched_gap: Any  # (C,) m, least distance from the tools
    watched_speed: Any  # (C,) m/s, at which it may shrink by the tool's motion
    watching: Any  # (1,) how many
    wall: Any  # (C,) contact points that are mostly held
    walls: Any  # (1,) how many
    # Lists of the region. fresh, was (n,): nodes that are new in it, and the hops they had.
    fresh: Any
    was: Any
    region_node: Any  # (n,)
    moved_node: Any  # (n,) those with mass
    moved: Any  # (1,) how many
    boundary_node: Any  # (n,)
    edges: Any  # Blocks
    links: Any  # Blocks
    cells: Any  # Blocks
    edge_slopes: Any  # their rows of Model.reduction
    link_slopes: Any
    cell_slopes: Any
    edge_mark: Any
    link_mark: Any
    cell_mark: Any
    node_mark: Any
    stamp: Any  # (1,) value of the marks of valid lists
    stale: Any  # (1,) 1 when the region's lists have to be made again
    # Of the modal region: m modes, r = 3 MOST_BOUNDARY rows, d = 3 MOST_DRIVE columns.
    drive_node: Any  # (n,) nodes of the region, then those at its edge
    drive: Any  # (n, 3) N
    drive_rows: Any  # (d, m) modes at the loads
    edge_rows: Any  # (d + m, r) effect of each load and each mode at the edge
    edge_share: Any  # (d + m,) amount of each
    edge_move: Any  # (r,) m
    mode_sum: Any  # (m,)
    mode_rest: Any  # (m,)
    mode_move: Any  # (m,)
    propagator: Any  # (5, m)
    propagator_key: Any  # (3,)
    field: Any  # (3n,) m


def make_scratch(model: Model, n_bodies: int) -> Scratch:
    """Return the working memory for a model, with its tables for a local region when it has one.

    Parameters
    ----------
    model : Model
        Constants of the model.
    n_bodies : int
        Number of bodies.

    Returns
    -------
    Scratch
        The memory.
    """
    n, hinges, links = len(model.rest), len(model.edges.nodes) * BLOCK, len(model.links.nodes) * BLOCK
    modes = len(model.reduction.frequency)
    # Only a model with a local region needs memory for one.
    local = 0 if model.adjacency is None else n
    region_hinges, region_links = (hinges, links) if local else (0, 0)
    region_cells = 0 if not local or model.tissue is None else len(model.tissue.nodes) * BLOCK
    held = 0 if model.tissue is None else MOST_SQUEEZED
    modal = modes > 0
    rows = 3 * MOST_BOUNDARY if modal else 0
    columns = 3 * MOST_DRIVE if modal and len(model.reduction.compliance) else 0

    def empty(*shape: int, dtype: Any = np.float64) -> Any:
        return np.zeros(shape, dtype=dtype)

    def singles(*shape: int) -> Any:
        return np.zeros(shape, dtype=np.float32)

    def ints(size: int) -> Any:
        return np.zeros(size, dtype=np.int32)

    def longs(*size: int) -> Any:
        return np.zeros(size, dtype=np.int64)

    return Scratch(
        plan=Plan.new(),
        force=empty(n, 3),
        impulse=empty(n_bodies, 6),
        mobility=empty(n),
        push=empty(3 * n),
        shrink=empty(3 * n),
        mobility_key=empty(5),
        coarse=np.ones(n),
        velocity_before=empty(n, 3),
        origin=empty(n_bodies, 3),
        rotation=empty(n_bodies, 9),
        last_origin=empty(n_bodies, 3),
        last_rotation=empty(n_bodies, 9),
        held=empty(n_bodies, 7),
        goal=empty(n_bodies, 7),
        before=empty(n_bodies, 7),
        fraction=empty(n_bodies),
        give=empty(n_bodies),
        near_entry=longs(MOST_NEAR),
        near_normal=empty(MOST_NEAR),
        near_tangent=empty(MOST_NEAR, 3),
        near_began=empty(MOST_NEAR, 3),
        near_plane=empty(MOST_NEAR, 11),
        near_soft=empty(MOST_NEAR, 4),
        near_node=longs(MOST_NEAR, 3),
        near_weight=empty(MOST_NEAR, 3),
        near_move=empty(MOST_NEAR, 3),
        work=empty(9 * BLOCK),
        squeezed=empty(held, 6),
        squeezed_node=longs(held, 4),
        squeezed_slope=empty(held, 4, 3),
        squeezing=longs(1),
        watched=longs(MOST_POINTS),
        watched_gap=empty(MOST_POINTS),
        watched_speed=empty(MOST_POINTS),
        watching=longs(1),
        wall=longs(MOST_POINTS),
        walls=longs(1),
        fresh=ints(local),
        was=longs(local),
        region_node=ints(local),
        moved_node=ints(local),
        moved=longs(1),
        boundary_node=ints(local),
        edges=empty_blocks(region_hinges, 4, 8),
        links=empty_blocks(region_links, 2, 2),
        cells=empty_blocks(region_cells, 4, CONSTANTS),
        edge_slopes=empty(*model.reduction.edge_slopes.shape),
        link_slopes=empty(*model.reduction.link_slopes.shape),
        cell_slopes=empty(*model.reduction.cell_slopes.shape),
        edge_mark=longs(region_hinges),
        link_mark=longs(region_links),
        cell_mark=longs(region_cells),
        node_mark=longs(local),
        stamp=longs(1),
        stale=longs(1),
        drive_node=ints(local),
        drive=empty(n if modal else 0, 3),
        drive_rows=singles(3 * MOST_DRIVE if modal else 0, modes),
        edge_rows=singles(columns + modes, rows),
        edge_share=singles(max(columns, 3 * MOST_DRIVE if modal else 0) + modes),
        edge_move=singles(rows),
        mode_sum=singles(modes),
        mode_rest=empty(modes),
        mode_move=empty(modes),
        propagator=empty(5, modes),
        propagator_key=empty(3),
        field=empty(3 * n if modal else 0),
    )
