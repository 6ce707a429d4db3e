"""From a mask to an organ: in which direction it faces, and what the stages report."""

import numpy as np
import pytest

from tissue_sim.errors import UserError
from tissue_sim.organ.build_record import Progress
from tissue_sim.organ.imaging.image import Volume
from tissue_sim.organ.pipeline import organ_from_image, organ_from_mask
from tissue_sim.organ.request import MOST_ATOMS, SPARSE, Request


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
    fractions = [done for stage, done in seen if stage == "balloon"]
    assert len(fractions) > 4
    assert fractions == sorted(fractions)
    assert (fractions[0], fractions[-1]) == (0.0, 1.0)
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


def ball(spacing, radius=11.0, size=30):
    """A mask of a ball of so many voxels' radius; spacing, mm."""
    grid = np.indices((size,) * 3) - 0.5 * (size - 1)
    return Volume((grid**2).sum(axis=0) < radius**2, np.full(3, spacing), np.zeros(3), np.eye(3), "ball.mha")


@pytest.mark.parametrize(("spacing", "size"), [(1000.0, "22 m"), (0.05, "0.0011 m")])
def test_a_mask_that_is_no_organ_in_size_is_refused(spacing, size):
    with pytest.raises(UserError) as caught:
        organ_from_mask(ball(spacing), Request(name="ball", points=200))
    voxels = f"{spacing:g} x {spacing:g} x {spacing:g} mm"
    assert f"mask ball.mha is {size} long, but an organ is 5 mm to 1 m; its voxels are {voxels}" in str(caught.value)
    image = ball(spacing)
    with pytest.raises(UserError, match=r"image ball\.mha is .* m long, but a CT is 5 mm to 3 m; its voxels are"):
        organ_from_image(image.with_array(image.array.astype(np.float32)), np.zeros(3), Request(name="ball"))


def test_both_volumes_are_reported_and_kept():
    lines = []
    organ = organ_from_mask(ball(2.0), Request(name="ball", points=200, atoms=4), Progress(lines.append))
    read = np.count_nonzero(ball(2.0).array) * 8e-3
    (line,) = [line for line in lines if "mL read" in line]
    assert line.startswith(f"{read:.1f} mL read, {organ.volume * 1e6:.1f} mL built (")
    assert organ.volume * 1e6 == pytest.approx(read, rel=0.03)
    assert organ.provenance["volume_read_ml"] == pytest.approx(read, abs=1e-3)
    assert organ.provenance["volume_built_ml"] == pytest.approx(organ.volume * 1e6, abs=1e-3)


def test_an_organ_of_another_volume_is_refused_or_accepted():
    """The mask is a shell, whose cavity is filled: a third of the ball."""
    shell = ball(2.0)
    shell = shell.with_array(shell.array & ~ball(2.0, radius=7.6).array)
    with pytest.raises(UserError, match=r"ball differs from its input: 30\.1 mL read, 43\.\d mL built \(\+4\d\."):
        organ_from_mask(shell, Request(name="ball", points=200))
    lines = []
    organ_from_mask(shell, Request(name="ball", points=200, atoms=4, accept=True), Progress(lines.append))
    assert any(line.startswith("warning: ") and "mL built" in line for line in lines)
