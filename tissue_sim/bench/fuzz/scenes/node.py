"""Hostile messages, services and subscribers to a running node, over DDS; afterwards it has to be as before.

Every process of cases has its own node, with one organ or a scene, which lives on from case to case, so that what one
leaves behind, such as memory, is seen by the next ones. After a failure the node is restarted.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from tissue_sim.bench.fuzz.cases import Broken, Case, Input
from tissue_sim.bench.fuzz.scenes.joined import scene_file
from tissue_sim.contact.scene_file import SceneFile
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.ros.probes.graph import NODE, Graph, ticks
from tissue_sim.ros.probes.soak_monitor import resident

if TYPE_CHECKING:
    from tissue_sim.ros.probes.hostile import Hostile
    from tissue_sim.ros.shared.children import Child

SEVERAL = "scene_node"  # the kind of cases whose node has several organs
MOST_ACTS = 3
WARM_CASES = 10  # cases after which a node has allocated everything that it needs
MOST_GROWTH = 40.0  # MB since then
SETTINGS = (
    "tools:=[left, right, jaws]",
    "left.radius:=0.005",
    "right.shape:=capsule",
    "right.radius:=0.003",
    "jaws.shape:=gripper",
    "jaws.radius:=0.003",
    "jaws.length:=0.04",
    *(f"{tool}.external_cf:={tool}/external_cf" for tool in ("left", "right", "jaws")),
    *(f"{tool}.reliable:=true" for tool in ("left", "right", "jaws")),  # so that nothing sent is lost on the way
)


class Served:
    """Node of this process, and its hostile client; several: whether it has several organs."""

    def __init__(self, several: bool) -> None:
        from tissue_sim.ros.probes.hostile import Hostile
        from tissue_sim.ros.shared.client import client_node

        self._stack, self.several = ExitStack(), several
        graph = self._stack.enter_context(Graph())
        if several:
            path = scene_file(Path(self._stack.enter_context(tempfile.TemporaryDirectory())))
            scene = SceneFile.read(path)
            organs = dict(zip(scene.names, scene.organs, strict=True))
        else:
            path = shipped_organ()
            organs = {"": Organ.load(path)}
        self.child: Child = graph.serve(f"scene_file:={path}" if several else f"organ_file:={path}", *SETTINGS)
        ticks(self.child)
        node = self._stack.enter_context(client_node("hostile", NODE))
        self.hostile: Hostile = Hostile(node, NODE, organs)
        self.hostile.meet()
        self.cases, self._memory, self._tick = 0, 0.0, -1
        self.child.errors.clear()

    def close(self) -> None:
        """End both."""
        self._stack.close()

    def check(self) -> str:
        """Check that it lives, has ticked, printed no traceback and leaks no memory. Raises Broken."""
        if self.child.exit_code is not None:
            raise Broken(f"the node has ended: {self.child.last_words()}")
        report = self.hostile.return_to_default_settings()
        lines = [*self.child.output, *self.child.errors]
        if any("Traceback" in line for line in lines):
            raise Broken(f"a traceback: {lines[-1]}")
        if wide := [line for line in lines if len(line) > 1000]:
            raise Broken(f"a line of {len(wide[0])} characters: {wide[0][:60]}")
        self.child.output.clear()
        self.child.errors.clear()
        (memory, _), self.cases = resident(self.child.pid), self.cases + 1
        if self.cases <= WARM_CASES:
            self._memory = max(memory, self._memory)
        elif memory > self._memory + MOST_GROWTH:
            raise Broken(f"{memory:.0f} MB after {self.cases} cases, {self._memory:.0f} MB after {WARM_CASES}")
        hostile = self.hostile
        felt = f"{hostile.wrenches} wrenches, {hostile.felt:.3g} N at most so far"
        felt += f"; got no processor time {hostile.starved} times" if hostile.starved else ""
        return f"{felt}; {memory:.0f} MB after {self.cases} cases; degraded: {report.get('degraded', 'unknown')}"


_served: list[Served] = []  # none or one


def prepare(case: Case, folder: Path) -> Input:
    """Draw up to three acts."""
    from tissue_sim.ros.probes.hostile_actions import ACTS, OF_SCENES, play

    rng, several = case.rng(), case.kind == SEVERAL
    usual = list(ACTS | OF_SCENES) if several else list(ACTS)
    acts = [str(act) for act in rng.choice(usual, size=rng.integers(1, MOST_ACTS + 1))]
    serve(several)

    def use() -> str:
        return used(_served[0], lambda hostile: play(hostile, rng, acts))

    return Input(", ".join(acts), use)


def warm_up(folder: Path) -> None:
    """Do nothing: nodes are started with their first case."""


def serve(several: bool) -> None:
    """Start the node of several organs or of one, unless it runs, in place of the other."""
    if _served and _served[0].several is not several:
        _served.pop().close()
    if not _served:
        _served.append(Served(several))


def used(served: Served, play: Callable[[Hostile], None]) -> str:
    """Play and check; a node that has failed is dropped. Raises Broken."""
    from tissue_sim.ros.probes.hostile import Fault

    try:
        play(served.hostile)
        return served.check()
    except (Broken, Fault, UserError) as error:
        _served.clear()
        words = served.child.last_words() if served.child.exit_code is not None else ""
        served.close()
        raise Broken(f"{error}{f'; the node has ended: {words}' if words else ''}") from None
