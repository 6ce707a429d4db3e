"""What the use of an input must not do, for the test that it is noticed."""

import ctypes
import os
import subprocess
import sys
import time
import warnings
from pathlib import Path

from helpers.fuzz.child import MEGABYTES, OUTSIDE, Ready
from tissue_sim.errors import UserError


def prepare(misdeed: str) -> Ready:
    return globals()[misdeed]


def prepare_to_list(path: Path) -> Ready:
    def use() -> str:
        if not path.is_dir():
            raise UserError("not a folder")
        return " ".join(sorted(one.name for one in path.iterdir()))

    return use


def behave() -> str:
    return "nothing wrong"


def refuse() -> str:
    raise UserError("no")


def refuse_in_two_lines() -> str:
    raise UserError("no\nno")


def crash() -> str:
    return str(ctypes.string_at(0))


def end() -> str:
    os._exit(3)


def hang() -> str:
    while True:
        time.sleep(1.0)


def raise_an_error() -> str:
    return str(1 // 0)


def take_memory() -> str:
    return str(len(b"\1" * round(1.2e6 * MEGABYTES)))


def ask_for_all_memory() -> str:
    return str(len(bytes(10**12)))


def warn() -> str:
    warnings.warn("of a rarely seen kind", stacklevel=1)
    return ""


def write() -> str:
    os.write(sys.__stderr__.fileno(), b"a library's words\n")
    return ""


def open_what_lies_outside() -> str:
    return str(len((Path(OUTSIDE)).read_bytes()))


def open_what_lies_elsewhere() -> str:
    return str(len(Path("/etc/passwd").read_bytes()))


def make_a_file() -> str:
    Path("pickled").write_text("")
    return ""


def start_a_program() -> str:
    subprocess.run(["true"], check=True)
    return ""
