"""What a calibration keeps: found again by the same inputs alone, and nothing else touched."""

import numpy as np
import pytest

from tissue_sim.calibration.checkpoint import Checkpoint
from tissue_sim.errors import UserError

pytest.importorskip("joblib")


def never():
    pytest.fail("was made again")


def test_a_checkpoint_keeps_what_belongs_to_its_inputs(tmp_path):
    first = Checkpoint(tmp_path / "kept", {"seed": 1})
    assert not first.found
    made = [first.remember("a", make)["x"] for make in (lambda: {"x": np.arange(3)}, never)]
    np.testing.assert_array_equal(made[0], made[1])
    again = Checkpoint(tmp_path / "kept", {"seed": 1})
    assert again.found
    np.testing.assert_array_equal(again.remember("a", never)["x"], np.arange(3))
    other = Checkpoint(tmp_path / "kept", {"seed": 2})
    assert not other.found
    np.testing.assert_array_equal(other.remember("a", lambda: {"x": np.ones(2)})["x"], np.ones(2))
    other.remove()
    assert not (tmp_path / "kept").exists()


def test_what_was_cut_short_is_made_again(tmp_path):
    first = Checkpoint(tmp_path / "kept", {})
    before = set(tmp_path.rglob("*.pkl"))
    first.remember("a", lambda: {"x": np.arange(3)})
    (file,) = set(tmp_path.rglob("*.pkl")) - before
    file.write_bytes(file.read_bytes()[:-20])
    again = Checkpoint(tmp_path / "kept", {}).remember("a", lambda: {"x": np.full(3, 7)})["x"]
    np.testing.assert_array_equal(again, np.full(3, 7))


def test_a_checkpoint_leaves_what_is_not_its_own(tmp_path):
    (tmp_path / "mine").write_text("precious")
    checkpoint = Checkpoint(tmp_path, {})
    checkpoint.remember("a", lambda: {"x": np.arange(3)})
    checkpoint.remove()
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
    assert (tmp_path / "mine").read_text() == "precious"


def test_a_folder_that_cannot_be_written_takes_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="cannot write"):
        Checkpoint(tmp_path / "file" / "kept", {})
