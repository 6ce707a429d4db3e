"""A large CT, 512 x 512 x 300, is built within 2 GB of memory."""

import subprocess
import sys

import numpy as np
import pytest
import SimpleITK as sitk

from tissue_sim.organ.imaging.phantom import PhantomParameters, make_phantom

# getrusage would tell the peak of the process that started this one, too.
BUILD = """
import sys
from tissue_sim.cli import main
code = main(sys.argv[1:])
print("PEAK", next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")))
sys.exit(code)
"""


def large_ct(path):
    """The phantom on 512 x 512 x 300 voxels of 0.6 x 0.6 x 1 mm, with fresh noise, as int16; returns its seed."""
    phantom = make_phantom(PhantomParameters(spacing=(1.5, 1.5, 2.5), noise=0.0, extent=(307.0, 307.0, 300.0)))
    grid = sitk.Image(512, 512, 300, sitk.sitkInt16)
    grid.SetSpacing((0.6, 0.6, 1.0))
    middle = phantom.ct.to_points((np.array(phantom.ct.size) - 1) / 2)
    grid.SetOrigin((middle - 0.5 * np.array([511 * 0.6, 511 * 0.6, 299.0])).tolist())
    image = sitk.Resample(phantom.ct.to_sitk(), grid, sitk.Transform(), sitk.sitkLinear, -1000.0, sitk.sitkInt16)
    array = sitk.GetArrayFromImage(image)
    rng = np.random.default_rng(300)
    for plane in array:
        plane[:] += (20.0 * rng.standard_normal(plane.shape, dtype=np.float32)).astype(np.int16)
    noisy = sitk.GetImageFromArray(array)
    noisy.CopyInformation(image)
    sitk.WriteImage(noisy, str(path))
    return phantom.seed_point


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_peak_memory_of_a_large_ct(tmp_path, capsys):
    ct = tmp_path / "large.nii"
    seed = large_ct(ct)
    words = ["build", str(ct), "--seed", ",".join(f"{v:.3f}" for v in seed), "--out", str(tmp_path / "organ.npz")]
    done = subprocess.run([sys.executable, "-c", BUILD, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    peak = int(done.stdout.split("PEAK")[1]) / 1024**2
    with capsys.disabled():
        print(f"\n512 x 512 x 300: peak memory {peak:.2f} GiB")
    assert peak * 1024**3 < 2.0e9
