"""Alignment of two recordings of the same inputs: by how many ticks one is later than the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissue_sim.errors import UserError
from tissue_sim.ros.bags.recording import Recording, tools_of


@dataclass(frozen=True)
class Alignment:
    """Alignment of two recordings: the second one applied poses `later` ticks later than the first."""

    later: int
    poses: int  # applied in both
    most_apart: int  # largest difference from `later`, ticks
    first_poses: int  # applied in the first

    def line(self) -> str:
        """Return the line that users read."""
        return (
            f"inputs: {self.poses} of {self.first_poses} poses are in both bags, {self.later} ticks later in the"
            f" other one, with a difference of at most {self.most_apart} ticks"
        )


def align(first: Recording, second: Recording) -> Alignment:
    """Align recordings by the ticks that applied the same poses.

    Poses are identified by their values, as some may be lost. Transport over DDS shifts poses by ticks, so the median
    counts.

    first: a recording; second: another recording of the same inputs. Raises UserError when no pose is in both, or the
    tools or surfaces differ.
    """
    if first.config["tools"] != second.config["tools"]:
        tools = (", ".join(one.config["tools"]) for one in (first, second))
        raise UserError(f"the bags have different tools: {' against '.join(tools)}")
    if len(first.organs) != len(second.organs):
        raise UserError(f"the bags have {len(first.organs)} and {len(second.organs)} organs")
    for pair in zip(first.organs, second.organs, strict=True):
        sizes = {len(one.surfaces[0]) for one in pair if one.surfaces}
        if len(sizes) > 1:
            raise UserError(
                f"the bags' surfaces have {' and '.join(map(str, sorted(sizes)))} points: they are of different organs"
            )
    before, after = used_poses(first), used_poses(second)
    both = [key for key in before if key in after]
    if not both:
        raise UserError("the bags have no pose in common: --against needs another recording of the same inputs")
    apart = np.array([after[key] - before[key] for key in both])
    later = int(np.median(apart))
    return Alignment(later, len(both), int(np.abs(apart - later).max()), len(before))


def used_poses(recording: Recording) -> dict[tuple[str, bytes], int]:
    """Return the tick that first applied a pose, by the tool's name and the pose's bytes."""
    found: dict[tuple[str, bytes], int] = {}
    body = 0
    for index, tool in enumerate(tools_of(recording.config)):
        poses = recording.poses[index]
        for tick, number in zip(*recording.used_poses(body, "pose"), strict=True):
            if number in poses:
                found.setdefault((tool.name, poses[number].tobytes()), tick)
        body += tool.n_bodies
    return found
