"""The local region (section 4 of the paper): nodes within two layers of the load move by their springs.

In the paper's own kind the rest stays as it is; in modal_region it follows the organ's modes.
"""

from __future__ import annotations

from typing import Any

from tissue_sim.jit import kernel
from tissue_sim.model.forces import angular_forces, return_forces, spring_forces
from tissue_sim.model.state import (
    ENGAGED,
    ENTRIES,
    LOADED,
    REGION_BOUNDARY,
    REGION_HINGES,
    REGION_NODES,
    REGION_SPRINGS,
)

HOPS = 2  # the "second layer"; every spring counts as one hop


@kernel
def mark_loaded(model: Any, state: Any) -> bool:
    """Give hop 0 to the nodes of contact points, tool tips and nodal forces; True if any is new."""
    grown = False
    hop = state.region_hop
    for entry in range(state.count[ENTRIES]):
        if state.tool_count[state.contact_tool[entry], ENGAGED] == 1:
            for c in range(3):
                node = state.contact_node[entry, c]
                if hop[node] != 0:
                    hop[node], grown = 0, True
    for tool in range(len(state.tool_force)):
        if state.tip_node[tool, 0] >= 0:
            for c in range(3):
                node = state.tip_node[tool, c]
                if hop[node] != 0:
                    hop[node], grown = 0, True
    if state.count[LOADED] == 1:
        force = state.nodal_force
        for node in range(len(hop)):
            if force[node, 0] != 0.0 or force[node, 1] != 0.0 or force[node, 2] != 0.0:
                if hop[node] != 0:
                    hop[node], grown = 0, True
    return grown


@kernel
def spread(model: Any, state: Any) -> None:
    """Hop distances on the surface edges from the loaded nodes, up to HOPS: from the table, or breadth first."""
    hop = state.region_hop
    if len(model.hops) > 0:
        for node in range(model.n_surface):
            if hop[node] == 0:
                for other in range(model.n_surface):
                    there = model.hops[node, other]
                    if there <= HOPS and (hop[other] < 0 or hop[other] > there):
                        hop[other] = there
        return
    for layer in range(HOPS):
        for node in range(model.n_surface):
            if hop[node] == layer:
                for index in range(model.neighbour_start[node], model.neighbour_start[node + 1]):
                    other = model.neighbours[index]
                    if hop[other] < 0 or hop[other] > layer + 1:
                        hop[other] = layer + 1


@kernel
def collect(model: Any, state: Any, scratch: Any) -> None:
    """List the nodes, springs and hinges that the region's nodes need."""
    hop = state.region_hop
    nodes = 0
    for index in range(len(model.moving)):
        node = model.moving[index]
        if hop[node] >= 0:
            scratch.region_node[nodes] = node
            nodes += 1
    springs = 0
    for s in range(len(model.spring_first)):
        if hop[model.spring_first[s]] >= 0 or hop[model.spring_second[s]] >= 0:
            scratch.region_first[springs] = model.spring_first[s]
            scratch.region_second[springs] = model.spring_second[s]
            scratch.region_rest_length[springs] = model.spring_rest_length[s]
            scratch.region_stiffness[springs] = model.spring_stiffness[s]
            springs += 1
    hinges = 0
    for h in range(len(model.angular_nodes)):
        near = False
        for c in range(4):
            near = near or hop[model.angular_nodes[h, c]] >= 0
        if near:
            for c in range(4):
                scratch.region_angular_nodes[hinges, c] = model.angular_nodes[h, c]
                scratch.region_angular_weight[hinges, c] = model.angular_weight[h, c]
            scratch.region_angular_rest[hinges] = model.angular_rest[h]
            scratch.region_angular_stiffness[hinges] = model.angular_stiffness[h]
            scratch.region_angular_least_area[hinges] = model.angular_least_area[h]
            hinges += 1
    # The edge: nodes outside that the region's springs and hinges look at.
    scratch.mark[:] = 0
    for s in range(springs):
        scratch.mark[scratch.region_first[s]] = 1
        scratch.mark[scratch.region_second[s]] = 1
    for h in range(hinges):
        for c in range(4):
            scratch.mark[scratch.region_angular_nodes[h, c]] = 1
    boundary = 0
    for index in range(len(model.moving)):
        node = model.moving[index]
        if scratch.mark[node] == 1 and hop[node] < 0:
            scratch.boundary_node[boundary] = node
            boundary += 1
    state.count[REGION_BOUNDARY] = boundary
    state.count[REGION_NODES] = nodes
    state.count[REGION_SPRINGS] = springs
    state.count[REGION_HINGES] = hinges


@kernel
def elastic_forces(model: Any, state: Any, scratch: Any) -> None:
    """Add the forces of the region's springs to scratch.force (n, 3) N."""
    nodes, springs, hinges = state.count[REGION_NODES], state.count[REGION_SPRINGS], state.count[REGION_HINGES]
    spring_forces(
        state.position,
        scratch.region_first[:springs],
        scratch.region_second[:springs],
        scratch.region_rest_length[:springs],
        scratch.region_stiffness[:springs],
        scratch.force,
    )
    angular_forces(
        state.position,
        scratch.region_angular_nodes[:hinges],
        scratch.region_angular_weight[:hinges],
        scratch.region_angular_rest[:hinges],
        scratch.region_angular_stiffness[:hinges],
        scratch.region_angular_least_area[:hinges],
        scratch.force,
    )
    return_forces(
        state.position, model.return_target, scratch.region_node[:nodes], model.return_stiffness, scratch.force
    )
