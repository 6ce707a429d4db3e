"""Phantoms, each painted and segmented once, for all tests of the organ pipeline."""

from types import SimpleNamespace

import numpy as np
import pytest

from tissue_sim.organ import build_shipped as ship
from tissue_sim.organ.imaging.phantom import PhantomParameters, make_phantom
from tissue_sim.organ.pipeline import Progress


@pytest.fixture(scope="session")
def phantom():
    return make_phantom()


@pytest.fixture(scope="session")
def rebuilt(phantom, tmp_path_factory):
    """The kidney that ships, built anew from the phantom: its file, and what each stage made on the way."""
    path, progress = tmp_path_factory.mktemp("ship") / "kidney.npz", Progress()

    def painted(parameters):
        assert parameters == PhantomParameters()
        return phantom

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ship, "Progress", lambda _tell: progress)
        patch.setattr(ship, "make_phantom", painted)
        assert ship.main(["--out", str(path)]) == 0
    return SimpleNamespace(path=path, record=progress.record)


@pytest.fixture(scope="session")
def segmented(rebuilt):
    return rebuilt.record.segmentation


@pytest.fixture(scope="session")
def kidney_wall(rebuilt):
    return rebuilt.record.wall


@pytest.fixture(scope="session")
def coarse():
    """A coarser phantom, for what doesn't depend on fineness."""
    return make_phantom(PhantomParameters(spacing=(2.0, 2.0, 2.5)))


@pytest.fixture(scope="session")
def around():
    """Crops a phantom's volume to what lies close around its kidney, which is found sooner there."""

    def crop(phantom, volume):
        centre = np.round(phantom.ct.to_index(phantom.seed_point)).astype(int)
        reach = np.ceil([60.0, 56.0, 72.5] / phantom.ct.spacing).astype(int)
        return volume.crop(centre - reach, centre + reach)

    return crop
