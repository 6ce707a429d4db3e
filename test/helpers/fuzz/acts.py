"""What a hostile client does to a node, each for a quarter of a second: mostly it sends messages, over and over."""

import itertools
import struct
import time
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from hypothesis import strategies as st
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from helpers.fuzz.hostile import HIGHEST_CLAMP, LIVE, TOOLS, USUAL_CLAMP, Hostile
from helpers.fuzz.mutations import ODD_FLOATS, Draw, of_bytes, some
from helpers.fuzz.plays import Vector, nodes, powers, quaternions, vectors
from helpers.fuzz.scenes import organ_called
from tissue_sim.ros.probes.graph import NODE
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.parameter_specs import TOOL_SPECS

RESPIRATION = f"/{NODE}/respiration"
JAWS = "jaws/gripper/measured_js"
NOW = b"\x11\x11\x11\x11"  # stands for the time, s, in bytes that are drawn


def play(hostile: Hostile, acts: list["Act"]) -> None:
    """Do them one after the other, and check the result of each."""
    hostile.clamp = USUAL_CLAMP
    for act in acts:
        if isinstance(act, Sets):  # the clamp among others
            hostile.clamp = HIGHEST_CLAMP
        act.play(hostile)
        hostile.look()


# messages -------------------------------------------------------------------------------------------


class Header(NamedTuple):
    """A time, ns, or now without one; later by so much, ns."""

    stamp: int | None = None
    late: int = 0
    frame: str = "organ"


class Pose(NamedTuple):
    """A tool at a place beside a node of the surface, or beside the middle, m."""

    tool: str
    node: int | None
    beside: Vector = (0.0, 0.0, 0.0)
    turn: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    header: Header = Header()

    def send(self, hostile: Hostile) -> None:
        at = hostile.middle if self.node is None else hostile.rest[self.node % len(hostile.rest)]
        hostile.pose(self.tool, at + self.beside, self.turn, *self.header)


class Force(NamedTuple):
    """A force at a tool's tip, N."""

    tool: str
    force: Vector
    header: Header = Header()

    def send(self, hostile: Hostile) -> None:
        hostile.force(self.tool, self.force, *self.header)


class Joint(NamedTuple):
    """The angle between the jaws, rad, or fractions of the breath's displacement, of which the first counts."""

    topic: str
    values: tuple[float, ...]
    header: Header = Header()

    def send(self, hostile: Hostile) -> None:
        message = JointState(name=["joint"], position=list(self.values))
        hostile.publish(self.topic, hostile.stamped(message, *self.header))


class Raw(NamedTuple):
    """Bytes that may be no message."""

    topic: str
    data: bytes

    def send(self, hostile: Hostile) -> None:
        hostile.publish(self.topic, self.data.replace(NOW, struct.pack("<i", int(time.time()))))


Message = Pose | Force | Joint | Raw


# acts -----------------------------------------------------------------------------------------------


class Sends(NamedTuple):
    """Sends messages over and over, with a pause after as many as there are tools, s."""

    messages: tuple[Message, ...]
    pause: float = 0.001

    def play(self, hostile: Hostile) -> None:
        turns = itertools.cycle(self.messages)

        def act() -> None:
            for message in itertools.islice(turns, len(TOOLS)):
                message.send(hostile)

        hostile.during(self.pause, act)


class Races(NamedTuple):
    """Moves two tools through the organ, up to a hundred times as fast as a hand."""

    speed: float  # m/s
    direction: Vector

    def play(self, hostile: Hostile) -> None:
        begun = time.monotonic()

        def act() -> None:
            at = 0.1 * np.sin(10.0 * self.speed * (time.monotonic() - begun)) * np.array(self.direction)
            hostile.pose("left", hostile.middle + at)
            hostile.pose("right", hostile.middle + at + 0.01)

        hostile.during(0.001, act)


class Floods(NamedTuple):
    """Sends as many messages as the process can, on every topic."""

    beside: Vector

    def play(self, hostile: Hostile) -> None:
        made = {
            PoseStamped: hostile.stamped(PoseStamped()),
            WrenchStamped: hostile.stamped(WrenchStamped()),
            JointState: JointState(position=[0.2]),
        }
        place = made[PoseStamped].pose.position
        place.x, place.y, place.z = (hostile.middle + self.beside).tolist()
        made[PoseStamped].pose.orientation.w = 1.0
        made[WrenchStamped].wrench.force.z = 0.1
        raw = {kind: serialize_message(message) for kind, message in made.items()}

        def act() -> None:
            for topic, kind in hostile.topics.items():
                for _ in range(1 if kind is JointState else 20):
                    hostile.publish(topic, raw[kind])

        hostile.during(0.0, act)


