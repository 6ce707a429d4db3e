"""From a mask to an organ: which way it faces, and what the stages tell on the way."""

import numpy as np
import pytest

from tissue_sim.organ.build_record import Progress
from tissue_sim.organ.imaging.image import Volume
from tissue_sim.organ.making import MOST_ATOMS, SPARSE, Request, organ_from_mask


def test_a_mirrored_mask_still_points_outward():
    grid = np.indices((30, 30, 40)) - np.array([14.5, 14.5, 19.5])[:, None, None, None]
    inside = (grid[0] / 11) ** 2 + (grid[1] / 9) ** 2 + (grid[2] / 16) ** 2 < 1
    mask = Volume(inside, np.ones(3), np.zeros(3), np.diag([1.0, -1.0, 1.0]), "mirrored")
    organ = organ_from_mask(mask, Request(name="egg", points=200, atoms=8))
    assert organ.volume == pytest.approx(4 / 3 * np.pi * 11 * 9 * 16 * 1e-9, rel=0.04)
    assert organ.surface_positions[:, 1].max() < 0.0


def test_stages_are_watched_in_order_and_timed(tmp_path):
    grid = np.indices((24, 24, 24)) - 11.5
    mask = Volume((grid**2).sum(axis=0) < 81, np.ones(3), np.zeros(3), np.eye(3), "ball")
    seen = []
    progress = Progress(watch=lambda stage, done: seen.append((stage, done)))
    organ_from_mask(mask, Request(name="ball", points=100, atoms=3), progress=progress)
    stages = list(dict.fromkeys(stage for stage, _ in seen))
    assert stages == ["wall", "balloon", "skeleton", "springs"] == list(progress.record.seconds)
    shares = [done for stage, done in seen if stage == "balloon"]
    assert len(shares) > 4
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert all(seconds > 0.0 for seconds in progress.record.seconds.values())
    assert progress.record.wall is not None
    assert progress.record.organ.n_surface == 100


def test_a_body_without_a_long_axis_gets_fewer_atoms_unless_they_are_asked_for():
    """Forty-eight on the short centreline of a ball would lie closer than its surface's edges, with slivers between."""
    grid = np.indices((40, 40, 40)) - 19.5
    mask = Volume((grid**2).sum(axis=0) < 300, np.ones(3), np.zeros(3), np.eye(3), "ball")
    organ = organ_from_mask(mask, Request(name="ball", points=400))
    corner = organ.surface_positions[organ.surface_triangles]
    edge = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).mean()
    apart = np.linalg.norm(np.diff(organ.atom_positions, axis=0), axis=1)
    assert 2 <= organ.n_atoms < MOST_ATOMS
    assert apart.mean() >= SPARSE * edge
    assert organ.provenance["atoms"] == organ.n_atoms
    assert organ_from_mask(mask, Request(name="ball", points=400, atoms=MOST_ATOMS)).n_atoms == MOST_ATOMS
