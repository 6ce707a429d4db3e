"""Plain NumPy twins of what kernels compute."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import shortest_path

from tissue_sim.model.elasticity.cell_law import COMPRESSED, STEEPEST
from tissue_sim.model.elasticity.cells import cells_of
from tissue_sim.model.elasticity.forces import SHORTEST
from tissue_sim.organ.organ import SpringKind


# energies, J; of complex positions too ---------------------------------------------------------
def length_of(vectors):
    # Not the norm: that takes magnitudes, which a complex step must pass through.
    return np.sqrt(np.sum(vectors * vectors, axis=1))


def spring_energy(x, model):
    length, rest = length_of(x[model.spring_second] - x[model.spring_first]), model.spring_rest_length
    stretch = length / rest
    faded = (SHORTEST - 1.0) ** 2 / 2.0 + (1.0 - 1.0 / SHORTEST) * (stretch**2 - SHORTEST**2) / 2.0
    stored = np.where(stretch.real < SHORTEST, faded, (stretch - 1.0) ** 2 / 2.0)
    return np.sum(model.spring_stiffness * rest**2 * stored)


def angular_energy(x, model):
    i, j, k, m = model.angular_nodes.T
    normal = np.cross(x[j] - x[i], x[k] - x[m])
    square = np.sum(normal * normal, axis=1)
    length = np.where(square.real > model.angular_least_area, np.sqrt(square), np.sqrt(model.angular_least_area))
    curved = np.einsum("hc,hcx->hx", model.angular_weight, x[model.angular_nodes])
    bent = np.einsum("hx,hx->h", curved, normal) / length
    return np.sum(0.5 * model.angular_stiffness * (bent - model.angular_rest) ** 2)


def return_energy(x, model):
    nodes = model.return_nodes
    return np.sum(0.5 * model.return_stiffness[nodes, None] * (x[nodes] - model.rest[nodes]) ** 2)


# forces, N -------------------------------------------------------------------------------------
def naive_springs(x, model):
    force = np.zeros_like(x)
    for s in range(len(model.spring_first)):
        i, j = model.spring_first[s], model.spring_second[s]
        arm = x[j] - x[i]
        length = max(np.linalg.norm(arm), SHORTEST * model.spring_rest_length[s])
        pull = model.spring_stiffness[s] * (length - model.spring_rest_length[s]) * arm / length
        force[i] += pull
        force[j] -= pull
    return force


def naive_angular(x, model):
    """Chain rule on k/2 (s - s0)^2, with the derivative of the unit normal as a 3x3 matrix; its length is bounded."""
    force = np.zeros_like(x)
    for h, nodes in enumerate(model.angular_nodes):
        i, j, k, m = nodes
        edge, across = x[j] - x[i], x[k] - x[m]
        long, least = np.cross(edge, across), np.sqrt(model.angular_least_area[h])
        collapsed = np.linalg.norm(long) <= least
        length = least if collapsed else np.linalg.norm(long)
        normal = long / length
        curved = model.angular_weight[h] @ x[nodes]
        push = -model.angular_stiffness[h] * (curved @ normal - model.angular_rest[h])
        slope = np.eye(3) if collapsed else np.eye(3) - np.outer(normal, normal)
        turning = slope @ curved / length
        for corner, node in enumerate(nodes):
            force[node] += push * model.angular_weight[h, corner] * normal
        for node, sign in ((i, -1.0), (j, 1.0)):
            force[node] += sign * push * np.cross(across, turning)
        for node, sign in ((k, 1.0), (m, -1.0)):
            force[node] += sign * push * np.cross(turning, edge)
    return force


def naive_returns(x, model):
    force = np.zeros_like(x)
    for node in model.return_nodes:
        force[node] = model.return_stiffness[node] * (model.rest[node] - x[node])
    return force


# the surface's graph ---------------------------------------------------------------------------
def hops_from(organ, sources):
    """Hops on the surface's edges from the nearest of some surface nodes, (n_surface,)."""
    edges = organ.spring_nodes[organ.spring_kind == SpringKind.EDGE]
    graph = coo_array((np.ones(len(edges)), edges.T), shape=(organ.n_surface, organ.n_surface))
    return shortest_path(graph.tocsr(), directed=False, unweighted=True, indices=sources).min(axis=0)


def naive_cells(x, model):
    """Forces of cells, N: the first Piola-Kirchhoff stress of each on its faces, one cell after the other."""
    force = np.zeros_like(x)
    cells, (mu, lam), penalty = cells_of(model.tissue)
    for c, nodes in enumerate(cells):
        rest = (model.rest[nodes[1:]] - model.rest[nodes[0]]).T
        gradient = (x[nodes[1:]] - x[nodes[0]]).T @ np.linalg.inv(rest)
        swollen = np.linalg.det(gradient)
        cofactor = np.stack([np.cross(gradient[(i + 1) % 3], gradient[(i + 2) % 3]) for i in range(3)])
        bounded = max(swollen, STEEPEST)
        pressure = 0.5 * lam[c] * (bounded - 1.0 / bounded) - mu[c] / bounded
        pressure += (swollen - bounded) * (0.5 * lam[c] + (0.5 * lam[c] + mu[c]) / STEEPEST**2)
        pressure += penalty[c] * min(swollen - COMPRESSED, 0.0)
        push = np.linalg.det(rest) / 6.0 * (mu[c] * gradient + pressure * cofactor) @ np.linalg.inv(rest).T
        force[nodes[1:]] -= push.T
        force[nodes[0]] += push.sum(axis=1)
    return force
