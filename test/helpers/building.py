"""Calls of `tissue_sim build`: that it succeeds, or is refused in one line."""

import SimpleITK as sitk

from tissue_sim.cli import main
from tissue_sim.organ.organ import Organ

FEW = ["--points", "200", "--atoms", "12", "--branches", "none"]


def write(volume, path):
    sitk.WriteImage(sitk.Cast(volume.to_sitk(), sitk.sitkInt16), str(path))
    return str(path)


def build(capsys, *arguments, out):
    code = main(["build", *arguments, *FEW, "--out", str(out)])
    captured = capsys.readouterr()
    assert code == 0
    assert captured.err == ""  # no bar where standard error is no terminal
    return Organ.load(out), captured.out


def refused(capsys, *arguments):
    """Standard error of a call that must end with exit code 2 and one line."""
    code = main(["build", *arguments])
    captured = capsys.readouterr()
    assert code == 2
    assert captured.err.count("\n") == 1
    assert captured.err.startswith("tissue_sim: error: ")
    return captured.err
