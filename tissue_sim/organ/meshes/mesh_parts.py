"""Parts that a mesh falls into: finding them, choosing the organ among them, joining them into one solid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.mask_parts import DOMINANT
from tissue_sim.organ.meshes.mesh_file import Piece
from tissue_sim.organ.meshes.mesh_holes import Hole, capped_volume, fill, holes
from tissue_sim.organ.meshes.mesh_repair import (
    WIDEST_HOLE,
    close_seams,
    components,
    crowded_edges,
    longest_side,
    once_used_edges,
    without_doubles,
    wound_alike,
)
from tissue_sim.organ.winding import winding_number

_HOLLOW = 0.5  # of the outer surface's volume: an inner surface that takes more makes a shell
_SHOWN = 8  # parts named in a message


@dataclass(frozen=True, eq=False)
class Part:
    """One part of a mesh.

    Attributes
    ----------
    name : str
        Its name in the file, or an empty string.
    positions : Floats, shape (n, 3), m
        Points.
    triangles : Longs, shape (t, 3)
        Corner indices, consistently wound.
    gaps : tuple[Hole, ...]
        Its holes.
    volume : float
        Enclosed volume, m^3, its holes capped.
    flaw : str
        Why it can't be an organ even with its holes filled, or an empty string.
    repairs : tuple[str, ...]
        What was repaired, one line each.
    number : int
        Rank among the file's parts; 1 is the largest.
    """

    name: str
    positions: Floats
    triangles: Longs
    gaps: tuple[Hole, ...]
    volume: float
    flaw: str
    repairs: tuple[str, ...]
    number: int = 1


def split(pieces: Sequence[Piece], scale: float) -> list[Part]:
    """Return the parts of a file's pieces, largest volume first; open parts have coinciding points and seams closed.

    Pieces that meet in the same points (a surface cut into regions) are one part.

    Parameters
    ----------
    pieces : Sequence[Piece]
        Pieces of the file.
    scale : float
        Metres in the file's unit.

    Returns
    -------
    list[Part]
        The parts.
    """
    first = np.cumsum([0, *(len(piece.positions) for piece in pieces)])
    positions = np.concatenate([piece.positions for piece in pieces]) * scale
    triangles = np.concatenate([piece.triangles + n for piece, n in zip(pieces, first, strict=False)])
    owner = np.searchsorted(first, np.arange(len(positions)), side="right") - 1
    closed, repairs = close_seams(positions, triangles, across=True)
    if len(once_used_edges(closed)):  # the gaps between separate parts are not seams
        closed, repairs = close_seams(positions, triangles, across=False)
    closed, doubles = without_doubles(closed)
    if doubles:
        repairs = (*repairs, f"omitted {doubles} duplicate triangles")
    if not len(closed):
        return []
    unused = len(positions) - len(np.unique(closed))
    if unused and not repairs:
        repairs = (f"removed {unused} points that no triangle uses",)
    crowd = crowded_edges(closed)
    groups = components(closed)
    parts = []
    for group in groups:
        names = tuple(pieces[k].name for k in np.unique(owner[closed[group]]) if pieces[k].name)
        used, inverse = np.unique(closed[group], return_inverse=True)
        part = _part(names, positions[used], inverse.reshape(-1, 3).astype(np.int64), crowd, repairs)
        parts.append(part if len(groups) == 1 else _seamless(part))
    ordered = sorted(parts, key=lambda part: -part.volume)
    return [replace(part, number=k) for k, part in enumerate(ordered, 1)]


def _part(names: Sequence[str], positions: Floats, triangles: Longs, crowd: int, repairs: tuple[str, ...]) -> Part:
    name = names[0] + (f" and {len(names) - 1} more" if len(names) > 1 else "") if names else ""
    wound = wound_alike(positions, triangles)
    if wound is None:
        return Part(name, positions, triangles, (), 0.0, "can't be wound consistently (like a Moebius strip)", repairs)
    if wound is not triangles:
        repairs = (*repairs, "made the winding consistent")
    gaps = tuple(holes(positions, wound))
    own = crowded_edges(wound)
    crowd = own if own or not gaps else crowd
    flaw = f"has {crowd} edges with more than two triangles" if own or (crowd and gaps) else ""
    return Part(name, positions, wound, gaps, abs(capped_volume(positions, wound, gaps)), flaw, repairs)


def _seamless(part: Part) -> Part:
    """Return a part, one of several, with its own seams closed."""
    if not part.gaps or part.flaw:
        return part
    closed, repairs = close_seams(part.positions, part.triangles, across=True)
    if not repairs or not len(closed):
        return part
    again = wound_alike(part.positions, closed)
    if again is None or crowded_edges(again):
        return part
    used, inverse = np.unique(again, return_inverse=True)
    positions, triangles = part.positions[used], inverse.reshape(-1, 3).astype(np.int64)
    gaps = tuple(holes(positions, triangles))
    volume = abs(capped_volume(positions, triangles, gaps))
    return replace(
        part, positions=positions, triangles=triangles, gaps=gaps, volume=volume, repairs=(*part.repairs, *repairs)
    )


def choose(parts: Sequence[Part], name: str, wanted: int | str | None) -> Part:
    """Return the part that is the organ: the one of the given number or name, else the one that clearly dominates.

    Small parts beside it and cavities inside it are left out and reported in its repairs.

    Parameters
    ----------
    parts : Sequence[Part]
        The parts, largest first.
    name : str
        Name for messages.
    wanted : int | str | None
        Number or name of the part; None for the one that dominates.

    Raises
    ------
    UserError
        Where there is no such part, where none dominates, and for a hollow shell.
    """
    if isinstance(wanted, str) and wanted.isdigit():
        wanted = int(wanted)
    if isinstance(wanted, int):
        if not 1 <= wanted <= len(parts):
            raise UserError(f"surface {name} has no part {wanted}; it contains {_listed(parts)}")
        return parts[wanted - 1]
    if wanted is not None:
        named = [part for part in parts if part.name == wanted]
        if not named:
            raise UserError(f"surface {name} has no part '{wanted}'; it contains {_listed(parts)}")
        parts = named
    main, others = parts[0], parts[1:]
    if not others or main.flaw:
        return main
    within = [_inside(main, other) for other in others]
    cavities = [other for other, inner in zip(others, within, strict=True) if inner]
    beside = [other for other, inner in zip(others, within, strict=True) if not inner]
    aside = sum(other.volume for other in beside)
    if aside > (1.0 - DOMINANT) * (main.volume + aside):
        raise UserError(
            f"surface {name} has {len(parts)} separate parts: {_listed(parts)};"
            " choose one with --part N, or join them with --merge-parts"
        )
    empty = sum(other.volume for other in cavities)
    if empty > _HOLLOW * main.volume:
        raise UserError(
            f"surface {name} is a hollow shell: the cavity is {100.0 * empty / main.volume:.0f} % of its volume,"
            f" but an organ must be solid: give --part {main.number} to fill it"
        )
    repairs = list(main.repairs)
    if beside:
        repairs.append(f"omitted {_count(beside, 'separate part')} of {_volume(aside)} next to {_volume(main.volume)}")
    if cavities:
        repairs.append(f"filled {_count(cavities, 'cavity', 'cavities')} of {_volume(empty)}")
    return replace(main, repairs=tuple(repairs))


def _inside(outer: Part, other: Part) -> bool:
    few = other.positions[np.linspace(0, len(other.positions) - 1, 5).astype(int)]
    filled = fill(outer.positions, outer.triangles, outer.gaps) if outer.gaps else None
    triangles = outer.triangles if filled is None else filled
    return bool(np.all(np.abs(winding_number(few, outer.positions, triangles)) > 0.5))  # wound in either direction


def _volume(volume: float) -> str:
    return f"{volume * 1e6:.3g} mL"


def _count(parts: Sequence[Part], one: str, many: str = "") -> str:
    return f"{len(parts)} {one if len(parts) == 1 else many or one + 's'}"


def _listed(parts: Sequence[Part]) -> str:
    shown = [f"{part.number} {part.name + ' ' if part.name else ''}{_volume(part.volume)}" for part in parts]
    more = [f"{len(shown) - _SHOWN} smaller"] if len(shown) > _SHOWN else []
    return ", ".join(shown[:_SHOWN] + more)


def closed_part(part: Part, name: str) -> Part:
    """Return the part with its holes filled, up to a tenth of its longest side, without new points.

    Parameters
    ----------
    part : Part
        The part.
    name : str
        Name for messages.

    Returns
    -------
    Part
        The part without holes; the filling is reported in its repairs.

    Raises
    ------
    UserError
        Where it can't be repaired, or its widest hole is too wide.
    """
    if part.flaw:
        raise UserError(f"surface {name} {part.flaw}; make it a simple closed surface first")
    if not part.gaps:
        return part
    size = longest_side(part.positions)
    widest = part.gaps[0].width
    if widest > WIDEST_HOLE * size:
        raise UserError(
            f"surface {name} is open: {_holes(part)}, the widest {widest * 1e3:.3g} mm; holes up to a tenth of its"
            f" longest side ({WIDEST_HOLE * size * 1e3:.3g} mm) are filled, close wider ones first"
        )
    filled = fill(part.positions, part.triangles, part.gaps)
    if filled is None or len(once_used_edges(filled)) or crowded_edges(filled):
        raise UserError(f"surface {name} is open: {_holes(part)} with rims that touch themselves; close them first")
    repairs = f"filled {_holes(part)}, up to {widest * 1e3:.3g} mm wide"
    volume = abs(capped_volume(part.positions, filled, []))
    return replace(part, triangles=filled, gaps=(), volume=volume, repairs=(*part.repairs, repairs))


def _holes(part: Part) -> str:
    return f"{len(part.gaps)} hole{'s' if len(part.gaps) > 1 else ''}"
