"""The loop in C does what the kernels do."""

import shutil

import numpy as np
import pytest

from helpers.scenes import ball, filled, kidney
from tissue_sim.bench import c_loop
from tissue_sim.bench.c_loop import AGREEMENT, NATIVE, PLAIN, CLoop, CLoopError
from tissue_sim.bench.organs import patch_load
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.cell_mesh import with_cells

pytestmark = pytest.mark.extended

needs_compiler = pytest.mark.skipif(not shutil.which(c_loop.COMPILER), reason="no C compiler")


CELLS = with_cells(filled(ball(2), 20), (1.0, 1.0))


def loop_of(organ, flags=PLAIN):
    return CLoop(Simulation(organ), flags, *patch_load(organ, 0.05))


@needs_compiler
@pytest.mark.parametrize("organ", [ball(2), kidney(), CELLS], ids=["ball", "kidney", "cells"])
@pytest.mark.parametrize("flags", [PLAIN, NATIVE], ids=["plain", "native"])
def test_c_loop_equals_the_kernels(organ, flags):
    loop = loop_of(organ, flags)
    assert loop.compare() <= AGREEMENT
    assert np.abs(loop.position - organ.rest_positions).max() > 1e-5, "the organ moved"


@needs_compiler
def test_c_loop_takes_time_for_each_substep():
    loop = loop_of(ball(2))
    times = loop(20)
    assert times.shape == (20,)
    assert np.median(times) > 0.0


@needs_compiler
@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("(1.0 - 1.0 / stretch)", "(1.0 - 1.001 / stretch)"),
        ("bent - c[3 * BLOCK + e]", "bent"),
        ("f[i] += m->load[i]", "f[i] += 0.5 * m->load[i]"),
    ],
)
def test_another_result_is_noticed(monkeypatch, right, wrong):
    assert right in c_loop.SOURCE
    monkeypatch.setattr(c_loop, "SOURCE", c_loop.SOURCE.replace(right, wrong))
    with pytest.raises(CLoopError, match="differs"):
        loop_of(ball(2)).compare()


@needs_compiler
@pytest.mark.parametrize(
    ("right", "wrong"), [("- shear * inverse", "- 1.001 * shear * inverse"), ("s12 * kx", "s13 * kx")]
)
def test_another_result_of_cells_is_noticed(monkeypatch, right, wrong):
    assert right in c_loop.SOURCE
    monkeypatch.setattr(c_loop, "SOURCE", c_loop.SOURCE.replace(right, wrong))
    with pytest.raises(CLoopError, match="differs"):
        loop_of(CELLS).compare()


def test_missing_compiler_is_named(monkeypatch):
    monkeypatch.setattr(c_loop, "COMPILER", "no-such-compiler")
    with pytest.raises(CLoopError, match="no C compiler"):
        loop_of(ball(2))


@needs_compiler
def test_flag_that_the_compiler_does_not_know_is_reported():
    with pytest.raises(CLoopError, match="--no-such-flag"):
        loop_of(ball(2), ("--no-such-flag",))
