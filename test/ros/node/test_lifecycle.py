"""How the node starts, lives beside others, changes while it runs, and ends: real processes."""

import re
import signal
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.qos import qos_profile_sensor_data
from rosbags.rosbag2 import Reader

from helpers.patience import LIMIT, wait_for
from helpers.ros.clients import Client
from helpers.ros.processes import (
    PUSHED,
    READY,
    UNHURRIED,
    Process,
    poke_path,
    press_until_contact,
    running_node,
    shipped,
    start_node,
    stopped,
)
from helpers.ros.replaying import repeated
from helpers.scenes import ball
from tissue_sim.cli import main
from tissue_sim.model.joined import Joined
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.ros.bags import spool
from tissue_sim.ros.bags.recorder import Recorder
from tissue_sim.ros.bags.writer import BagWriter
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.organs import Organs
from tissue_sim.ros.shared.tool_topics import TOOL_TOPICS

AWAY = (1.0, 0.0, 0.0)  # m, far from the organ


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lifecycle")
    with running_node(folder, UNHURRIED, f"record_folder:={folder / 'bags'}") as process:
        yield process


@pytest.fixture(scope="module")
def client(node):
    # On a busy machine the node publishes its first markers late; who subscribes before leaves it none to skip.
    first = Client(markers=False)
    assert first.spin_until(lambda: int(first.diagnostics.get("skipped.no_subscriber", 0)) > 0)
    first.close()
    client = Client()
    client.meet()
    yield client
    client.close()


def counter(client, name):
    return int(client.diagnostics[name])


# skips -----------------------------------------------------------------------------------------
def test_every_skip_has_a_counter_that_counts(client):
    """Asleep organ, no subscriber, nothing moved, unchanged mesh; then a tool far away. A small load: see below."""
    names = ("asleep", "no_subscriber", "nothing_moved", "mesh_unchanged", "tool_far", "small_load")
    assert {f"skipped.{name}" for name in names} <= set(client.diagnostics)
    assert counter(client, "skipped.no_subscriber") > 0, "nobody looked before this test"
    before = {name: counter(client, f"skipped.{name}") for name in ("asleep", "nothing_moved", "mesh_unchanged")}

    def stand():
        return [name for name, count in before.items() if counter(client, f"skipped.{name}") <= count]

    assert client.spin_until(lambda: not stand()), stand()
    push_from_afar(client)


def push_from_afar(client):
    """Until the node has counted that a tool is too far away to look for contacts."""
    far, small = counter(client, "skipped.tool_far"), counter(client, "skipped.small_load")

    def is_counted():
        client.send_pose(AWAY)
        return counter(client, "skipped.tool_far") > far

    assert client.spin_until(is_counted)
    assert counter(client, "skipped.small_load") == small


@pytest.mark.extended
def test_a_small_load_that_moves_a_local_region_is_counted_and_its_bag_repeats(tmp_path, capsys):
    """A loop with local regions is compiled for nothing else; test/model shows that such ticks are counted."""
    words = "model:=hybrid", "local_region:=frozen", UNHURRIED, PUSHED, f"record_folder:={tmp_path / 'bags'}"
    # In a namespace: the other node of this file is there, too.
    with running_node(tmp_path, *words, remap=("__ns:=/small",)):
        client = Client("/small")
        try:
            client.meet()
            push_from_afar(client)
            small = counter(client, "skipped.small_load")
            touch, inward = poke_path(shipped(), radius=0.0)

            def push_softly():
                client.send_pose(touch - 0.0055 * inward)  # the tip stays clear of the surface
                client.send_force(0.05 * inward)
                return counter(client, "skipped.small_load") > small

            assert client.spin_until(push_softly), client.diagnostics
            change_rate_and_replay(client, capsys)
        finally:
            client.close()


def hold_up(child, seconds):
    """Stop a process for so many s, counted from when it stands."""
    with stopped(child.pid):
        time.sleep(seconds)


def test_time_that_was_lost_is_reported(client, node):
    """A process that is held up for a second is behind, and drops ticks: the next diagnostics warn."""
    dropped = int(client.report()["dropped_ticks"])
    reports = []

    def is_reported():
        """Hold it up again where no report said so: the one that does may be lost."""
        hold_up(node.child, 1.0)
        reports[:] = [(client.report(), client.level, client.message) for _ in range(3)]
        behind, factors = (
            [float(values[name]) for values, *_ in reports] for name in ("behind_ms", "real_time_factor")
        )
        return counter(client, "dropped_ticks") > dropped and max(behind) > 900.0 and min(factors) < 0.9

    assert client.spin_until(is_reported), reports
    # At the lowest rate that a slow machine is given, a tick is 8 ms.
    assert counter(client, "dropped_ticks") - dropped > 0.9 / 0.008
    values, level, message = max(reports, key=lambda report: float(report[0]["behind_ms"]))
    assert level == DiagnosticStatus.WARN
    assert f"{float(values['behind_ms']):.1f} ms behind" in message
    assert "dropped_ticks" in "".join(message for *_, message in reports)


