"""Displacements of the finite-element body at any places of its surface, also between its own nodes."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csr_array

from tissue_sim.array_types import Floats
from tissue_sim.bench.sizes import Sized
from tissue_sim.calibration.fe_mesh import FeMesh
from tissue_sim.calibration.fem import Body
from tissue_sim.contact.triangles import nearest_among

AT_ONCE = 64  # loads solved together
STEPS = 60  # of Newton's method, at most
CLOSE = 1e-10  # of a facet
_MIDDLES = ((0, 1), (1, 2), (0, 2))  # corners whose midpoints are nodes


def answers(body: Body, size: Sized, forces: Floats) -> Floats:
    """Return linear displacements at the points of a size under the reference's forces, (c, n, 3) m.

    On a coarser surface, they are those that bring it closest to the reference's own points.

    forces (c, m, 3) N: the reference's forces.
    """
    finer = size.organ.n_surface > size.reference.n_surface
    if finer:
        carry = sampling(body.filling, size.organ.surface_positions)
    else:
        carry = csr_array(np.linalg.pinv(size.follow.toarray()))
    found = np.empty((len(forces), size.organ.n_surface, 3))
    for first in range(0, len(forces), AT_ONCE):
        loads = np.stack([body.loads(force) for force in forces[first : first + AT_ONCE]])
        for number, moved in enumerate(body.solid.solve(loads), first):
            found[number] = carry @ moved[: carry.shape[1]]
    return found


def sampling(filling: FeMesh, points: Floats) -> csr_array:
    """Return the values (p, n) at points (p, 3) m of the filled surface of values at the filling's nodes.

    A facet whose mid-edge nodes went to quarter points maps its coordinates to places quadratically, which Newton's
    method inverts.
    """
    corner = filling.nodes[filling.facets[:, :3]]
    facet, weight, _ = nearest_among(corner, points)
    nodes = filling.facets[facet]
    wanted = weight[:, 1:]
    place = np.zeros((len(points), 6, 2))  # of each node, in the facet's two barycentric coordinates
    place[:, 1, 0] = place[:, 2, 1] = 1.0
    for number, (a, b) in enumerate(_MIDDLES, 3):
        start, end = corner[facet, a], corner[facet, b]
        along = end - start
        fraction = np.sum((filling.nodes[nodes[:, number]] - start) * along, axis=1) / np.sum(along**2, axis=1)
        place[:, number] = place[:, a] + fraction[:, None] * (place[:, b] - place[:, a])
    at = wanted.copy()
    for _ in range(STEPS):
        values, slopes = _shapes(at)
        off = wanted - np.einsum("pa,pax->px", values, place)
        some = np.flatnonzero(np.abs(off).max(axis=1) > CLOSE)
        if not len(some):
            break
        at[some] += np.linalg.solve(np.einsum("par,pax->pxr", slopes[some], place[some]), off[some, :, None])[..., 0]
    values = _shapes(at)[0]
    rows = np.repeat(np.arange(len(points)), 6)
    return coo_array((values.ravel(), (rows, nodes.ravel())), shape=(len(points), len(filling.nodes))).tocsr()


def _shapes(at: Floats) -> tuple[Floats, Floats]:
    """Return the six quadratic functions (p, 6) of a facet at coordinates (p, 2), and their gradients (p, 6, 2)."""
    fraction = np.stack([1.0 - at.sum(axis=1), at[:, 0], at[:, 1]], axis=1)
    slope = np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]])
    values = [fraction[:, k] * (2.0 * fraction[:, k] - 1.0) for k in range(3)]
    slopes = [(4.0 * fraction[:, k, None] - 1.0) * slope[k] for k in range(3)]
    for a, b in _MIDDLES:
        values.append(4.0 * fraction[:, a] * fraction[:, b])
        slopes.append(4.0 * (fraction[:, a, None] * slope[b] + fraction[:, b, None] * slope[a]))
    return np.stack(values, axis=1), np.stack(slopes, axis=1)
