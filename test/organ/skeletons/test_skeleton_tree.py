"""Branches: all found, none invented; a branch is a segment between junctions and tips."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from helpers import vessels
from helpers.shapes import ball, solid
from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.masks import read_mask
from tissue_sim.organ.skeletons.skeleton import extract
from tissue_sim.organ.surfaces.surface import make_wall

CT = Path(__file__).parents[3].parent / "shared" / "data" / "ct_abdomen"
COARSE = (1.5, 1.5, 2.0)

FINE = (1.0, 1.0, 1.0)
TREES = {
    "Y": (vessels.y_tube(), 3),
    "wide Y": (vessels.y_tube(angle=60.0), 3),
    "Y with thin arms": (vessels.y_tube(8.0, 4.0, 45.0), 3),
    "T": ([vessels.tube([[0, 0, -60], [0, 0, 60]], 6.0), vessels.tube([[0, 0, 0], [60, 0, 0]], 6.0)], 3),
    "vessel": (vessels.vessel_tree(), 7),
    "trunk with sides": (vessels.trunk_with_sides(), 7),
}
# Thin arms need fine voxels; the largest trees are found in coarse ones, too, and much sooner.
AT_ONCE = {
    "Y": FINE,
    "wide Y": COARSE,
    "Y with thin arms": FINE,
    "T": FINE,
    "vessel": COARSE,
    "trunk with sides": COARSE,
}


def gaps(skeleton):
    return np.linalg.norm(skeleton.positions[1:] - skeleton.positions[skeleton.parent[1:]], axis=1)


def check_tree(skeleton, atoms):
    """A tree with earlier parents, branches without gaps in their numbers, that hang together."""
    assert skeleton.positions.shape == (atoms, 3)
    assert skeleton.parent[0] == -1
    assert np.all(skeleton.parent[1:] >= 0)
    assert np.all(skeleton.parent[1:] < np.arange(1, atoms))
    assert skeleton.branch.dtype == np.int32
    assert set(skeleton.branch) == set(range(skeleton.branches))
    children = np.bincount(skeleton.parent[1:], minlength=atoms)
    # Along a branch every atom has one child, so branches change at junctions only.
    other = skeleton.branch[1:] != skeleton.branch[skeleton.parent[1:]]
    assert np.all(children[skeleton.parent[1:][other]] > 1)


def junctions_and_tips(skeleton):
    degree = np.bincount(skeleton.parent[1:], minlength=len(skeleton.parent)) + (skeleton.parent >= 0)
    return np.flatnonzero(degree > 2), np.flatnonzero(degree == 1)


@pytest.mark.parametrize(
    ("name", "spacing"),
    [
        pytest.param(name, spacing, marks=[] if AT_ONCE[name] == spacing else pytest.mark.extended)
        for name in TREES
        for spacing in (FINE, COARSE)
    ],
)
def test_all_branches_are_found_and_none_invented(name, spacing, capsys):
    tubes, count = TREES[name]
    wall = make_wall(vessels.mask_of(tubes, spacing, shift=(0.3, 0.2, 0.1)))
    skeleton = extract(wall, 96)
    check_tree(skeleton, 96)
    assert skeleton.branches == count
    junctions, tips = junctions_and_tips(skeleton)
    assert (len(junctions), len(tips)) == ((count - 1) // 2, (count + 3) // 2)
    points = wall.to_patient(skeleton.positions) * 1e3
    middle = np.concatenate([vessels.dense(t) for t in tubes])
    off = cKDTree(middle).query(points)[0] / wall.spacing
    with capsys.disabled():
        print(
            f"\n{name}, {wall.spacing:g} mm: {skeleton.branches} branches,"
            f" mean offset {off.mean():.2f} voxels, most {off.max():.2f}"
        )
    assert off.mean() < 0.5
    assert off.max() < 4.5
    # Every free end of a tube has a tip of the skeleton near by; the one tip more is the first tube's start.
    starts = cKDTree([t.points[0] for t in tubes])
    leaves = [t.points[-1] for t in tubes if starts.query(t.points[-1])[0] > 1.0]
    assert len(leaves) == len(tips) - 1
    assert cKDTree(points[tips]).query(leaves)[0].max() < 1.5 * max(t.radius.max() for t in tubes)
    assert np.all(wall.sample(skeleton.positions) < 0.0)
    spacings = gaps(skeleton)
    assert spacings.max() < 1.2 * spacings.min()


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.extended)])
def test_a_rough_wall_makes_no_branches(seed):
    rough = vessels.mask_of([vessels.s_bend(radius=9.0)], widen=vessels.bumps(1.2, 12.0, seed))
    assert extract(make_wall(rough), 60).branches == 1
    fine = vessels.mask_of([vessels.helix(radius=8.0)], widen=vessels.bumps(0.8, 8.0, seed))
    assert extract(make_wall(fine), 60).branches == 1
    forked = vessels.mask_of(vessels.y_tube(), widen=vessels.bumps(0.7, 9.0, seed))
    assert extract(make_wall(forked), 60).branches == 3


def flat(a, b, c):
    return solid(
        lambda x, y, z: np.sqrt((x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2) - 1.0,
        size=(2 * a + 8, 2 * b + 8, 2 * c + 8),
    )


UNBRANCHED = {  # made when they are asked for, and not by each worker that collects these tests
    "ball": lambda: solid(ball(18.0)),
    "ellipsoid": lambda: flat(10, 12, 35),
    "flat ellipsoid": lambda: flat(12, 24, 48),
    "flatter ellipsoid": lambda: flat(10, 30, 60),
    "disc": lambda: flat(8, 40, 40),
    "tapered tube": lambda: vessels.mask_of([vessels.straight(4.0, 80.0, (1, 2, 3), 12.0)]),
    "bent tube": lambda: vessels.mask_of([vessels.quarter_torus()]),
}


@pytest.mark.parametrize("name", UNBRANCHED)
def test_what_does_not_branch_stays_a_chain(name):
    skeleton = extract(make_wall(UNBRANCHED[name]()), 48)
    assert skeleton.branches == 1
    np.testing.assert_array_equal(skeleton.parent, np.arange(-1, 47))
    np.testing.assert_array_equal(skeleton.branch, 0)


@pytest.mark.skipif(not CT.is_dir(), reason=f"no {CT.name} in ../shared/data beside the project")
@pytest.mark.parametrize(
    "organ",
    [
        "kidney_left",
        *(pytest.param(name, marks=pytest.mark.extended) for name in ("kidney_right", "liver", "spleen", "aorta")),
    ],
)
def test_real_organs_that_do_not_branch(organ):
    skeleton = extract(make_wall(read_mask(CT / f"{organ}.nii.gz")), 48)
    assert skeleton.branches == 1
    np.testing.assert_array_equal(skeleton.parent, np.arange(-1, 47))


def test_branches_off_gives_the_longest_chain():
    wall = make_wall(vessels.mask_of(vessels.y_tube()))
    skeleton = extract(wall, 40, branches="none")
    assert skeleton.branches == 1
    np.testing.assert_array_equal(skeleton.parent, np.arange(-1, 39))
    assert skeleton.length == pytest.approx(110.0, abs=8.0)


@pytest.mark.extended
def test_few_atoms_many_atoms_and_unknown_choices():
    wall = make_wall(vessels.mask_of(vessels.vessel_tree(), COARSE))
    with pytest.raises(UserError, match="--atoms 7 is too few for a skeleton of 7 branches; use 8 or more"):
        extract(wall, 7)
    for atoms in (8, 17, 200):
        skeleton = extract(wall, atoms)
        check_tree(skeleton, atoms)
        assert np.all(np.bincount(skeleton.branch) >= 1)
    with pytest.raises(UserError, match="--branches some is unknown"):
        extract(wall, 20, branches="some")