# changes while it runs -------------------------------------------------------------------------
@pytest.mark.extended
def test_rate_changes_live_and_the_bag_repeats(client, capsys):
    change_rate_and_replay(client, capsys)
    for wrong in (10.0, 1e5):
        assert not client.set_parameter("rate", wrong).successful


def change_rate_and_replay(client, capsys):
    """Record a press in which the rate changes; the bag repeats bit for bit."""
    started = client.record(True)
    assert started.success, started.message
    position = press_until_contact(client, client.ask, deepest=0.004)
    assert client.spin_until(lambda: client.ask(position) or client.hand_force() > 0.05)
    for rate in (500.0, 1000.0):
        assert client.set_parameter("rate", rate).successful
        tick = int(client.report()["tick"])
        assert client.spin_until(lambda then=tick: client.ask(position) or counter(client, "tick") > then + 200)
    touch, inward = poke_path(shipped())
    for depth in np.linspace(0.004, -0.008, 100):
        client.ask(touch + depth * inward)
    assert client.record(False).success
    repeated(started.message, capsys)


RANGES = {"friction": 6.0, "stiffness_scale": 0.0, "damping_scale": -1.0, "marker_rate": 0.0, "contact_rate": 5000.0}


@pytest.mark.parametrize("name", RANGES)
def test_live_parameters_keep_to_their_range(client, name):
    assert not client.set_parameter(name, RANGES[name]).successful
    assert client.set_parameter(name, {"marker_rate": 60.0, "contact_rate": 250.0}.get(name, 1.0)).successful


# beside others ---------------------------------------------------------------------------------
def test_second_node_of_the_same_name_is_noticed(client, node):
    """One line with the remedy, a warning in diagnostics while it lasts."""
    twin = rclpy.create_node("tissue_sim", context=client.context)
    assert client.spin_until(lambda: counter(client, "same_name_nodes") == 1)
    assert client.level == DiagnosticStatus.WARN
    assert "another node has the name /tissue_sim" in client.message
    lines = [line for line in node.text().splitlines() if "another node has the name" in line]
    assert len(lines) == 1
    assert "-r __node:=" in lines[0]
    assert "-r __ns:=" in lines[0]
    twin.destroy_node()
    assert client.spin_until(lambda: counter(client, "same_name_nodes") == 0)


