"""What kernels take by reference."""

import gc
import inspect
import os
import subprocess
import sys
import weakref
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest

from helpers.scenes import ball
from tissue_sim.handles import handle, row
from tissue_sim.model.simulation import Simulation


class Inner(NamedTuple):
    table: Any


class Outer(NamedTuple):
    values: Any
    factor: float
    inner: Any


START = """
import sys
sys.path.insert(0, sys.argv[1])
import numba
import numpy as np
from tuples import Inner, Outer
from tissue_sim.handles import handle, row
"""
HANDLES = """
@numba.njit
def add(outer):
    for k in range(len(outer.values)):
        outer.values[k] += outer.factor * outer.inner.table[k]

values, table = np.zeros(3), np.array([1.0, 2.0, 3.0])
made = handle(Outer(values, 2.0, Inner(table)))
add(made)
print(*values)
table[:] = 10.0
add(made)
print(*values)
made = handle(Outer(values, 1.0, Inner(np.ones(3))))
for _ in range(100):
    np.full(3, 7.0)  # would lie where the table was, were it not kept
add(made)
print(*values)
"""
ROWS = """
@numba.njit
def add(rows):
    total = 0.0
    for k in range(len(rows)):
        total += rows[k].factor * rows[k].inner.table.sum()
    rows[0].values[:] = total

def outer(factor):
    return Outer(values, factor, Inner(np.array([1.0, factor])))

values = np.zeros(1)
for count in (1, 2, 5):
    made = row([handle(outer(1.0 + number)) for number in range(count)])
    for _ in range(100):
        np.full(2, 7.0)  # would lie where a table was, were it not kept
    add(made)
    print(*values)
print(len(add.signatures))
try:
    row([handle(outer(1.0)), handle(Inner(values))])
except ValueError as error:
    print(error)
"""
TUPLES = "\n".join(["from typing import Any, NamedTuple", inspect.getsource(Inner), inspect.getsource(Outer)])


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """Lines that HANDLES prints, and those that ROWS prints.

    In a process and a cache of their own: what is compiled for these tuples would be looked for by all others.
    """
    folder = tmp_path_factory.mktemp("handles")
    (folder / "tuples.py").write_text(TUPLES)
    environment = os.environ | {"XDG_CACHE_HOME": str(folder)}
    environment.pop("NUMBA_CACHE_DIR", None)
    words = [sys.executable, "-c", f"{START}{HANDLES}print()\n{ROWS}", str(folder)]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    of_handles, _, of_rows = done.stdout.partition("\n\n")
    return of_handles.splitlines(), of_rows.splitlines()


def test_handle_shares_arrays_copies_numbers_and_keeps_both(shown):
    assert shown[0] == ["2.0 4.0 6.0", "22.0 24.0 26.0", "23.0 25.0 27.0"]


def test_a_row_is_one_type_however_many_handles_it_has(shown):
    """Factors 1, 2, ... of tables (1, factor)."""
    assert shown[1] == ["2.0", "8.0", "70.0", "1", "2 types of handles in a row; expected: one"]


def test_a_row_is_a_tuple_without_the_compiler(monkeypatch):
    monkeypatch.setattr(numba.config, "DISABLE_JIT", True)
    assert row([1, 2]) == (1, 2)


def test_handle_is_the_tuple_itself_without_the_compiler(monkeypatch):
    monkeypatch.setattr(numba.config, "DISABLE_JIT", True)
    outer = Outer(np.zeros(3), 2.0, Inner(np.ones(3)))
    assert handle(outer) is outer


def test_kernels_that_count_no_references_keep_none():
    """Else no array of a simulation was ever freed: each cut, and each scene, took megabytes for good."""
    simulation = Simulation(ball())
    before = simulation.world._meminfo.refcount
    simulation.step()
    simulation.reset()
    assert simulation.world._meminfo.refcount == before
    words = simulation.state.words
    while isinstance(words.base, np.ndarray):
        words = words.base
    left = weakref.ref(words)
    del simulation, words
    gc.collect()
    assert left() is None


def test_a_kernel_that_takes_a_handle_runs_no_code_of_numba_in_python():
    """Numba drops an exception that comes out of it, Ctrl-C among them."""
    simulation = Simulation(ball())

    def moved():
        simulation.step()
        simulation.settle(np.zeros((len(simulation.organ.surface_positions), 3)))

    moved()  # compiles, and learns the types of all arguments
    called = []
    sys.setprofile(lambda frame, event, _: called.append(frame.f_code.co_filename) if event == "call" else None)
    try:
        moved()
    finally:
        sys.setprofile(None)
    assert called
    assert [name for name in called if f"{os.sep}numba{os.sep}" in name] == []
