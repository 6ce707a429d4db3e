"""Report of an identification: one self-contained HTML page with curves, residuals, the map, and all figures."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.figures import empty_figure, hide_box, png
from tissue_sim.identification.identify import Identified, lines_of, provenance_of
from tissue_sim.identification.measured import LEAST_FORCE
from tissue_sim.identification.stiffness_map import interpolated
from tissue_sim.organ.reporting.page import flat
from tissue_sim.organ.reporting.render import Solid, draw, view_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap


SHOWN = 12  # presses whose curves are drawn, from the softest to the stiffest
MEASURED, MODEL, QUIET = "#2166ac", "#d55e00", "#999999"
COLOURS, BANDS, SIDE = "viridis", 12, 560


def write_report(found: Identified, path: Path) -> None:
    """Write the report of an identification.

    Parameters
    ----------
    found : Identified
        The result.
    path : Path
        The HTML file.

    Raises
    ------
    UserError
        Without matplotlib or jinja2, and where the file can't be written.
    """
    try:
        page = report_page(found)
        path.write_text(page, encoding="utf-8")
    except ModuleNotFoundError as error:
        raise UserError(f"--report needs {error.name}: pip install 'tissue_sim[image]'") from None
    except OSError as error:
        raise UserError(f"cannot write report {path}: {error.strerror}") from None


def report_page(found: Identified) -> str:
    """Return the page as HTML; every text from outside is escaped."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    page = Environment(autoescape=True, undefined=StrictUndefined, loader=FileSystemLoader(Path(__file__).parent))
    page.filters |= {"base64": lambda png: base64.b64encode(png).decode()}
    places, caption = _places(found)
    return page.get_template("report.html.jinja").render(
        name=found.source.name,
        source=found.measurement.source,
        presses=len(found.measurement.presses),
        radius=f"{1e3 * found.measurement.radius:g}",
        lines=lines_of(found),
        curves=_curves(found),
        held_out=_held_out(found),
        residuals=_residuals(found),
        places=places,
        places_caption=caption,
        provenance=flat(provenance_of(found)),
    )


def _bare(axis: Axes, across: str, up: str) -> None:
    axis.set_xlabel(across)
    axis.set_ylabel(up)
    hide_box(axis)


