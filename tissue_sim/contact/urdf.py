"""Instruments from a URDF: collision bodies of named links, and their places for a position of the jaw's joint.

The file is read as plain XML: only the links' collisions and the joints are needed, and xacro is expanded beforehand
(`xacro instrument.urdf.xacro`). Poses are computed by plain sums, so that a replay repeats them on every processor.
"""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from tissue_sim.contact.quaternions import Quaternion, Vector, multiply, rotate
from tissue_sim.errors import UserError, shown
from tissue_sim.organ.shipped import shipped_file

MOVING = ("revolute", "continuous", "prismatic")
MAX_PARTS = 8  # largest number of bodies of an instrument, each of which takes time in every tick
NOWHERE: Vector = (0.0, 0.0, 0.0)
UNTURNED: Quaternion = (0.0, 0.0, 0.0, 1.0)


class Place(NamedTuple):
    """A place in a frame, m, and a rotation."""

    at: Vector = NOWHERE
    turn: Quaternion = UNTURNED

    def after(self, first: Place) -> Place:
        """Return the composition of another transform followed by this one."""
        x, y, z = rotate(self.turn, first.at)
        return Place((self.at[0] + x, self.at[1] + y, self.at[2] + z), multiply(self.turn, first.turn))

    def inverse(self) -> Place:
        """Return the inverse transform."""
        x, y, z, w = self.turn
        back = (-x, -y, -z, w)
        px, py, pz = rotate(back, self.at)
        return Place((-px, -py, -pz), back)


class Part(NamedTuple):
    """A collision element of a link.

    Attributes
    ----------
    link : str
        The link.
    kind : str
        box, cylinder, sphere or mesh.
    size : tuple[float, ...], m
        Sides of a box, radius and length of a cylinder, or radius of a sphere; for a mesh its scale factors, not
        lengths.
    place : Place
        Its place on the link.
    file : str
        File of a mesh.
    """

    link: str
    kind: str
    size: tuple[float, ...]
    place: Place
    file: str = ""


class Joint(NamedTuple):
    """A joint, which moves its child link.

    Attributes
    ----------
    name : str
        Its name.
    kind : str
        fixed, revolute, continuous, prismatic, or another kind, which does not move.
    parent, child : str
        The links that it joins.
    place : Place
        Its place on the parent.
    axis : Vector
        Unit vector about or along which it moves.
    bounds : tuple[float, float], rad or m
        Limits of its position.
    mimics : tuple[str, float, float]
        The joint that it follows, the factor and the offset; an empty name: none.
    """

    name: str
    kind: str
    parent: str
    child: str
    place: Place
    axis: Vector
    bounds: tuple[float, float]
    mimics: tuple[str, float, float]

    def moved(self, position: float) -> Place:
        """Return the place of the child on the parent at a position of the joint, rad or m."""
        if self.kind == "prismatic":
            x, y, z = self.axis
            return self.place.after(Place((position * x, position * y, position * z)))
        if self.kind in MOVING:
            sine = math.sin(0.5 * position)
            x, y, z = self.axis
            return self.place.after(Place(turn=(sine * x, sine * y, sine * z, math.cos(0.5 * position))))
        return self.place


