"""Scene as a YAML file: organs and their places, their attachments, and the breathing that moves them."""

from __future__ import annotations

import difflib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from tissue_sim.contact.attachments import Attachment, Breathing
from tissue_sim.contact.coupling_setup import join
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.errors import UserError, shown
from tissue_sim.json_types import JsonObject
from tissue_sim.model.elasticity.gravity import MOST_GRAVITY
from tissue_sim.model.joined import Joined
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.contact_pairs import MAX_ORGANS
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.placement import placed

FORMAT = 1
# Keys of a scene, an organ in it, its breathing, an attachment.
SCENE_KEYS = "format", "organs", "attachments", "breathing", "friction", "gravity"
_ORGAN_KEYS = "name", "file", "position", "quaternion", "stiffness", "breathes"
_BREATHING_KEYS = "rate", "way"
_ATTACHMENT_KEYS = "between", "of", "point", "moves", "within", "nodes", "stiffness", "damping", "slack"


@dataclass(frozen=True)
class SceneFile:
    """Content of a scene's file, with its organs in their places.

    Attributes
    ----------
    names : tuple[str, ...], shape (k,)
        Names of the organs.
    organs : tuple[Organ, ...], shape (k,)
        The organs.
    stiffness : tuple[float, ...], shape (k,)
        Factors on their tissue's stiffness.
    breathes : tuple[float, ...], shape (k,)
        Motion of their clamps with the breath, as a factor.
    attachments : tuple[Attachment, ...]
        Attachments of the organs.
    breathing : Breathing | None
        Breathing; None for none.
    friction : float
        Coulomb coefficient between organs.
    gravity : tuple[float, ...], shape (3,), m/s^2
        Gravity.
    """

    names: tuple[str, ...]
    organs: tuple[Organ, ...]
    stiffness: tuple[float, ...]
    breathes: tuple[float, ...]
    attachments: tuple[Attachment, ...]
    breathing: Breathing | None
    friction: float
    gravity: tuple[float, ...]

    @classmethod
    def read(cls, path: Path) -> SceneFile:
        """Read a scene.

        Parameters
        ----------
        path : Path
            The file.

        Raises
        ------
        UserError
            Where the file isn't a scene; the message names the file and the entry.
        """
        try:
            content = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise UserError(f"scene {path} can't be read: {error.strerror}") from None
        except (YAMLError, UnicodeDecodeError, RecursionError, ValueError) as error:
            said = shown(" ".join(str(error).split()), 200)
            raise UserError(f"scene {path} is not valid YAML: {said}") from None
        if content is None:
            raise UserError(f"scene {path} is empty; 'tissue_sim abdomen' makes one")
        try:
            return cls._parsed(path, _object(content, "the scene", SCENE_KEYS))
        except _InvalidEntry as error:
            raise UserError(f"scene {path}: {error}") from None

    @classmethod
    def _parsed(cls, path: Path, said: JsonObject) -> SceneFile:
        if said.get("format") != FORMAT:
            raise _InvalidEntry(f"format is {shown(repr(said.get('format')))}, this package reads {FORMAT}")
        entries = _list(said.get("organs"), "organs")
        if not 1 <= len(entries) <= MAX_ORGANS:
            raise _InvalidEntry(f"organs has {len(entries)} entries, expected: 1 to {MAX_ORGANS}")
        rows = [_organ(path, entry, f"organs[{number}]") for number, entry in enumerate(entries)]
        names = [name for name, *_ in rows]
        if twice := [name for name in names if names.count(name) > 1]:
            raise _InvalidEntry(f"two organs have the name '{twice[0]}'")
        _, organs, stiffness, breathes = zip(*rows, strict=True)
        attached = _list(said.get("attachments", []), "attachments")
        breathing = said.get("breathing")
        return cls(
            tuple(names),
            organs,
            stiffness,
            breathes,
            tuple(_attachment(one, names, f"attachments[{number}]") for number, one in enumerate(attached)),
            None if breathing is None else _breathing(breathing),
            _number(said.get("friction", 0.0), "friction", 0.0, 5.0),
            tuple(_numbers(said.get("gravity", [0.0, 0.0, 0.0]), "gravity", 3, 0.5 * MOST_GRAVITY)),
        )

    def join(self, simulations: Sequence[Simulation]) -> Joined:
        """Return the coupled simulations of its organs.

        Parameters
        ----------
        simulations : Sequence[Simulation]
            Simulations of the organs.

        Raises
        ------
        UserError
            When the parts don't fit together.
        """
        return join(simulations, self.attachments, self.breathing, self.breathes, self.friction)

    def scene(self, tools: list[Tool], **options: Any) -> Scene:
        """Return the scene with tools.

        Parameters
        ----------
        tools : list[Tool]
            The tools.
        options : Any
            Options of Scene.

        Raises
        ------
        UserError
            When the parts don't fit together.
        """
        made = Scene(
            self.organs,
            tools,
            stiffness=self.stiffness,
            attachments=self.attachments,
            breathing=self.breathing,
            breathes=self.breathes,
            organ_friction=self.friction,
            gravity=self.gravity,
            self_contact=True,
            **options,
        )
        made.names = list(self.names)
        return made


def load_scene(path: str | os.PathLike[str], tools: Sequence[Tool] = (), **options: Any) -> Scene:
    """Read a scene of several organs, and put tools into it.

    Parameters
    ----------
    path
        YAML file; organ files are named relative to it.
    tools
        The rigid tools.
    **options
        `rate`, `model`, `ticks_a_set` and others that `Scene` takes.

    Returns
    -------
    Scene
        The scene at rest; its organs have the names of the file.

    Raises
    ------
    UserError
        For a file that is missing or no scene, and where organs and tools don't fit together.
    """
    return SceneFile.read(Path(path)).scene(list(tools), **options)