def _curves(found: Identified) -> bytes:
    """Return a picture of measured and simulated forces of some presses."""
    order = np.argsort(found.fit.own[:, 0])
    chosen = order[np.unique(np.linspace(0, len(order) - 1, SHOWN).astype(np.int64))]
    across = min(4, len(chosen))
    down = -(-len(chosen) // across)
    figure = empty_figure(2.7 * across, 2.2 * down)
    samples = found.samples
    predicted = found.fit.predicted(found.curves, samples, found.fit.own)
    for number, row in enumerate(chosen):
        axis = figure.add_subplot(down, across, number + 1)
        known = samples.counts[row] > 0.0
        deep = 1e3 * samples.depths[row][known]
        axis.plot(deep, samples.forces[row][known], ".", color=MEASURED)
        axis.plot(deep, predicted[row][known], color=MODEL)
        axis.set_title(found.measurement.presses[row].name, fontsize=9, loc="left")
        _bare(axis, "depth (mm)", "force (N)")
    return png(figure, 110)


def _held_out(found: Identified) -> bytes | None:
    """Return a picture of predicted against measured forces at held-out places; None without any."""
    if found.held_out is None:
        return None
    judged = found.samples.judged & np.isfinite(found.held_out.predicted)
    measured, predicted = found.samples.forces[judged], found.held_out.predicted[judged]
    figure = empty_figure(5.0, 4.2)
    axis = figure.add_subplot()
    axis.plot(measured, predicted, ".", color=MEASURED, markersize=3)
    most = float(max(measured.max(initial=0.0), predicted.max(initial=0.0)))
    axis.plot([0.0, most], [0.0, most], color=QUIET, linewidth=0.8)
    _bare(axis, "measured force (N)", "predicted force (N)")
    return png(figure, 110)


def _residuals(found: Identified) -> bytes:
    """Return a picture of residuals against depth."""
    samples, seen = found.samples, found.diagnosis
    predicted = found.fit.predicted(found.curves, samples, found.fit.own)
    off = 100.0 * (samples.forces - predicted) / np.maximum(np.abs(predicted), LEAST_FORCE)
    known = samples.counts > 0.0
    figure = empty_figure(7.0, 3.4)
    axis = figure.add_subplot()
    axis.plot(1e3 * samples.depths[known], off[known], ".", color=QUIET, markersize=2)
    axis.plot(1e3 * seen.depths, 100.0 * seen.residuals, "o-", color=MODEL)
    axis.axhline(0.0, color="#000000", linewidth=0.6)
    axis.set_ylim(-60.0, 60.0)
    _bare(axis, "depth (mm)", "measured less fitted (%)")
    return png(figure, 110)


def _places(found: Identified) -> tuple[bytes, str]:
    """Return a picture of the modulus over the organ or over places, and its caption."""
    modulus = 1e-3 * found.modulus * np.exp(found.fit.own[:, 0])
    points = found.measurement.points
    if found.measurement.is_registered:
        return _on_organ(found, points, modulus), (
            "Young's modulus (kPa) of each press, on the surface around it; grey where nothing was pressed."
            + (" The organ file holds this map." if found.of_cells is not None else " The organ file has one modulus.")
        )
    figure = empty_figure(6.0, 4.2)
    axis = figure.add_subplot()
    if np.isfinite(points).all():
        centred = points - points.mean(axis=0)
        across, up = 1e3 * np.linalg.svd(centred, full_matrices=False)[2][:2] @ centred.T
        shown = axis.scatter(across, up, c=modulus, cmap=COLOURS, s=14, vmin=_low(modulus), vmax=_high(modulus))
        figure.colorbar(shown, label="Young's modulus (kPa)")
        axis.set_aspect("equal")
        _bare(axis, "mm", "mm")
        return png(figure, 110), "Young's modulus of each press, at its place in the recording's axes."
    axis.hist(modulus, bins=min(20, len(modulus)), color=MEASURED)
    _bare(axis, "Young's modulus (kPa)", "presses")
    return png(figure, 110), "Young's modulus of each press."


def _low(values: Floats) -> float:
    return float(np.quantile(values, 0.02))


def _high(values: Floats) -> float:
    return float(max(np.quantile(values, 0.98), _low(values) * 1.02))


def _on_organ(found: Identified, points: Floats, modulus: Floats) -> bytes:
    """Return a picture of the organ from the side of the presses, coloured by the modulus around them."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from scipy.spatial import cKDTree

    rest, triangles = found.source.surface_positions, found.source.surface_triangles
    middle = rest[triangles].mean(axis=1)
    radius = found.measurement.radius
    near = cKDTree(points).query(middle)[0] < 2.0 * radius
    norm = Normalize(_low(modulus), _high(modulus))
    value = norm(interpolated(points, modulus, middle, radius))
    band = np.where(near, np.clip((np.asarray(value) * BANDS).astype(np.int64), 0, BANDS - 1), -1)
    towards = points.mean(axis=0) - rest.mean(axis=0)
    upright = abs(towards[2]) < 0.9 * float(np.linalg.norm(towards))
    view = view_of(rest, towards, (0.0, 0.0, 1.0) if upright else (0.0, 1.0, 0.0), (SIDE, SIDE), 0.08)
    skins = [
        Solid(rest, triangles[band == one], _colour(int(one), colormaps[COLOURS]), lines=0.6) for one in np.unique(band)
    ]
    figure = empty_figure(6.0, 4.8)
    axis = figure.add_subplot()
    axis.imshow(draw(view, skins))
    axis.set_axis_off()
    figure.colorbar(ScalarMappable(norm, COLOURS), ax=axis, shrink=0.8, label="Young's modulus (kPa)")
    return png(figure, 110)


def _colour(band: int, colours: Colormap) -> tuple[float, float, float]:
    if band < 0:
        return 0.8, 0.8, 0.8
    red, green, blue, _ = colours((band + 0.5) / BANDS)
    return red, green, blue
