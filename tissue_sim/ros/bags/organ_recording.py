"""What a bag says about one organ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tissue_sim.errors import UserError
from tissue_sim.model.data.contact_set import ContactSet
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.stepping.state_check import check_settings, contact_set_of
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.bags import bag
from tissue_sim.ros.bags.recorded_cut import RecordedCut, organ_in, recorded_cuts
from tissue_sim.ros.shared.cdr import parse_cloud, parse_octets

TOO_SHORT = "it was recorded too briefly or broken off, so that nothing of it can be replayed: delete it"
ADDED = ("toughness", "flank_friction")  # settings that older bags lack, whose tools are not blades
NO_LONGER = ("factor_slot",)  # settings of older bags that this version has no use for


@dataclass
class OrganRecording:
    """The organ's messages by topic, in the order of recording."""

    file: bytes  # the organ file
    state: dict[str, np.ndarray]
    settings: dict[int, Settings]
    contact_sets: dict[int, ContactSet]
    journal: dict[str, np.ndarray]  # records by kind, see organ_recorder
    surfaces: list[np.ndarray] = field(default_factory=list)  # (n_surface, 3) float32; without the walls of cuts
    cuts: list[RecordedCut] = field(default_factory=list)
    # With which the node has planned to go on after cuts, by their numbers; bags from before them lack these.
    plans: dict[int, Settings] = field(default_factory=dict)

    @classmethod
    def parsed(cls, path: Path, messages: Mapping[str, Sequence[bytes]], below: str, n_bodies: int) -> OrganRecording:
        """Return the recording from the messages of the topics below a name.

        path: the bag, for messages; messages: messages by topic; below: that name; n_bodies: number of bodies. Raises
        UserError when the bag lacks something; the message names it.
        """
        octets = {
            name: [parse_octets(raw) for raw in messages[f"{below}/{name}"]]
            for name, kind in bag.ORGAN_TOPICS.items()
            if kind == bag.OCTETS
        }
        for name, lack in (("state", "state to start from"), ("settings", "settings")):
            if not octets[name]:
                raise UserError(f"bag {path} has no {lack}: {TOO_SHORT}")
        if not octets["journal"]:
            raise UserError(f"bag {path} has no events: {TOO_SHORT}")
        rows = [bag.unpack(values) for values in octets["journal"]]
        state = bag.unpack(octets["state"][0])
        n_nodes = len(state["position"])
        sets = [contact_set_of(bag.unpack(values), n_bodies, n_nodes) for values in octets["contact_set"]]
        settings = [bag.unpack(values) for values in octets["settings"]]
        made = [bag.unpack(values) for values in octets["cut"]]
        cuts = recorded_cuts(made)
        recording = cls(
            file=octets["organ"][0].tobytes(),
            state=state,
            settings={int(found["sequence"]): settings_of(path, found["settings"]) for found in settings},
            contact_sets={int(found.header.sequence): found for found in sets},
            journal={kind: np.concatenate([row[kind] for row in rows]) for kind in rows[0]},
            surfaces=_without_walls([parse_cloud(raw) for raw in messages[f"{below}/surface"]], cuts),
            cuts=cuts,
            plans={int(found["number"]): settings_of(path, found["settings"]) for found in made if "settings" in found},
        )
        if len({len(surface) for surface in recording.surfaces}) > 1:
            raise ValueError("its surfaces have different numbers of points")
        return recording

    @property
    def first_tick(self) -> int:
        """Tick of the state."""
        return int(self.state["status"]["tick"].item())

    def organ(self) -> Organ:
        """Return the organ that the bag holds."""
        return organ_in(self.file)


def _without_walls(surfaces: list[np.ndarray], cuts: Sequence[RecordedCut]) -> list[np.ndarray]:
    """Return the points of the outer surface: those that a cut has added come behind them."""
    if not cuts:
        return surfaces
    count = cuts[0].organ.n_surface
    if any(len(surface) < count for surface in surfaces):
        raise ValueError(f"its surfaces have fewer points than the {count} of its organ")
    return [surface[:count] for surface in surfaces]


def settings_of(path: Path, recorded: np.ndarray) -> Settings:
    """Return settings from a record of them; raise UserError naming a field that one of both lacks."""
    names = [name for name in recorded.dtype.names or () if name not in NO_LONGER]
    wanted = Settings.dtype.names or ()
    if differing := sorted((set(names) ^ set(wanted)) - set(ADDED)):
        raise UserError(f"bag {path}: setting '{differing[0]}' is in the bag or in this version only; record it again")
    settings = Settings.new()
    for name in names:
        setattr(settings, name, recorded[name][()])
    check_settings(settings)
    return settings
