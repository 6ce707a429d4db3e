"""Ctrl-C in each command that takes long: one line that says what is left of its work, and exit code 130."""

import importlib
from pathlib import Path

import numpy as np
import pytest

from helpers.paths import ROOT
from tissue_sim import interrupts
from tissue_sim.cli import main
from tissue_sim.organ.shipped import shipped_organ

ORGAN, BAG = str(shipped_organ()), str(ROOT / "bags" / "poke")
WORK = {  # words of a command, the function that does its work, what the line ends with
    "build": (["--surface", "{folder}/none.stl"], "tissue_sim.commands.build.make", "no organ was written"),
    "phantom": (["{folder}/ct.nii"], "tissue_sim.organ.imaging.phantom.make_phantom", "nothing was written"),
    "calibrate": (
        [ORGAN, "--out", "{folder}/k.npz"],
        "tissue_sim.commands.calibrate.calibrate",
        "the same command continues from {folder}/.k.npz.calibration",
    ),
    "calibrate several": (
        [ORGAN, "--out", "{folder}"],
        "tissue_sim.commands.calibrate.calibrate_many",
        "organs that are ready stay in {folder}, and the same command continues with the others",
    ),
    "identify": (
        [ORGAN, "--out", "{folder}/k.npz", "--csv", "{folder}/presses.csv", "--radius", "0.005"],
        "tissue_sim.commands.identify.identify",
        "the same command continues from {folder}/.k.npz.identification",
    ),
    "abdomen": (
        ["--out", "{folder}", "--as-built"],
        "tissue_sim.organ.pipeline.organ_from_mask",
        "organs that are ready stay in {folder}/abdomen",
    ),
    "solve": (
        [ORGAN, "--loads", "{folder}/loads.npz", "--out", "{folder}/found.npz"],
        "tissue_sim.model.simulation.Simulation.settle",
        "nothing was written",
    ),
    "learn": (["Press"], "tissue_sim.environments.training.learn", "no policy was written"),
    "replay": ([BAG], "tissue_sim.ros.bags.replay.replay_bag", "0 of 1 bags were compared"),
    "export": ([BAG, "{folder}/poke.glb"], "tissue_sim.commands.export_bag.frames_of", "nothing was written"),
    "bench fall": ([], "tissue_sim.bench.fall.in_one_thread", "there is no result"),
}


@pytest.fixture
def folder(tmp_path) -> Path:
    np.savez(tmp_path / "loads.npz", forces=np.zeros((1, 994, 3)))
    (tmp_path / "presses.csv").write_text("press,depth,force\n1,0.001,0.1\n1,0.002,0.2\n")
    return tmp_path


@pytest.mark.parametrize("raised", [KeyboardInterrupt, RuntimeError], ids=["as itself", "as another error"])
@pytest.mark.parametrize("command", WORK)
def test_a_line_says_what_is_left(command, raised, folder, monkeypatch, capsys):
    words, work, left = WORK[command]
    place, name = work.rsplit(".", 1)
    try:
        owner = importlib.import_module(place)
    except ModuleNotFoundError:  # a class of that module
        module, kind = place.rsplit(".", 1)
        owner = getattr(importlib.import_module(module), kind)

    def stopped(*_, **__):
        interrupts._Seen.any = True
        raise raised

    monkeypatch.setattr(owner, name, stopped)
    called = command.removesuffix(" several")
    assert main([*called.split(), *(word.format(folder=folder) for word in words)]) == 130
    assert capsys.readouterr().err.splitlines()[-1] == f"tissue_sim {called}: stopped; {left.format(folder=folder)}"
    assert not interrupts._Seen.any, "later errors are errors again"
