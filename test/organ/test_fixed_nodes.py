"""Held nodes chosen in words and by file."""

import numpy as np
import pytest

from tissue_sim.errors import UserError
from tissue_sim.organ.fixed_nodes import select_fixed


def test_fixed_choices(tmp_path):
    positions = np.random.default_rng(8).uniform(-1.0, 3.0, (300, 3))
    low = select_fixed("z<0.1", positions)
    level = positions[:, 2].min() + 0.1 * np.ptp(positions[:, 2])
    np.testing.assert_array_equal(low, np.flatnonzero(positions[:, 2] <= level))
    assert len(select_fixed("none", positions)) == 0
    assert len(select_fixed("y > 0", positions)) == 300
    np.save(tmp_path / "nodes.npy", np.array([7, 3, 7]))
    np.testing.assert_array_equal(select_fixed(str(tmp_path / "nodes.npy"), positions), [3, 7])
    np.save(tmp_path / "far.npy", np.array([300]))
    np.save(tmp_path / "float.npy", np.array([0.5]))
    (tmp_path / "text.npy").write_text("1 2 3")
    for choice, reason in {
        "z<1.5": "within 0..1",
        "z=0.1": "is not understood",
        str(tmp_path / "far.npy"): r"outside 0\.\.299",
        str(tmp_path / "float.npy"): "1-D array of integers",
        str(tmp_path / "text.npy"): "not a .npy file",
        str(tmp_path / "none.npy"): "does not exist",
    }.items():
        with pytest.raises(UserError, match=reason):
            select_fixed(choice, positions)
