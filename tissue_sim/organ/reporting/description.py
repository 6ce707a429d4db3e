"""Figures of an organ, and their presentation as lines of text."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.cell_mesh import quality_of
from tissue_sim.organ.inclusions import inclusions_of
from tissue_sim.organ.organ import Organ, SpringKind
from tissue_sim.organ.surface_checks import signed_volume
from tissue_sim.organ.surfaces.surface_distance import distance_to_surface
from tissue_sim.organ.surfaces.surface_quality import measure
from tissue_sim.organ.tool_resolution import CUT_EDGES, FAIR, FAIR_WITHIN, FINE, FINE_WITHIN

UNITS = "SI: m, kg, s, N, Pa"


def describe(organ: Organ) -> JsonObject:
    """Return all figures of an organ, nested, ready for JSON.

    Units stand in the names: mm, mL, g, N/m, Pa, kg/m^3, degrees. A range is an object of `least`, `median` and
    `largest`. `variation` is the standard deviation over the mean; `least_ball_radius` is the radius of the smallest
    ball for whose force the surface is fine enough, and `least_cut_depth` the depth from which on a cut is resolved.

    Parameters
    ----------
    organ : Organ
        The organ.

    Returns
    -------
    JsonObject
        The figures by name.
    """
    surface = organ.surface_positions
    quality = measure(surface, organ.surface_triangles)
    return {
        "name": organ.name,
        "schema_version": organ.schema_version,
        "units": UNITS,
        "digest": organ.digest(),
        "volume_ml": organ.volume * 1e6,
        "extent_mm": [float(v) * 1e3 for v in np.ptp(surface, axis=0)],
        "lower_corner_mm": [float(v) * 1e3 for v in surface.min(axis=0)],
        "upper_corner_mm": [float(v) * 1e3 for v in surface.max(axis=0)],
        "surface": {
            "points": organ.n_surface,
            "triangles": len(organ.surface_triangles),
            "edges": organ.n_surface + len(organ.surface_triangles) - quality.euler,
            "held_points": len(organ.fixed),
            "euler_number": quality.euler,
            "edge_mean_mm": quality.edge_mean * 1e3,
            "edge_variation": quality.edge_variation,
            "least_angle_deg": quality.least_angle,
            "self_intersections": quality.self_intersections,
        },
        "least_ball_radius": {
            f"within_{FINE_WITHIN:g}_percent_mm": FINE * quality.edge_mean * 1e3,
            f"within_{FAIR_WITHIN:g}_percent_mm": FAIR * quality.edge_mean * 1e3,
        },
        "least_cut_depth_mm": CUT_EDGES * quality.edge_mean * 1e3,
        "skeleton": _skeleton(organ),
        "interior_points": len(organ.interior_positions),
        "springs": _springs(organ),
        **({"cells": _cells(organ)} if len(organ.cell_nodes) else {}),
        **({"inclusions": _inclusions(organ)} if len(organ.inclusion_stiffness) else {}),
        "mass_g": _masses(organ),
        "tissue": {
            "youngs_modulus_pa": organ.youngs_modulus,
            "poisson_ratio": organ.poisson_ratio,
            "density_kg_m3": organ.density,
            **({"stiffening": organ.stiffening, "of_the_cells": organ.cell_stiffening} if organ.stiffening else {}),
            **({"relaxation": _relaxation(organ)} if organ.relaxation_fraction else {}),
        },
        "provenance": dict(organ.provenance),
    }


def _relaxation(organ: Organ) -> dict[str, float]:
    return {"percent_of_the_first_force": 100.0 * organ.relaxation_fraction, "seconds": organ.relaxation_time}


def _skeleton(organ: Organ) -> JsonObject:
    parent = organ.atom_parent
    child = np.flatnonzero(parent >= 0)
    links = organ.atom_positions[child] - organ.atom_positions[parent[child]]
    length = np.linalg.norm(links, axis=1) * 1e3
    neighbours = np.bincount(np.concatenate([child, parent[child]]), minlength=len(parent))
    found: JsonObject = {
        "atoms": organ.n_atoms,
        "branches": _branches(neighbours),
        "tips": int(np.count_nonzero(neighbours <= 1)),
        "junctions": int(np.count_nonzero(neighbours > 2)),
        "length_mm": float(length.sum()),
        "radius_mm": _range(organ.atom_radius * 1e3),
    }
    return found | ({"spacing_mm": _range(length)} if len(length) else {})


def _branches(neighbours: NDArray[np.int64]) -> int:
    """Return the number of lines between tips and junctions of a tree, from every atom's number of neighbours."""
    return int(neighbours[neighbours != 2].sum()) // 2


def _springs(organ: Organ) -> JsonObject:
    found: JsonObject = {}
    for kind in SpringKind:
        chosen = organ.spring_kind == kind
        if chosen.any():
            found[kind.name.lower()] = {
                "count": int(np.count_nonzero(chosen)),
                "stiffness_n_per_m": _range(organ.spring_stiffness[chosen]),
                "rest_length_mm": _range(organ.spring_rest_length[chosen] * 1e3),
            }
    if len(organ.angular_stiffness):
        found["angular"] = {
            "count": len(organ.angular_stiffness),
            "stiffness_n_per_m": _range(organ.angular_stiffness),
        }
    held_back = organ.return_stiffness > 0.0
    if held_back.any():
        found["return"] = {
            "count": int(np.count_nonzero(held_back)),
            "stiffness_n_per_m": _range(organ.return_stiffness[held_back]),
        }
    return found


