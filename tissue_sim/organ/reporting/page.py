"""Report of a build: one self-contained HTML page with pictures and figures of every stage."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.organ.build_record import BuildRecord
from tissue_sim.organ.organ import Organ, SpringKind
from tissue_sim.organ.reporting import pictures
from tissue_sim.organ.reporting.description import describe, is_nested, label, shown
from tissue_sim.organ.reporting.exchange import bones
from tissue_sim.organ.surfaces.surface import (
    MarchingCubesReport,
    SurfaceComparison,
    SurfaceQuality,
    Wall,
    compare,
    corner_angles,
    marching_cubes_report,
    marching_cubes_surface,
    measure,
)

Surface = tuple[Floats, NDArray[np.int32]]

_STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", sans-serif; color: #1d2530;
  background: #fff; margin: 2.5rem auto; max-width: 62rem; padding: 0 1.25rem; }
h1 { font-size: 1.9rem; margin: 0 0 .2rem; } h2 { font-size: 1.25rem; margin: 2.6rem 0 .7rem; padding-bottom: .25rem;
  border-bottom: 1px solid #d7dce2; }
.lede { color: #55606e; margin: 0 0 1.2rem; }
.warning { background: #fff6dd; border-left: 4px solid #e0a100; padding: .55rem .9rem; margin: .6rem 0; }
.warning ul { margin: .2rem 0; padding-left: 1.2rem; }
figure { margin: 1rem 0; } figure img { max-width: 100%; height: auto; }
figcaption { color: #55606e; font-size: .87rem; margin-top: .35rem; }
.row { display: flex; flex-wrap: wrap; gap: 1.2rem; align-items: flex-end; justify-content: space-evenly; }
.row figure { flex: 0 1 auto; max-width: calc(94% / var(--n)); }
@media (max-width: 40rem) { .row figure { max-width: 100%; } }
table { border-collapse: collapse; margin: .8rem 0; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .28rem 1.1rem .28rem 0; border-bottom: 1px solid #e7eaee; vertical-align: top; }
th { font-weight: 600; } td.n, th.n { text-align: right; padding-left: .6rem; }
td.k { color: #55606e; white-space: nowrap; } td { overflow-wrap: anywhere; }
.columns { display: grid; grid-template-columns: repeat(auto-fit, minmax(19rem, 1fr)); gap: 0 2.5rem;
  align-items: start; }
.bar { display: inline-block; height: .6rem; background: #7f9cc0; }
footer { color: #77818d; font-size: .85rem; margin-top: 3rem; }
@media print { body { margin: 0; max-width: none; } figure, table { break-inside: avoid; } }
"""


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
    organ, wall = record.organ, record.wall
    if organ is None or wall is None or record.mask is None:
        raise UserError("the report needs a finished build")
    surfaces = compared(organ, wall, record)
    figures = describe(organ)
    total = sum(record.seconds.values())
    lede = (
        f"{organ.volume * 1e6:.1f} mL, {organ.n_surface} points, {len(organ.surface_triangles)} triangles,"
        f" {organ.n_atoms} medial atoms, built in {total:.1f} s"
        f" from {organ.provenance.get('source', record.mask.name or 'a mask')}"
    )
    parts = [
        f"<h1>{escape(organ.name)}</h1>",
        f'<p class="lede">{escape(lede)}{f"; {escape(organ_file)}" if organ_file else ""}</p>',
        _warnings(record),
        *_segmentation_part(record, organ, surfaces),
        *_surfaces_part(organ, surfaces, record),
        *_skeleton_part(organ, surfaces, figures),
        *_springs_part(figures),
        *_provenance_part(record, organ, figures),
    ]
    head = (
        '<meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(organ.name)}: build report</title>"
    )
    body = "\n".join(part for part in parts if part)
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head>{head}<style>{_STYLE}</style></head>\n<body>\n{body}\n</body></html>\n'
    )


