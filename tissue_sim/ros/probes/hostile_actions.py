"""Acts of a hostile client on a node; each lasts for SECONDS."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from tissue_sim.array_types import Floats
from tissue_sim.ros.probes.hostile import HIGHEST_CLAMP, LIVE, TOOLS, USUAL_CLAMP, Hostile, Rng
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.parameters import TOOL_SPECS

WORST = (np.nan, np.inf, -np.inf, 5e-324, -1e308, 1e308, 1e9, 0.0, -0.0, 1e-300)
STORM = "sets parameters"  # the clamp among them


def play(hostile: Hostile, rng: Rng, acts: list[str]) -> None:
    """Play acts of ACTS, or OF_SCENES, one after the other, and check the result of each.

    Parameters
    ----------
    hostile : Hostile
        The client.
    rng : Rng
        Draws what they send.
    acts : list[str]
        Names of the acts.

    Raises
    ------
    Fault
        When the node breaks a promise.
    """
    hostile.clamp = USUAL_CLAMP
    for act in acts:
        if act == STORM:
            hostile.clamp = HIGHEST_CLAMP
        (ACTS | OF_SCENES)[act](hostile, rng)
        hostile.look()


def _teleport(hostile: Hostile, rng: Rng) -> None:
    def act() -> None:
        for tool in TOOLS:
            hostile.poses[tool].publish(hostile.pose(hostile.somewhere(rng), _turn(rng)))

    hostile.during(0.001, act)


def _spin(hostile: Hostile, rng: Rng) -> None:
    at = hostile.rest[rng.integers(len(hostile.rest))]

    def act() -> None:
        for tool in TOOLS:
            hostile.poses[tool].publish(hostile.pose(at, _turn(rng)))

    hostile.during(0.001, act)


def _race(hostile: Hostile, rng: Rng) -> None:
    """Move a hundred times as fast as a hand."""
    speed, way, begun = rng.uniform(5.0, 50.0), _turn(rng)[:3], time.monotonic()

    def act() -> None:
        at = hostile.middle + 0.1 * np.sin(speed * 10.0 * (time.monotonic() - begun)) * way
        hostile.poses["left"].publish(hostile.pose(at, (0, 0, 0, 1)))
        hostile.poses["right"].publish(hostile.pose(at + 0.01, (0, 0, 0, 1)))

    hostile.during(0.001, act)


def _inside(hostile: Hostile, rng: Rng) -> None:
    at = hostile.middle + rng.uniform(-0.005, 0.005, size=3)

    def act() -> None:
        for tool in TOOLS:
            hostile.poses[tool].publish(hostile.pose(at, (0, 0, 0, 1)))

    hostile.during(0.002, act)


def _snap(hostile: Hostile, rng: Rng) -> None:
    """Close jaws through each other, and open them beyond all measure, around tissue."""
    at = hostile.rest[rng.integers(len(hostile.rest))]

    def act() -> None:
        hostile.open_jaws(float(rng.choice([-10.0, -0.5, 0.0, 0.5, 7.0, np.nan, np.inf, 1e300])))
        hostile.poses["jaws"].publish(hostile.pose(at, (0, 0, 0, 1)))

    hostile.during(0.001, act)


def _push(hostile: Hostile, rng: Rng) -> None:
    """Send forces up to 1e9 N, at a tip that touches."""
    at, size = hostile.rest[rng.integers(len(hostile.rest))], 10.0 ** rng.uniform(0.0, 9.0)

    def act() -> None:
        for tool in TOOLS:
            hostile.poses[tool].publish(hostile.pose(at, (0, 0, 0, 1)))
            hostile.forces[tool].publish(hostile.force(size * rng.normal(size=3)))

    hostile.during(0.002, act)


def _nonsense(hostile: Hostile, rng: Rng) -> None:
    """Send numbers that are none, or hardly any."""

    def act() -> None:
        tool, numbers = rng.choice(TOOLS), hostile.somewhere(rng)
        numbers[rng.integers(3)] = rng.choice(WORST)
        turn = _turn(rng)
        if rng.random() < 0.5:
            turn = rng.choice(WORST, size=4)
        hostile.poses[tool].publish(hostile.pose(numbers, turn))
        hostile.forces[tool].publish(hostile.force(rng.choice(WORST, size=3)))

    hostile.during(0.001, act)


def _stamps(hostile: Hostile, rng: Rng) -> None:
    """Send stamps of the past, of the future, zero, and before 1970."""

    def act() -> None:
        stamp = int(rng.choice([0, 1, 10**9, int(time.time() * 1e9), 2**31 * 10**9 - 1, -(10**9), -1]))
        stamp += int(rng.integers(-(10**9), 10**9)) * int(stamp > 10**10 and stamp < 2 * 10**18)
        hostile.poses["left"].publish(hostile.pose(hostile.somewhere(rng), (0, 0, 0, 1), stamp))

    hostile.during(0.001, act)


def _frames(hostile: Hostile, rng: Rng) -> None:
    names = ("", "map", "organ ", "/organ", "x" * 10_000, "\u00fc" * 3000, "a\nb\x1b[31m", "%s%n", "organ/../x")

    def act() -> None:
        frame = str(rng.choice(names))
        hostile.poses["left"].publish(hostile.pose(hostile.somewhere(rng), (0, 0, 0, 1), frame=frame))
        hostile.forces["left"].publish(hostile.force((0, 0, 1), frame))

    hostile.during(0.002, act)


def _flood(hostile: Hostile, rng: Rng) -> None:
    """Send as many messages as this process can, on every topic."""
    pose, force = hostile.pose(hostile.somewhere(rng), (0, 0, 0, 1)), hostile.force((0, 0, 0.1))
    poses, forces, angle = serialize_message(pose), serialize_message(force), JointState(position=[0.2])

    def act() -> None:
        for tool in TOOLS:
            for _ in range(20):
                hostile.poses[tool].publish(poses)
                hostile.forces[tool].publish(forces)
        hostile.angles.publish(angle)
        if hostile.breath is not None:
            hostile.breath.publish(hostile.respiration([0.5]))

    hostile.during(0.0, act)


def _bytes(hostile: Hostile, rng: Rng) -> None:
    """Send CDR cut short, with wrong lengths, of the other byte order, or no CDR at all."""
    good = [
        (hostile.poses["left"], serialize_message(hostile.pose(hostile.middle, (0, 0, 0, 1)))),
        (hostile.forces["left"], serialize_message(hostile.force((0, 0, 1)))),
        (hostile.angles, serialize_message(JointState(name=["jaw"], position=[0.3]))),
    ]
    if hostile.breath is not None:
        good.append((hostile.breath, serialize_message(hostile.respiration([0.5]))))

    def act() -> None:
        publisher, raw = good[rng.integers(len(good))]
        data = bytearray(raw)
        draw = rng.integers(6)
        if draw == 0:
            data = data[: rng.integers(len(data))]
        elif draw == 1:
            struct.pack_into("<I", data, int(rng.choice([12, 16])), int(rng.choice([2**32 - 1, 2**31, 1000, 0])))
        elif draw == 2:
            data[0:4] = bytes(rng.integers(0, 256, size=4, dtype=np.uint8))
        elif draw == 3:
            data = bytearray(rng.bytes(int(rng.integers(0, 2000))))
        else:
            for _ in range(int(rng.integers(1, 20))):
                data[rng.integers(len(data))] = rng.integers(256)
        publisher.publish(bytes(data))

    hostile.during(0.0005, act)


def _parameters(hostile: Hostile, rng: Rng) -> None:
    """Set values in and out of range, and of other types, of every parameter; several at once."""
    names = [*LIVE, *(f"{tool}.{spec.name}" for tool in TOOLS for spec in TOOL_SPECS), "rate", "model", "nothing"]
    strange = (True, -1, 0, 10**12, 1.0, 1e308, float("nan"), "", "x" * 10_000, [1.0, 2.0], ["a"], [True], b"\0")

    def act() -> None:
        asked = []
        for name in rng.choice(names, size=rng.integers(1, 5)):
            spec = LIVE.get(str(name))
            if spec is not None and spec.low is not None and spec.high is not None and rng.random() < 0.6:
                value: Any = type(spec.default)(rng.uniform(spec.low, spec.high))
            else:
                value = strange[rng.integers(len(strange))]
            value = [value] if isinstance(value, bytes) else value
            asked.append(Parameter(str(name), value=value).to_parameter_msg())
        hostile.call("set_parameters", SetParameters.Request(parameters=asked))

    hostile.during(0.0, act)


def _ask(hostile: Hostile, rng: Rng) -> None:
    """Call services in the middle of a touch."""

    def act() -> None:
        hostile.poses["left"].publish(hostile.pose(hostile.somewhere(rng), (0, 0, 0, 1)))
        name = str(rng.choice(["reset", "list_parameters", "get_parameters"]))
        requests = {
            "reset": Trigger.Request(),
            "list_parameters": ListParameters.Request(prefixes=["x" * 1000], depth=2**40),
            "get_parameters": GetParameters.Request(names=["nothing", "", "tools"] * 20),
        }
        hostile.call(name, requests[name])

    hostile.during(0.0, act)


def _never_read(hostile: Hostile, rng: Rng) -> None:
    """Subscribe to everything, and take nothing."""
    deep = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
    lazy = [
        client.NewestMessage(hostile.node, MarkerArray, f"/{hostile.target}/markers", client.latched_qos()),
        client.NewestMessage(hostile.node, WrenchStamped, "left/servo_cf", client.stream_qos()),
        client.NewestMessage(hostile.node, DiagnosticArray, "/diagnostics", deep),
    ]
    _race(hostile, rng)
    for inbox in lazy:
        inbox.close()


def _pant(hostile: Hostile, rng: Rng) -> None:
    """Send a breath that jumps, between invalid fractions and stamps."""
    assert hostile.breath is not None

    def act() -> None:
        assert hostile.breath is not None
        share, stamp = float(rng.choice([0.0, 1.0, rng.random(), *WORST])), None
        shares = [share] * int(rng.choice([0, 1, 1, 1, 1000]))
        if rng.random() < 0.2:
            stamp = int(rng.integers(0, 2**61))
        hostile.breath.publish(hostile.respiration(shares, stamp))

    hostile.during(0.002, act)


def _turn(rng: Rng) -> Floats:
    drawn = rng.normal(size=4)
    return np.asarray(drawn / np.linalg.norm(drawn))


ACTS: dict[str, Callable[[Hostile, Rng], None]] = {
    "teleports": _teleport,
    "spins": _spin,
    "races": _race,
    "is inside": _inside,
    "snaps": _snap,
    "pushes": _push,
    "sends nonsense": _nonsense,
    "stamps wildly": _stamps,
    "names frames": _frames,
    "floods": _flood,
    "sends bytes": _bytes,
    STORM: _parameters,
    "asks": _ask,
    "never reads": _never_read,
}
OF_SCENES = {"pants": _pant}
