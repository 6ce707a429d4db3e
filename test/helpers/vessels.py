"""Phantoms of tubes: analytic middles, radii along them, trees of vessels, and their masks on any grid."""

from dataclasses import dataclass

import numpy as np

from tissue_sim.organ.imaging.image import Volume


@dataclass(frozen=True)
class Tube:
    """A round tube along points (n, 3) mm of radius (n,) mm; its ends are round."""

    points: np.ndarray
    radius: np.ndarray

    @property
    def arc(self):
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.points, axis=0), axis=1))])


def tube(points, radius, end_radius=None):
    """Tube along points whose radius changes evenly from radius to end_radius."""
    points = np.asarray(points, dtype=float)
    arc = Tube(points, np.zeros(len(points))).arc
    last = radius if end_radius is None else end_radius
    return Tube(points, radius + (last - radius) * arc / arc[-1])


def level(tubes, axes, widen=None):
    """Distance-like level (nz, ny, nx) of the tubes' union on a grid, 9 mm and more where it's far: negative inside.

    axes: coordinates x, y, z of the grid, mm; widen(x, y, z): mm added to the radius near the wall.
    """
    found = np.full([len(a) for a in axes[::-1]], 9.0)
    for one in tubes:
        for a, b, r, s in zip(one.points[:-1], one.points[1:], one.radius[:-1], one.radius[1:], strict=True):
            reach, along = max(r, s) + 9.0, b - a
            ends = zip(axes, np.minimum(a, b) - reach, np.maximum(a, b) + reach, strict=True)
            box = tuple(slice(*np.searchsorted(axis, (low, high))) for axis, low, high in ends)[::-1]
            z, y, x = (
                axis[part].reshape([-1 if k == n else 1 for k in range(3)])
                for n, (axis, part) in enumerate(zip(axes[::-1], box, strict=True))
            )
            t = np.clip(((x - a[0]) * along[0] + (y - a[1]) * along[1] + (z - a[2]) * along[2]) / (along @ along), 0, 1)
            away = (x - a[0] - t * along[0]) ** 2 + (y - a[1] - t * along[1]) ** 2 + (z - a[2] - t * along[2]) ** 2
            found[box] = np.minimum(found[box], np.sqrt(away) - (r + t * (s - r)))
    if widen is not None:
        near = np.nonzero(np.abs(found) < 6.0)
        found[near] -= widen(*(axis[k] for axis, k in zip(axes, near[::-1], strict=True)))
    return found


def mask_of(tubes, spacing=(1.0, 1.0, 1.0), shift=(0.0, 0.0, 0.0), widen=None):
    """Mask of the tubes' union on a grid of `spacing` mm that holds it; shift: of the grid, voxels."""
    step = np.asarray(spacing, dtype=float)
    reach = max(float(t.radius.max()) for t in tubes) + 4.0
    low = np.min([t.points.min(axis=0) for t in tubes], axis=0) - reach
    high = np.max([t.points.max(axis=0) for t in tubes], axis=0) + reach
    origin = low + np.asarray(shift) * step
    axes = [origin[k] + step[k] * np.arange(int((high[k] - low[k]) / step[k]) + 2) for k in range(3)]
    return Volume(level(tubes, axes, widen) < 0.0, step, origin, np.eye(3), "tubes")


def dense(one, step=0.05):
    """Points (n, 3) every `step` mm along the tube's middle."""
    arc = one.arc
    t = np.arange(0.0, arc[-1], step)
    return np.stack([np.interp(t, arc, one.points[:, k]) for k in range(3)], axis=1)


def bumps(amplitude, scale, seed):
    """Noise of the wall: a smooth random field, mm; amplitude is its standard deviation, scale its wavelength, mm."""
    rng = np.random.default_rng(seed)
    waves = rng.normal(size=(40, 3))
    waves *= 2.0 * np.pi / scale / np.linalg.norm(waves, axis=1, keepdims=True)
    phase = rng.uniform(0.0, 2.0 * np.pi, 40)

    def widen(x, y, z):
        total = np.zeros(x.shape)
        for w, p in zip(waves, phase, strict=True):
            total += np.cos(w[0] * x + w[1] * y + w[2] * z + p)
        return amplitude * total * np.sqrt(2.0 / 40.0)

    return widen