def compared(organ: Organ, wall: Wall, record: BuildRecord) -> Surfaces:
    """Return marching cubes and the organ's surface, measured and compared as in the paper, in mm."""
    positions, triangles = marching_cubes_surface(wall)
    cubes = wall.to_patient(positions) * 1e3, wall.outward(triangles)
    surface = organ.surface_positions * 1e3, organ.surface_triangles
    smooth = marching_cubes_report(wall)
    raw = marching_cubes_report(record.mask) if record.mask is not None else smooth
    return Surfaces(cubes, surface, raw, smooth, measure(*surface), compare(cubes, surface))


# parts ---------------------------------------------------------------------------------------------


def _warnings(record: BuildRecord) -> str:
    if not record.warnings and not record.repairs:
        return ""
    lines = [f"<li>{escape(line)}</li>" for line in record.warnings]
    lines += [f"<li>repaired: {escape(line)}</li>" for line in record.repairs]
    return f'<div class="warning"><ul>{"".join(lines)}</ul></div>'


def _segmentation_part(record: BuildRecord, organ: Organ, surfaces: Surfaces) -> Iterable[str]:
    found = record.segmentation
    atoms = organ.atom_positions * 1e3
    balloon = "balloon" if record.balloon is not None else "surface as given"
    outlines = [
        ("marching cubes", pictures.CUBES, surfaces.cubes),
        (balloon, pictures.BALLOON, surfaces.organ),
    ]
    centre = atoms[int(np.argmax(organ.atom_radius))]
    source = pictures.Source(record.ct, record.mask, record.frame == "LPS", record.seed)
    png = pictures.slices(source, outlines, atoms, centre)
    yield f"<h2>{'Segmentation' if found else 'Outlines'}</h2>"
    note = "Slices through the organ's deepest atom."
    if record.ct is not None:
        note += " Window -160 to 240 HU; the patient's left is on the right of the axial and coronal slices."
    yield _figure(png, note)
    mask, wall = record.mask, record.wall
    rows: list[tuple[str, str]] = []
    if found is not None:
        figures = found.figures()
        rows += [
            ("volume", f"{found.volume:.1f} mL"),
            ("mean of the organ", f"{found.mean:.0f} HU, standard deviation {found.deviation:.1f} HU"),
            ("wall located at", f"{found.wall:.0f} HU"),
            ("eroded until separate", f"{found.erosion:.1f} mm"),
            ("reaches the image's border", shown(found.at_edge)),
        ]
        told = {"volume", "mean", "deviation", "wall", "erosion", "smoothing", "at_edge", "grid_mm", "warnings"}
        rows.insert(2, ("smoothed by", f"{found.smoothing:g} mm"))
        rows += [(label(key), shown(value)) for key, value in figures.items() if key not in told]
    if mask is not None:
        voxels = int(np.count_nonzero(mask.array))
        rows.append(("mask", f"{voxels} voxels of {shown([float(v) for v in mask.spacing])} mm"))
    if wall is not None:
        rows += [
            ("grid of the wall", f"{shown(wall.spacing)} mm"),
            ("separate fragments omitted", str(wall.fragments)),
            ("cavities and handles filled", f"{wall.filled:.2f} mL"),
            ("handles cut", f"{wall.cut:.2f} mL"),
        ]
    yield _pairs(rows)


