"""Slabs that stand for phantoms: their size, and what is no size."""

import numpy as np
import pytest

from tissue_sim.errors import UserError
from tissue_sim.identification.slab import slab_as_built, slab_file, slab_size
from tissue_sim.organ.tool_resolution import mean_edge


@pytest.mark.extended
def test_the_slab_has_its_size():
    size = slab_size("slab:60x60x25")
    organ = slab_as_built(size)
    np.testing.assert_allclose(np.ptp(organ.surface_positions, axis=0), size, rtol=0.02)
    assert 0.003 < mean_edge(organ) < 0.005


def test_sizes_have_files_of_their_own():
    assert slab_size("slab:40x30x20.5") == pytest.approx((0.04, 0.03, 0.0205))
    assert slab_file((0.04, 0.03, 0.0205)).name == "40x30x20.5.npz"


@pytest.mark.parametrize("word", ["slab:60x60", "slab:axbxc", "slab:1x1x1", "slab:25x60x60", "slab:200x60x25"])
def test_what_is_no_slab_is_refused(word):
    with pytest.raises(UserError, match="slab"):
        slab_size(word)
