"""The demonstration with a node that is stood in for: it starts, reports, and ends everything in order."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from helpers.exit_codes import exit_code_of
from helpers.patience import LIMIT, wait_for
from helpers.ros.processes import STAND_IN, Process
from tissue_sim.cli import main
from tissue_sim.ports import free_port
from tissue_sim.ros import demo
from tissue_sim.ros.shared.children import Child
from tissue_sim.ros.shared.domains import chosen_graph

SLEEPER = "import signal,time;{};print('up',flush=True);time.sleep(3600)"


def start_demo(folder: Path, *words: str, node: str = "") -> Process:
    """`tissue_sim demo` whose node is the stand-in with further arguments."""
    code = (
        "import sys; from tissue_sim import cli; from tissue_sim.ros import demo;"
        f"from tissue_sim.ros.shared import children; children.SECONDS_TO_END = {LIMIT};"
        f"demo.node_command = lambda organ, folder, priority: [sys.executable, {STAND_IN!r},"
        f" '--record-folder', str(folder), *{node.split()!r}];"
        f"sys.exit(cli.main({['demo', '--bag-folder', str(folder / 'bags'), *words]!r}))"
    )
    return Process(["-c", code], folder / "demo.log")


def children_of(process: Process) -> list[int]:
    listed = subprocess.run(
        ["ps", "-o", "pid=", "--ppid", str(process.child.pid)], capture_output=True, text=True, check=False
    )
    return [int(pid) for pid in listed.stdout.split()]


@pytest.mark.extended
def test_it_runs_its_seconds_and_names_its_bag(tmp_path):
    process = start_demo(tmp_path, "--seconds", "1.5", "--port", str(free_port()))
    assert process.wait() == 0, process.text()
    lines = process.text().splitlines()
    bag = tmp_path / "bags" / "bag"
    assert lines[-2:] == [f"bag: {bag}", f"replay it with: tissue_sim replay {bag}"]
    assert any(line.startswith("bridge: ") and "poses sent" in line for line in lines)
    assert "Traceback" not in process.text()


@pytest.mark.extended
def test_ctrl_c_ends_it_with_0_and_leaves_no_child(tmp_path):
    process = start_demo(tmp_path, "--no-viewer")
    process.wait_for("1000 Hz | tick p50  210 us, p99   480 us | overruns    3 | active nodes  642 | contacts   7")
    children = children_of(process)
    assert len(children) >= 2
    assert process.stop(signal.SIGINT) == 0
    assert "replay it with" in process.text()
    for pid in children:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


@pytest.mark.extended
def test_a_node_that_dies_is_named_with_its_last_line(tmp_path):
    process = start_demo(tmp_path, "--no-viewer", node="--dies-after 1.0")
    assert process.wait() == 1
    assert (
        "tissue_sim demo: the node ended by itself, exit code 1: stand_in: error: the disk is on fire" in process.text()
    )


def test_an_end_before_the_node_is_up_is_said(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    sleeper = [sys.executable, "-c", SLEEPER.format("0")]
    monkeypatch.setattr(demo, "node_command", lambda organ, folder, priority: sleeper)

    class AtOnce(demo.client.Stop):
        def __bool__(self):
            return True

    monkeypatch.setattr(demo.client, "Stop", AtOnce)
    assert main(["demo", "--no-viewer"]) == 130
    assert capfd.readouterr().err == "tissue_sim demo: stopped before the node was up; no bag was recorded\n"
    assert not list((tmp_path / "recordings").iterdir())  # no empty folder is left


def test_a_bag_of_a_node_that_had_no_time_to_report_it_is_named(tmp_path, monkeypatch, capfd):
    folder = tmp_path / "bags"
    old, new = folder / "old", folder / "new"
    old.mkdir(parents=True)
    records = [sys.executable, "-c", f"import os; os.mkdir({str(new)!r});" + SLEEPER.format("0")]
    monkeypatch.setattr(demo, "node_command", lambda organ, folder, priority: records)
    monkeypatch.setattr(demo.client.Stop, "__bool__", lambda _: new.exists())
    assert main(["demo", "--no-viewer", "--bag-folder", str(folder)]) == 0
    assert capfd.readouterr().out.splitlines()[-1].endswith(f"replay {new}")


@pytest.mark.parametrize(
    ("words", "message"), [(["--organ", "nowhere.npz"], "nowhere.npz does not exist"), (["--seconds", "-1"], "outside")]
)
def test_wrong_use_is_one_line_and_exit_code_2(words, message, capfd):
    assert exit_code_of("demo", *words) == 2
    error = capfd.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_the_users_graph_is_kept_and_a_free_one_is_found():
    chosen = {"ROS_DOMAIN_ID": "7", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    with chosen_graph(chosen):
        pass
    assert chosen == {"ROS_DOMAIN_ID": "7", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    empty: dict[str, str] = {}
    with chosen_graph(empty):
        pass
    assert empty["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert 1 <= int(empty["ROS_DOMAIN_ID"]) <= 101


def test_the_node_gets_paths_that_yaml_reads_as_text(tmp_path):
    words = demo.node_command("a: b.npz", tmp_path, 20)
    assert f'record_folder:="{tmp_path}"' in words
    assert f'organ_file:="{Path("a: b.npz").absolute()}"' in words


# children --------------------------------------------------------------------------------------
def test_a_child_that_ignores_signals_is_killed(monkeypatch):
    monkeypatch.setattr("tissue_sim.ros.shared.children.SECONDS_TO_END", 0.3)
    monkeypatch.setattr("tissue_sim.ros.shared.children.SECONDS_TO_TERMINATE", 0.3)
    deaf = "signal.signal(signal.SIGINT, signal.SIG_IGN);signal.signal(signal.SIGTERM, signal.SIG_IGN)"
    child = Child("deaf", [sys.executable, "-c", SLEEPER.format(deaf)], os.environ)
    wait_for(lambda: child.output)
    assert not child.stop()
    assert child.exit_code == -signal.SIGKILL


def test_a_child_ends_when_its_parent_is_killed():
    code = (
        "import os, sys, time; from tissue_sim.ros.shared.children import Child;"
        f"c = Child('c', [sys.executable, '-c', {SLEEPER.format('0')!r}], os.environ);"
        "time.sleep(0.5); print(c._process.pid, flush=True); time.sleep(3600)"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    parent.kill()
    parent.wait()

    def has_ended():
        """Or would have, if the user who took it over had asked how."""
        try:
            return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
        except (FileNotFoundError, ProcessLookupError):
            return True

    wait_for(has_ended, "the child lives on")
