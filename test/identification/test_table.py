"""Presses from CSV files: three layouts, and what is none."""

import numpy as np
import pytest

from tissue_sim.errors import UserError
from tissue_sim.identification.table import is_stream, presses_of, read_columns


def written(folder, text):
    (folder / "presses.csv").write_text(text)
    return folder / "presses.csv"


def test_one_sample_a_row(tmp_path):
    path = written(tmp_path, "# made up\npress,depth,force\n1,0,0\n1,0.001,0.1\n2,0,0.01\n2,0.002,0.3\n2,0.001,0.2\n")
    first, second = presses_of(read_columns(path), 0.005, "file")
    np.testing.assert_array_equal(first.forces, [0.0, 0.1])
    np.testing.assert_array_equal(second.depths, [0.0, 0.002], "what comes after the deepest is the release")
    assert not first.is_placed


def test_one_press_a_row_with_its_place(tmp_path):
    rows = ["x,y,z,nx,ny,nz,d0,d1,fn0,fn1", "1,2,3,0,0,2,0,.001,.1,.4", "1,2,3,0,0,1,0,.001,.01,.05"]
    rows += ["0,0,0,0,0,1,0,.001,.1,.5", "0,0,0,0,0,1,0,.002,.1,.6"]
    found = presses_of(read_columns(written(tmp_path, "\n".join(rows))), 0.5, "file")
    assert [press.name for press in found] == ["press 1", "press 3"], "a weak one and one of another depth are left out"
    np.testing.assert_allclose(found[0].direction, [0.0, 0.0, -1.0])
    np.testing.assert_allclose(found[0].place, [1.0, 2.0, 3.5])


def test_streams_are_distinguished(tmp_path):
    assert is_stream(read_columns(written(tmp_path, "time,x,y,z,fx,fy,fz\n" + "0,0,0,0,0,0,0\n")))


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "no rows"),
        ("a,b\n1,2\n", "expected: columns press,depth,force"),
        ("press,depth,force\n1,2\n", "row 2 has 2 columns"),
        ("press,depth,force\n1,2,three\n", "column force"),
        ("press,depth,force\n1,2,inf\n", "not finite"),
    ],
)
def test_what_is_no_table_is_refused(tmp_path, text, what):
    with pytest.raises(UserError, match=what):
        presses_of(read_columns(written(tmp_path, text)), 0.005, "file")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(UserError, match=r"nothing\.csv"):
        read_columns(tmp_path / "nothing.csv")
