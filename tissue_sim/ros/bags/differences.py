"""Differences between two runs before anything is compared: organ, package, parameters."""

from __future__ import annotations

from dataclasses import dataclass

from tissue_sim.errors import shown
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.bags.config import organs_of
from tissue_sim.version import __version__

# Where and whether a bag is written changes nothing; an organ is identified by its digest, not by its path.
BESIDE_THE_POINT = frozenset({"record", "record_folder", "record_markers", "organ_file", "scene_file"})
_LONGEST = 200  # characters of a value in a line


@dataclass(frozen=True)
class Described:
    """A run described by what determines its results; `how` names it in a line, as in `recorded 0.6`."""

    how: str
    organ: str
    digest: str
    version: str
    parameters: JsonObject

    @classmethod
    def recorded(cls, config: JsonObject, how: str = "recorded") -> Described:
        """Describe a bag by its configuration. how: what it is called in a line."""
        organs = organs_of(config).values()
        name = config["scene"] if "scene" in config else config["organ"]["name"]
        digest = "".join(organ["digest"] for organ in organs)
        return cls(how, name, digest, config["package_version"], config["parameters"])

    def replayed(self, organ: Organ | None) -> Described:
        """Describe the same run by this package, with another organ if there is one."""
        name, digest = (self.organ, self.digest) if organ is None else (organ.name, organ.digest())
        return Described("replayed with", name, digest, __version__, self.parameters)


def differences(first: Described, second: Described) -> list[str]:
    """Return one line for each difference between two runs."""
    lines = []

    def report(what: str, one: object, other: object) -> None:
        if one != other:
            lines.append(f"{what}: {first.how} {shown(str(one), _LONGEST)}, {second.how} {shown(str(other), _LONGEST)}")

    if first.digest != second.digest:
        report("organ", f"{first.organ} ({first.digest[:12]})", f"{second.organ} ({second.digest[:12]})")
    report("package", f"tissue_sim {first.version}", f"tissue_sim {second.version}")
    names = (first.parameters.keys() | second.parameters.keys()) - BESIDE_THE_POINT
    for name in sorted(names):
        report(f"parameter {name}", *(run.parameters.get(name, "nothing") for run in (first, second)))
    return lines
