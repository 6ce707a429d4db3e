"""Signals where Python can't raise."""

import subprocess
import sys

IN_A_CALLBACK = """
import ctypes, os, signal, time
from tissue_sim.ros.ending import Ending

ending = Ending()

@ctypes.CFUNCTYPE(None)
def called_from_c():
    {}

called_from_c()
time.sleep({})
"""


def run(line, then_sleeps=5.0):
    code = IN_A_CALLBACK.format(line, then_sleeps)
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)


def test_signal_in_a_callback_of_the_compiler_ends_without_a_traceback():
    done = run("os.kill(os.getpid(), signal.SIGINT); time.sleep(0.1)")
    assert (done.returncode, done.stderr) == (0, "tissue_node: ended while starting\n")


def test_other_errors_there_are_still_shown():
    assert "ZeroDivisionError" in run("1 / 0", then_sleeps=0.0).stderr