class Sets(NamedTuple):
    """Sets parameters, several at once."""

    requests: tuple[tuple[tuple[str, Any], ...], ...]

    def play(self, hostile: Hostile) -> None:
        made = [[Parameter(name, value=value).to_parameter_msg() for name, value in one] for one in self.requests]
        turns = itertools.cycle(made)
        hostile.during(0.0, lambda: hostile.call("set_parameters", SetParameters.Request(parameters=next(turns))))


class Asks(NamedTuple):
    """Calls services in the middle of a touch."""

    names: tuple[str, ...]
    node: int

    def play(self, hostile: Hostile) -> None:
        requests = {
            "reset": Trigger.Request(),
            "list_parameters": ListParameters.Request(prefixes=["x" * 1000], depth=2**40),
            "get_parameters": GetParameters.Request(names=["nothing", "", "tools"] * 20),
        }
        turns = itertools.cycle(self.names)

        def act() -> None:
            Pose("left", self.node).send(hostile)
            name = next(turns)
            hostile.call(name, requests[name])

        hostile.during(0.0, act)


class NeverReads(NamedTuple):
    """Subscribes to everything and takes nothing, while tools race."""

    race: Races

    def play(self, hostile: Hostile) -> None:
        deep = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
        lazy = [
            client.NewestMessage(hostile.node, MarkerArray, f"/{hostile.target}/markers", client.latched_qos()),
            client.NewestMessage(hostile.node, WrenchStamped, "left/servo_cf", client.stream_qos()),
            client.NewestMessage(hostile.node, DiagnosticArray, "/diagnostics", deep),
        ]
        self.race.play(hostile)
        for inbox in lazy:
            inbox.close()


Act = Sends | Races | Floods | Sets | Asks | NeverReads


# what is drawn --------------------------------------------------------------------------------------

tools = st.sampled_from(TOOLS)
anywhere = st.tuples(*[ODD_FLOATS] * 3)
# From 1901 to 2038, as a stamp can be; those of now are a second early to a second late.
stamps = st.sampled_from((0, 1, 10**9, (2**31 - 1) * 10**9, -(10**9), -1)) | st.integers(-(2**60), 2**60)
now = st.just(Header())
times = stamps.map(Header) | st.integers(-(10**9), 10**9).map(lambda late: Header(late=late))
texts = st.sampled_from(("", "map", "organ ", "/organ", "x" * 10_000, "ü" * 3000, "a\nb\x1b[31m", "%s%n", "organ/../x"))
texts |= st.text(st.characters(codec="utf-8", exclude_characters="\0"))
frames = texts.map(lambda frame: Header(frame=frame))
near = st.builds(Pose, tools, nodes, vectors(0.03), quaternions, now)


def several(*messages: st.SearchStrategy[Message], pause: float = 0.001) -> st.SearchStrategy[Sends]:
    """Some of these messages, over and over."""
    drawn = st.lists(st.one_of(*messages), min_size=1, max_size=20).map(tuple)
    return st.builds(Sends, drawn, st.just(pause))


@st.composite
def _at_one_place(draw: Draw) -> Sends:
    """All tools in one place at or in the organ, where they spin, or push and are pushed with up to 1e9 N."""
    at = some(draw, (draw(nodes), None))
    beside = (0.0, 0.0, 0.0) if at is not None else draw(vectors(0.005))
    size = draw(powers(0.0, 9.0))
    made: list[Message] = []
    for tool in TOOLS:
        made += [Pose(tool, at, beside, turn) for turn in draw(st.lists(quaternions, min_size=1, max_size=5))]
        pushes = draw(st.lists(vectors(size), max_size=2))
        made += [Force(tool, push) for push in pushes]
    return Sends(tuple(made))