# Analytic tubes -------------------------------------------------------------------------------------


def straight(radius=7.0, length=60.0, direction=(0.0, 0.0, 1.0), end_radius=None):
    d = np.asarray(direction, dtype=float)
    return tube(np.linspace(-0.5, 0.5, 61)[:, None] * length * d / np.linalg.norm(d), radius, end_radius)


def quarter_torus(bend=40.0, radius=8.0):
    a = np.linspace(0.0, np.pi / 2, 91)
    return tube(np.stack([bend * np.cos(a), bend * np.sin(a), 0 * a], axis=1), radius)


def s_bend(bend=24.0, radius=7.0):
    a = np.linspace(np.pi, 0.0, 91)
    first = np.stack([bend * np.cos(a), bend * np.sin(a), 0 * a], axis=1)
    b = np.linspace(np.pi, 2 * np.pi, 91)[1:]
    return tube(
        np.concatenate([first, np.stack([2 * bend + bend * np.cos(b), bend * np.sin(b), 0 * b], axis=1)]), radius
    )


def helix(bend=25.0, rise=40.0, turns=1.5, radius=6.0):
    a = np.linspace(0.0, 2 * np.pi * turns, 181)
    return tube(np.stack([bend * np.cos(a), bend * np.sin(a), rise * a / (2 * np.pi)], axis=1), radius)


# Trees ----------------------------------------------------------------------------------------------


def y_tube(radius=7.0, arm_radius=6.0, angle=35.0, length=55.0):
    """A stem along -z and two arms, each `angle` degrees off +z: 3 branches."""
    a = np.deg2rad(angle)
    return [
        tube([[0, 0, -length], [0, 0, 0]], radius),
        tube([[0, 0, 0], [length * np.sin(a), 0, length * np.cos(a)]], arm_radius),
        tube([[0, 0, 0], [-length * np.sin(a), 0, length * np.cos(a)]], arm_radius),
    ]


def vessel_tree():
    """A trunk that forks into two, each of which forks again, out of plane and tapered: 7 branches.

    Radii at a fork follow Murray's law (the cubes of the daughters' radii make up the mother's).
    """
    root, fork = np.zeros(3), np.array([0.0, 0.0, 50.0])
    left, right = fork + [-36.0, 4.0, 30.0], fork + [30.0, -6.0, 42.0]
    ends = [
        left + [-34.0, 22.0, 14.0],
        left + [-8.0, -22.0, 38.0],
        right + [36.0, 14.0, 16.0],
        right + [-2.0, -26.0, 36.0],
    ]
    links = [
        (root, fork, 8.0, 7.6),
        (fork, left, 6.4, 5.9),
        (fork, right, 5.6, 5.2),
        (left, ends[0], 4.9, 4.2),
        (left, ends[1], 4.4, 3.8),
        (right, ends[2], 4.3, 3.7),
        (right, ends[3], 3.9, 3.4),
    ]
    tubes = []
    for k, (a, b, r, s) in enumerate(links):
        t = np.linspace(0.0, 1.0, 31)[:, None]
        side = np.cross(b - a, [0.3, 1.0, 0.2 * k])
        side *= 4.0 / np.linalg.norm(side)
        tubes.append(tube(a + t * (b - a) + np.sin(np.pi * t) * side, r, s))
    return tubes


def trunk_with_sides():
    """A trunk with three thin branches off its side, two of them slanted: 7 branches."""
    trunk = tube([[0, 0, -70.0], [0, 0, 70.0]], 9.0)
    roots = [np.array([0, 0, -35.0]), np.array([0, 0, 0.0]), np.array([0, 0, 35.0])]
    ways = [np.array([1.0, 0.0, 0.0]), np.array([-0.75, 0.35, 0.55]), np.array([0.3, 0.75, 0.6])]
    sides = [tube(np.stack([p, p + w / np.linalg.norm(w) * 43.0]), 4.0) for p, w in zip(roots, ways, strict=True)]
    return [trunk, *sides]
