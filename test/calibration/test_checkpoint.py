"""What a calibration keeps: found again by the same inputs alone, and nothing else touched."""

import numpy as np
import pytest

from tissue_sim.calibration.checkpoint import Checkpoint
from tissue_sim.errors import UserError


def test_a_checkpoint_keeps_what_belongs_to_its_inputs(tmp_path):
    first = Checkpoint(tmp_path / "kept", {"seed": 1})
    made = [first.remember("a", lambda: {"x": np.arange(3)})["x"] for _ in range(2)]
    np.testing.assert_array_equal(made[0], made[1])
    again = Checkpoint(tmp_path / "kept", {"seed": 1})
    assert again.found
    np.testing.assert_array_equal(again.remember("a", lambda: pytest.fail("was made again"))["x"], np.arange(3))
    (tmp_path / "kept" / "a.npz").write_bytes(b"cut short")
    assert again.load("a") is None
    other = Checkpoint(tmp_path / "kept", {"seed": 2})
    assert not other.found
    assert other.load("a") is None
    other.remove()
    assert not (tmp_path / "kept").exists()


def test_a_checkpoint_leaves_other_folders_alone(tmp_path):
    (tmp_path / "mine").write_text("precious")
    with pytest.raises(UserError, match="something else"):
        Checkpoint(tmp_path, {})
    assert (tmp_path / "mine").read_text() == "precious"
