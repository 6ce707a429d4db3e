"""How the node starts, lives beside others, changes while it runs, and ends: real processes."""

import os
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
from rosbags.rosbag2 import Reader, Writer

from helpers.ros.clients import Client
from helpers.ros.processes import (
    READY,
    Process,
    poke_path,
    press_until_felt,
    running_node,
    shipped,
    start_node,
    start_publisher,
)
from helpers.scenes import ball
from tissue_sim.cli import main
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.ros.bags.recorder import Recorder
from tissue_sim.ros.shared.physics import Physics
from tissue_sim.ros.shared.tool_topics import TOOL_TOPICS

AWAY = (1.0, 0.0, 0.0)  # m, far from the organ


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    """A node whose small loads move a local region."""
    folder = tmp_path_factory.mktemp("lifecycle")
    with running_node(folder, "local_region:=frozen", f"record_folder:={folder / 'bags'}") as process:
        yield process


@pytest.fixture(scope="module")
def client(node):
    client = Client()
    assert client.spin_until(lambda: client.pose.get_subscription_count() > 0 and client.diagnostics, 20.0)
    yield client
    client.close()


def counter(client, name):
    return int(client.diagnostics[name])


# skips -----------------------------------------------------------------------------------------
def test_every_skip_has_a_counter_that_counts(client):
    """Asleep organ, no subscriber, nothing moved, unchanged mesh; then a tool far away, then a small load."""
    names = ("asleep", "no_subscriber", "nothing_moved", "mesh_unchanged", "tool_far", "small_load")
    assert {f"skipped.{name}" for name in names} <= set(client.diagnostics)
    assert counter(client, "skipped.no_subscriber") > 0, "nobody looked before this test"
    for name in ("asleep", "nothing_moved", "mesh_unchanged"):
        before = counter(client, f"skipped.{name}")
        assert client.spin_until(lambda b=before, n=name: counter(client, f"skipped.{n}") > b, 3.0), name
    far, small = counter(client, "skipped.tool_far"), counter(client, "skipped.small_load")

    def push_from_afar():
        client.send_pose(AWAY)
        return counter(client, "skipped.tool_far") > far

    assert client.spin_until(push_from_afar, 5.0)
    assert counter(client, "skipped.small_load") == small
    touch, inward = poke_path(shipped(), radius=0.0)

    def push_softly():
        client.send_pose(touch - 0.0055 * inward)  # the tip stays clear of the surface
        client.send_force(0.05 * inward)
        return counter(client, "skipped.small_load") > small

    assert client.spin_until(push_softly, 5.0), client.diagnostics


def cpu_seconds(pid):
    """Processor time of a process, s."""
    threads = Path(f"/proc/{pid}/task").glob("*/schedstat")
    return 1e-9 * sum(int(thread.read_text().split()[0]) for thread in threads)


@pytest.mark.skipif(not Path("/proc/self/schedstat").exists(), reason="the kernel keeps no schedstat")
def test_idle_node_with_a_viewer_costs_under_3_percent_of_a_core(client, node):
    """Nothing sent for a while; a machine under load makes every wake-up dearer, so the best of some counts."""
    client.spin(0.5)
    shares = []
    for _ in range(4):
        begin, spent = time.monotonic(), cpu_seconds(node.child.pid)
        client.spin(2.0)
        shares.append((cpu_seconds(node.child.pid) - spent) / (time.monotonic() - begin))
        if shares[-1] < 0.03:
            break
    print(f"\nidle, with a viewer: {100 * min(shares):.1f} % of a core")
    assert min(shares) < 0.03, shares


def test_time_that_was_lost_is_told(client, node):
    """A process that is held up for 0.2 s is behind, and drops ticks: diagnostics warn within a second."""
    assert client.spin_until(lambda: int(client.diagnostics["tick"]) > 0, 3.0)
    dropped = counter(client, "dropped_ticks")
    os.kill(node.child.pid, signal.SIGSTOP)
    time.sleep(0.2)
    os.kill(node.child.pid, signal.SIGCONT)
    assert client.spin_until(lambda: counter(client, "dropped_ticks") > dropped, 3.0)
    behind, factor = float(client.diagnostics["behind_ms"]), float(client.diagnostics["real_time_factor"])
    assert counter(client, "dropped_ticks") - dropped > 150
    assert behind > 190.0
    assert factor < 0.9
    assert client.level == DiagnosticStatus.WARN
    assert f"{behind:.1f} ms behind" in client.message
    assert "dropped_ticks" in client.message