class Instrument:
    """A tool that a URDF describes.

    Parameters
    ----------
    joints : Mapping[str, Joint]
        All joints, by the links that they move.
    parts : Sequence[Part]
        The collision elements that are the tool's bodies.
    tip : str
        Link whose frame is the tool's.
    jaw : str
        Joint whose position is the tool's angle; empty for none.
    """

    def __init__(self, joints: Mapping[str, Joint], parts: Sequence[Part], tip: str, jaw: str) -> None:
        self.parts, self._joints, self._tip = tuple(parts), dict(joints), tip
        self._jaw = next((joint for joint in joints.values() if joint.name == jaw), None)
        self._places = functools.lru_cache(maxsize=4)(self._placed)

    def places(self, angle: float) -> list[Place]:
        """Return the places of its parts on the tool.

        Parameters
        ----------
        angle : float, rad or m
            Position of the jaw's joint, which is kept within its bounds.

        Returns
        -------
        list[Place]
            The place of each part.
        """
        return self._places(angle)

    def _placed(self, angle: float) -> list[Place]:
        to_tip = self._on_root(self._tip, angle).inverse()
        return [to_tip.after(self._on_root(part.link, angle)).after(part.place) for part in self.parts]

    def _on_root(self, link: str, angle: float) -> Place:
        place = Place()
        while (joint := self._joints.get(link)) is not None:
            place = joint.moved(self._position(joint, angle)).after(place)
            link = joint.parent
        return place

    def _position(self, joint: Joint, angle: float) -> float:
        """Return a joint's position; joints that don't follow the jaw stay at 0, or at the limit nearest to it."""
        led, factor, offset = joint.mimics
        if led:
            (other,) = (one for one in self._joints.values() if one.name == led)
            return factor * self._position(other, angle) + offset
        low, high = joint.bounds
        return min(max(angle if joint is self._jaw else 0.0, low), high)


@functools.lru_cache(maxsize=16)
def read_instrument(path: str, links: tuple[str, ...], tip: str, jaw: str) -> Instrument:
    """Return the instrument that a URDF describes.

    Parameters
    ----------
    path : str
        The file.
    links : tuple[str, ...]
        Links whose collision elements are its bodies; empty for all that have any.
    tip : str
        Link whose frame is the tool's; empty for the root.
    jaw : str
        Joint that moves the jaws; empty for none.

    Raises
    ------
    UserError
        If the file can't be used, or has no such link or joint; the message names it.
    """
    file = Path(path) if Path(path).is_file() else shipped_file(path)
    if file is None:
        raise UserError(f"URDF '{shown(path)}' does not exist; name one whose xacro is expanded")
    try:
        root = ElementTree.parse(file).getroot()
    except (ElementTree.ParseError, UnicodeDecodeError, OSError, ValueError) as error:
        raise UserError(f"URDF '{path}' cannot be read: {error}") from None
    if root.tag != "robot":
        raise UserError(f"URDF '{path}' begins with <{shown(root.tag)}>, not with <robot>")
    try:
        joints = [_joint(one) for one in root.findall("joint")]
        parts = {one.attrib["name"]: _parts(one, file) for one in root.findall("link")}
    except (KeyError, ValueError) as error:
        raise UserError(f"URDF '{path}': {error} is missing or not a number") from None
    _check(path, joints, set(parts))
    for link in (*links, *([tip] if tip else [])):
        if link not in parts:
            raise UserError(f"URDF '{path}' has no link '{shown(link)}'; it has {', '.join(parts)}")
    movable = [joint.name for joint in joints if joint.kind in MOVING]
    if jaw and jaw not in movable:
        raise UserError(f"URDF '{path}' has no joint '{shown(jaw)}' that moves; it has {', '.join(movable) or 'none'}")
    chosen = [part for link in (links or tuple(parts)) for part in parts[link]]
    if empty := [link for link in links if not parts[link]]:
        raise UserError(f"URDF '{path}': link '{empty[0]}' has no collision element; name another one in links")
    if not 1 <= len(chosen) <= MAX_PARTS:
        raise UserError(
            f"URDF '{path}': the links have {len(chosen)} collision elements; name links with 1 to {MAX_PARTS}"
        )
    moved = {joint.child for joint in joints}
    base = next(link for link in parts if link not in moved)
    return Instrument({joint.child: joint for joint in joints}, chosen, tip or base, jaw)


def _check(path: str, joints: Sequence[Joint], links: set[str]) -> None:
    """Raise UserError if joints and links are not a tree, or a joint follows itself or one that doesn't exist."""
    names, parents = {joint.name: joint for joint in joints}, {joint.child: joint.parent for joint in joints}
    for joint in joints:
        if not {joint.parent, joint.child} <= links:
            raise UserError(f"URDF '{path}': joint '{joint.name}' joins a link that it doesn't have")
        seen, led = {joint.name}, joint.mimics[0]
        while led:
            if led not in names or led in seen:
                raise UserError(f"URDF '{path}': joint '{joint.name}' mimics '{shown(led)}', which it can't follow")
            seen.add(led)
            led = names[led].mimics[0]
    if len(parents) < len(joints):
        raise UserError(f"URDF '{path}': a link is moved by two joints")
    for link in links:
        passed, above = {link}, parents.get(link)
        while above is not None:
            if above in passed:
                raise UserError(f"URDF '{path}': its links form a circle at '{above}'")
            passed.add(above)
            above = parents.get(above)


