"""Finite elements that hold a cut, under nine loads, with and without contact of its lips; and the uncut organ.

Each load is settled on one mesh, and the difference of the linear answers of a finer one is added, as in
calibration.reference. The results of the kidney ship with the package, the others are kept in the user's cache.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim import progress
from tissue_sim.array_types import Floats, Longs
from tissue_sim.bench.cutting.cut_body import COARSE, FINE, SAMPLES, Answer, CutBody
from tissue_sim.bench.cutting.cuts import CUTS, OPENING, Cut, Loads, Place, loads_of, placed, scaled
from tissue_sim.bench.pinch_reference import fits
from tissue_sim.calibration.evaluation import errors
from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.reference import LEFT
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_file
from tissue_sim.result_cache import remembered

STORED = "config/references/cut.npz"  # of the kidney that ships
VERSION = 1  # of what is computed here
TOUCHES = 1e-4  # m by which lips would pass through each other, from which contact is taken into account
UNIT = 5e-7  # m, of displacements in the file
OPENED = 0.005  # m by which the lips are pulled apart in the middle
MOST_TRIES, CLOSE = 4, 0.03  # of finding the force for that, and relative distance from it

Table = dict[str, NDArray]


class Reference(NamedTuple):
    """Results of finite elements for one cut: c loads, n surface nodes, s places along the lips."""

    names: tuple[str, ...]
    force: Floats  # (c, n, 3) N
    uncut: Floats  # (c, n, 3) m, without the cut
    free: Floats  # (c, n, 3) m, with lips that pass through each other
    displacement: Floats  # (c, n, 3) m, with contact of the lips
    opening: Floats  # (c, s, 3) m, with contact
    closed: Floats  # (c,) m by which the lips would pass through each other
    left: Floats  # (c,) m by which they do with contact
    settled: NDArray[np.bool_]  # (c,)
    released: Floats  # (c,) J that the cut releases under the load, lips free
    off: Floats  # (c,) %, error of displacements that is left
    gap_off: Floats  # (c,) %, the same of openings
    opening_force: float  # N that opens the middle by OPENED; nan where none does
    nodes: Longs  # (2,) of both meshes

    @property
    def touch(self) -> NDArray[np.bool_]:
        """Under which loads (c,) the lips touch."""
        touch: NDArray[np.bool_] = self.closed > TOUCHES
        return touch


def key_of(organ: Organ, cut: Cut) -> str:
    """Return a digest of what the finite elements of a cut use."""
    return hashlib.sha256(repr((VERSION, fits(organ), tuple(cut))).encode()).hexdigest()


def reference_of(organ: Organ, cut: Cut, stored: Table | None) -> Reference:
    """Return the reference of a cut: that of the file, of the cache, or computed now in some minutes.

    stored: content of the file that ships. Raises UserError as CutBody does.
    """
    key = key_of(organ, cut)
    if stored is not None and f"{key}/force" in stored:
        return unpacked({name.split("/")[1]: array for name, array in stored.items() if name.startswith(key)})
    place = placed(organ, cut)
    return unpacked(remembered(f"cut-{cut.organ}", key, lambda: packed(computed(organ, cut, place))))


def stored_table() -> Table | None:
    """Return the content of the file that ships; None where it is missing."""
    path = shipped_file(STORED)
    if path is None:
        return None
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def remake(organ: Organ, path: Path, cuts: Sequence[Cut]) -> None:
    """Write references of an organ's cuts, computed now or kept in the user's cache, into a file.

    What the file has of other cuts of the organ stays. Raises UserError as reference_of does, and where the file can't
    be written.
    """
    known = {key_of(organ, cut) for cut in CUTS if cut not in cuts}
    table = {name: array for name, array in (stored_table() or {}).items() if name.split("/")[0] in known}
    for cut in cuts:
        found = packed(reference_of(organ, cut, None))
        table |= {f"{key_of(organ, cut)}/{name}": array for name, array in found.items()}
    try:
        np.savez_compressed(path, **table)  # type: ignore[arg-type]
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}") from None


def packed(found: Reference) -> dict[str, NDArray]:
    """Return a reference as small arrays."""
    table = {name: np.asarray(value) for name, value in found._asdict().items()}
    for name in ("uncut", "free", "displacement", "opening"):
        table[name] = np.rint(table[name] / UNIT).astype(np.int16)
    loaded = found.force.any(axis=(0, 2))
    table["force"] = found.force[:, loaded]
    table["loaded"] = np.packbits(loaded)
    # What has no contact is there once.
    table["displacement"] = table["displacement"][found.touch]
    return table


def unpacked(table: Mapping[str, NDArray]) -> Reference:
    """Return a reference from the arrays of packed."""
    fields = {name: value for name, value in table.items() if name != "loaded"}
    for name in ("uncut", "free", "displacement", "opening"):
        fields[name] = UNIT * fields[name].astype(np.float64)
    count, n = fields["free"].shape[:2]
    force = np.zeros((count, n, 3))
    force[:, np.unpackbits(table["loaded"], count=n).astype(bool)] = table["force"]
    displacement = fields["free"].copy()
    displacement[fields["closed"] > TOUCHES] = fields["displacement"]
    fields |= {"force": force, "displacement": displacement}
    fields["names"] = tuple(str(name) for name in table["names"])  # type: ignore[assignment]
    fields["opening_force"] = float(table["opening_force"])  # type: ignore[assignment]
    return Reference(**fields)  # type: ignore[arg-type]


# finite elements -----------------------------------------------------------------------------------


def computed(organ: Organ, cut: Cut, place: Place) -> Reference:
    """Compute the reference of a cut: some minutes. place: where it lies. Raises UserError as CutBody does."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1), progress.task(f"finite elements, {cut.name}"):
        body, loads = CutBody(organ, place.sheet), loads_of(organ, place)
        reach = [np.linalg.norm(one.displacement, axis=1).max() for one in body.linear(loads.force)]
        loads = scaled(organ, loads, np.array(reach))
        fine_body = CutBody(organ, place.sheet, FINE)
        coarse, fine = body.linear(loads.force), fine_body.linear(loads.force)
        nodes = np.array([body.n_nodes, fine_body.n_nodes])
        del fine_body
        free, touching, whole = _equilibria(body, loads)
        uncut, uncut_potential = _without_cut(organ, loads)
        better = _displacements(fine) - _displacements(coarse)
        wider = _openings(fine) - _openings(coarse)
        return Reference(
            names=loads.names,
            force=loads.force,
            uncut=uncut,
            free=_displacements(free) + better,
            displacement=_displacements(touching) + better,
            opening=_openings(touching) + wider,
            closed=np.array([one.closed for one in free]),
            left=np.array([one.closed for one in touching]),
            settled=np.array([one.settled and other.settled for one, other in zip(free, touching, strict=True)]),
            released=uncut_potential - whole,
            off=LEFT * 100.0 * errors(_displacements(coarse), _displacements(fine)),
            gap_off=LEFT * 100.0 * errors(_openings(coarse), _openings(fine)),
            opening_force=_opening_force(body, loads, coarse, fine),
            nodes=nodes,
        )


