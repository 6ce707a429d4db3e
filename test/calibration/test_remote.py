"""Objects in processes of their own: what they keep, what they raise, and when they end."""

import os
import signal
import subprocess
import sys
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from importlib import import_module

import pytest

from helpers.patience import LIMIT
from tissue_sim.calibration.remote import Remote
from tissue_sim.errors import UserError

ORPHAN = """
import time
from importlib import import_module
from tissue_sim.calibration.remote import Remote

if __name__ == "__main__":
    print(Remote(import_module, "os").call("getpid"), flush=True)
    time.sleep(3600.0)
"""


def its(module):
    """A module of another process: what it says is of that."""
    return closing(Remote(import_module, module))


def wait_until_gone(process):
    for _ in range(1200):
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    pytest.fail("the process is still there")


def test_an_object_keeps_what_it_has_and_raises_what_it_raises():
    with closing(Remote(deque, [1])) as remote:
        remote.call("append", 2)
        assert [remote.call("pop"), remote.call("pop")] == [2, 1]
        with pytest.raises(IndexError, match="empty"):
            remote.call("pop")
        remote.call("append", 3)
        assert remote.call("count", 3) == 1


def test_it_has_one_thread_and_leaves_ours_alone(monkeypatch):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    with its("os") as remote:
        assert remote.call("getpid") != os.getpid()
        assert remote.call("getenv", "OPENBLAS_NUM_THREADS") == "1"
        assert "OPENBLAS_NUM_THREADS" not in os.environ
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    with its("os"):
        assert os.environ["OPENBLAS_NUM_THREADS"] == "3"


def test_a_process_that_was_killed_is_reported_in_one_line():
    with its("os") as remote:
        os.kill(remote.call("getpid"), signal.SIGKILL)
        for _ in range(2):
            with pytest.raises(UserError, match="has ended; run it again"):
                remote.call("getcwd")


def test_close_ends_it_in_the_middle_of_a_call():
    remote = Remote(import_module, "signal")
    with ThreadPoolExecutor(1) as thread:
        answer = thread.submit(remote.call, "sigwait", {signal.SIGUSR2})
        remote.call("getsignal", signal.SIGUSR2)  # it answers beside the call that it waits in
        remote.close()
        with pytest.raises(UserError, match="has ended"):
            answer.result(60.0)
    remote.close()  # nothing is left to end


def test_it_ends_with_its_parent_however_that_ended(tmp_path):
    script = tmp_path / "orphan.py"
    script.write_text(ORPHAN)
    parent = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True)
    process = int(parent.stdout.readline())
    parent.kill()
    parent.wait()
    parent.stdout.close()
    wait_until_gone(process)


def test_a_script_without_a_guard_is_run_once(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "print('begun')\nfrom tissue_sim.calibration.remote import Remote\nremote = Remote(dict, [('a', 5)])\n"
        "print(remote.call('get', 'a'), __file__)\nremote.close()\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=LIMIT, check=False)
    assert done.stdout.splitlines() == ["begun", f"5 {script}"], done.stderr