@st.composite
def _snaps(draw: Draw) -> Sends:
    """Closes jaws through each other, and opens them beyond all measure, around tissue."""
    angles = st.sampled_from((-10.0, -0.5, 0.0, 0.5, 7.0)) | ODD_FLOATS
    at = draw(nodes)
    drawn = draw(st.lists(angles, min_size=1, max_size=10))
    return Sends(tuple(one for angle in drawn for one in (Joint(JAWS, (angle,)), Pose("jaws", at))))


OF_ORGAN = ("left/measured_cp", "left/external_cf", JAWS)


@cache
def _good() -> dict[str, bytes]:
    """A message that a node would use, of each topic."""
    made: dict[str, Any] = {
        "left/measured_cp": PoseStamped(),
        "left/external_cf": WrenchStamped(),
        JAWS: JointState(name=["jaw"], position=[0.3]),
        RESPIRATION: JointState(name=["breath"], position=[0.5]),
    }
    pose = made["left/measured_cp"].pose
    pose.position.x, pose.position.y, pose.position.z = organ_called("kidney").surface_positions.mean(axis=0).tolist()
    pose.orientation.w = 1.0
    for message in made.values():
        message.header.frame_id, message.header.stamp.sec = "organ", int.from_bytes(NOW, "little")
    return {topic: serialize_message(message) for topic, message in made.items()}


@st.composite
def _raw(draw: Draw, topics: tuple[str, ...]) -> Raw:
    """CDR cut short, with wrong lengths, of the other byte order, or no CDR at all."""
    topic = some(draw, topics)
    if draw(st.integers(0, 5)) == 5:
        return Raw(topic, draw(st.binary(max_size=500)))
    return Raw(topic, of_bytes(draw, _good()[topic]))


_NAMES = [*LIVE, *(f"{tool}.{spec.name}" for tool in TOOLS for spec in TOOL_SPECS), "rate", "model", "nothing"]
_STRANGE = (True, -1, 0, 10**12, 1.0, 1e308, float("nan"), "", "x" * 10_000, [1.0, 2.0], ["a"], [True], [b"\0"])


@st.composite
def _setting(draw: Draw) -> tuple[str, Any]:
    """A parameter in or out of its range, or of another type."""
    name = some(draw, _NAMES)
    spec = LIVE.get(name)
    if spec is not None and spec.low is not None and spec.high is not None and draw(st.booleans()):
        return name, type(spec.default)(draw(st.floats(spec.low, spec.high)))
    return name, some(draw, _STRANGE)


def acts(scene: bool) -> st.SearchStrategy[list[Act]]:
    """One to three acts on a node of one organ, or of a scene that breathes."""
    races = st.builds(Races, st.floats(5.0, 50.0), quaternions.map(lambda four: four[:3]))
    values = st.floats(0.0, 1.0) | ODD_FLOATS
    breaths = values.map(lambda one: (one,)) | st.just(()) | values.map(lambda one: (one,) * 1000)
    pants = st.builds(Joint, st.just(RESPIRATION), breaths, now | times)
    kinds: dict[str, st.SearchStrategy] = {
        "teleports": several(near),
        "stays": _at_one_place(),
        "races": races,
        "snaps": _snaps(),
        "sends nonsense": several(
            st.builds(Pose, tools, nodes, anywhere, quaternions | st.tuples(*[ODD_FLOATS] * 4), now),
            st.builds(Force, tools, anywhere, now),
        ),
        "stamps wildly": several(st.builds(Pose, tools, nodes, vectors(0.03), quaternions, times)),
        "names frames": several(
            st.builds(Pose, tools, nodes, vectors(0.03), quaternions, frames),
            st.builds(Force, tools, vectors(), frames),
        ),
        "floods": st.builds(Floods, vectors(0.05)),
        "sends bytes": several(_raw((*OF_ORGAN, RESPIRATION) if scene else OF_ORGAN), pause=0.0005),
        "sets parameters": st.builds(
            Sets, st.lists(st.lists(_setting(), min_size=1, max_size=4).map(tuple), min_size=1, max_size=20).map(tuple)
        ),
        "asks": st.builds(
            Asks,
            st.lists(st.sampled_from(("reset", "list_parameters", "get_parameters")), min_size=1).map(tuple),
            nodes,
        ),
        "never reads": st.builds(NeverReads, races),
    }
    if scene:
        kinds["pants"] = several(pants)
    return st.lists(st.sampled_from(list(kinds)).flatmap(kinds.__getitem__), min_size=1, max_size=3)
