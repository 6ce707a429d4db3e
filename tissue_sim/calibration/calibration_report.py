"""Presentation of a calibration's result: lines of text, and pictures of held-out errors, worst cases and release."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Pixels
from tissue_sim.calibration.calibrate import Calibrated
from tissue_sim.calibration.evaluation import errors
from tissue_sim.errors import UserError
from tissue_sim.figures import empty_figure, hide_box
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.reporting.render import Solid, View, draw, view_of

if TYPE_CHECKING:
    from matplotlib.colors import BoundaryNorm
    from matplotlib.figure import Figure


WORST = 4  # cases with pictures
_REFERENCE, _MODEL, _LINEAR = "#2166ac", "#d55e00", "#777777"
_SKIN, _LOADED = (0.62, 0.72, 0.86), (0.90, 0.60, 0.42)
_SIDE = 420  # pixels
_ERRORS, _COLOURS, _BANDS = "viridis", 256, 8  # colour map of errors, its colours, and how many are used


def lines(figures: JsonObject) -> Iterator[str]:
    """Yield the figures as lines of text.

    Parameters
    ----------
    figures : JsonObject
        Figures of a calibration.

    Yields
    ------
    Iterator[str]
        One line.
    """
    reference, fitted, motion = figures["reference"], figures["fit"], figures["motion"]
    if "error" in reference:
        yield reference["error"]
    yield f"fitted: {fitted['mean_percent']:.2f} % mean, {fitted['worst_percent']:.2f} % worst (linear)"
    if "stiffening_of_cells" in fitted:
        yield f"the cells' b is {fitted['stiffening_of_cells']:.2f} times the tissue's"
    for name, found in figures["held_out"].items():
        volume, least = found["volume_change_percent"], found["least_volume"]
        yield (
            f"held out, {name}: {found['mean_percent']:.2f} % mean, {found['worst_percent']:.2f} % worst,"
            f" {found['rms_mm']:.3f} mm RMS; {found['settled']} of {found['cases']} converged, up to"
            f" {found['deepest_mm']:.1f} mm; linear elasticity {found['linear_elasticity_mean_percent']:.2f} % mean;"
            f" volume {volume['model'][1]:+.3f} % (reference {volume['reference'][1]:+.3f} %), smallest local volume"
            f" ratio {least['model']:.2f} (reference {least['reference']:.2f})"
        )
    if reference["unsettled"]:
        yield f"excluded: {reference['unsettled']} held-out loads under which the reference does not converge"
    for name in reference["near_buckling"]:
        yield f"excluded, near buckling: {name}"
    ours, theirs = motion["frequencies_hz"], motion["reference_hz"]
    yield (
        f"lowest modes {', '.join(f'{f:.2f}' for f in ours[:4])} Hz (reference"
        f" {', '.join(f'{f:.2f}' for f in theirs[:4])} Hz), damping {motion['damping_rate_per_s']:.1f} 1/s, error of"
        f" the release {motion['release_percent']:.1f} % over 1 s"
    )
    step = figures["step"]
    yield f"critical step {step['critical_us']:.0f} us, {step['substeps_a_ms']} substeps per millisecond"


def write_pictures(found: Calibrated, folder: Path) -> list[Path]:
    """Write errors.png, worst.png and release.png.

    Parameters
    ----------
    found : Calibrated
        The result of a calibration.
    folder : Path
        Where they are written.

    Returns
    -------
    list[Path]
        Their paths.

    Raises
    ------
    UserError
        Without matplotlib, and where the folder can't be written.
    """
    figures = {"errors.png": _errors, "worst.png": _worst, "release.png": _release}
    paths = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, draw_figure in figures.items():
            paths.append(folder / name)
            draw_figure(found).savefig(paths[-1], dpi=130)
    except ModuleNotFoundError as error:
        raise UserError(f"--report needs {error.name}: pip install 'tissue_sim[calibration]'") from None
    except OSError as error:
        raise UserError(f"cannot write to {folder}: {error.strerror}") from None
    return paths


def _errors(found: Calibrated) -> Figure:
    """Return a figure of the error of every held-out case, the best first, beside that of linear elasticity."""
    figure = empty_figure(8.0, 4.2)
    axis = figure.subplots()
    error = 100.0 * errors(found.found.displacement, found.wanted.displacement)
    by_linear = 100.0 * errors(found.linear, found.wanted.displacement)
    order = np.argsort(error)
    sharp = np.array([found.cases.kind[case] == "sharp" for case in order])
    place = np.arange(len(order))
    axis.plot(place, by_linear[order], "o", color=_LINEAR, markersize=4, label="linear elasticity")
    axis.plot(place[~sharp], error[order][~sharp], "o", color=_MODEL, label="model, smooth loads")
    axis.plot(place[sharp], error[order][sharp], "^", color=_REFERENCE, label="model, sharp loads")
    lost = found.found.converged[order] == 0.0
    if lost.any():
        axis.plot(place[lost], error[order][lost], "kx", markersize=10, label="not converged")
    axis.set_xlabel("held-out load, the best first")
    axis.set_ylabel("relative L2 error (%)")
    axis.set_ylim(bottom=0.0)
    axis.legend(frameon=False)
    hide_box(axis)
    return figure


def _release(found: Calibrated) -> Figure:
    """Return a figure of the poked node's distance from rest after the release."""
    figure = empty_figure(7.0, 3.8)
    axis = figure.subplots()
    motion = found.release
    both = ((motion.wanted, "finite elements", _REFERENCE, "-"), (motion.found, "model", _MODEL, "--"))
    for history, label, colour, style in both:
        along = history @ (motion.wanted[0] / np.linalg.norm(motion.wanted[0]))
        axis.plot(motion.time, 1e3 * along, style, color=colour, label=label)
    axis.set_xlabel("time after the release (s)")
    axis.set_ylabel("displacement of the poked node (mm)")
    axis.set_title(f"error {100.0 * motion.error:.1f} % (relative L2)", loc="left")
    axis.legend(frameon=False)
    hide_box(axis)
    return figure


