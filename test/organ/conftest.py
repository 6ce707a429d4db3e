"""Phantoms, each painted and segmented once, for all tests of how organs are made."""

from types import SimpleNamespace

import pytest

from helpers.phantoms import around_kidney, coarse_phantom, fine_phantom
from tissue_sim.commands import build_shipped
from tissue_sim.organ import shipped_kidney
from tissue_sim.organ.build_record import Progress
from tissue_sim.organ.imaging.phantom import PhantomParameters


@pytest.fixture(scope="session")
def phantom():
    return fine_phantom()


@pytest.fixture(scope="session")
def rebuilt(phantom, tmp_path_factory):
    """The kidney that ships, built anew from the phantom: its file, and what each stage made on the way."""
    path, progress = tmp_path_factory.mktemp("shipped") / "kidney.npz", Progress()

    def painted(parameters):
        assert parameters == PhantomParameters()
        return phantom

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build_shipped, "Progress", lambda _tell: progress)
        patch.setattr(shipped_kidney, "make_phantom", painted)
        assert build_shipped.main(["--out", str(path)]) == 0
    return SimpleNamespace(path=path, record=progress.record)


@pytest.fixture(scope="session")
def segmented(rebuilt):
    return rebuilt.record.segmentation


@pytest.fixture(scope="session")
def kidney_wall(rebuilt):
    return rebuilt.record.wall


@pytest.fixture(scope="session")
def coarse():
    return coarse_phantom()


@pytest.fixture(scope="session")
def around():
    return around_kidney
