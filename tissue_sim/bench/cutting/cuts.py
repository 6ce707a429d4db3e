"""The cuts of `tissue_sim bench cut --accuracy`, and nine loads on each.

None is among those by which the model's advance of the front was chosen.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats, Longs
from tissue_sim.calibration.cases import Surface, surface_of, tractions
from tissue_sim.directions import across
from tissue_sim.errors import UserError
from tissue_sim.model.cutting.sheet import Sheet, sheet_of
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.surfaces.line_hits import line_hits
from tissue_sim.organ.surfaces.sizing import mean_edge

PATCH = 19  # nodes under a load
BESIDE, FAR = 1.4, 3.8  # mean edges from the cut to the middle of a patch at a lip, and of one away from it
CLEAR = 2.0  # mean edges from the clamp to the middle of a patch far away
MOST_FORCE = 1.1  # of Young's modulus times the square of the mean edge: 0.2 N on the kidney
MOST_REACH = 0.008  # m, largest displacement of the linear body
MOST_TRACTION = 0.4  # of Young's modulus
GENTLE = 0.3  # of all that: lips that are pressed together, which without contact pass far through each other
SHIFTS, SHIFT = 61, 0.35  # places beside the wanted one, within so many mean edges, of which the clearest is taken
CLOSE = 1e-4  # m from a sheet, where its side is determined
SPACING = 0.5  # mean edges between two points of a polyline


class Cut(NamedTuple):
    """A cut of an organ.

    Attributes
    ----------
    organ : str
        Which organ.
    shape : str
        flat, curved or L.
    length : float
        Its length along the surface, m.
    depth : float
        Its depth, m.
    from_ : tuple[float, float, float]
        Direction from the organ's middle in which its own middle lies on the surface.
    turn : float
        Angle of its direction on the surface, degrees.
    """

    organ: str
    shape: str
    length: float
    depth: float
    from_: tuple[float, float, float]
    turn: float = 0.0

    @property
    def name(self) -> str:
        """Its name in tables."""
        return f"{self.organ}, {self.shape} {1e3 * self.length:.0f} x {1e3 * self.depth:.0f}"


CUTS = (
    Cut("kidney", "flat", 0.028, 0.010, (-0.5, -1.0, 0.9), 25.0),
    Cut("kidney", "flat", 0.020, 0.005, (0.35, -1.0, 0.6), 70.0),
    Cut("kidney", "flat", 0.030, 0.020, (0.15, -1.0, -1.0), 160.0),
    Cut("kidney", "curved", 0.032, 0.012, (0.1, -1.0, 0.1), 100.0),
    Cut("kidney", "curved", 0.024, 0.009, (-1.0, -0.2, -0.9), 20.0),
    Cut("kidney", "L", 0.030, 0.012, (0.2, -0.5, 1.3), 0.0),
    Cut("kidney", "curved", 0.030, 0.010, (-0.8, -0.5, 0.5), 45.0),  # along a rim, with a thin lip
    Cut("kidney", "curved", 0.028, 0.012, (-0.08, -0.21, -0.97), 112.0),  # across a pole, up to its rim
    Cut("slab", "flat", 0.030, 0.012, (0.1, 0.1, 1.0), 30.0),
    Cut("slab", "L", 0.036, 0.010, (-0.1, 0.05, 1.0), 75.0),
    Cut("liver", "flat", 0.045, 0.020, (0.0, 0.0, 1.0), 0.0),
    Cut("liver", "curved", 0.060, 0.020, (0.3, 0.0, 1.0), 60.0),
)


class Place(NamedTuple):
    """Position and axes of a cut."""

    middle: Floats  # (3,) m, on the surface
    along: Floats  # (3,) unit vectors: along it,
    into: Floats  # (3,) into the organ
    across: Floats  # (3,) to the sheet's positive side
    sheet: Sheet


def placed(organ: Organ, cut: Cut) -> Place:
    """Return where a cut lies: its polyline follows the surface, as far from surface nodes as it can be there.

    Raises UserError where it leaves the organ.
    """
    surface = surface_of(organ)
    middle = organ.surface_positions.mean(axis=0)
    direction = np.asarray(cut.from_) / np.linalg.norm(cut.from_)
    on = _struck(organ, middle[None], direction)[0]
    near = np.argsort(np.linalg.norm(surface.positions - on, axis=1))[:PATCH]
    into = -surface.normal[near].mean(axis=0)
    into /= np.linalg.norm(into)
    first, second = across(into)
    turn = np.radians(cut.turn)
    along = np.cos(turn) * first + np.sin(turn) * second
    edge = mean_edge(organ.surface_positions, organ.surface_triangles)
    axes = np.stack([along, np.cross(into, along)])
    best: tuple[float, Place] | None = None
    for shift in np.linspace(-SHIFT * edge, SHIFT * edge, SHIFTS):
        flat = _line(cut, SPACING * edge) + [0.0, shift]
        polyline = _struck(organ, on + flat @ axes, -into)
        sheet = sheet_of(organ, polyline, into, cut.depth)
        clear = _clearance(organ, sheet)
        if best is None or clear > best[0]:
            start = polyline[len(polyline) // 2]
            best = clear, Place(start, along, into, _across(sheet, start, along), sheet)
    assert best is not None
    return best[1]


def _line(cut: Cut, spacing: float) -> Floats:
    """Return a cut's polyline (k, 2) m in the plane: straight, an arc of 100 degrees, or two lines at a right angle."""
    count = int(np.ceil(0.5 * cut.length / spacing))
    run = np.linspace(-0.5 * cut.length, 0.5 * cut.length, 2 * count + 1)
    if cut.shape == "flat":
        return np.stack([run, np.zeros_like(run)], axis=1)
    if cut.shape == "curved":
        radius = cut.length / np.radians(100.0)
        return radius * np.stack([np.sin(run / radius), 1.0 - np.cos(run / radius)], axis=1)
    if cut.shape == "L":
        slant = np.sqrt(0.5)
        return np.stack([slant * run, slant * np.abs(run)], axis=1)
    raise UserError(f"a cut has no shape '{cut.shape}': flat, curved or L")