def _worst(found: Calibrated) -> Figure:
    """Return a figure of the worst cases: finite elements, the model coloured by its error, and both by node."""
    from matplotlib.cm import ScalarMappable

    error = errors(found.found.displacement, found.wanted.displacement)
    cases = np.argsort(-error)[:WORST]
    figure = empty_figure(10.0, 3.1 * len(cases))
    rows = figure.subplots(len(cases), 3, squeeze=False)
    rest = found.organ.surface_positions
    for case, row in zip(cases, rows, strict=True):
        wanted, answer = found.wanted.displacement[case], found.found.displacement[case]
        view = _view(rest, found.organ.surface_positions[found.cases.centre[case][0]])
        loaded = np.any(found.cases.force[case] != 0.0, axis=1)
        moved_mm, off_mm = 1e3 * np.linalg.norm(wanted, axis=1), 1e3 * np.linalg.norm(answer - wanted, axis=1)
        bands = _bands(float(off_mm.max()))
        row[0].imshow(_loaded_picture(found, view, rest + wanted, loaded))
        row[1].imshow(_error_picture(found, view, rest + answer, off_mm, bands))
        for axis in row[:2]:
            axis.set_axis_off()
        figure.colorbar(ScalarMappable(bands, _ERRORS), ax=row[1], shrink=0.8, label="error (mm)", format="%.3g")
        row[0].set_title(f"{found.cases.kind[case]}, finite elements", fontsize=10, loc="left")
        settled = "" if found.found.converged[case] else ", not converged"
        row[1].set_title(f"model, error {100.0 * error[case]:.1f} %{settled}", fontsize=10, loc="left")
        row[2].plot(moved_mm[~loaded], off_mm[~loaded], ".", color=_LINEAR, markersize=3)
        row[2].plot(moved_mm[loaded], off_mm[loaded], ".", color=_MODEL, label="loaded nodes")
        row[2].set_xlabel("displacement (mm)")
        row[2].set_ylabel("error (mm)")
        row[2].legend(frameon=False, fontsize=8)
        hide_box(row[2])
    return figure


def _view(rest: Floats, pressed: Floats) -> View:
    """Return a view of the organ from the side of the pressed place."""
    towards = pressed - rest.mean(axis=0)
    upright = abs(towards[2]) < 0.9 * float(np.linalg.norm(towards))
    return view_of(rest, towards, (0.0, 0.0, 1.0) if upright else (0.0, 1.0, 0.0), (_SIDE, _SIDE), 0.12)


def _bands(largest: float) -> BoundaryNorm:
    """Return the norm of a colour map for errors from 0 to the largest, mm."""
    from matplotlib.colors import BoundaryNorm

    return BoundaryNorm(np.linspace(0.0, max(largest, 1e-6), _BANDS + 1), _COLOURS, extend="neither")


def _error_picture(found: Calibrated, view: View, positions: Floats, off_mm: Floats, bands: BoundaryNorm) -> Pixels:
    """Render the surface at positions (n, 3) m, each triangle coloured by the mean error of its corners, mm (n,)."""
    from matplotlib import colormaps

    triangles = found.organ.surface_triangles
    band = np.asarray(bands(off_mm[triangles].mean(axis=1)))
    skins = ((triangles[band == one], colormaps[_ERRORS](int(one))[:3]) for one in np.unique(band))
    return draw(view, [Solid(positions, some, colour, lines=0.6) for some, colour in skins])


def _loaded_picture(found: Calibrated, view: View, positions: Floats, loaded: NDArray[np.bool_]) -> Pixels:
    """Render the surface at positions (n, 3) m, the triangles of loaded nodes (n,) in another colour."""
    triangles = found.organ.surface_triangles
    pressed = loaded[triangles].all(axis=1)
    skins = ((triangles[~pressed], _SKIN), (triangles[pressed], _LOADED))
    return draw(view, [Solid(positions, some, colour, lines=0.6) for some, colour in skins if len(some)])
