"""The report of a build: complete in itself, true to the organ; and the pictures in it."""

import base64
import dataclasses
import io
import re

import numpy as np
import pytest
from matplotlib.image import imread

from helpers.html_page import Page
from tissue_sim.errors import UserError
from tissue_sim.organ.build_record import BuildRecord, Progress
from tissue_sim.organ.pipeline import organ_from_image
from tissue_sim.organ.reporting import pictures, slice_pictures
from tissue_sim.organ.reporting.description import describe
from tissue_sim.organ.reporting.page import report_page, write_report
from tissue_sim.organ.request import Request
from tissue_sim.organ.segmenting.segmentation import SegmentationParameters

pytestmark = pytest.mark.extended

NAME = 'kidney <b onmouseover="x">&amp;'


def png(image):
    kind, _, data = image["src"].partition(",")
    assert kind == "data:image/png;base64"
    return imread(io.BytesIO(base64.b64decode(data)))


@pytest.fixture(scope="module")
def record(coarse, around):
    progress = Progress()
    request = Request(name=NAME, points=300, atoms=12, provenance={"source": "<script>alert(1)</script>.nii"})
    one_window = SegmentationParameters(window=3.3)
    organ_from_image(around(coarse, coarse.ct), coarse.seed_point, request, one_window, progress=progress)
    return progress.record


@pytest.fixture(scope="module")
def page(record):
    odd = dataclasses.replace(record, lines=["warning: <i>odd</i>"], repairs=("closed <u>3</u> holes",))
    return report_page(odd, "kidney.npz")


def test_the_page_is_complete_in_itself(page):
    parsed = Page(page)
    assert not {"script", "link", "iframe", "object"} & set(parsed.tags)
    for key, value in parsed.attributes:
        assert not key.startswith("on")
        assert key not in ("src", "href") or value.startswith("data:image/png;base64,")
    assert not re.search(r"url\(|@import|https?://", page)
    assert len(parsed.images) == 7
    assert page.startswith("<!DOCTYPE html>")
    assert all(image["alt"] for image in parsed.images)


def test_what_comes_from_outside_is_escaped(page, record):
    assert NAME not in page
    assert "<script>" not in page
    assert NAME in Page(page).text
    assert "<script>alert(1)</script>.nii" in Page(page).text
    assert "&lt;i&gt;odd&lt;/i&gt;" in page
    assert "<i>" not in page
    assert "<u>" not in page
    assert "repaired: closed <u>3</u> holes" in Page(page).text


def test_the_figures_are_those_of_the_organ(page, record):
    organ, found, text = record.organ, record.segmentation, Page(page).text
    figures = describe(organ)
    surface = figures["surface"]
    for words in (
        f"{organ.volume * 1e6:.1f} mL, 300 points, 596 triangles, 12 medial atoms",
        f"volume {found.volume:.1f} mL",
        f"mean of the organ {found.mean:.0f} HU",
        f"eroded until separate {found.erosion:.1f} mm",
        f"{surface['edge_variation']:.3f}",
        f"{surface['least_angle_deg']:.1f}",
        f"atoms 12 branches {figures['skeleton']['branches']}",
        f"edge {figures['springs']['edge']['count']} ",
        f"spoke {figures['springs']['spoke']['count']} ",
        "segmentation parameters: organ any",
        f"digest (SHA-256 of its arrays) {organ.digest()}",
    ):
        assert words in text, words
    assert all(stage in text for stage in ("segment", "wall", "balloon", "skeleton", "springs"))
    assert list(record.seconds) == ["segment", "wall", "balloon", "skeleton", "springs"]


def test_the_distances_between_the_surfaces_are_reported(page):
    found = re.search(r"symmetric Hausdorff\) ([\d.]+) ([\d.]+) mean distance ([\d.]+) ([\d.]+)", Page(page).text)
    largest, in_voxels, mean, _ = map(float, found.groups())
    assert 0.1 < mean < largest < 5.0  # mm, 300 points on a kidney
    assert in_voxels == pytest.approx(largest / 1.25, abs=0.02)


def test_slices_show_the_ct_and_its_outlines(page):
    picture = png(Page(page).images[0])[..., :3]
    grey = np.ptp(picture, axis=2) < 0.02
    shades = np.unique(np.round(picture[grey][:, 0], 1))
    assert len(shades) > 6  # tissue, fat, bone, air
    for colour in (pictures.MASK, pictures.BALLOON, pictures.ATOMS):
        wanted = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
        assert np.count_nonzero(np.abs(picture - wanted).max(axis=2) < 0.1) > 100, colour


def test_pictures_fill_their_frames(page):
    for image in Page(page).images[1:]:
        picture = png(image)[..., :3]
        drawn = np.abs(picture - 1.0).max(axis=2) > 0.02
        rows, columns = np.flatnonzero(drawn.any(axis=1)), np.flatnonzero(drawn.any(axis=0))
        assert np.ptp(rows) > 0.6 * picture.shape[0]
        assert np.ptp(columns) > 0.5 * picture.shape[1]


def test_an_unfinished_build_and_an_unwritable_file_are_refused(record, tmp_path, monkeypatch):
    with pytest.raises(UserError, match="finished build"):
        report_page(BuildRecord())
    monkeypatch.setattr("tissue_sim.organ.reporting.page.report_page", lambda *_: "page")
    with pytest.raises(UserError, match="cannot write report"):
        write_report(record, tmp_path)


def test_scale_bars_have_round_lengths():
    assert [pictures.nice_length(most) for most in (0.9, 1.0, 4.9, 5.0, 37.0, 0.034)] == pytest.approx(
        [0.5, 1.0, 2.0, 5.0, 20.0, 0.02]
    )


def test_slices_look_the_way_radiologists_do():
    """The letters at the borders agree with the directions of the axes, LPS."""
    for plane in slice_pictures.PLANES:
        shown = dict(zip(("left", "right", "top", "bottom"), plane.letters, strict=True))
        letters = [("R", "L"), ("A", "P"), ("F", "H")]  # lower and upper end of each axis of LPS
        assert (shown["left"], shown["right"]) == letters[plane.right]
        low, high = letters[plane.up]
        assert (shown["top"], shown["bottom"]) == ((high, low) if plane.up_sign > 0 else (low, high))
