"""What nobody thought of reaches a user as one line, and a developer, who asks for it, as a traceback."""

import os
import re
import subprocess
import sys

import pytest

from tissue_sim import cli
from tissue_sim.organ.organ import Organ
from tissue_sim.unexpected_errors import TRACEBACK, described, place_of

ORGAN = "tissue_sim.organ.organ"
# A program whose reading of an organ fails as nobody thinks: at first as a user sees it, then as a developer asks.
FAILING = """
import os
import sys
from tissue_sim import cli
from tissue_sim.organ.organ import Organ
from tissue_sim.unexpected_errors import TRACEBACK

Organ.digest = None
first = cli.main()
print("first", first, file=sys.stderr)
os.environ[TRACEBACK] = "1"
second = cli.main()
print("second", second, file=sys.stderr)
sys.exit(first)
"""
# A command that prints a line and loads nothing.
PRINTING = """
import sys
import types
from tissue_sim import cli

sys.modules["printing"] = types.SimpleNamespace(add_arguments=lambda _: None, run=lambda _: print("an organ") or 0)
cli.COMMANDS["info"] = ("printing", "print a line")
sys.exit(cli.main())
"""
ONE_LINE = (
    r"tissue_sim: error: internal: TypeError: .*\(tissue_sim/\S+\.py:\d+\);"
    r" TISSUE_SIM_TRACEBACK=1 shows the traceback\n"
)


def run(code, *words, **environment):
    environment = {name: value for name, value in os.environ.items() if name != TRACEBACK} | environment
    return subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, env=environment, check=False
    )


def test_command_that_fails_ends_with_one_line_and_1():
    done = run(FAILING, "info", "config/organs/kidney.npz", "--json")
    assert done.returncode == 1
    user, separator, developer = done.stderr.partition("first 1\n")
    assert separator
    assert re.fullmatch(ONE_LINE, user)
    assert developer.startswith("Traceback (most recent call last)")
    assert re.search(rf"^{ONE_LINE}second 1\n\Z", developer, re.MULTILINE)


def test_thread_and_what_is_uncaught_are_reported_in_one_line_each():
    code = """
import threading
from tissue_sim.unexpected_errors import catch_all
from tissue_sim.organ.organ import Organ
catch_all("some program")
made = threading.Thread(target=Organ.load, args=(7,))
made.start()
made.join()
Organ.load(8)
"""
    done = run(code)
    assert done.returncode == 1
    first, second = done.stderr.splitlines()
    for line in (first, second):
        assert line.startswith("some program: error: internal: ")
        assert "(tissue_sim/organ/" in line


def test_place_is_the_innermost_inside_the_package():
    with pytest.raises(Exception) as caught:  # noqa: PT011
        Organ.load(7)
    assert re.fullmatch(r"tissue_sim/organ/\S+\.py:\d+", place_of(caught.value))
    assert place_of(ValueError()) == ""
    assert described(ValueError("in\n two  lines")) == "ValueError: in two lines"
    assert described(KeyboardInterrupt()) == "KeyboardInterrupt"


@pytest.mark.parametrize(
    "words",
    [
        ("-c", PRINTING, "info"),
        pytest.param(("-m", "tissue_sim", "info", "config/organs/kidney.npz"), marks=pytest.mark.extended),
    ],
    ids=["a line", "info"],
)
@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_full_disk_or_closed_stream_takes_one_line(stream, words, monkeypatch):
    words = [sys.executable, *words]
    number = {"stdout": 1, "stderr": 2}[stream]
    # Unbuffered, a line fails where it is printed, and a program that forgets to flush would not be noticed.
    monkeypatch.delenv("PYTHONUNBUFFERED", raising=False)
    closed = subprocess.run(
        ["sh", "-c", f'exec "$@" {number}>&-', "sh", *words], capture_output=True, text=True, check=False
    )
    assert (closed.returncode, closed.stderr) == (0, "")
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            words, **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, stream: full}, text=True, check=False
        )
    if stream == "stdout":
        assert done.returncode == 1
        assert re.fullmatch(r"tissue_sim: error: No space left on device \(\S+\)\n", done.stderr)
    else:
        assert done.returncode == 0


def test_a_pipe_that_breaks_elsewhere_is_no_success(monkeypatch, capsys):
    """Only who closes the standard output, as `head` does, wants no more."""

    def broken(*_):
        raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.setattr(Organ, "digest", broken)
    monkeypatch.setattr(cli, "output_is_gone", lambda: False)
    assert cli.main(["info", "config/organs/kidney.npz", "--json"]) == 1
    assert "Broken pipe" in capsys.readouterr().err


def test_output_is_gone_when_its_reader_is():
    code = "import sys; from tissue_sim.errors import output_is_gone; sys.stderr.write(str(output_is_gone()))"
    assert run(code).stderr == "False"
    gone = f"{sys.executable} -c 'import time; time.sleep(0.3); {code}' | true"
    assert subprocess.run(gone, shell=True, capture_output=True, text=True, check=False).stderr == "True"


def test_what_a_terminal_obeys_is_reported_and_not_sent(capsys):
    assert cli.main(["info", "no\x1b[2Jorgan\n.npz"]) == 2
    told_line = capsys.readouterr().err
    assert "\x1b" not in told_line
    assert told_line.count("\n") == 1
    assert "no\\x1b[2Jorgan\\n.npz" in told_line
    assert len(described(ValueError("x" * 10_000))) < 700


def test_caller_of_main_keeps_its_hooks():
    before = sys.excepthook
    assert cli.main(["info", "nowhere.npz"]) == 2
    assert sys.excepthook is before