class Pair(NamedTuple):
    folders: list[Path]
    nodes: list[Process]
    clients: list[Client]


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Two nodes with two organs, each recording in a folder of its own, and a client of each."""
    other = shipped_organ().with_name("kidney_as_built.npz")
    words = {"a": ("tools:=[left]",), "b": ("tools:=[left, right]", f"organ_file:={other}")}
    rules = {"a": ("__ns:=/a",), "b": ("__ns:=/b", "right/servo_cf:=renamed")}
    made = Pair([tmp_path_factory.mktemp(name) for name in "ab"], [], [])
    try:
        for name, folder in zip("ab", made.folders, strict=True):
            recording = ("record:=true", f"record_folder:={folder}", "marker_rate:=5.0", UNHURRIED)
            made.nodes.append(start_node(folder, *words[name], *recording, remap=rules[name], wait=False))
        for name, process in zip("ab", made.nodes, strict=True):
            process.wait_for(READY)
            made.clients.append(Client(f"/{name}"))
        for client in made.clients:
            assert client.spin_until(lambda c=client: c.pose.get_subscription_count() > 0 and c.diagnostics)
        yield made
    finally:
        for client in made.clients:
            client.close()
        for process in made.nodes:
            process.child.kill()
            process.child.wait()


def test_two_nodes_with_two_organs_run_side_by_side(pair):
    """Namespaces keep their forces apart; a remapped topic goes where it was sent."""
    first, second = pair.clients
    received = []
    second.node.create_subscription(WrenchStamped, "renamed", received.append, qos_profile_sensor_data)
    right = second.node.create_publisher(PoseStamped, "right/measured_cp", qos_profile_sensor_data)
    assert second.spin_until(lambda: right.get_subscription_count() > 0)
    away = PoseStamped()
    away.header.frame_id, away.pose.position.x, away.pose.orientation.w = "organ", AWAY[0], 1.0

    def move(position):
        first.send_pose(position)
        away.header.stamp = second.stamp()
        right.publish(away)
        for client in pair.clients:
            client.spin(0.003)

    position = press_until_contact(first, move)

    def are_reported():
        move(position)
        return len(received) > 50 and counter(second, "right.poses") > 50 and counter(first, "left.poses") > 50

    assert first.spin_until(are_reported), "DDS never brings the remapped topic together"
    assert all(message.wrench.force.x == 0.0 for message in received)
    assert second.node.count_publishers("/b/right/servo_cf") == 0, "it goes by another name"
    assert not second.wrenches, "nobody moves its other tool"
    for client, process in zip(pair.clients, pair.nodes, strict=True):
        assert counter(client, "same_name_nodes") == 0
        assert "another node" not in process.text()


# the end ---------------------------------------------------------------------------------------
@pytest.mark.parametrize(("one", "number"), [(0, signal.SIGINT), (1, signal.SIGTERM)], ids=["SIGINT", "SIGTERM"])
def test_signal_under_load_zeroes_the_wrench_and_closes_the_bag(pair, one, number):
    client, process = pair.clients[one], pair.nodes[one]
    client.wrenches.clear()
    position = press_until_contact(client, client.ask)
    for _ in range(20):
        client.ask(position)
    process.child.send_signal(number)

    def is_over():
        client.send_pose(position)
        client.spin(0.002)
        return process.child.poll() is not None

    assert client.spin_until(is_over), process.text()
    assert process.stop() == 0, process.text()
    assert client.spin_until(lambda: np.all(client.wrenches[-1][1] == 0.0))
    (folder,) = pair.folders[one].glob("tissue_sim-*")
    if "the disk doesn't answer" in process.text():  # it had a moment only; what is there is made whole again
        assert main(["replay", str(folder)]) == 0
        return
    closed = re.search(rf"bag closed: {folder}(?:, without (\d+) messages)?\n", process.text())
    assert closed, process.text()
    with Reader(folder) as reader:
        topic = f"{client.node.get_namespace()}/left/servo_cf"
        kept = sum(one.msgcount for one in reader.connections if one.topic == topic)
    left_out = int(closed[1] or 0)  # by a disk that is too slow
    assert kept + left_out >= 0.9 * len(client.wrenches) > 9, "the forces are in the bag"


@pytest.mark.extended
def test_signal_while_kernels_compile_ends_it(tmp_path, start):
    """In the compiler no Python handler runs; there is no bag yet, and nothing to zero."""
    processes = {}
    for number in (signal.SIGINT, signal.SIGTERM):
        folder = tmp_path / number.name
        folder.mkdir()
        processes[number] = start(folder, wait=False, NUMBA_CACHE_DIR=str(folder / "cache"))
    for process in processes.values():
        process.wait_for("compiling the kernels")
    for number, process in processes.items():
        time.sleep(1.0)  # somewhere in the compiler
        assert process.stop(number) == 0, process.text()
        assert "Traceback" not in process.text()


def hears(process):
    """Whether a process that runs has come to handle SIGTERM itself, which Python does not."""
    try:
        status = Path(f"/proc/{process.child.pid}/status").read_text()
    except FileNotFoundError:
        return False
    caught = re.search(r"SigCgt:\s*(\w+)", status)
    return caught is not None and bool(int(caught[1], 16) >> (signal.SIGTERM - 1) & 1)


OTHERS = [pytest.param(delay, marks=pytest.mark.extended) for delay in (0.4, 0.8, 1.6, 2.0)]


@pytest.mark.parametrize("delay", [1.2, *OTHERS])
def test_signal_while_loading_ends_it(tmp_path, start, delay):
    """While Python itself starts, twice over the wheels, the signal ends it as it does every program.

    There Python can lose a KeyboardInterrupt: who sent it would send it again. From the program's first line on, one
    signal is enough.
    """
    processes = {}
    for number in (signal.SIGINT, signal.SIGTERM):
        (tmp_path / number.name).mkdir()
        processes[number] = start(tmp_path / number.name, wait=False)
    time.sleep(delay)
    for number, process in processes.items():
        is_ready = hears(process)
        process.child.send_signal(number)
        if not is_ready:
            wait_for(lambda one=process: one.child.poll() is not None or hears(one))
        code = process.wait() if is_ready else process.stop(number)
        assert code in (0, -number), process.text()
        assert "Traceback" not in process.text() or code == -number


def test_bag_with_a_full_queue_is_closed_without_the_rest(tmp_path, monkeypatch):
    """What a slow disk can't take in time is left out and counted; the bag can be read."""
    simulation = Simulation(ball(2))
    loop = Loop(Joined([simulation]))
    recorder = Recorder("/tissue_sim", Organs(loop), [""], {"tools": ["left"]})
    for topic in TOOL_TOPICS:
        recorder.add_topic("left", topic, f"/left/{topic}")
    write = BagWriter.write

    def slowly(self, *words):
        time.sleep(0.002)
        write(self, *words)

    monkeypatch.setattr(BagWriter, "write", slowly)
    monkeypatch.setattr(spool, "CLOSING_TIME", LIMIT)
    loop.start()
    path = recorder.start(tmp_path, {})
    for _ in range(20_000):
        recorder.received("/left/measured_cp", b"\0" * 64)
    assert recorder.stop(0.3) == path
    loop.stop()
    assert recorder.error == ""
    assert 10_000 < recorder.lost < 20_000
    with Reader(path) as reader:
        assert reader.message_count + recorder.lost > 20_000
