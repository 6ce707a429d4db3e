"""The shipped kidney comes out of the real pipeline, today as when it was made."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tissue_sim.commands import build_shipped
from tissue_sim.organ import shipped_kidney
from tissue_sim.organ.build_record import Progress
from tissue_sim.organ.imaging.phantom import PhantomParameters
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.segmenting.segmentation import dice
from tissue_sim.organ.shipped_kidney import KIDNEY
from tissue_sim.organ.surfaces.surface import measure

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def rebuilt(phantom, tmp_path_factory):
    """The kidney that ships, built again from the phantom: its file, and what each stage made."""
    path, progress = tmp_path_factory.mktemp("shipped") / "kidney.npz", Progress()

    def painted(parameters):
        assert parameters == PhantomParameters()
        return phantom

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build_shipped, "Progress", lambda _tell: progress)
        patch.setattr(shipped_kidney, "make_phantom", painted)
        assert build_shipped.main(["--out", str(path)]) == 0
    return SimpleNamespace(path=path, record=progress.record)


@pytest.mark.extended
def test_its_segmentation_is_the_phantoms_kidney(phantom, rebuilt, capsys):
    """One seed, at the noise and the fineness of a real CT."""
    segmented = rebuilt.record.segmentation
    overlap = dice(segmented.mask, phantom.kidney)
    with capsys.disabled():
        print(f"\nphantom, noise 12 HU: Dice {overlap:.4f}")
    assert overlap >= 0.97
    true = phantom.kidney.array.sum() * phantom.kidney.voxel_volume
    assert abs(segmented.volume - true) < 0.05 * true
    assert not segmented.at_edge
    assert segmented.warnings == ()
    assert abs(segmented.mean - 32.0) < 3.0
    assert -45.0 < segmented.wall < -25.0


@pytest.mark.extended
def test_the_shipped_kidney_is_rebuilt(rebuilt):
    shipped, rebuilt = Organ.load(ROOT / KIDNEY), Organ.load(rebuilt.path)
    assert (rebuilt.n_surface, len(rebuilt.surface_triangles), rebuilt.n_atoms) == (994, 1984, 48)
    assert abs(rebuilt.volume / shipped.volume - 1) < 1e-3
    if np.array_equal(rebuilt.surface_triangles, shipped.surface_triangles):
        np.testing.assert_allclose(rebuilt.surface_positions, shipped.surface_positions, atol=1e-6)
        np.testing.assert_array_equal(rebuilt.spring_nodes, shipped.spring_nodes)
    else:  # another processor rounds otherwise, and an edge flips: the shape must be the same all the same
        centres = [o.surface_positions[o.surface_triangles].mean(axis=1) for o in (shipped, rebuilt)]
        assert cKDTree(np.concatenate([centres[0], shipped.surface_positions])).query(centres[1])[0].mean() < 1.5e-3
        assert measure(rebuilt.surface_positions, rebuilt.surface_triangles).self_intersections == 0
    np.testing.assert_allclose(rebuilt.atom_positions, shipped.atom_positions, atol=2e-4)


def test_the_shipped_kidney_is_small_and_says_where_it_is_from():
    assert (ROOT / KIDNEY).stat().st_size < 1_000_000
    shipped = Organ.load(ROOT / KIDNEY)
    assert shipped.name == "kidney"
    assert shipped.provenance["source"] == "synthetic abdominal CT"
    assert shipped.provenance["phantom"]["seed"] == 2006
    assert len(shipped.fixed) > 20
