"""The report of a build: complete in itself, true to the organ; and the pictures in it."""

import base64
import dataclasses
import html
import io
import re
from html.parser import HTMLParser

import numpy as np
import pytest
import trimesh
from matplotlib.image import imread

from tissue_sim.cli import main
from tissue_sim.errors import UserError
from tissue_sim.organ.pipeline import BuildRecord, Progress, Request, organ_from_image
from tissue_sim.organ.reporting import pictures
from tissue_sim.organ.reporting.info import describe
from tissue_sim.organ.reporting.page import report_page, write_report
from tissue_sim.organ.reporting.render import Solid, draw, rasterize, view_of
from tissue_sim.organ.segmenting.segmentation import SegmentationParameters

NAME = 'kidney <b onmouseover="x">&amp;'
VOID = {"meta", "img", "link", "br"}


class Page(HTMLParser):
    """Tags, pictures and text of a page; fails where a tag isn't closed in order."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.images, self.words, self.attributes, self._open = [], [], [], [], []
        self.feed(text)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs
        if tag == "img":
            self.images.append(dict(attrs))
        if tag not in VOID:
            self._open.append(tag)

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_data(self, data):
        if self._open[-1:] != ["style"]:
            self.words.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())


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
    told = dataclasses.replace(record, lines=["warning: <i>odd</i>"], repairs=("closed <u>3</u> holes",))
    return report_page(told, "kidney.npz")


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
    assert html.escape(NAME) in page
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


def test_the_distances_between_the_surfaces_are_told(page):
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


def test_a_mesh_has_a_report_too_beside_the_organ(tmp_path, capsys):
    egg = trimesh.creation.icosphere(subdivisions=2, radius=0.02)
    egg.apply_scale([1.0, 0.8, 1.6])
    egg.invert()
    egg.export(tmp_path / "egg.ply")
    words = ["--surface", str(tmp_path / "egg.ply"), "--length", "0.08", "--keep-points", "--atoms", "6"]
    assert main(["build", *words, "--interior", "9", "--out", str(tmp_path / "o.npz"), "--report"]) == 0
    assert f"{tmp_path / 'o.html'}: report" in capsys.readouterr().out
    text = (tmp_path / "o.html").read_text(encoding="utf-8")
    assert "<h1>egg</h1>" in text
    parsed = Page(text)
    assert "surface as given" in parsed.text
    assert "repaired: turned inward triangles outward" in parsed.text
    assert "scaled: the longest side is 8 cm" in parsed.text
    assert "HU" not in parsed.text
    assert "interior points 9" in parsed.text
    assert len(parsed.images) == 7


def test_an_unfinished_build_and_an_unwritable_file_are_refused(record, tmp_path, monkeypatch):
    with pytest.raises(UserError, match="finished build"):
        report_page(BuildRecord())
    monkeypatch.setattr("tissue_sim.organ.reporting.page.report_page", lambda *_: "page")
    with pytest.raises(UserError, match="cannot write report"):
        write_report(record, tmp_path)


# rendering -----------------------------------------------------------------------------------------


def test_nearer_hides_farther_whatever_the_order():
    small = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    near, far = ([0.0, -4.0, 0.0], [0.0, 4.0, 0.5])
    red = Solid(small.vertices + near, small.faces.astype(np.int32), (1.0, 0.0, 0.0))
    blue = Solid(2.0 * small.vertices + far, small.faces.astype(np.int32), (0.0, 0.0, 1.0))
    view = view_of(np.concatenate([red.positions, blue.positions]), (0, -1, 0), (0, 0, 1), (200, 200))
    first, second = draw(view, [red, blue]), draw(view, [blue, red])
    np.testing.assert_array_equal(first, second)
    at = view.project([near, [0.0, 4.0, 2.2]])[:, :2] / 2.0
    (red_x, red_y), (blue_x, blue_y) = at.astype(int)
    assert first[red_y, red_x, 0] > 2 * int(first[red_y, red_x, 2])
    assert first[blue_y, blue_x, 2] > 2 * int(first[blue_y, blue_x, 0])


def test_glass_lets_what_is_inside_be_seen():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    faces = ball.faces.astype(np.int32)
    inside = Solid(0.3 * ball.vertices, faces, (1.0, 0.0, 0.0))
    view = view_of(ball.vertices, (1, 0, 0), (0, 0, 1), (120, 120))
    behind_glass = draw(view, [inside], Solid(ball.vertices, faces, (0.4, 0.5, 0.7)))
    hidden = draw(view, [inside, Solid(ball.vertices, faces, (0.4, 0.5, 0.7))])
    middle = behind_glass[60, 60].astype(int)
    assert middle[0] > middle[2] + 40
    assert hidden[60, 60, 0] < hidden[60, 60, 2]
    assert (behind_glass[2, 2] == 255).all()


def test_the_rasterizer_finds_triangle_height_and_edge_distance():
    # Height 10 + x/10 + y/5 over a triangle that faces the viewer: y runs down, so its corners run clockwise there.
    corner = np.array([[2.0, 2.0], [12.0, 30.0], [38.0, 6.0]])
    pixels = np.column_stack([corner, 10.0 + corner @ [0.1, 0.2]])
    depth = np.full((40, 40), -np.inf)
    owner, weight, rim = rasterize(pixels, np.array([[0, 1, 2]], dtype=np.int32), depth, +1)
    rows, columns = np.nonzero(owner == 0)
    assert len(rows) == pytest.approx(0.5 * abs(np.linalg.det(corner[1:] - corner[0])), rel=0.02)
    np.testing.assert_allclose(depth[rows, columns], 10.0 + 0.1 * (columns + 0.5) + 0.2 * (rows + 0.5), rtol=1e-12)
    np.testing.assert_allclose(weight[rows, columns] @ corner, np.column_stack([columns, rows]) + 0.5, rtol=1e-12)
    centre = np.column_stack([columns, rows]) + 0.5
    distances = []
    for k in range(3):
        a, along = corner[k], corner[(k + 1) % 3] - corner[k]
        distances.append(np.abs(np.cross(np.insert(along, 2, 0.0), np.insert(centre - a, 2, 0.0, axis=1))[:, 2]))
        distances[-1] /= np.linalg.norm(along)
    np.testing.assert_allclose(rim[rows, columns], np.min(distances, axis=0), rtol=1e-9)
    other, _, _ = rasterize(pixels, np.array([[0, 1, 2]], dtype=np.int32), np.full((40, 40), -np.inf), -1)
    assert (other == -1).all()
    hidden, _, _ = rasterize(pixels, np.array([[0, 1, 2]], dtype=np.int32), np.full((40, 40), 100.0), +1)
    assert (hidden == -1).all()


def test_scale_bars_have_round_lengths():
    assert [pictures.nice_length(most) for most in (0.9, 1.0, 4.9, 5.0, 37.0, 0.034)] == pytest.approx(
        [0.5, 1.0, 2.0, 5.0, 20.0, 0.02]
    )


def test_slices_look_the_way_radiologists_do():
    """The letters at the borders agree with the directions of the axes, LPS."""
    for plane in pictures.PLANES:
        shown = dict(zip(("left", "right", "top", "bottom"), plane.letters, strict=True))
        letters = [("R", "L"), ("A", "P"), ("F", "H")]  # lower and upper end of each axis of LPS
        assert (shown["left"], shown["right"]) == letters[plane.right]
        low, high = letters[plane.up]
        assert (shown["top"], shown["bottom"]) == ((high, low) if plane.up_sign > 0 else (low, high))
