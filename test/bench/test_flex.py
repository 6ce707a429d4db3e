"""The organ as a MuJoCo flex."""

import sys

import numpy as np
import pytest

from helpers.scenes import ball
from tissue_sim.bench.flex import Flex, tetrahedra
from tissue_sim.bench.organs import patch_load


def test_tetrahedra_fill_the_organ():
    organ = ball(2)
    cells = tetrahedra(organ)
    corner = organ.rest_positions[cells]
    volume = np.linalg.det(corner[:, 1:] - corner[:, :1]) / 6.0
    assert np.all(volume > 0.0)
    assert volume.sum() == pytest.approx(organ.volume, rel=0.05)


def test_flex_gives_way_and_stays_where_it_is_held(tmp_path, monkeypatch):
    pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)
    organ = ball(2)
    nodes, forces = patch_load(organ, 0.05)
    flex = Flex(organ, nodes, forces)
    assert np.median(flex(40)) > 0.0
    moved = flex.positions - organ.rest_positions
    assert np.all(np.isfinite(moved))
    assert np.mean(moved[nodes] @ forces[0]) / np.linalg.norm(forces[0]) > 1e-5
    assert np.abs(moved[organ.fixed]).max() < 1e-9
    assert not list(tmp_path.iterdir()), "MuJoCo writes no log"


def test_missing_mujoco_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ModuleNotFoundError, match="mujoco"):
        Flex(ball(2), *patch_load(ball(2), 0.05))
