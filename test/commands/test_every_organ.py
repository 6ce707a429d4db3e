"""Every organ of a folder: what is there is built, what can't be is named."""

from pathlib import Path

import numpy as np
import pytest
import SimpleITK

from tissue_sim.commands.every_organ import SOURCES, built, main
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ

DATA = Path(__file__).parents[3] / "shared" / "data"


def test_what_is_there_is_built_and_what_cannot_be_is_named(tmp_path, capsys):
    folder = tmp_path / "ct_abdomen"
    folder.mkdir()
    grid = np.indices((30, 30, 40)) - np.array([14.5, 14.5, 19.5])[:, None, None, None]
    inside = (grid[0] / 11) ** 2 + (grid[1] / 9) ** 2 + (grid[2] / 16) ** 2 < 1
    SimpleITK.WriteImage(SimpleITK.GetImageFromArray(inside.astype(np.uint8)), folder / "spleen.nii.gz")
    SimpleITK.WriteImage(SimpleITK.GetImageFromArray(0 * inside.astype(np.uint8)), folder / "liver.nii.gz")
    found = built(list(SOURCES), tmp_path, tmp_path / "out")
    assert [path.name for path in found] == ["spleen.npz"]
    assert Organ.load(found[0]).name == "spleen"
    assert "liver: not built: " in capsys.readouterr().out


def test_a_folder_without_any_is_one_line(tmp_path, monkeypatch, capsys):
    with pytest.raises(UserError, match=r"no organ in .* can be built"):
        built(list(SOURCES), tmp_path, tmp_path / "out")
    monkeypatch.setattr("sys.argv", ["every_organ", "--data", str(tmp_path), "--out", str(tmp_path / "out")])
    assert main() == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.skipif(not DATA.is_dir(), reason="no ../shared/data beside the project")
def test_every_source_is_in_the_data():
    assert [source.file for source in SOURCES if not (DATA / source.file).is_file()] == []
    assert len({source.name for source in SOURCES}) == len(SOURCES)
