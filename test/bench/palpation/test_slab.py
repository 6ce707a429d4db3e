"""The slab that balls are pressed into."""

import numpy as np
import pytest

from tissue_sim.bench.palpation.slab import SLAB, slab_as_built
from tissue_sim.organ.tool_resolution import mean_edge


@pytest.mark.extended
def test_the_slab_has_its_size():
    organ = slab_as_built()
    np.testing.assert_allclose(np.ptp(organ.surface_positions, axis=0), SLAB, rtol=0.02)
    assert 0.003 < mean_edge(organ) < 0.005