def _joint(element: ElementTree.Element) -> Joint:
    def linked(tag: str) -> str:
        found = element.find(tag)
        if found is None:
            raise KeyError(tag)
        return found.attrib["link"]

    axis, mimic, limit = element.find("axis"), element.find("mimic"), element.find("limit")
    way = _vector(axis.get("xyz", "1 0 0") if axis is not None else "1 0 0")
    length = math.sqrt(sum(one * one for one in way))
    if length < 1e-9:
        raise ValueError("an axis that is not zero")
    bounds = -math.inf, math.inf
    if limit is not None and element.attrib["type"] != "continuous":
        bounds = float(limit.get("lower", "0")), float(limit.get("upper", "0"))
    led = ("", 1.0, 0.0)
    if mimic is not None:
        led = mimic.attrib["joint"], float(mimic.get("multiplier", "1")), float(mimic.get("offset", "0"))
    unit = (way[0] / length, way[1] / length, way[2] / length)
    return Joint(
        element.attrib["name"],
        element.attrib["type"],
        linked("parent"),
        linked("child"),
        _origin(element),
        unit,
        bounds,
        led,
    )


def _parts(link: ElementTree.Element, file: Path) -> list[Part]:
    found = []
    for collision in link.findall("collision"):
        geometry = collision.find("geometry")
        shape = next(iter(geometry), None) if geometry is not None else None
        if shape is None:
            raise KeyError("geometry")
        name, place = link.attrib["name"], _origin(collision)
        if shape.tag == "mesh":
            scale = _vector(shape.get("scale", "1 1 1"))
            found.append(Part(name, "mesh", scale, place, _resolved(shape.attrib["filename"], file)))
        elif shape.tag == "box":
            found.append(Part(name, "box", _vector(shape.attrib["size"]), place))
        elif shape.tag == "sphere":
            found.append(Part(name, "sphere", (float(shape.attrib["radius"]),), place))
        elif shape.tag == "cylinder":
            size = float(shape.attrib["radius"]), float(shape.attrib["length"])
            found.append(Part(name, "cylinder", size, place))
        else:
            raise ValueError(f"a shape other than <{shape.tag}>")
    return found


def _origin(element: ElementTree.Element) -> Place:
    origin = element.find("origin")
    if origin is None:
        return Place()
    roll, pitch, yaw = _vector(origin.get("rpy", "0 0 0"))
    turn = UNTURNED
    for angle, axis in ((roll, 0), (pitch, 1), (yaw, 2)):  # about fixed axes, one after the other
        sines = [0.0, 0.0, 0.0]
        sines[axis] = math.sin(0.5 * angle)
        turn = multiply((sines[0], sines[1], sines[2], math.cos(0.5 * angle)), turn)
    return Place(_vector(origin.get("xyz", "0 0 0")), turn)


def _vector(text: str) -> Vector:
    numbers = [float(word) for word in text.split()]
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        raise ValueError(f"three numbers in '{shown(text)}'")
    return (numbers[0], numbers[1], numbers[2])


def _resolved(name: str, urdf: Path) -> str:
    """Return the path of a mesh: beside the URDF, in a ROS package, or in a parent folder with the package's name."""
    if name.startswith("package://"):
        package, _, inside = name.removeprefix("package://").partition("/")
        prefixes = [prefix for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
        places = [Path(prefix, "share", package, inside) for prefix in prefixes]
        places += [folder / inside for folder in urdf.resolve().parents if folder.name == package]
        return str(next((place for place in places if place.is_file()), places[0] if places else Path(name)))
    return str(urdf.parent / name.removeprefix("file://"))