def _surfaces_part(organ: Organ, surfaces: Surfaces, record: BuildRecord) -> Iterable[str]:
    name = "balloon" if record.balloon is not None else "surface as given"
    view, _ = pictures.views(surfaces.organ[0])
    left = pictures.surface_picture(view, surfaces.cubes, cubes=True)
    right = pictures.surface_picture(view, surfaces.organ, cubes=False)
    yield "<h2>The two surfaces</h2>"
    yield _row(
        _figure(
            left.png,
            f"Marching cubes on the smooth wall: {surfaces.smooth.points} points. Bar {left.bar:g} mm.",
            left.width,
        ),
        _figure(right.png, f"{name.capitalize()}: {organ.n_surface} points. Bar {right.bar:g} mm.", right.width),
    )
    yield _table(
        ["", "marching cubes on the mask", "marching cubes on the smooth wall", name],
        _comparison_rows(surfaces),
    )
    c = surfaces.comparison
    voxel = float(record.mask.spacing.min()) if record.mask is not None else 1.0
    yield _table(
        [f"{name} against marching cubes on the smooth wall", "mm", "voxels"],
        [
            ["largest distance (symmetric Hausdorff)", f"{c.hausdorff:.2f}", f"{c.hausdorff / voxel:.2f}"],
            ["mean distance", f"{c.mean:.3f}", f"{c.mean / voxel:.3f}"],
        ],
    )
    yield _pairs([("volume difference", f"{100.0 * (c.volume_ratio - 1.0):+.2f} %")])
    sets = [
        ("marching cubes", pictures.CUBES, *_edges_and_angles(surfaces.cubes)),
        (name, pictures.BALLOON, *_edges_and_angles(surfaces.organ)),
    ]
    yield _figure(pictures.histograms(sets), "Edge lengths and angles of both surfaces.")


