"""Report of a build: one self-contained HTML page with pictures and figures of every stage."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.organ.build_record import BuildRecord
from tissue_sim.organ.edges import directed_edges
from tissue_sim.organ.imaging.image import Volume
from tissue_sim.organ.organ import Organ, SpringKind
from tissue_sim.organ.reporting import pictures, slice_pictures
from tissue_sim.organ.reporting.description import describe, label, parts_of, shown
from tissue_sim.organ.reporting.exchange import bones
from tissue_sim.organ.surfaces.marching_cubes import MarchingCubesReport, marching_cubes_report, marching_cubes_surface
from tissue_sim.organ.surfaces.surface import SurfaceComparison, SurfaceQuality, Wall, compare, corner_angles, measure

if TYPE_CHECKING:
    from jinja2 import Template

Surface = tuple[Floats, NDArray[np.int32]]


@dataclass(frozen=True)
class Surfaces:
    """Both surfaces of a build in mm of the organ's frame, and their figures.

    Attributes
    ----------
    raw : MarchingCubesReport
        Marching cubes on the mask as segmented.
    smooth : MarchingCubesReport
        Marching cubes on the wall, the reference of `comparison`.
    """

    cubes: Surface
    organ: Surface
    raw: MarchingCubesReport
    smooth: MarchingCubesReport
    quality: SurfaceQuality
    comparison: SurfaceComparison


def write_report(record: BuildRecord, path: str | Path, organ_file: str = "") -> None:
    """Write the report of a finished build.

    Parameters
    ----------
    record : BuildRecord
        Results of the stages.
    path : str | Path
        The HTML file.
    organ_file : str, optional
        Name of the organ file, for the heading.

    Raises
    ------
    UserError
        Where the build isn't finished, or the file can't be written.
    """
    page = report_page(record, organ_file)
    try:
        Path(path).write_text(page, encoding="utf-8")
    except OSError as error:
        raise UserError(f"cannot write report {path}: {error.strerror}") from None


def report_page(record: BuildRecord, organ_file: str = "") -> str:
    """Return the page as HTML; every text from outside is escaped. Raises UserError for an unfinished build."""
    organ, wall, mask = record.organ, record.wall, record.mask
    if organ is None or wall is None or mask is None:
        raise UserError("the report needs a finished build")
    name = "balloon" if record.balloon is not None else "surface as given"
    surfaces = compared(organ, wall, mask)
    described = describe(organ)
    outlines = [("marching cubes", pictures.CUBES, surfaces.cubes), (name, pictures.BALLOON, surfaces.organ)]
    atoms = organ.atom_positions * 1e3
    deepest = atoms[int(np.argmax(organ.atom_radius))]
    source = slice_pictures.Source(record.ct, mask, record.frame == "LPS", record.seed)
    return _template().render(
        record=record,
        organ=organ,
        organ_file=organ_file,
        name=name,
        surfaces=surfaces,
        voxels=np.count_nonzero(mask.array),
        described=described,
        provenance=flat(organ.provenance),
        slices=slice_pictures.slices(source, outlines, atoms, deepest),
        shots=_shots(organ, surfaces),
        histograms=pictures.histograms([(*outline[:2], *_edges_and_angles(outline[2])) for outline in outlines]),
    )


def _template() -> Template:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    page = Environment(autoescape=True, undefined=StrictUndefined, loader=FileSystemLoader(Path(__file__).parent))
    page.filters |= {"label": label, "shown": shown, "base64": lambda png: base64.b64encode(png).decode()}
    return page.get_template("page.html.jinja")


def compared(organ: Organ, wall: Wall, mask: Volume) -> Surfaces:
    """Return marching cubes and the organ's surface, measured and compared as in the paper, in mm."""
    positions, triangles = marching_cubes_surface(wall)
    cubes = wall.to_patient(positions) * 1e3, wall.outward(triangles)
    surface = organ.surface_positions * 1e3, organ.surface_triangles
    raw, smooth = marching_cubes_report(mask), marching_cubes_report(wall)
    return Surfaces(cubes, surface, raw, smooth, measure(*surface), compare(cubes, surface))


def _shots(organ: Organ, surfaces: Surfaces) -> dict[str, pictures.Picture]:
    """Return the rendered pictures."""
    atoms, links = organ.atom_positions * 1e3, bones(organ)
    first, second = pictures.views(surfaces.organ[0])
    spokes = organ.spring_nodes[organ.spring_kind == SpringKind.SPOKE]
    return {
        "cubes": pictures.surface_picture(first, surfaces.cubes, cubes=True),
        "organ": pictures.surface_picture(first, surfaces.organ, cubes=False),
        "front": pictures.skeleton_picture(first, surfaces.organ, atoms, links),
        "side": pictures.skeleton_picture(second, surfaces.organ, atoms, links),
        "spokes": pictures.spokes_picture(first, organ.rest_positions * 1e3, organ.n_surface, atoms, links, spokes),
    }


def flat(nested: Mapping[str, object], before: str = "") -> list[tuple[str, str]]:
    """Return nested figures as rows of words and text."""
    rows: list[tuple[str, str]] = []
    for key, value in nested.items():
        words = f"{before}{label(str(key))}"
        parts = parts_of(value)
        if parts is not None:
            rows += flat(parts, f"{words}: ")
        else:
            rows.append((words, shown(value)))
    return rows


def _edges_and_angles(surface: Surface) -> tuple[Floats, Floats]:
    """Return the length of every edge, mm, and every angle, degrees."""
    positions, t = surface
    edges = np.unique(np.sort(directed_edges(t), axis=1), axis=0)
    length = np.linalg.norm(positions[edges[:, 0]] - positions[edges[:, 1]], axis=1)
    return length, np.rad2deg(corner_angles(positions, t)).ravel()
