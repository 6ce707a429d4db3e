"""A cut in a bag: the organ after it, so that a replay needs nothing that was computed on another machine."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Array, Longs
from tissue_sim.model.cutting.cut_cells import Sides, sides_of
from tissue_sim.model.cutting.cut_surface import CutSurface, without_idle_points
from tissue_sim.model.data.records import array_of
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ

NO_SET = -1  # no contact set was found on the new surface yet
NEVER = 2**62  # number of a contact set that no bag has


class RecordedCut(NamedTuple):
    """An organ after a cut, or after the reset of its cuts."""

    tick: int  # the first with it, -1 where the bag began later
    first_set: int  # number of the first contact set that was found on it
    organ: Organ
    origin: Longs  # (n,) node before whose place each node takes
    surface: CutSurface | None  # None without cuts
    sides: Sides | None  # None in bags without blades
    number: int  # how many organs were exchanged until this one


def organ_in(file: bytes) -> Organ:
    """Return the organ of the content of an organ file that a bag holds."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "organ.npz"
        path.write_bytes(file)
        return Organ.load(path)


def fields_of_cut(number: int, tick: int, made: Simulation, file: bytes) -> dict[str, Array]:
    """Return a cut as arrays by name.

    number: how many organs were exchanged until this one; tick: the first tick with it; made: the simulation after it;
    file: content of its organ's file.
    """
    fields: dict[str, Array] = {
        "number": np.array(number),
        "tick": np.array(tick),
        "first_set": np.array(NO_SET),
        "organ": np.frombuffer(file, dtype=np.uint8),
        "origin": np.asarray(made.origin),
        "settings": array_of(made.settings).copy(),
    }
    if made.cut_organ is not None:
        fields |= {f"surface.{name}": array for name, array in made.cut_organ.surface._asdict().items()}
        if len(made.shapes.blades.body):
            fields |= sides_of(made.cut_organ)._asdict()
    return fields


def recorded_cuts(messages: Sequence[Mapping[str, Array]]) -> list[RecordedCut]:
    """Return the cuts of an organ, in order.

    messages: fields of each message about them. Raises ValueError for a message that no node writes.
    """
    made: dict[int, RecordedCut] = {}
    sets: dict[int, int] = {}
    for fields in messages:
        number = _whole(fields, "number")
        if "organ" in fields:
            made[number] = _cut_of(fields)
        first = _whole(fields, "first_set")
        if first != NO_SET:
            sets[number] = first
    return [cut._replace(first_set=sets.get(number, NEVER)) for number, cut in sorted(made.items())]


def _cut_of(fields: Mapping[str, Array]) -> RecordedCut:
    names = CutSurface._fields
    surface = None
    given = [fields[f"surface.{name}"] for name in names if f"surface.{name}" in fields]
    if given:  # those of an uncut organ have none
        if len(given) != len(names):
            raise ValueError("its cut has a surface that lacks something")
        surface = CutSurface(*given)
        _check_surface(surface)
    file, origin = fields["organ"], fields.get("origin")
    if file.dtype != np.uint8 or origin is None or origin.dtype.kind != "i" or origin.ndim != 1:
        raise ValueError("its cut is of another type")
    organ = organ_in(file.tobytes())
    if surface is not None:  # bags of earlier versions have points that no triangle has
        surface = without_idle_points(surface, organ.n_surface)
    tick, number = _whole(fields, "tick"), _whole(fields, "number")
    return RecordedCut(tick, NEVER, organ, origin.astype(np.int64), surface, _sides_of(fields, organ), number)


def _sides_of(fields: Mapping[str, Array], organ: Organ) -> Sides | None:
    if "below" not in fields:
        return None
    below, above, is_cut = (fields.get(name, np.zeros(0)) for name in Sides._fields)
    if is_cut.shape != below.shape[:1] or is_cut.dtype.kind != "i":
        raise ValueError("its cut has sides of another type")
    for side in (below, above):
        if side.dtype.kind != "i" or side.ndim != 2 or side.shape != (len(below), 4):
            raise ValueError("its cut has sides of another type")
        if side.min(initial=0) < 0 or side.max(initial=0) >= organ.n_nodes:
            raise ValueError("its cut has sides without nodes")
    sides = Sides(*(side.astype(np.int64) for side in (below, above, is_cut)))
    if not _are_of_all_cells(sides, organ):
        raise ValueError("its cut has sides of other cells than its organ")
    return sides


def _are_of_all_cells(sides: Sides, organ: Organ) -> bool:
    """Return whether sides are those of the cells from which a cut organ was made: a blade is in one of these."""
    source = np.concatenate([np.arange(organ.n_uncut), organ.virtual_of]).astype(np.int64)
    cells, count = source[organ.cell_nodes], len(sides.below)
    # The first copies come in the order of the cells, and all others are of the same.
    own = all(np.array_equal(source[side], cells[:count]) for side in (sides.below, sides.above))
    return own and len(np.unique(cells, axis=0)) == count


def _check_surface(surface: CutSurface) -> None:
    points, count = len(surface.nodes), len(surface.triangles)
    shapes = [(points, 4), (points, 4), (count, 3), (count,), (points,), (points,)]
    kinds = "".join(array.dtype.kind for array in surface)
    if [array.shape for array in surface] != shapes or kinds != "ifiiii":
        raise ValueError("its cut has a surface of another type")
    if not np.isfinite(surface.weights).all() or surface.nodes.min(initial=0) < 0:
        raise ValueError("its cut has a surface that is not finite")
    for among in (surface.triangles, surface.partner):
        if among.min(initial=0) < 0 or among.max(initial=0) >= points:
            raise ValueError("its cut has triangles without points")


def _whole(fields: Mapping[str, Array], name: str) -> int:
    found = fields.get(name)
    if found is None or found.shape != () or found.dtype.kind != "i":
        raise ValueError(f"its cut has no {name}")
    return int(found)