# changes while it runs -------------------------------------------------------------------------
def test_rate_changes_live_and_the_bag_repeats(client, tmp_path, capsys):
    started = client.record(True)
    assert started.success, started.message
    publisher = start_publisher(tmp_path, depth=0.004, seconds=3.0)
    client.spin(1.2)
    assert client.set_parameter("rate", 500.0).successful
    assert client.spin_until(lambda: abs(float(client.diagnostics["tick_rate_hz"]) - 500.0) < 60.0, 6.0)
    assert abs(float(client.diagnostics["real_time_factor"]) - 1.0) < 0.35, "neither half nor double"
    assert client.set_parameter("rate", 1000.0).successful
    client.spin_until(lambda: publisher.child.poll() is not None, 20.0)
    assert publisher.stop() == 0
    assert client.record(False).success
    assert max(np.linalg.norm(wrench[:3]) for _, wrench in client.wrenches) > 0.05
    assert main(["replay", started.message, "--force-tolerance", "0", "--position-tolerance", "0"]) == 0
    assert "repeats" in capsys.readouterr().out
    for wrong in (10.0, 1e5):
        assert not client.set_parameter("rate", wrong).successful


RANGES = {"friction": 6.0, "stiffness_scale": 0.0, "damping_scale": -1.0, "marker_rate": 0.0, "contact_rate": 5000.0}


@pytest.mark.parametrize("name", RANGES)
def test_live_parameters_keep_to_their_range(client, name):
    assert not client.set_parameter(name, RANGES[name]).successful
    assert client.set_parameter(name, {"marker_rate": 60.0, "contact_rate": 250.0}.get(name, 1.0)).successful


# beside others ---------------------------------------------------------------------------------
def test_second_node_of_the_same_name_is_noticed(client, node):
    """One line with the remedy, a warning in diagnostics while it lasts."""
    twin = rclpy.create_node("tissue_sim", context=client.context)
    assert client.spin_until(lambda: counter(client, "same_name_nodes") == 1, 5.0)
    assert client.level == DiagnosticStatus.WARN
    assert "another node is called /tissue_sim" in client.message
    lines = [line for line in node.text().splitlines() if "another node is called" in line]
    assert len(lines) == 1
    assert "-r __node:=" in lines[0]
    assert "-r __ns:=" in lines[0]
    twin.destroy_node()
    assert client.spin_until(lambda: counter(client, "same_name_nodes") == 0, 5.0)