class _InvalidEntry(Exception):
    """Error in an entry; its message begins with the name of the entry."""


def _organ(path: Path, entry: object, where: str) -> tuple[str, Organ, float, float]:
    said = _object(entry, where, _ORGAN_KEYS)
    name = said.get("name")
    if not (isinstance(name, str) and name.isidentifier() and name.isascii()):
        raise _InvalidEntry(
            f"{where}.name is {shown(repr(name))}; expected: letters, digits and _, not beginning with a digit"
        )
    file = said.get("file")
    if not isinstance(file, str) or not file:
        raise _InvalidEntry(f"{where}.file is {shown(repr(file))}; expected: an organ file, next to the scene")
    organ = Organ.load(path.parent / file)
    position = _numbers(said.get("position", [0.0, 0.0, 0.0]), f"{where}.position", 3, 10.0)
    quaternion = _numbers(said.get("quaternion", [0.0, 0.0, 0.0, 1.0]), f"{where}.quaternion", 4, 1.0 + 1e-6)
    try:
        there = placed(organ, position, quaternion)
    except UserError as error:
        raise _InvalidEntry(f"{where}: {error}") from None
    stiffness = _number(said.get("stiffness", 1.0), f"{where}.stiffness", 0.01, 100.0)
    return name, there, stiffness, _number(said.get("breathes", 0.0), f"{where}.breathes", -1.0, 1.0)


def _attachment(entry: object, names: Sequence[str], where: str) -> Attachment:
    said = _object(entry, where, _ATTACHMENT_KEYS)
    if ("between" in said) == ("of" in said):
        raise _InvalidEntry(f"{where} needs either 'between' with two organs, or 'of' with one and a 'point'")
    ends = [said["of"]] if "of" in said else _list(said["between"], f"{where}.between")
    if len(ends) != (1 if "of" in said else 2) or not all(isinstance(name, str) for name in ends):
        raise _InvalidEntry(
            f"{where}.{'of' if 'of' in said else 'between'} is {shown(repr(ends))}; expected: names of organs"
        )
    if unknown := [name for name in ends if name not in names]:
        raise _InvalidEntry(
            f"{where} names organ '{shown(unknown[0])}', which doesn't exist; there are {', '.join(names)}"
        )
    if ("of" in said) != ("point" in said):
        raise _InvalidEntry(f"{where}: 'of' needs a 'point', and 'between' has none")
    if ("within" in said) == ("nodes" in said):
        raise _InvalidEntry(f"{where} needs either 'within', m, or 'nodes'")
    number = names.index(ends[0]), names.index(ends[1]) if len(ends) == 2 else None
    return Attachment(
        number,
        stiffness=_number(said.get("stiffness"), f"{where}.stiffness", 1e-6, 1e6),
        damping=_number(said.get("damping", 0.0), f"{where}.damping", 0.0, 1e4),
        within=_number(said.get("within", 0.0), f"{where}.within", 0.0, 1.0),
        nodes=_nodes(said["nodes"], f"{where}.nodes", len(ends)) if "nodes" in said else None,
        point=_numbers(said["point"], f"{where}.point", 3, 10.0) if "point" in said else None,
        slack=None if said.get("slack") is None else _number(said["slack"], f"{where}.slack", 0.0, 10.0),
        moves=_number(said.get("moves", 0.0), f"{where}.moves", -1.0, 1.0),
    )


def _breathing(entry: object) -> Breathing:
    said = _object(entry, "breathing", _BREATHING_KEYS)
    rate = _number(said["rate"], "breathing.rate", 1.0, 120.0) if "rate" in said else 0.0
    return Breathing(rate, _numbers(said.get("way"), "breathing.way", 3, 0.2))


# kinds of values ---------------------------------------------------------------------------------


def _object(value: object, where: str, keys: Sequence[str]) -> JsonObject:
    if not isinstance(value, dict):
        raise _InvalidEntry(f"{where} is {shown(repr(value))}; expected: {', '.join(keys)}")
    for key in value:
        if key not in keys:
            near = difflib.get_close_matches(str(key), keys, 1)
            hint = f"did you mean '{near[0]}'?" if near else f"there are {', '.join(keys)}"
            raise _InvalidEntry(f"{where} has '{shown(str(key))}', which is unknown; {hint}")
    return value


def _list(value: object, where: str) -> list[Any]:
    if not isinstance(value, list):
        raise _InvalidEntry(f"{where} is {shown(repr(value))}; expected: a list")
    return value


def _number(value: object, where: str, low: float, high: float) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not low <= value <= high:  # nor NaN
        raise _InvalidEntry(f"{where} is {shown(repr(value))}; expected: a number in {low:g}..{high:g}")
    return float(value)


def _numbers(value: object, where: str, count: int, most: float) -> list[float]:
    if not isinstance(value, list) or len(value) != count:
        raise _InvalidEntry(f"{where} is {shown(repr(value))}; expected: {count} numbers")
    return [_number(one, f"{where}[{place}]", -most, most) for place, one in enumerate(value)]


def _nodes(value: object, where: str, ends: int) -> list[Any]:
    wanted = "a list of nodes" if ends == 1 else "a list of pairs of nodes"
    rows = _list(value, where)
    flat = rows if ends == 1 else [node for row in rows for node in (row if isinstance(row, list) else [None])]
    right = all(type(node) is int and 0 <= node < 2**31 for node in flat)
    if not rows or not right or (ends == 2 and any(len(row) != 2 for row in rows)):
        raise _InvalidEntry(f"{where} is {shown(repr(value))}; expected: {wanted}")
    return rows
