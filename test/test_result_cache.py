"""What is kept in the user's cache between runs."""

import errno
import os

import numpy as np
import pytest

from tissue_sim.result_cache import KEPT, remembered


@pytest.fixture
def folder(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "tissue_sim"


class Made:
    """Counts how often it is asked."""

    def __init__(self, value=1.0):
        self.value, self.times = value, 0

    def __call__(self):
        self.times += 1
        return {"table": np.full((3, 4), self.value, dtype=np.float32), "none": np.zeros((0, 0))}


def test_second_call_returns_the_same_arrays_without_making_them(folder):
    make = Made(0.1)
    first = remembered("thing", "k" * 64, make)
    second = remembered("thing", "k" * 64, make)
    assert make.times == 1
    assert first.keys() == second.keys()
    for name, array in first.items():
        np.testing.assert_array_equal(array, second[name])
        assert array.dtype == second[name].dtype
    assert len(list(folder.iterdir())) == 1, "nothing half-written stays"


def test_other_kinds_and_keys_are_other_things(folder):
    for number, (kind, key) in enumerate([("thing", "a"), ("thing", "b"), ("other", "a")]):
        assert remembered(kind, key, Made(number))["table"][0, 0] == number
    assert remembered("thing", "b", Made(9.0))["table"][0, 0] == 1.0


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 and no more", b"no archive at all", None])
def test_damaged_file_is_made_anew(folder, damage):
    remembered("thing", "a", Made())
    (path,) = folder.iterdir()
    path.write_bytes(path.read_bytes()[:-60] if damage is None else damage)
    make = Made(5.0)
    assert remembered("thing", "a", make)["table"][0, 0] == 5.0
    assert remembered("thing", "a", make)["table"][0, 0] == 5.0
    assert make.times == 1


def test_home_that_cannot_be_written_costs_time_alone(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    make = Made()
    for _ in range(2):
        np.testing.assert_array_equal(remembered("thing", "a", make)["table"], 1.0)
    assert make.times == 2


def test_disk_that_is_full_costs_time_alone_and_keeps_no_part(folder, monkeypatch):
    def no_room(path, **arrays):
        path.write_bytes(b"half of it")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("tissue_sim.result_cache.np.savez", no_room)
    make = Made()
    for _ in range(2):
        np.testing.assert_array_equal(remembered("thing", "a", make)["table"], 1.0)
    assert make.times == 2
    assert not list(folder.iterdir())


def test_the_ones_used_longest_ago_are_forgotten(folder):
    for number in range(KEPT):
        remembered("thing", f"{number}", Made(number))
        os.utime(folder / f"thing-{number}.npz", (1000.0 + number, 1000.0 + number))
    remembered("other", "0", Made())
    remembered("thing", "0", Made())  # used again, so that the next oldest goes
    remembered("thing", "new", Made())
    names = {path.name for path in folder.iterdir()}
    expected = {f"thing-{number}.npz" for number in range(KEPT) if number != 1}
    assert names == expected | {"thing-new.npz", "other-0.npz"}
