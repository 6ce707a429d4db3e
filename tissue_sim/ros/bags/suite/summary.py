"""A bag summed up in figures: a change of the model, or of a scene, shows as other figures in a diff."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tissue_sim.json_types import JsonObject
from tissue_sim.model.data.records import copy_of
from tissue_sim.organ.surface_checks import signed_volume
from tissue_sim.ros.bags.player import Player
from tissue_sim.ros.bags.recording import Recording

LOOK_EVERY = 10  # ticks between two checks of the surface


class _Watch:
    """Observer of a replay, called after each of its ticks."""

    def __init__(self, player: Player) -> None:
        self._player, organ = player, player.organs[0].simulation.organ
        self._rest, self._triangles = organ.surface_positions, organ.surface_triangles
        n_tools = len(player.tools.tools)
        self.peak, self.impulse, self.dent = np.zeros(n_tools), np.zeros(n_tools), 0.0
        self.volumes: list[float] = []

    def __call__(self, tick: int) -> None:
        simulation, tools = self._player.organs[0].simulation, self._player.tools
        if simulation.asleep:
            return
        for tool, bodies in enumerate(tools.bodies):
            force = float(np.linalg.norm(simulation.state.wrench[bodies, :3].sum(axis=0)))
            self.peak[tool] = max(self.peak[tool], force)
            self.impulse[tool] += force / simulation.rate
        if tick % LOOK_EVERY == 0:
            surface = simulation.positions[: len(self._rest)]
            self.dent = max(self.dent, float(np.linalg.norm(surface - self._rest, axis=1).max()))
            self.volumes.append(signed_volume(surface, self._triangles))


def figures(recording: Recording, refused: Mapping[str, int]) -> JsonObject:
    """Replay a bag and sum it up: N, N s, mm, percent of the volume, ticks.

    refused: number of inputs that the node refused and the bag therefore lacks, by kind.
    """
    (organ,) = (one.organ() for one in recording.organs)
    player = Player(recording, [organ])
    before = copy_of(player.organs[0].simulation.state.count)
    watch = _Watch(player)
    replayed = player.run(recording.shown(), watch)
    after, volume = (
        player.organs[0].simulation.state.count,
        signed_volume(organ.surface_positions, organ.surface_triangles),
    )
    found: JsonObject = {"organ": recording.config["organ"]["digest"][:12], "ticks": replayed.ticks}
    found |= {"ticks asleep": int(after.asleep_ticks - before.asleep_ticks), "inputs": replayed.inputs}
    found |= {"contact sets": replayed.contact_sets, "faults": int(after.faults - before.faults)}
    for tool, name in enumerate(recording.config["tools"]):
        if watch.peak[tool] > 0.0:
            found[f"{name}: peak force"] = f"{watch.peak[tool]:.3g} N"
            found[f"{name}: impulse"] = f"{watch.impulse[tool]:.3g} N s"
    changes = [100.0 * (one / volume - 1.0) for one in watch.volumes] or [0.0]
    found["farthest from rest"] = f"{1e3 * watch.dent:.3g} mm"
    found["volume"] = f"{min(changes):+.2f} to {max(changes):+.2f} %"
    found["refused"] = ", ".join(f"{kind} {count}" for kind, count in sorted(refused.items())) or "none"
    return found


def as_text(scenes: Mapping[str, tuple[str, JsonObject]]) -> str:
    """Return the summary, of a description and figures of each scene, by its name, as text."""
    parts = []
    for name, (what, found) in scenes.items():
        rows = "".join(f"  {key + ':':<24} {value}\n" for key, value in found.items())
        parts.append(f"{name}: {what}\n{rows}")
    return "\n".join(parts)
