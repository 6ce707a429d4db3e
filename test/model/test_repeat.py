"""The same inputs give the same bits, for every integrator in every region, and the same numbers uncompiled."""

import os
import subprocess
import sys
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from helpers.pressing import line
from helpers.scenes import ball
from helpers.states import assert_same, snapshot
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.model.data.settings import INTEGRATORS, LOCAL_REGIONS
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.cell_mesh import with_cells

ROOT = Path(__file__).resolve().parents[2]


def contact_run(integrator, region, organ):
    """A probe led into a ball, held and away; every bit of the state after it, and what was felt."""
    scene = Scene(organ, [Tool("probe", radius=0.008)], local_region=region, integrator=integrator)
    top = ball(2).surface_positions[np.argmax(ball(2).surface_positions[:, 2])] + [0.0, 0.0, 0.008]
    down, felt = line(top + [0.0, 0.0, 0.001], top - [0.0, 0.0, 0.002], 40), []
    for position in [*down, *down[-1:] * np.ones((10, 1)), *down[::-2]]:
        scene.move(0, position)
        scene.step()
        felt.append(scene.wrenches.copy())
    return scene.simulation.state.words.copy(), np.array(felt)


@pytest.mark.parametrize(("integrator", "region"), product(INTEGRATORS, LOCAL_REGIONS))
def test_two_runs_with_a_tool_are_bit_identical(integrator, region):
    one, other = (contact_run(integrator, region, ball(2)) for _ in range(2))
    assert np.abs(one[1]).max() > 0.01, "no touch"
    for first, second in zip(one, other, strict=True):
        np.testing.assert_array_equal(first, second)


def test_two_runs_of_a_region_of_cells_are_bit_identical():
    one, other = (contact_run("symplectic", "modal", with_cells(ball(2))) for _ in range(2))
    assert np.abs(one[1]).max() > 0.01, "no touch"
    for first, second in zip(one, other, strict=True):
        np.testing.assert_array_equal(first, second)


UNCOMPILED = """
import sys
import numpy as np
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ
organ = Organ.load(sys.argv[1])
found = []
for integrator, region in (("symplectic", "off"), ("symplectic", "modal"), ("explicit", "frozen")):
    simulation = Simulation(organ, integrator=integrator, local_region=region, substeps=1)
    for _ in range(3):
        simulation.apply_force(int(sys.argv[2]), [0.01, 0.0, -0.05])
        simulation.step()
    found.append(simulation.positions.copy())
np.save(sys.argv[3], found)
"""


@pytest.mark.extended
def test_steps_and_regions_without_the_compiler_agree(tmp_path):
    organ = ball()
    node = int(np.argmax(organ.surface_positions[:, 2]))
    organ.save(tmp_path / "ball.npz")
    paths = []
    for name, environment in (("compiled", {}), ("plain", {"NUMBA_DISABLE_JIT": "1"})):
        paths.append(tmp_path / f"{name}.npy")
        words = [sys.executable, "-c", UNCOMPILED, tmp_path / "ball.npz", str(node), paths[-1]]
        subprocess.run(words, cwd=ROOT, env={**os.environ, **environment}, check=True)
    compiled, plain = (np.load(path) for path in paths)
    assert np.all(np.abs(compiled - organ.rest_positions).max(axis=(1, 2)) > 1e-6)
    np.testing.assert_allclose(plain, compiled, rtol=0.0, atol=1e-12 * 0.03)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_snapshot_continues_bit_identically(integrator):
    node = int(np.argmax(ball(2).surface_positions[:, 2]))
    whole, other = (Simulation(ball(2), integrator=integrator) for _ in range(2))
    for tick in range(60):
        if tick == 30:
            other.restore(snapshot(whole))
        for simulation in (whole, other) if tick >= 30 else (whole,):
            simulation.apply_force(node, [0.02, 0.0, -0.1])
            simulation.step()
    assert_same(whole, other)
    assert whole.state.status.tick == 60
