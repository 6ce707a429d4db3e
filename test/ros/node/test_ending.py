"""Ends of the node that nobody asked for in the usual way."""

import subprocess
import sys
import threading
from functools import partial
from types import SimpleNamespace

import pytest

from helpers.patience import LIMIT
from tissue_sim.ros.node import serve

IN_A_CALLBACK = """
import ctypes, os, signal, time
from tissue_sim.ros.shared.shutdown_handler import ShutdownHandler

ending = ShutdownHandler()

@ctypes.CFUNCTYPE(None)
def called_from_c():
    {}

called_from_c()
time.sleep({})
"""


def run(line, then_sleeps=LIMIT):
    code = IN_A_CALLBACK.format(line, then_sleeps)
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=LIMIT, check=False)


def test_signal_in_a_callback_of_the_compiler_ends_without_a_traceback():
    done = run("os.kill(os.getpid(), signal.SIGINT); time.sleep(0.1)")
    assert (done.returncode, done.stderr) == (0, "tissue_node: ended while starting\n")


def test_what_was_left_half_made_is_deleted_without_a_traceback():
    half = "half = type('Half', (), {'__del__': lambda self: self.never_made})()"
    done = run(f"{half}; os.kill(os.getpid(), signal.SIGINT); time.sleep(0.1)")
    assert (done.returncode, done.stderr) == (0, "tissue_node: ended while starting\n")


def test_nothing_is_raised_inside_the_compiler():
    """It may crash on what it leaves half made: the process ends without it."""
    body = "import os, signal, time; os.kill(os.getpid(), signal.SIGTERM); time.sleep(0.1); print(1, flush=True)"
    done = run(f'exec("{body}", {{"__name__": "llvmlite.binding"}})')
    assert (done.returncode, done.stdout, done.stderr) == (0, "1\n", "tissue_node: ended while starting\n")


def test_other_errors_there_are_still_shown():
    assert "ZeroDivisionError" in run("1 / 0", then_sleeps=0.0).stderr


WHERE_THE_EVENT_IS_LOCKED = """
import os, signal, sys, time
from tissue_sim.ros.shared.shutdown_handler import ShutdownHandler

ending = ShutdownHandler()
ending.closes()
with ending.asked._cond:
    os.kill(os.getpid(), signal.SIGINT)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(0.1)
print(ending.asked.wait(60.0), flush=True)
os._exit(0)
"""


def test_signals_one_after_the_other_never_wait_for_each_other():
    """One that comes while another one is handled finds the event's lock taken, by the thread that it interrupts."""
    words = [sys.executable, "-c", WHERE_THE_EVENT_IS_LOCKED]
    done = subprocess.run(words, capture_output=True, text=True, timeout=LIMIT, check=False)
    assert (done.returncode, done.stdout) == (0, "True\n"), done.stderr


BEFORE_IT_WATCHES = """
import os, signal, threading
from tissue_sim.ros.node import program

start = threading.Thread.start

def signalled(thread):
    os.kill(os.getpid(), signal.SIGTERM)
    start(thread)

threading.Thread.start = signalled
program.run()
"""


def test_signal_before_the_program_watches_for_it_ends_without_a_traceback():
    done = subprocess.run(
        [sys.executable, "-c", BEFORE_IT_WATCHES], capture_output=True, text=True, timeout=LIMIT, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.fixture
def served(monkeypatch):
    """Serves a made-up node, whose spinning fails again and again; notes what is done to it."""
    done, notes = [], []
    node = SimpleNamespace(**{name: partial(done.append, name) for name in ("start", "close", "destroy_node")})
    node.unexpected_errors = SimpleNamespace(note=notes.append)
    node.loop = SimpleNamespace(ended=False, failure=None)
    ending = SimpleNamespace(asked=threading.Event(), started=lambda: None, closes=lambda: None)

    def fail(timeout_sec):
        if len(notes) == 3:
            ending.asked.set()
        raise KeyError("nobody thought of this")

    executor = SimpleNamespace(add_node=lambda _: None, spin_once=fail)
    monkeypatch.setattr(serve, "TissueNode", lambda: node)
    monkeypatch.setattr(serve, "make_executor", lambda: executor)
    monkeypatch.setattr(serve, "_start_rclpy", lambda _: None)
    monkeypatch.setattr(threading, "excepthook", threading.excepthook)
    interval = sys.getswitchinterval()
    yield SimpleNamespace(node=node, done=done, notes=notes, run=partial(serve.serve, ["tissue_node"], ending))
    sys.setswitchinterval(interval)


def test_errors_of_rclpy_itself_are_noted_and_the_node_goes_on(served):
    assert served.run() == 0
    assert [type(error) for error in served.notes] == [KeyError] * 4
    assert served.done == ["start", "close", "destroy_node"]


def test_a_node_whose_loop_ended_closes_and_ends_with_one_line(served, capfd):
    served.node.loop.ended, served.node.loop.failure = True, MemoryError("no more")
    assert served.run() == 1
    assert capfd.readouterr().err == "tissue_node: error: internal: the physics loop ended: MemoryError: no more\n"
    assert served.done == ["start", "close", "destroy_node"]
