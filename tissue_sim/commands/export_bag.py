"""`tissue_sim export` of a bag: frames of what it shows, for ParaView and Blender."""

from __future__ import annotations

from pathlib import Path

from tissue_sim.errors import UserError
from tissue_sim.interrupts import leaving
from tissue_sim.organ.reporting.exchange import UNITS
from tissue_sim.outputs import check_folder
from tissue_sim.ros.bags.frames import frames_of, write_glb, write_vtu
from tissue_sim.ros.bags.reading import read_bag

FORMATS = {".pvd": write_vtu, ".glb": write_glb}


def export_bag(bag: Path, out: Path, every: int, unit: str) -> None:
    """Write frames of a bag, and print what was written.

    bag: its folder; out: a .pvd or .glb file, which frames are named after; every: ticks from one frame to the next;
    unit: m or mm. Raises UserError for a bag that can't be replayed, and for files that can't be written.
    """
    write = FORMATS.get(out.suffix.lower())
    if write is None:
        raise UserError(f"{out}: no format for the frames of a bag; let its name end in {' or '.join(FORMATS)}")
    check_folder(out, out)
    if out.suffix.lower() == ".glb" and unit != "m":
        raise UserError(f"{out}: GLB is in metres; leave out --unit {unit}")
    if every < 1:
        raise UserError(f"--every {every} is less than 1 tick")
    with leaving("nothing was written"):
        frames = frames_of(read_bag(bag), every)
    try:
        with leaving("the frames so far are written"):
            written = write(out, frames, UNITS[unit])
    except OSError as error:
        raise UserError(f"cannot write {error.filename or out}: {error.strerror}") from None
    first, last = frames[0], frames[-1]
    files = f"{written[0]} to {written[-1].name}" if write is write_glb else f"{out}, and {len(written) - 1} files"
    print(f"{files}: {len(frames)} frames, every {every} ticks, {first.time:.3f} to {last.time:.3f} s, {unit}")
