"""Ctrl-C that a compiled library drops."""

import signal
import subprocess
import sys

import pytest

from tissue_sim import interrupts
from tissue_sim.bench import rows
from tissue_sim.errors import UserError

# A callback of ctypes, as LLVM calls one with what it compiled, drops what is raised in it.
DROPPED = """
import ctypes, os, signal, sys
import tissue_sim.cli as cli

signal.signal(signal.SIGINT, signal.{handler})

def compile_and_run(words, chosen):
    if {interrupted}:
        ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), signal.SIGINT))()
    raise RuntimeError("no compiled object yet")

cli._run = compile_and_run
sys.exit(cli.main())
"""


@pytest.mark.parametrize(
    ("interrupted", "handler", "code", "line"),
    [
        (True, "default_int_handler", 130, "tissue_sim: stopped\n"),
        (True, "SIG_IGN", 1, "tissue_sim: error: internal: RuntimeError: no compiled object yet"),
        (False, "default_int_handler", 1, "tissue_sim: error: internal: RuntimeError: no compiled object yet"),
    ],
    ids=["interrupted", "ignored", "not interrupted"],
)
def test_an_error_after_ctrl_c_is_no_error(interrupted, handler, code, line):
    words = [sys.executable, "-c", DROPPED.format(interrupted=interrupted, handler=handler)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert done.stderr.startswith(line)
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("error", [KeyboardInterrupt(), RuntimeError("half made"), UserError("k.npz is damaged")])
def test_what_an_interrupt_leaves_is_what_the_innermost_block_says(monkeypatch, error):
    monkeypatch.setattr(interrupts._Seen, "any", True)
    with interrupts.leaving("not here"):
        pass
    with (
        pytest.raises(type(error)),
        interrupts.leaving("nothing was written"),
        interrupts.leaving("one of two was written"),
    ):
        raise error
    assert interrupts.reported() == "one of two was written"
    assert interrupts.reported() == ""
    assert not interrupts.caused(RuntimeError())


def test_an_error_without_an_interrupt_leaves_nothing_to_say():
    with pytest.raises(RuntimeError), interrupts.leaving("nothing was written"):
        raise RuntimeError
    assert interrupts.reported() == ""


def fail():
    with rows.until_stopped():
        raise RuntimeError("no compiled object yet")


@pytest.fixture
def interrupted(monkeypatch):
    rows.begin()
    monkeypatch.setattr(interrupts._Seen, "any", False)
    with pytest.raises(RuntimeError):
        fail()
    with pytest.raises(KeyboardInterrupt):
        interrupts.interrupt(signal.SIGINT, None)
    yield
    rows.begin()


def test_rows_measured_before_stay(interrupted):
    rows.keep()
    fail()
    assert rows.stopped()


def test_a_benchmark_without_rows_ends_as_interrupted(interrupted):
    with pytest.raises(KeyboardInterrupt):
        fail()
    assert not rows.stopped()
