"""What a bag says about what joins the organs of a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Longs
from tissue_sim.model.data.links import POINT, Links, make_links
from tissue_sim.model.data.records import copy_of
from tissue_sim.model.joined import Joined
from tissue_sim.model.runtime.joined_box import JoinedRow
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.breathing import Breath
from tissue_sim.model.stepping.contact_pairs import OrganContactSet, make_organ_contacts, set_of_words
from tissue_sim.model.stepping.state_check import MAX_NUMBER
from tissue_sim.ros.bags import bag
from tissue_sim.ros.shared.cdr import parse_octets

_ROWS = {
    "joined": JoinedRow,
    "pairs": bag.PairRow,
    "pair_surfaces": bag.PairSurfaceRow,
    "respiration": bag.RespirationRow,
    "wrenches": bag.WrenchRow,
}

_LATER = {"pair_surfaces": np.zeros(0, dtype=bag.PairSurfaceRow.dtype)}  # bags from before them lack these


class Sizes(NamedTuple):
    """Numbers of nodes that an organ has in a bag."""

    first: int  # at its beginning
    after: dict[int, int]  # after each cut, by its number


@dataclass
class JoinedRecording:
    """What joined organs at the tick of their states, by name (see joined_recorder), and what happened since.

    fields: empty of an organ alone; pair_sets: those that are whole, by number; journal: records by kind, see
    joined_recorder.
    """

    fields: dict[str, np.ndarray]
    pair_sets: dict[int, OrganContactSet]
    journal: dict[str, np.ndarray]

    @classmethod
    def parsed(cls, messages: Mapping[str, Sequence[bytes]], below: str, sizes: Sequence[Sizes]) -> JoinedRecording:
        """Return the recording from the messages of the topics below a name.

        messages: messages by topic; below: that name; sizes: numbers of nodes of each organ. Raises ValueError when
        they are damaged.
        """
        unpacked = {
            name: [bag.unpack(parse_octets(raw)) for raw in messages[f"{below}/{name}"]] for name in bag.SCENE_TOPICS
        }
        if not unpacked["joined"] or not unpacked["journal"]:
            raise ValueError(
                "it does not contain the ligaments of its organs: the recording was too short or interrupted"
            )
        journal = {
            kind: np.concatenate([(_LATER | rows)[kind] for rows in unpacked["journal"]])
            for kind in (*_ROWS, "pair_ticks")
        }
        _check_journal(journal, len(sizes))
        fields = {"versions": np.zeros(len(sizes), dtype=np.int64)} | unpacked["joined"][0]  # older bags lack them
        _check_fields(fields, sizes)
        known = _with_versions(sizes, fields["versions"])
        sets = {int(found["sequence"]): _pairs_of(found["words"], known) for found in unpacked["organ_contact_set"]}
        return cls(fields, sets, journal)

    @classmethod
    def alone(cls, wrenches: np.ndarray) -> JoinedRecording:
        """Return that of an organ alone, whose own journal has the rows of wrenches."""
        journal = {kind: np.zeros(0, dtype=record.dtype) for kind, record in _ROWS.items()}
        journal["joined"] = np.array([(-1, 0, 0)], dtype=JoinedRow.dtype)  # nothing was taken up before its first tick
        return cls({}, {}, journal | {"pair_ticks": np.zeros((0, 1), dtype=np.int64), "wrenches": wrenches})

    def join(self, simulations: Sequence[Simulation]) -> Joined:
        """Join simulations in the states of the bag as they were. Raises UserError when they don't fit."""
        fields = self.fields
        if not fields:
            return Joined(simulations)
        links = Links(**{name: fields[f"links.{name}"].copy() for name in Links._fields})
        breath = Breath.at(fields["breath"].view(np.int64).reshape(-1).copy())
        joined = Joined(
            simulations, links, make_organ_contacts(float(fields["friction"][0])), breath, fields["moves"].tolist()
        )
        joined.pairs.version[: len(simulations)] = fields["versions"]
        joined.restore(copy_of(breath), set_of_words(fields["pairs"]), fields["pressed"], fields["held"])
        return joined


def _pairs_of(words: np.ndarray, sizes: Sequence[Sizes]) -> OrganContactSet:
    """Return pairs from the words of a set; raise ValueError for one that names what isn't there."""
    made = set_of_words(words)
    count, points = int(made.found[0]), int(made.points[0])
    node, organ = made.node[:count], made.organ[:count]
    _check_ends(organ, np.maximum(node[:, :1], 0), np.maximum(node[:, 1:], 0), [one.first for one in sizes])
    weights = np.concatenate([made.weight[:count].ravel(), made.point_weight[:points].ravel()])
    if len(weights) and not np.abs(weights).max() <= 2.0:
        raise ValueError("its organ contacts have invalid weights")
    if points == 0 and node.min(initial=0) < 0:
        raise ValueError("it joins a node that doesn't exist")
    _check_points(made, sizes)
    return made


