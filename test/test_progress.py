"""How far long work is: in a log, on a terminal, while kernels compile."""

import os
import pty
import re
import signal
import subprocess
import sys
import termios
import threading
from types import SimpleNamespace

import pytest
from numba.core import event

from helpers.clock import clock_of
from helpers.patience import LIMIT
from tissue_sim import jit, progress
from tissue_sim.cli import main
from tissue_sim.errors import UserError
from tissue_sim.progress_reporter import SETTING

# `info` whose reading of the organ is over when a line comes in.
SLOW_INFO = """
import sys
import tissue_sim.commands.info as info
from tissue_sim.cli import main
from tissue_sim.progress import task

def slow(args):
    with task("reading", 8) as one:
        one.advance(2, "still here")
        sys.stdin.readline()
    print("an organ")
    return 0

info.run = slow
sys.exit(main(["info", "k.npz"]))
"""


@pytest.fixture
def clock(monkeypatch):
    """No thread, no terminal, and a time of its own: what is reported depends on that alone."""
    clock = clock_of(monkeypatch)
    with progress.still():
        yield clock


def lines(capsys):
    captured = capsys.readouterr()
    assert captured.out == "", "the standard output is for results"
    return captured.err.splitlines()


# in a log -------------------------------------------------------------------------------------------


def test_what_ends_within_three_seconds_says_nothing(clock, capsys):
    with progress.task("build"):
        for _ in progress.steps(range(29), "stages"):
            clock.now += 0.1
    assert lines(capsys) == []


def test_a_line_after_three_seconds_and_one_each_ten_seconds(clock, capsys):
    with progress.task("calibrate"), progress.task("fit", 100) as fit:
        for _ in range(50):
            clock.now += 1.0
            fit.advance(1, "2.5 %")
    assert lines(capsys) == [
        f"calibrate: fit {done} of 100, 2.5 %; 00:{done:02}, about 0{left} left"
        for done, left in ((3, "1:37"), (13, "1:27"), (23, "1:17"), (33, "1:07"), (43, "0:57"))
    ]


def test_many_short_tasks_after_each_other_are_not_silent(clock, capsys):
    for stage in range(16):
        with progress.task(f"stage {stage}", 2) as one:
            clock.now += 1.0
            one.advance()
        clock.now += 0.5
    assert [line.split(";")[0] for line in lines(capsys)] == ["stage 2 1 of 2", "stage 9 1 of 2"]


def test_what_was_reported_otherwise_puts_the_next_line_off(clock, capsys):
    with progress.task("bench fall") as one:
        for row in range(6):
            clock.now += 9.0
            progress.say(f"row {row}")
            one.advance(0)
    assert lines(capsys) == [f"row {row}" for row in range(6)]


def test_shares_and_unknown_lengths(clock, capsys):
    with progress.task("wall", 50.0, "%") as build:
        clock.now += 4.0
        build.reach(20.0)
        with progress.task("inner") as inner:
            clock.now += 3723.0
            inner.reach(0)
    assert lines(capsys) == ["wall 40 %; 00:04, about 00:06 left", "wall 40 %: inner; 1:02:03"]


@pytest.mark.extended
def test_a_process_says_how_far_it_is_while_a_step_lasts():
    """Until it has: the step ends when it has said so three times."""
    environment = os.environ | {SETTING: "0.05"}
    streams = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", SLOW_INFO], env=environment, text=True, **streams) as process:
        seen = [process.stderr.readline()]
        while sum("reading" in line for line in seen) < 3:
            seen.append(process.stderr.readline())
        out, _ = process.communicate("go on\n", timeout=LIMIT)
    assert (process.returncode, out) == (0, "an organ\n")
    assert re.fullmatch(r"info: reading 2 of 8, still here; \d\d:\d\d, about \d\d:\d\d left\n", seen[-1])


def test_a_log_of_its_own_and_none(clock, capsys):
    logged = []
    with progress.task("starting") as one:
        progress.report_by(logged.append)
        clock.now += 4.0
        one.advance(0)
        progress.report_by(None)
        clock.now += 100.0
        one.advance(0)
    assert logged == ["starting; 00:04"]
    assert lines(capsys) == []


@pytest.mark.parametrize("given", ["often", "-1", "nan", "inf"])
def test_a_setting_that_is_none_is_refused(given, monkeypatch, capsys):
    monkeypatch.setattr(progress, "_reporter", progress.Reporter())
    monkeypatch.setenv(SETTING, given)
    assert main(["info", "k.npz"]) == 2
    assert capsys.readouterr().err == (
        f"tissue_sim: error: {SETTING}={given}: use the seconds between two lines of progress, such as 60,"
        " or 0 for none\n"
    )
    with pytest.raises(UserError, match="seconds between two lines"), progress.task("any"):
        pass