def _comparison_rows(surfaces: Surfaces) -> list[list[str]]:
    raw, smooth, organ = surfaces.raw, surfaces.smooth, surfaces.quality
    qualities = (raw.quality, smooth.quality, organ)
    reports = (raw, smooth)
    points, triangles = len(surfaces.organ[0]), len(surfaces.organ[1])
    rows: list[list[str]] = [
        ["points", *(str(r.points) for r in reports), str(points)],
        ["triangles", *(str(r.triangles) for r in reports), str(triangles)],
        ["fragments outside", *(str(r.islands) for r in reports), "0"],
        ["cavities inside", *(str(r.hollows) for r in reports), "0"],
        ["handles", *(str(r.handles) for r in reports), str(1 - organ.euler // 2)],
    ]
    for words, value in (
        ("mean edge (mm)", lambda q: f"{q.edge_mean:.2f}"),
        ("edge variation", lambda q: f"{q.edge_variation:.3f}"),
        ("smallest angle (degrees)", lambda q: f"{q.least_angle:.1f}"),
        ("self-intersections", lambda q: str(q.self_intersections)),
        ("volume (mL)", lambda q: f"{q.volume * 1e-3:.2f}"),
    ):
        rows.append([words, *(value(quality) for quality in qualities)])
    return rows


def _skeleton_part(organ: Organ, surfaces: Surfaces, figures: Mapping[str, Any]) -> Iterable[str]:
    atoms, links = organ.atom_positions * 1e3, bones(organ)
    first, second = pictures.views(surfaces.organ[0])
    spokes = organ.spring_nodes[organ.spring_kind == SpringKind.SPOKE]
    spoken = "Skeleton and spokes." if organ.n_interior == 0 else "Skeleton, interior atoms, spokes."
    shots = [
        (pictures.skeleton_picture(first, surfaces.organ, atoms, links), "The skeleton inside the surface."),
        (pictures.skeleton_picture(second, surfaces.organ, atoms, links), "From another direction."),
        (pictures.spokes_picture(first, organ.rest_positions * 1e3, organ.n_surface, atoms, links, spokes), spoken),
    ]
    yield "<h2>The skeleton</h2>"
    yield _row(*(_figure(shot.png, f"{words} Bar {shot.bar:g} mm.", shot.width) for shot, words in shots))
    yield _pairs([(label(key), shown(value)) for key, value in figures["skeleton"].items()])


def _springs_part(figures: Mapping[str, Any]) -> Iterable[str]:
    yield "<h2>Springs and masses</h2>"
    rows = []
    for kind, found in figures["springs"].items():
        length = found.get("rest_length_mm")
        rows.append(
            [kind, str(found["count"]), shown(found["stiffness_n_per_m"]), shown(length) if length is not None else "-"]
        )
    yield _table(["springs", "count", "stiffness (N/m)", "rest length (mm)"], rows)
    tissue = [(label(key), shown(value)) for key, value in figures["tissue"].items()]
    masses = [(f"mass, {label(key)} (g)", shown(value)) for key, value in figures["mass_g"].items()]
    sizes = [
        ("extent (mm)", shown(figures["extent_mm"])),
        ("fixed points", str(figures["surface"]["held_points"])),
        ("interior points", str(figures["interior_points"])),
    ]
    yield f'<div class="columns">{_pairs(masses)}{_pairs([*tissue, *sizes])}</div>'


def _provenance_part(record: BuildRecord, organ: Organ, figures: Mapping[str, Any]) -> Iterable[str]:
    yield "<h2>Time</h2>"
    longest = max(record.seconds.values(), default=1.0) or 1.0
    rows = [
        f'<tr><td class="k">{escape(stage)}</td><td class="n">{seconds:.2f} s</td>'
        f'<td><span class="bar" style="width:{12.0 * seconds / longest:.2f}rem"></span></td></tr>'
        for stage, seconds in record.seconds.items()
    ]
    total = sum(record.seconds.values())
    rows.append(f'<tr><td class="k">together</td><td class="n">{total:.2f} s</td><td></td></tr>')
    yield f"<table>{''.join(rows)}</table>"
    yield "<h2>Messages</h2>"
    yield f"<ul>{''.join(f'<li>{escape(line)}</li>' for line in record.lines)}</ul>"
    yield "<h2>Provenance</h2>"
    yield _pairs(
        [
            *flat(organ.provenance),
            ("schema version", str(figures["schema_version"])),
            ("units of the file", str(figures["units"])),
            ("digest (SHA-256 of its arrays)", str(figures["digest"])),
        ]
    )


def flat(nested: Mapping[str, Any], before: str = "") -> list[tuple[str, str]]:
    """Return nested figures as rows of words and text."""
    rows: list[tuple[str, str]] = []
    for key, value in nested.items():
        words = f"{before}{label(str(key))}"
        if is_nested(value):
            inner = value.items() if isinstance(value, Mapping) else enumerate(value, start=1)
            rows += flat({str(name): item for name, item in inner}, f"{words}: ")
        else:
            rows.append((words, shown(value)))
    return rows


def _edges_and_angles(surface: Surface) -> tuple[Floats, Floats]:
    """Return the length of every edge, mm, and every angle, degrees."""
    positions, t = surface
    edges = np.unique(np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1), axis=0)
    length = np.linalg.norm(positions[edges[:, 0]] - positions[edges[:, 1]], axis=1)
    return length, np.rad2deg(corner_angles(positions, t)).ravel()


# HTML ----------------------------------------------------------------------------------------------


def _figure(png: bytes, caption: str, width: int | None = None) -> str:
    data = base64.b64encode(png).decode()
    size = f' width="{width}"' if width else ""
    text = escape(caption)
    return (
        f'<figure><img{size} alt="{text}" src="data:image/png;base64,{data}"><figcaption>{text}</figcaption></figure>'
    )


def _row(*figures: str) -> str:
    return f'<div class="row" style="--n: {len(figures)}">{"".join(figures)}</div>'


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return an HTML table whose first column holds words, the others figures."""
    top = "".join(f"<th{' class="n"' if k else ''}>{escape(text)}</th>" for k, text in enumerate(head))
    body = "".join(
        "<tr>" + "".join(f'<td class="{"n" if k else "k"}">{escape(text)}</td>' for k, text in enumerate(row)) + "</tr>"
        for row in rows
    )
    return f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


def _pairs(rows: Iterable[tuple[str, str]]) -> str:
    body = "".join(f'<tr><td class="k">{escape(key)}</td><td>{escape(text)}</td></tr>' for key, text in rows)
    return f"<table><tbody>{body}</tbody></table>"
