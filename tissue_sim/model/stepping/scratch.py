"""Allocation of the working memory of a model."""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats, Ints, Longs, Singles
from tissue_sim.model.contact.active_contact import MAX_ACTIVE, ActiveContact
from tissue_sim.model.contact.volume_limit import MAX_COMPRESSED, CompressedCell
from tissue_sim.model.data.blades import LIP_NODES, BladeRow
from tissue_sim.model.data.blocks import BLOCK, empty_blocks
from tissue_sim.model.data.contact_set import MAX_CONTACT_POINTS
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.records import Record, Records
from tissue_sim.model.data.scratch import MobilityKey, Plan, Scratch
from tissue_sim.model.elasticity.cells import CONSTANTS
from tissue_sim.model.regions.modal_region import MAX_BOUNDARY, MAX_DRIVE


def make_scratch(model: Model, n_bodies: int, n_samples: int = 0) -> Scratch:
    """Return the working memory for a model, with its tables for a local region when it has one.

    Parameters
    ----------
    model : Model
        Constants of the model.
    n_bodies : int
        Number of bodies.
    n_samples : int, optional
        Number of places of blades.
    """
    n, hinges, links = len(model.rest), len(model.edges.nodes) * BLOCK, len(model.links.nodes) * BLOCK
    modes = len(model.reduction.frequency)
    # Only a model with a local region needs memory for one.
    local = 0 if model.adjacency is None else n
    region_hinges, region_links = (hinges, links) if local else (0, 0)
    region_cells = 0 if not local or model.tissue is None else len(model.tissue.nodes) * BLOCK
    modal = modes > 0
    rows = 3 * MAX_BOUNDARY if modal else 0
    columns = 3 * MAX_DRIVE if modal and len(model.reduction.compliance) else 0

    def empty(*shape: int) -> Floats:
        return np.zeros(shape)

    def singles(*shape: int) -> Singles:
        return np.zeros(shape, dtype=np.float32)

    def ints(size: int) -> Ints:
        return np.zeros(size, dtype=np.int32)

    def longs(*size: int) -> Longs:
        return np.zeros(size, dtype=np.int64)

    def records(kind: type[Record], size: int) -> Records:
        return kind.rows(longs(size * kind.words()))

    return Scratch(
        plan=Plan.new(),
        force=empty(n, 3),
        impulse=empty(n_bodies, 6),
        slew_part=np.ones(n_bodies),
        mobility=empty(n),
        mass=empty(n),
        push=empty(3 * n),
        shrink=empty(3 * n),
        mobility_key=MobilityKey.new(),
        coarse=np.ones(n),
        mass_factor=np.ones(n),
        last_mass_factor=np.ones(n),
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
        active=records(ActiveContact, MAX_ACTIVE),
        work=empty(9 * BLOCK),
        blade_rows=records(BladeRow, n_samples),
        blade_stretch=empty(9),
        blade_back=empty(9),
        blade_way=empty(3),
        blade_at=empty(3),
        blade_weight=empty(LIP_NODES),
        compressed=records(CompressedCell, 0 if model.tissue is None else MAX_COMPRESSED),
        n_compressed=longs(1),
        candidates=longs(MAX_CONTACT_POINTS),
        candidate_gap=empty(MAX_CONTACT_POINTS),
        candidate_speed=empty(MAX_CONTACT_POINTS),
        n_candidates=longs(1),
        wall=longs(MAX_CONTACT_POINTS),
        wall_depth=empty(MAX_CONTACT_POINTS),
        wall_pose=empty(n_bodies, 7),
        wall_push=empty(n_bodies, 3),
        wall_arm=empty(n_bodies, 3),
        wall_before=empty(n_bodies, 6),
        n_walls=longs(1),
        walls_measured=longs(1),
        new_node=ints(local),
        previous_hop=longs(local),
        region_node=ints(local),
        moved_node=ints(local),
        n_moved=longs(1),
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
        drive_rows=singles(3 * MAX_DRIVE if modal else 0, modes),
        edge_rows=singles(columns + modes, rows),
        edge_load=singles(max(columns, 3 * MAX_DRIVE if modal else 0) + modes),
        edge_move=singles(rows),
        mode_sum=singles(modes),
        mode_rest=empty(modes),
        mode_move=empty(modes),
        propagator=empty(5, modes),
        propagator_key=empty(3),
        field=empty(3 * n if modal else 0),
    )