def _cells(organ: Organ) -> JsonObject:
    volume, quality = quality_of(organ.rest_positions, organ.cell_nodes)
    return {
        "count": len(organ.cell_nodes),
        "filled_percent": 100.0 * float(volume.sum()) / organ.volume,
        "quality": _range(quality),
        "mu_pa": _range(organ.cell_mu),
        "lambda_pa": _range(organ.cell_lambda),
    }


def _inclusions(organ: Organ) -> list[JsonObject]:
    return [
        {
            "times_as_stiff": inclusion.stiffness,
            "volume_ml": 1e6 * signed_volume(inclusion.positions, inclusion.triangles),
            "middle_mm": [float(v) * 1e3 for v in inclusion.positions.mean(axis=0)],
            "least_depth_mm": 1e3
            * float(distance_to_surface(inclusion.positions, organ.surface_positions, organ.surface_triangles).min()),
        }
        for inclusion in inclusions_of(organ)
    ]


def _masses(organ: Organ) -> JsonObject:
    grams = organ.mass * 1e3
    surface, atoms, interior = np.split(grams, [organ.n_surface, organ.n_surface + organ.n_atoms])
    parts = {"total": grams, "surface": surface, "atoms": atoms, "interior": interior}
    return {name: float(part.sum()) for name, part in parts.items() if len(part)} | {"per_point": _range(grams)}


def _range(values: Floats) -> dict[str, float]:
    return {"least": float(values.min()), "median": float(np.median(values)), "largest": float(values.max())}


def file_header(path: str | Path) -> JsonObject:
    """Return the schema version and units as the file states them; the file has been checked by Organ.load.

    Parameters
    ----------
    path : str | Path
        The file.

    Returns
    -------
    JsonObject
        The stated values by name.

    Raises
    ------
    UserError
        Where the file changed in the meantime.
    """
    try:
        with np.load(Path(path), allow_pickle=False) as stored:
            header = json.loads(str(stored["header"]))
    except (OSError, ValueError, KeyError):
        raise UserError(f"organ file {path} changed while it was read; try again") from None
    return {key: header[key] for key in ("schema_version", "units") if key in header}


# text ----------------------------------------------------------------------------------------------

_UNITS = {"mm": "mm", "ml": "mL", "g": "g", "pa": "Pa", "deg": "degrees", "kg_m3": "kg/m^3", "n_per_m": "N/m"}
_NAMES = {
    "tissue_sim": "tissue_sim",
    "youngs_modulus_pa": "Young's modulus (Pa)",
    "poisson_ratio": "Poisson's ratio",
    "stiffening": "stiffening (b of Demiray's law)",
    "of_the_cells": "of the cells, times that",
    "source_sha256": "source's SHA-256",
}


def text_lines(found: Mapping[str, object], indent: int = 0) -> Iterator[str]:
    """Yield the figures of `describe`, or a provenance, as lines of text, nested by indentation.

    Parameters
    ----------
    found : Mapping[str, object]
        The figures by name.
    indent : int, optional
        Level of indentation.

    Yields
    ------
    Iterator[str]
        One line.
    """
    pad = "  " * indent
    for key, value in found.items():
        parts = parts_of(value)
        if parts is not None:
            yield f"{pad}{label(key)}:"
            yield from text_lines(parts, indent + 1)
        else:
            yield f"{pad}{label(key)}: {shown(value)}"


def parts_of(value: object) -> dict[str, object] | None:
    """Return by name or number what needs lines of its own: a mapping that is not a range, or lists in a list.

    Parameters
    ----------
    value : object
        The value; None is returned for one that fits on a line.
    """
    if isinstance(value, Mapping):
        return None if is_range(value) else {str(name): item for name, item in value.items()}
    if isinstance(value, list | tuple) and any(isinstance(item, Mapping | list | tuple) for item in value):
        return {str(number): item for number, item in enumerate(value, start=1)}
    return None


def is_range(value: object) -> TypeGuard[Mapping[str, float]]:
    """Return whether a value is a range as `describe` makes it."""
    return isinstance(value, Mapping) and value.keys() == {"least", "median", "largest"}


def label(key: str) -> str:
    """Return a key as words, its unit in parentheses: `edge_mean_mm` gives `edge mean (mm)`; `tissue_sim` is kept.

    Parameters
    ----------
    key : str
        The key.
    """
    if key in _NAMES:
        return _NAMES[key]
    for suffix, unit in _UNITS.items():
        if key.endswith(f"_{suffix}"):
            return f"{key[: -len(suffix) - 1].replace('_', ' ')} ({unit})"
    return key.replace("_", " ")


def shown(value: object) -> str:
    """Return a plain value as text: four significant digits, `least to largest, median m` for a range.

    Parameters
    ----------
    value : object
        The value.
    """
    if is_range(value):
        return f"{shown(value['least'])} to {shown(value['largest'])}, median {shown(value['median'])}"
    if isinstance(value, list | tuple):
        return ", ".join(shown(item) for item in value) if value else "none"
    if value is None:
        return "not given"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.0f}" if 1e3 <= abs(value) < 1e15 else f"{value:.4g}"
    return str(value)
