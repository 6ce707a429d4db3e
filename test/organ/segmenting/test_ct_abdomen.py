"""A real CT, 3 mm and without contrast agent: kidneys, spleen and liver, each from one seed."""

from pathlib import Path

import numpy as np
import pytest

from tissue_sim.cli import main
from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.image_file import read_image
from tissue_sim.organ.imaging.masks import read_mask
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.segmenting.anatomy import misfits
from tissue_sim.organ.segmenting.segmentation import dice, segment
from tissue_sim.organ.surfaces.surface import measure

DATA = Path(__file__).parents[3].parent / "shared" / "data" / "ct_abdomen"
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"no {DATA.name} in ../shared/data beside the project")

SEED = np.array([85.0, -110.3, 364.3])


@pytest.fixture(scope="module")
def ct():
    return read_image(DATA / "ct.nii.gz")


@pytest.fixture(scope="module")
def left_kidney(tmp_path_factory):
    """The left kidney's file as the command line builds it, and its segmentation."""
    out, found = tmp_path_factory.mktemp("ct") / "kidney.npz", []

    def kept(*arguments, **options):
        found.append(segment(*arguments, **options))
        return found[-1]

    words = ["build", str(DATA / "ct.nii.gz"), "--seed", ",".join(map(str, SEED)), "--organ", "kidney"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tissue_sim.organ.segmenting.segmentation.segment", kept)
        assert main([*words, "--out", str(out)]) == 0
    return out, found[0]


@pytest.mark.extended
def test_the_left_kidney_becomes_an_organ(left_kidney):
    organ = Organ.load(left_kidney[0])
    assert (organ.n_surface, len(organ.surface_triangles), organ.n_atoms) == (994, 1984, 48)
    assert 110e-6 < organ.volume < 170e-6
    quality = measure(organ.surface_positions, organ.surface_triangles)
    assert quality.self_intersections == 0
    assert quality.least_angle > 10.0
    assert organ.provenance["wall_distance_mm"] < 0.75  # half a voxel of the working grid


ORGANS = {
    "kidney_left": ("kidney", [(85.0, -110.3, 364.3), (91.0, -149.3, 355.3), (76.0, -104.3, 382.3)]),
    "kidney_right": ("kidney", [(-83.0, -137.3, 316.3), (-77.0, -161.3, 340.3), (-56.0, -113.3, 346.3)]),
    "spleen": ("spleen", [(85.0, -110.3, 427.3), (97.0, -86.3, 400.3), (127.0, -134.3, 400.3)]),
    "liver": ("liver", [(-80.0, -155.3, 427.3), (1.0, -248.3, 397.3), (19.0, -227.3, 400.3)]),
}


def overlaps(name, found, capsys):
    """Dice of what was found; the masks are another program's, see SOURCE.txt."""
    truth = read_mask(DATA / f"{name}.nii.gz")
    reached = [dice(each.mask, truth) for each in found]
    with capsys.disabled():
        print(f"\n{name}: Dice " + ", ".join(f"{value:.3f}" for value in reached))
    return reached


@pytest.mark.extended
def test_dice_of_the_left_kidney_from_one_seed_in_the_middle(left_kidney, capsys):
    assert overlaps("kidney_left", [left_kidney[1]], capsys)[0] >= 0.85
    assert not left_kidney[1].at_edge
    assert not any("reaches the image's border" in line for line in left_kidney[1].warnings)


@pytest.mark.slow
@pytest.mark.parametrize("name", ORGANS)
def test_dice_from_any_seed(name, ct, capsys):
    found = [segment(ct, np.array(seed), organ=ORGANS[name][0], accept=True) for seed in ORGANS[name][1]]
    assert min(overlaps(name, found, capsys)) >= 0.85
    cut = name in ("spleen", "liver")  # the image ends below the diaphragm's dome
    assert found[0].at_edge == cut
    assert any("reaches the image's border" in line for line in found[0].warnings) == cut


@pytest.mark.slow
def test_an_organ_cut_by_the_image_is_refused(ct):
    with pytest.raises(UserError, match=r"the spleen reaches the image's border.*--accept"):
        segment(ct, np.array(ORGANS["spleen"][1][0]), organ="spleen")


@pytest.mark.slow
def test_the_spleen_is_no_kidney(ct):
    with pytest.raises(UserError, match=r"--organ|border"):
        segment(ct, np.array(ORGANS["spleen"][1][0]), organ="kidney")
    as_kidney = segment(ct, np.array(ORGANS["liver"][1][0]), organ="kidney", accept=True)
    assert any("does not fit the anatomy of the kidney" in line for line in as_kidney.warnings)


@pytest.mark.parametrize(
    "name",
    ["kidney_left", *(pytest.param(name, marks=pytest.mark.extended) for name in ORGANS if name != "kidney_left")],
)
def test_real_organs_keep_the_bounds(name, ct):
    """The masks themselves are within the anatomy and hang together, so what is refused is a fault."""
    mask = read_mask(DATA / f"{name}.nii.gz")
    values = ct.array[mask.array]
    assert misfits(mask, float(np.median(values)), ORGANS[name][0]) == ()
    assert misfits(mask, float(np.median(values)), None) == ()
