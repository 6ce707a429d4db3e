"""Content of a scene, for `tissue_sim info`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tissue_sim.contact.attachments import Attachment, links_of
from tissue_sim.contact.scene_file import SceneFile
from tissue_sim.json_types import JsonObject
from tissue_sim.model.simulation import Simulation


def describe_scene(path: Path) -> JsonObject:
    """Return all figures of a scene, ready for JSON; units stand in the names.

    Raises UserError where the file isn't a scene.
    """
    said = SceneFile.read(path)
    scene = said.scene([])
    breathing = said.breathing
    organs = zip(said.names, said.organs, said.stiffness, said.breathes, strict=True)
    return {
        "scene": path.name,
        "organs": [
            {
                "name": name,
                "organ": organ.name,
                "digest": organ.digest(),
                "points": organ.n_surface,
                "cells": len(organ.cell_nodes),
                "volume_ml": organ.volume * 1e6,
                "lower_corner_mm": (1e3 * organ.surface_positions.min(axis=0)).tolist(),
                "upper_corner_mm": (1e3 * organ.surface_positions.max(axis=0)).tolist(),
                "stiffness": stiffness,
                "breathes": breathes,
            }
            for name, organ, stiffness, breathes in organs
        ],
        "attachments": [_attachment(one, said, scene.simulations) for one in said.attachments],
        "substeps_for_attachments": int(scene.simulation.settings.least_substeps),
        "friction": said.friction,
        "gravity_m_per_s2": list(said.gravity),
        "breathing": None
        if breathing is None
        else {"rate_per_minute": breathing.rate, "way_mm": (1e3 * np.asarray(breathing.way)).tolist()},
    }


def _attachment(one: Attachment, said: SceneFile, simulations: list[Simulation]) -> JsonObject:
    near, far = one.organs
    links = links_of([one], simulations)
    return {
        "from": said.names[near],
        "to": "a point" if far is None else said.names[far],
        "links": len(links.slack),
        "stiffness_n_per_m": one.stiffness,
        "slack_mm": [float(1e3 * links.slack.min()), float(1e3 * links.slack.max())],
    }


def scene_lines(found: JsonObject) -> list[str]:
    """Return the figures as lines of text."""
    lines = [f"scene {found['scene']}: {len(found['organs'])} organs"]
    for organ in found["organs"]:
        low, high = (", ".join(f"{v:.0f}" for v in organ[key]) for key in ("lower_corner_mm", "upper_corner_mm"))
        extra = f", stiffness {organ['stiffness']:g}" if organ["stiffness"] != 1.0 else ""
        extra += f", breathes {organ['breathes']:g}" if organ["breathes"] else ""
        cells = f"{organ['cells']} cells" if organ["cells"] else "springs"
        lines.append(
            f"  {organ['name']}: {organ['volume_ml']:.1f} mL, {organ['points']} points, {cells},"
            f" from {low} to {high} mm{extra}"
        )
    for one in found["attachments"]:
        least, most = (f"{slack:.1f}" for slack in one["slack_mm"])
        lines.append(
            f"  {one['from']} to {one['to']}: {one['links']} links, {one['stiffness_n_per_m']:g} N/m in total,"
            f" slack {least if least == most else f'{least} to {most}'} mm"
        )
    if found["attachments"]:
        lines.append(f"  substeps for the attachments: at least {found['substeps_for_attachments']}")
    if found["breathing"]:
        displacement = ", ".join(f"{v:g}" for v in found["breathing"]["way_mm"])
        rate = found["breathing"]["rate_per_minute"]
        lines.append(f"  breathing: {f'{rate:g} a minute' if rate else 'from ~/respiration'}, {displacement} mm")
    if found["friction"]:
        lines.append(f"  friction between organs: {found['friction']:g}")
    if any(found["gravity_m_per_s2"]):
        lines.append(f"  gravity: {', '.join(f'{v:g}' for v in found['gravity_m_per_s2'])} m/s^2")
    return lines