def test_zero_switches_it_off(clock, monkeypatch, capsys):
    monkeypatch.setenv(SETTING, "0")
    with progress.task("build") as one:
        clock.now += 1000.0
        one.advance()
    assert lines(capsys) == []


# beside what is timed -------------------------------------------------------------------------------


def threads():
    return [thread for thread in threading.enumerate() if thread.name == "progress"]


def test_no_thread_runs_beside_what_is_timed(monkeypatch):
    monkeypatch.setattr(progress, "_reporter", progress.Reporter())
    monkeypatch.setenv(SETTING, "")
    with progress.task("bench tick"):
        assert len(threads()) == 1
        with progress.still(), progress.task("ticks", 5):
            assert not threads()
            with progress.moving():
                assert len(threads()) == 1
            assert not threads()
        assert len(threads()) == 1
    for thread in threads():
        thread.join(LIMIT)
    assert not threads()


# on a terminal --------------------------------------------------------------------------------------


@pytest.mark.extended
def test_a_bar_moves_on_a_terminal_while_a_step_lasts():
    """Above it stays what was printed, and nothing of it is left at the end."""
    program = SLOW_INFO.replace("one.advance(2", "print('a line'); one.advance(2")
    ours, theirs = pty.openpty()
    termios.tcsetwinsize(theirs, (40, 90))
    environment = os.environ | {SETTING: "0.05"}
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, stdout=theirs, stderr=theirs) as process:
        os.close(theirs)
        shown = ""
        while (
            len(set(re.findall(r"info: reading: +25%\|[^\[]*\| 2/8 \[(\d\d:\d\d)<\d\d:\d\d, still here\]", shown))) < 2
        ):
            shown += os.read(ours, 4096).decode()
        process.stdin.write(b"go on\n")
        process.stdin.close()
        while "an organ" not in shown:
            shown += os.read(ours, 4096).decode()
        assert process.wait(LIMIT) == 0
    os.close(ours)
    assert screen(shown)[:2] == ["a line", "an organ"]


def screen(written):
    """The lines that a terminal shows."""
    found = []
    for line in written.split("\n"):
        shown = ""
        for part in line.rstrip("\r").split("\r"):
            shown = part + shown[len(part) :]
        found.append(shown.rstrip())
    return found


# compiling ------------------------------------------------------------------------------------------


def compiled(function):
    return {"dispatcher": SimpleNamespace(py_func=function)}


def test_compiling_is_reported_with_the_time_of_all_kernels(clock, monkeypatch, capsys):
    monkeypatch.setattr(jit, "time", clock)
    for _ in range(4):
        for _ in range(2):  # one for the other
            event.start_event("numba:compile", compiled(jit.alone))
        clock.now += 2.0
        with progress.task("what asks for it") as one:
            one.advance(0)
        for _ in range(2):
            event.end_event("numba:compile", compiled(jit.alone))
    assert lines(capsys) == ["compiling kernels, once for this version: what asks for it; 00:00"]


def test_kernels_of_others_are_not_reported(clock, capsys):
    event.start_event("numba:compile", compiled(re.match))
    clock.now += 100.0
    assert progress.name_of_all() == ""
    event.end_event("numba:compile", compiled(re.match))
    assert lines(capsys) == []


# Ctrl-C ---------------------------------------------------------------------------------------------


@pytest.mark.extended
def test_ctrl_c_in_a_benchmark_prints_the_rows_that_there_are():
    """Of the process alone: the one that measures for it is stopped by it, and hands over what it has."""
    # A job in the background is started without the signal, and hands that down.
    code = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)"
    code += "\nfrom tissue_sim.cli import main\nsys.exit(main())"
    command = [sys.executable, "-c", code, "bench", "fall", "--loads", "30"]
    with subprocess.Popen(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        rows = [process.stderr.readline() for _ in range(2)]
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=LIMIT)
    assert all(re.fullmatch(r"0\.2 E, \w+: difference [\d.]+ %\n", row) for row in rows)
    assert (process.returncode, "Traceback" in err) == (130, False)
    first, *table = out.splitlines()
    assert first == "stopped by Ctrl-C: these are the measurements so far"
    counts = next(line.split() for line in table if line.startswith("0.2"))
    assert 2 <= int(counts[1]) < 30
    assert any(line.endswith("met so far") for line in table)
