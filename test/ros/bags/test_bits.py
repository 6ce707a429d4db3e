"""Bits do not depend on the processor: kernels compiled for any x86-64 repeat what those for this machine recorded."""

import os
import platform
import subprocess
import sys

import pytest

from helpers.paths import ROOT

BAGS = [str(ROOT / "bags" / name) for name in ("nip", "gripper", "local_force")]


KERNELS_OF_BLAS = "Prescott", "Nehalem", "Haswell"  # of OpenBLAS, which has others for others; each runs on AVX2
# Prints what follows from an organ and goes into its ticks.
MODEL = """
import hashlib
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
one = Simulation(Organ.load(shipped_organ()))
tissue = one.model.tissue
parts = (array.tobytes() for array in (tissue.constants, tissue.groups.constants, one.model.rest))
print(one.frequency.hex(), hashlib.sha256(b"".join(parts)).hexdigest())
"""


@pytest.mark.extended
@pytest.mark.skipif(platform.machine() != "x86_64", reason="another architecture was not measured")
def test_a_model_is_the_same_by_any_linear_algebra():
    outputs = {
        subprocess.run(
            [sys.executable, "-c", MODEL],
            env=os.environ | ({"OPENBLAS_CORETYPE": kernels} if kernels else {}),
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for kernels in ("", *KERNELS_OF_BLAS)
    }
    assert len(outputs) == 1


@pytest.mark.extended
@pytest.mark.skipif(platform.machine() != "x86_64", reason="another architecture was not measured")
@pytest.mark.parametrize("kernels", KERNELS_OF_BLAS)
def test_another_processors_linear_algebra_repeats_to_the_last_bit(kernels):
    """What a replay computes beside its compiled kernels: cells' shapes, poses."""
    words = ["--force-tolerance", "0", "--position-tolerance", "0"]
    done = subprocess.run(
        [sys.executable, "-m", "tissue_sim", "replay", *BAGS[:2], *words],
        env=os.environ | {"OPENBLAS_CORETYPE": kernels},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() != "x86_64", reason="another architecture was not measured")
def test_another_instruction_set_repeats_to_the_last_bit(tmp_path):
    """Compiles all kernels again, in a folder of their own."""
    compiled = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(tmp_path / "generic")}
    words = ["--force-tolerance", "0", "--position-tolerance", "0"]
    done = subprocess.run(
        [sys.executable, "-m", "tissue_sim", "replay", *BAGS, *words],
        env=os.environ | compiled,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count(" ok\n") == len(BAGS)
    assert any((tmp_path / "generic").rglob("*.nbi")), "nothing was compiled"