def _equilibria(body: CutBody, loads: Loads) -> tuple[list[Answer], list[Answer], Floats]:
    """Return the equilibria without and with contact of the lips, and the potential energy (c,) J of the former."""
    free, touching, potential = [], [], []
    settled = progress.steps(body.settle_many(loads.force), "equilibria", len(loads.force))
    for force, (answer, moved) in zip(loads.force, settled, strict=True):
        free.append(answer)
        touching.append(body.touching(force, moved) if answer.closed > TOUCHES else answer)
        potential.append(body.solid.energy(moved)[0] - float(np.vdot(body.loads(force), moved)))
    return free, touching, np.array(potential)


@lru_cache(maxsize=1)
def _uncut_bodies(organ: Organ) -> tuple[Body, Body]:
    """Return the uncut organ on meshes as fine as those with the cut; the cuts of an organ share them."""
    return Body(organ, grading=COARSE.grading), Body(organ, grading=FINE.grading)


def _without_cut(organ: Organ, loads: Loads) -> tuple[Floats, Floats]:
    """Return the uncut organ's displacements (c, n, 3) m, corrected by a finer mesh, and potential energy (c,) J."""
    body, finer = _uncut_bodies(organ)
    better = finer.settle_linear(loads.force) - body.settle_linear(loads.force)
    moved, potential = [], []
    settled = body.solid.settle_many([body.loads(one) for one in loads.force])
    for force, found in zip(loads.force, settled, strict=True):
        moved.append(found.displacement[: organ.n_surface])
        energy = body.solid.energy(found.displacement)[0]
        potential.append(energy - float(np.vdot(body.loads(force), found.displacement)))
    return np.array(moved) + better, np.array(potential)


def _opening_force(body: CutBody, loads: Loads, coarse: list[Answer], fine: list[Answer]) -> float:
    """Return the force, N on each lip, that opens the middle of a cut by OPENED; nan where none is found."""
    which = loads.names.index(OPENING)
    size = patch_force(loads.force[which])
    ratio = middle_opening(fine[which].opening) / middle_opening(coarse[which].opening)

    def opened_by(force: float) -> float | None:
        answer, _ = next(body.settle_many(loads.force[which : which + 1] * (force / size)))
        return middle_opening(answer.opening) * ratio if answer.settled else None

    return force_for(OPENED, size * OPENED / middle_opening(fine[which].opening), opened_by)


def patch_force(force: Floats) -> float:
    """Return the force, N, on each of the two patches of a load (n, 3) N."""
    return 0.5 * float(np.linalg.norm(force, axis=1).sum())


def middle_opening(opening: Floats) -> float:
    """Return the opening, m, in the middle of a cut, from that along it (SAMPLES, 3)."""
    return float(np.linalg.norm(opening[SAMPLES // 2]))


def force_for(wanted: float, guess: float, opened_by: Callable[[float], float | None]) -> float:
    """Return the force, N, at which a function of it takes a value; nan where it isn't found.

    wanted: the value; guess: where to begin, N; opened_by: the function, None where it has no value.
    """
    known = [(0.0, 0.0)]
    for _ in range(MOST_TRIES):
        value = opened_by(guess)
        if value is None:
            return float("nan")
        known.append((guess, value))
        if abs(value - wanted) < CLOSE * wanted:
            break
        (before, at_before), (last, at_last) = known[-2:]
        guess = last + (wanted - at_last) * (last - before) / (at_last - at_before)
    (before, at_before), (last, at_last) = known[-2:]
    return float(last + (wanted - at_last) * (last - before) / (at_last - at_before))


def _displacements(answers: list[Answer]) -> Floats:
    return np.array([one.displacement for one in answers])


def _openings(answers: list[Answer]) -> Floats:
    return np.array([one.opening for one in answers])
