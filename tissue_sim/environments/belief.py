"""Where an organ of known shape may lie, by what a finger felt: a particle filter for many agents at once."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.stats import qmc

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.environments.steering import turned_about_z
from tissue_sim.organ.surfaces.surface_distance import distance_to_surface
from tissue_sim.organ.winding import inside

PARTICLES = 512  # of each agent, a power of two as Sobol's sequence has it
SPACING, MARGIN = 0.003, 0.03  # m, of the grid of distances, and how far it reaches beyond the organ
NOISE = 0.001  # m by which a distance is off where the shape and the compliance are known
ANGLE = 0.35  # rad by which a force is turned from the normal of the surface at rest
TOUCH = 0.02  # N, from which on a force has a direction
JITTER = 0.15  # of the spread, by which particles that are drawn again differ
FEWEST = 0.5  # fraction of effective particles below which all are drawn again


class Shape:
    """Signed distances from an organ's surface at rest, and their directions, on a grid.

    Parameters
    ----------
    surface : Floats, shape (n, 3), m
        Its points.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    """

    def __init__(self, surface: Floats, triangles: Ints) -> None:
        self._low = surface.min(axis=0) - MARGIN
        axes = [
            np.arange(low, high + SPACING, SPACING)
            for low, high in zip(self._low, surface.max(axis=0) + MARGIN, strict=True)
        ]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        signed = distance_to_surface(points, surface, triangles)
        signed[inside(points, surface, triangles)] *= -1.0
        grid = signed.reshape([len(axis) for axis in axes])
        self._grids = [grid, *np.gradient(grid, SPACING)]

    def distance(self, points: Floats) -> Floats:
        """Return how far points (..., 3) in m lie outside, (...) m; negative inside."""
        return self._at(0, points)

    def outward(self, points: Floats) -> Floats:
        """Return the directions (..., 3) in which the distance of points (..., 3) grows fastest."""
        found = np.stack([self._at(axis, points) for axis in (1, 2, 3)], axis=-1)
        return np.asarray(found / np.maximum(np.linalg.norm(found, axis=-1, keepdims=True), 1e-9))

    def _at(self, which: int, points: Floats) -> Floats:
        where = np.moveaxis((points - self._low) / SPACING, -1, 0)
        return np.asarray(map_coordinates(self._grids[which], where, order=1, mode="nearest"))


def shape_of(surface: Floats, triangles: Ints) -> Shape:
    """Return the Shape of a surface (n, 3) m with triangles (t, 3), computed once: it takes seconds.

    Parameters
    ----------
    surface : Floats, shape (n, 3), m
        Its points.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    """
    return _shape_of(surface.astype(np.float64).tobytes(), triangles.astype(np.int32).tobytes())


@lru_cache(maxsize=2)
def _shape_of(surface: bytes, triangles: bytes) -> Shape:
    return Shape(np.frombuffer(surface).reshape(-1, 3), np.frombuffer(triangles, dtype=np.int32).reshape(-1, 3))


class Belief:
    """Guesses (n, p) of how an organ lies for n agents: shifts, turns about z, and how likely each is.

    All agents begin with the same guesses and are jittered by the same numbers, so that an agent alone does what it
    does among others.

    Parameters
    ----------
    shape : Shape
        The organ.
    count : int
        Number of agents.
    shift, turn : float
        By how many m along each axis and rad the organ may be moved.
    """

    def __init__(self, shape: Shape, count: int, shift: float, turn: float) -> None:
        self._shape = shape
        guesses = 2.0 * qmc.Sobol(4, seed=1).random(PARTICLES) - 1.0
        self._first = guesses * np.array([shift, shift, shift, turn])
        self._jitter = JITTER * np.random.default_rng(1).normal(size=(16, PARTICLES, 4))
        self.guesses = np.tile(self._first, (count, 1, 1))
        self.weights = np.full((count, PARTICLES), 1.0 / PARTICLES)
        self._times = np.zeros(count, dtype=np.int64)  # that particles were drawn again

    def forget(self, agents: Longs) -> None:
        """Begin again for some agents."""
        self.guesses[agents], self.weights[agents], self._times[agents] = self._first, 1.0 / PARTICLES, 0

    def take(self, tips: Floats, forces: Floats, radius: float, compliance: Floats) -> None:
        """Weigh the guesses by what fingers feel.

        Parameters
        ----------
        tips : Floats, shape (n, 3), m
            Middles of the fingers.
        forces : Floats, shape (n, 3), N
            What the hands feel.
        radius : float, m
            Of the fingers.
        compliance : Floats, shape (n,), m/N
            By how much the tissue gives way.
        """
        there = self._to_organ(tips[:, None])
        gaps = self._shape.distance(there) - radius
        size = np.linalg.norm(forces, axis=1)
        depth = (compliance * size)[:, None]
        is_touching = (size > TOUCH)[:, None]
        # In the air, only what would be inside the tissue is unlikely.
        off = np.where(is_touching, gaps + depth, np.minimum(gaps + NOISE, 0.0)) / (NOISE + 0.5 * depth)
        normals = self.to_world(self._shape.outward(there))
        cosine = np.einsum("npx,nx->np", normals, forces / np.maximum(size, TOUCH)[:, None])
        turned = np.where(is_touching, np.arccos(np.clip(cosine, -1.0, 1.0)) / ANGLE, 0.0)
        # Poses of one path follow each other closely: each counts for a part, or the first ones would decide all.
        weights = self.weights * np.exp(-0.25 * np.minimum(0.5 * (off**2 + turned**2), 50.0))
        self.weights = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-300)
        few = np.flatnonzero(1.0 / np.maximum((self.weights**2).sum(axis=1), 1e-300) < FEWEST * PARTICLES)
        for agent in few:
            self._draw_again(int(agent))

    def _draw_again(self, agent: int) -> None:
        """Draw the particles of an agent by their weights, spread a little (Gordon et al. 1993)."""
        weights = self.weights[agent]
        total = np.cumsum(weights)
        chosen = np.searchsorted(total, (np.arange(PARTICLES) + 0.5) / PARTICLES * total[-1])
        guesses = self.guesses[agent, np.minimum(chosen, PARTICLES - 1)]
        spread = np.maximum(guesses.std(axis=0), [2e-4, 2e-4, 2e-4, 5e-3])
        self.guesses[agent] = guesses + spread * self._jitter[self._times[agent] % len(self._jitter)]
        self.weights[agent] = 1.0 / PARTICLES
        self._times[agent] += 1

    def where(self, point: Floats) -> tuple[Floats, Floats]:
        """Return where a point (3,) of the organ lies in the mean (n, 3) m, and how far guesses differ (n,) m."""
        points = self._to_world_points(point)
        mean = np.einsum("np,npx->nx", self.weights, points)
        apart = ((points - mean[:, None]) ** 2).sum(axis=2)
        return mean, np.sqrt(np.einsum("np,np->n", self.weights, apart))

    def outward(self, tips: Floats) -> Floats:
        """Return the normals (n, 3) of the surface near points (n, 3), in the mean of the guesses."""
        normals = self.to_world(self._shape.outward(self._to_organ(tips[:, None])))
        mean = np.einsum("np,npx->nx", self.weights, normals)
        return np.asarray(mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-9))

    def to_world(self, vectors: Floats) -> Floats:
        """Return vectors (n, p, 3) of the organ's frame in the agents' frames."""
        return turned_about_z(vectors, self.guesses[..., 3])

    def _to_world_points(self, point: Floats) -> Floats:
        return self.to_world(np.broadcast_to(point, (*self.guesses.shape[:2], 3))) + self.guesses[..., :3]

    def _to_organ(self, points: Floats) -> Floats:
        return turned_about_z(points - self.guesses[..., :3], -self.guesses[..., 3])
