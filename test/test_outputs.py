"""What a command will write: refused in one line before the work begins, and JSON that reads back."""

import json

import pytest

from tissue_sim.errors import UserError
from tissue_sim.outputs import check_file, check_folder, make_folder, write_json


def test_a_missing_folder_is_named(tmp_path):
    check_folder(tmp_path / "organ.npz", "the organ file")
    with pytest.raises(UserError, match=r"folder .*missing for the report does not exist; make it first"):
        check_folder(tmp_path / "missing" / "report.html", "the report")


def test_a_file_has_the_ending_of_its_format(tmp_path):
    check_file("--out", tmp_path / "organ.NPZ", ".npz", "the organ file")
    with pytest.raises(UserError, match=r"--out .*organ\.obj must end in \.npz"):
        check_file("--out", tmp_path / "organ.obj", ".npz", "the organ file")
    with pytest.raises(UserError, match=r"folder .*missing for the organ file does not exist"):
        check_file("--out", tmp_path / "missing" / "organ.npz", ".npz", "the organ file")


def test_a_folder_is_made_where_it_can_be(tmp_path):
    make_folder(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b").is_dir()
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match=r"cannot make folder .*file: File exists; name another with --out"):
        make_folder(tmp_path / "file")


def test_json_reads_back(tmp_path):
    values = {"modulus": 6.3, "stiff_places": ["a", "b"]}
    write_json(tmp_path / "found.json", values)
    assert json.loads((tmp_path / "found.json").read_text()) == values
    with pytest.raises(UserError, match="cannot write"):
        write_json(tmp_path / "missing" / "found.json", values)