class Pair(NamedTuple):
    folders: list[Path]
    nodes: list[Process]
    clients: list[Client]


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Two nodes with two organs, each recording in a folder of its own, and a client of each."""
    other = shipped_organ().with_name("kidney_as_built.npz")
    words = {"a": ("tools:=[left]",), "b": ("tools:=[left, right]", f"organ_file:={other}")}
    rules = {"a": ("__ns:=/a",), "b": ("__ns:=/b", "right/servo_cf:=felt")}
    made = Pair([tmp_path_factory.mktemp(name) for name in "ab"], [], [])
    try:
        for name, folder in zip("ab", made.folders, strict=True):
            recording = ("record:=true", f"record_folder:={folder}", "marker_rate:=5.0")
            made.nodes.append(start_node(folder, *words[name], *recording, remap=rules[name], wait=False))
        for name, process in zip("ab", made.nodes, strict=True):
            process.wait_for(READY)
            made.clients.append(Client(f"/{name}"))
        for client in made.clients:
            assert client.spin_until(lambda c=client: c.pose.get_subscription_count() > 0 and c.diagnostics, 20.0)
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
    felt = []
    second.node.create_subscription(WrenchStamped, "felt", felt.append, qos_profile_sensor_data)
    right = second.node.create_publisher(PoseStamped, "right/measured_cp", qos_profile_sensor_data)
    assert second.spin_until(lambda: right.get_subscription_count() > 0, 10.0)
    away = PoseStamped()
    away.header.frame_id, away.pose.position.x, away.pose.orientation.w = "organ", AWAY[0], 1.0

    def move(position):
        first.send_pose(position)
        away.header.stamp = second.stamp()
        right.publish(away)
        for client in pair.clients:
            client.spin(0.003)

    position = press_until_felt(first, move)
    end = time.monotonic() + 10.0
    while len(felt) <= 50 and time.monotonic() < end:  # DDS may bring the topic together late
        move(position)
    first.spin(1.1)
    second.spin(1.1)
    assert len(felt) > 50
    assert all(message.wrench.force.x == 0.0 for message in felt)
    assert second.node.count_publishers("/b/right/servo_cf") == 0, "it goes by another name"
    assert not second.wrenches, "nobody moves its other tool"
    assert counter(second, "right.poses") > 50
    assert counter(first, "left.poses") > 50
    for client, process in zip(pair.clients, pair.nodes, strict=True):
        assert counter(client, "same_name_nodes") == 0
        assert "another node" not in process.text()


# the end ---------------------------------------------------------------------------------------
def end_of(process, number):
    """Exit code after a signal, and how long it took, s."""
    begin = time.monotonic()
    return process.stop(number), time.monotonic() - begin


@pytest.mark.parametrize(("one", "number"), [(0, signal.SIGINT), (1, signal.SIGTERM)], ids=["SIGINT", "SIGTERM"])
def test_signal_under_load_zeroes_the_wrench_and_closes_the_bag(pair, one, number):
    client, process = pair.clients[one], pair.nodes[one]
    client.spin(0.2)
    client.wrenches.clear()
    position = press_until_felt(client, lambda position: (client.send_pose(position), client.spin(0.005)))
    process.child.send_signal(number)
    begin = time.monotonic()
    while process.child.poll() is None and time.monotonic() - begin < 5.0:
        client.send_pose(position)
        client.spin(0.002)
    taken = time.monotonic() - begin
    print(f"\n{number.name}: over after {taken:.2f} s")
    assert taken < 1.0, process.text()
    assert process.stop() == 0, process.text()
    client.spin(0.1)
    assert np.all(client.wrenches[-1][1] == 0.0)
    (folder,) = pair.folders[one].glob("tissue_sim-*")
    assert f"bag closed: {folder}" in process.text()
    with Reader(folder) as reader:
        topic = f"{client.node.get_namespace()}/left/servo_cf"
        kept = sum(one.msgcount for one in reader.connections if one.topic == topic)
    assert kept >= 0.9 * len(client.wrenches) > 9, "what was felt is in the bag"


def test_signal_while_kernels_compile_ends_at_once(tmp_path, start):
    """In the compiler no Python handler runs; there is no bag yet, and nothing to zero."""
    processes = {}
    for number in (signal.SIGINT, signal.SIGTERM):
        folder = tmp_path / number.name
        folder.mkdir()
        processes[number] = start(folder, wait=False, NUMBA_CACHE_DIR=str(folder / "cache"))
    for process in processes.values():
        process.wait_for("compiling the kernels")
    for number, process in processes.items():
        time.sleep(2.0)
        code, seconds = end_of(process, number)
        assert code == 0, process.text()
        assert seconds < 1.0
        assert "Traceback" not in process.text()


@pytest.mark.parametrize("delay", [0.4, 0.8, 1.2, 1.6, 2.0])
def test_signal_while_loading_ends_at_once(tmp_path, start, delay):
    """While Python itself starts, twice over the wheels, the signal ends it as it does every program."""
    processes = {}
    for number in (signal.SIGINT, signal.SIGTERM):
        (tmp_path / number.name).mkdir()
        processes[number] = start(tmp_path / number.name, wait=False)
    time.sleep(delay)
    for number, process in processes.items():
        code, seconds = end_of(process, number)
        assert code in (0, -number), process.text()
        assert seconds < 1.0, process.text()
        assert "Traceback" not in process.text() or code == -number


def test_bag_with_a_full_queue_is_closed_in_time(tmp_path, monkeypatch):
    """What a slow disk can't take in time is left out and counted; the bag can be read."""
    simulation = Simulation(ball(2))
    physics = Physics(simulation)
    recorder = Recorder("/tissue_sim", 1, {"tools": ["left"]})
    for topic in TOOL_TOPICS:
        recorder.add_topic("left", topic, f"/left/{topic}")
    write = Writer.write

    def slowly(self, *words):
        time.sleep(0.002)
        write(self, *words)

    monkeypatch.setattr(Writer, "write", slowly)
    physics.start()
    path = recorder.start(tmp_path, physics, b"organ", b"\0" * 16, {})
    for _ in range(20_000):
        recorder.received("/left/measured_cp", b"\0" * 64)
    begin = time.monotonic()
    assert recorder.stop(physics, 0.3) == path
    assert time.monotonic() - begin < 1.0
    physics.stop()
    assert recorder.error == ""
    assert 10_000 < recorder.lost < 20_000
    with Reader(path) as reader:
        assert reader.message_count + recorder.lost > 20_000