def _struck(organ: Organ, points: Floats, direction: Floats) -> Floats:
    """Return where lines (k,) through points along a direction leave the surface last, (k, 3) m."""
    where = line_hits(organ, points, direction)
    if np.isnan(where).all(axis=1).any():
        raise UserError(f"a cut leaves organ '{organ.name}'")
    far = np.nanmax(where, axis=1)
    return np.asarray(points + far[:, None] * direction)


def _clearance(organ: Organ, sheet: Sheet) -> float:
    """Return how near, m, the sheet comes to a surface node that it may pass."""
    place = sheet.place(organ.surface_positions)
    near = sheet.covers(place, 0.5 * sheet.depth)
    return float(np.abs(place.across[near]).min(initial=np.inf))


def _across(sheet: Sheet, middle: Floats, along: Floats) -> Floats:
    """Return the unit vector across a cut in its middle, which halves the angle of an L, to the positive side."""
    direction = np.cross(sheet.direction, along)
    return np.asarray(direction * np.sign(sheet.place((middle + CLOSE * direction)[None]).across[0]))


class Loads(NamedTuple):
    """Loads on a cut organ. c loads."""

    names: tuple[str, ...]
    force: Floats  # (c, n_surface, 3) N


OPENING, CLOSING = "both lips apart", "both lips together"


def loads_of(organ: Organ, place: Place) -> Loads:
    """Return nine loads of 1 N on each patch: at the lips, beside the cut, and far from it."""
    surface = surface_of(organ)
    edge = mean_edge(organ.surface_positions, organ.surface_triangles)
    _, along, into, across, sheet = place
    plus, minus = (_patch(surface, sheet, place.middle + side * BESIDE * edge * across, side) for side in (1.0, -1.0))
    beside = _patch(surface, sheet, place.middle - FAR * edge * across, -1.0)
    ends = [_end(surface, place.middle, along), _end(surface, place.middle, -along)]
    made = {
        "one lip away": ((plus, across),),
        OPENING: ((plus, across), (minus, -across)),
        "one lip along the cut": ((plus, along),),
        "one lip out": ((plus, -into),),
        "one lip in": ((plus, into),),
        CLOSING: ((plus, -across), (minus, across)),
        "press beside the cut": ((beside, -_facing(surface, beside)),),
        "press far away": ((ends[0], -_facing(surface, ends[0])),),
        "pull sideways far away": ((ends[1], across),),
    }
    force = np.zeros((len(made), organ.n_surface, 3))
    for load, parts in zip(force, made.values(), strict=True):
        for nodes, direction in parts:
            load[nodes] += (surface.area[nodes] / surface.area[nodes].sum())[:, None] * direction
    return Loads(tuple(made), force)


def scaled(organ: Organ, loads: Loads, reach: Floats) -> Loads:
    """Return loads as large as they are applied.

    loads: loads of 1 N on a patch; reach (c,) m: the largest displacement of the cut linear body under each.
    """
    edge = mean_edge(organ.surface_positions, organ.surface_triangles)
    most = np.minimum(MOST_REACH / reach, MOST_TRACTION * organ.youngs_modulus / tractions(loads.force, organ))
    factor = np.minimum(most, MOST_FORCE * organ.youngs_modulus * edge**2)
    factor = factor * np.where([name == CLOSING for name in loads.names], GENTLE, 1.0)
    return loads._replace(force=loads.force * factor[:, None, None])


def _patch(surface: Surface, sheet: Sheet, middle: Floats, side: float) -> Longs:
    """Return the free nodes nearest to a point, on one side of the sheet and facing as the nearest does."""
    good = surface.free & (side * sheet.place(surface.positions).across > 0.0)
    apart = np.linalg.norm(surface.positions - middle, axis=1)
    nearest = np.flatnonzero(good)[np.argmin(apart[good])]
    good &= surface.normal @ surface.normal[nearest] > 0.0
    nodes = np.flatnonzero(good)
    return nodes[np.argsort(apart[nodes], kind="stable")[:PATCH]]


def _end(surface: Surface, middle: Floats, direction: Floats) -> Longs:
    """Return the free nodes around the one that is farthest from the cut in a direction, and not at the clamp."""
    held = surface.positions[~surface.free]
    clear = cKDTree(held).query(surface.positions)[0] > CLEAR * surface.edge if len(held) else surface.free
    ahead = np.where(clear, (surface.positions - middle) @ direction, -np.inf)
    node = int(np.argmax(ahead))
    good = np.flatnonzero(surface.free & (surface.normal @ surface.normal[node] > 0.0))
    apart = np.linalg.norm(surface.positions[good] - surface.positions[node], axis=1)
    return good[np.argsort(apart, kind="stable")[:PATCH]]


def _facing(surface: Surface, nodes: Longs) -> Floats:
    """Return the mean normal of nodes, of length 1."""
    normal = surface.normal[nodes].mean(axis=0)
    return np.asarray(normal / np.linalg.norm(normal))
