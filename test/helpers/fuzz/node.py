"""A running node, over DDS, under a hostile client; afterwards it has to be as before.

The child that plays has its own node, with one organ or a scene, which lives on from play to play, so that what one
leaves behind, such as memory, is seen by the next ones. After a failure the node is restarted.
"""

import tempfile
from contextlib import ExitStack
from pathlib import Path

from helpers.fuzz.acts import Act, play
from helpers.fuzz.child import Ready
from helpers.fuzz.hostile import TOOLS, Hostile
from helpers.fuzz.scenes import organ_called, scene_file
from tissue_sim.contact.scene_file import SceneFile
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.ros.probes.graph import NODE, Graph, ticks
from tissue_sim.ros.probes.soak_monitor import resident
from tissue_sim.ros.shared.client import client_node

WARM_PLAYS = 10  # after which a node has allocated everything that it needs
MOST_GROWTH = 40.0  # MB since then
SETTINGS = (
    f"tools:=[{', '.join(TOOLS)}]",
    "left.radius:=0.005",
    "right.shape:=capsule",
    "right.radius:=0.003",
    "jaws.shape:=gripper",
    "jaws.radius:=0.003",
    "jaws.length:=0.04",
    *(f"{tool}.external_cf:={tool}/external_cf" for tool in TOOLS),
    *(f"{tool}.reliable:=true" for tool in TOOLS),  # so that nothing sent is lost on the way
)


class Served:
    """A node of one organ, or of a scene, and its hostile client."""

    def __init__(self, scene: bool) -> None:
        self._stack, self.scene = ExitStack(), scene
        graph = self._stack.enter_context(Graph())
        if scene:
            path = scene_file(Path(self._stack.enter_context(tempfile.TemporaryDirectory())))
            read = SceneFile.read(path)
            organs = dict(zip(read.names, read.organs, strict=True))
        else:
            path, organs = shipped_organ(), {"": organ_called("kidney")}
        self.child = graph.serve(f"{'scene' if scene else 'organ'}_file:={path}", *SETTINGS)
        ticks(self.child)
        self.hostile = Hostile(self._stack.enter_context(client_node("hostile", NODE)), NODE, organs)
        self.hostile.meet()
        self._plays, self._memory = 0, 0.0
        self.child.errors.clear()

    def close(self) -> None:
        """End both."""
        self._stack.close()

    def check(self) -> str:
        """Check that it lives, has ticked, printed no traceback and leaks no memory."""
        assert self.child.exit_code is None, "the node has ended"
        self.hostile.return_to_default_settings()
        lines = [*self.child.output, *self.child.errors]
        assert not any("Traceback" in line for line in lines), f"a traceback: {lines[-1]}"
        wide = [line for line in lines if len(line) > 1000]
        assert not wide, f"a line of {len(wide[0])} characters: {wide[0][:60]}"
        self.child.output.clear()
        self.child.errors.clear()
        (memory, _), self._plays = resident(self.child.pid), self._plays + 1
        if self._plays <= WARM_PLAYS:
            self._memory = max(memory, self._memory)
        growth = memory - self._memory
        assert growth <= MOST_GROWTH, f"{growth:.0f} MB more after {self._plays} plays than after {WARM_PLAYS}"
        return f"{memory:.0f} MB after {self._plays} plays"


_served: list[Served] = []  # none or one


def prepare(scene: bool, acts: list[Act]) -> Ready:
    """Start the node of a scene or of one organ, unless it runs, in place of the other."""
    if _served and _served[0].scene is not scene:
        _served.pop().close()
    if not _served:
        _served.append(Served(scene))
    return lambda: _use(_served[0], acts)


def _use(served: Served, acts: list[Act]) -> str:
    try:
        play(served.hostile, acts)
        return served.check()
    except Exception as error:
        _served.clear()
        ended = served.child.exit_code is not None
        words = f"; the node has ended: {served.child.last_words()}" if ended else ""
        served.close()
        raise AssertionError(f"{error}{words}") from error