def _check_points(found: OrganContactSet, sizes: Sequence[Sizes]) -> None:
    """Raise ValueError where pairs name cut points that aren't there, or these name nodes that aren't."""
    count, points = int(found.found[0]), int(found.points[0])
    if points == 0:
        return
    node, organ, owner = found.node[:count], found.organ[:count], found.point_organ[:points]
    ends = organ[:, [0, 1, 1, 1]]
    made = node < 0
    if owner.min() < 0 or owner.max() >= len(sizes) or node.min(initial=0) < -points:
        raise ValueError("it joins a point of a cut that doesn't exist")
    if np.any(owner[-1 - node[made]] != ends[made]):
        raise ValueError("it joins a point of a cut of another organ")
    rows = zip(owner.tolist(), found.point_version[:points].tolist(), found.point_node[:points], strict=True)
    for one, version, nodes in rows:
        # Points of a surface from before the bag are dropped when they are taken up.
        most = sizes[one].after.get(version)
        if nodes.min() < 0 or (most is not None and nodes.max() >= most):
            raise ValueError("it joins a node that doesn't exist")


def _check_ends(organ: Longs, near: Longs, far: Longs, sizes: Sequence[int]) -> None:
    """Raise ValueError where nodes of two organs, (p, 2), aren't there: near (p, a) of the first, far (p, b)."""
    if organ.size and (organ.min() < 0 or organ.max() >= len(sizes)):
        raise ValueError("it joins an organ that doesn't exist")
    count = np.array(sizes)
    for nodes, own in ((near, organ[:, 0]), (far, organ[:, 1])):
        if nodes.size and (nodes.min() < 0 or np.any(nodes >= count[own][:, None])):
            raise ValueError("it joins a node that doesn't exist")


def _with_versions(sizes: Sequence[Sizes], versions: np.ndarray) -> list[Sizes]:
    """Return the sizes with those of the surfaces that the organs had at first, by their numbers."""
    if versions.shape != (len(sizes),) or versions.dtype != np.int64:
        raise ValueError(f"its 'versions' has shape {versions.shape}, expected ({len(sizes)},)")
    both = list(zip(sizes, versions.tolist(), strict=True))
    return [Sizes(one.first, one.after | {own: min(one.first, one.after.get(own, one.first))}) for one, own in both]


def _check_fields(fields: Mapping[str, np.ndarray], sizes: Sequence[Sizes]) -> None:
    count = int(_pairs_of(fields["pairs"], _with_versions(sizes, fields["versions"])).found[0])
    like: dict[str, np.ndarray] = {f"links.{k}": v for k, v in make_links(len(fields["links.slack"]))._asdict().items()}
    like |= {
        "breath": Breath.rows(np.zeros(Breath.words(), dtype=np.int64)),
        "moves": np.zeros(len(sizes)),
        "friction": np.zeros(1),
    }
    like |= {"pressed": np.zeros(count), "held": np.zeros((count, 3))}
    for name, wanted in like.items():
        found = fields[name]
        if found.shape != wanted.shape or found.dtype != wanted.dtype:
            raise ValueError(f"its '{name}' has shape {found.shape}, expected {wanted.shape}")
        parts = [found] if found.dtype.names is None else [found[part] for part in found.dtype.names]
        if any(part.dtype.kind == "f" and part.size and not np.abs(part).max() <= MAX_NUMBER for part in parts):
            raise ValueError(f"its '{name}' contains numbers that are not finite, or beyond {MAX_NUMBER:g}")
    organ, node = fields["links.organ"], fields["links.node"]
    ends = organ.copy()
    ends[:, 1] = np.where(organ[:, 1] == POINT, organ[:, 0], organ[:, 1])
    far = np.where(organ[:, 1] == POINT, node[:, 0], node[:, 1])
    _check_ends(ends, node[:, :1], far[:, None], [one.first for one in sizes])


def _check_journal(journal: Mapping[str, np.ndarray], n_organs: int) -> None:
    for kind, record in _ROWS.items():
        if journal[kind].dtype != record.dtype or journal[kind].ndim != 1:
            raise ValueError(f"its journal's {kind} have another type")
    organ = journal["pair_surfaces"]["organ"]
    if len(organ) and not 0 <= organ.min() <= organ.max() < n_organs:
        raise ValueError("its journal names a surface of an organ that doesn't exist")
    if not np.all(np.abs(journal["respiration"]["share"]) <= MAX_NUMBER):
        raise ValueError("its journal contains a breathing displacement that is not finite")
    ticks = journal["pair_ticks"]
    if ticks.shape != (len(journal["pairs"]), n_organs) or ticks.dtype != np.int64:
        raise ValueError("its journal's pair_ticks have another type")
