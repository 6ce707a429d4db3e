"""--refine: its forms, and what is said of others."""

import numpy as np
import pytest
import SimpleITK
import trimesh

from helpers.shapes import ball, solid
from tissue_sim.cli import main
from tissue_sim.commands.build_refine import parse_refine
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.refinement import Along, Ball, Painted
from tissue_sim.organ.surfaces.sizing import local_edges


def test_words_join():
    assert (parse_refine([]).thin, parse_refine([]).clamp) == (False, False)
    assert (parse_refine(["thin"]).thin, parse_refine(["thin"]).clamp) == (True, False)
    for given in (["auto"], ["thin", "clamp"]):
        assert parse_refine(given).thin
        assert parse_refine(given).clamp


def test_places_are_balls_in_millimetres_or_masks(tmp_path):
    path = tmp_path / "hilum.nii.gz"
    volume = solid(ball(6.0), size=(20, 20, 20))
    SimpleITK.WriteImage(SimpleITK.GetImageFromArray(volume.array.astype(np.uint8)), path)
    first, second, third, fourth = parse_refine(["1,-2,3:10", "1,-2,3:10:1.5", str(path), f"{path}:2"]).places
    assert isinstance(first, Ball)
    np.testing.assert_allclose(first.centre, [0.001, -0.002, 0.003])
    assert (first.radius, first.edge) == (pytest.approx(0.01), None)
    assert isinstance(second, Ball)
    assert second.edge == pytest.approx(0.0015)
    assert isinstance(third, Painted)
    assert (third.mask.array.sum(), third.edge) == (volume.array.sum(), None)
    assert isinstance(fourth, Painted)
    assert fourth.edge == pytest.approx(0.002)


def test_a_line_that_will_be_cut_is_a_place_too():
    (line,) = parse_refine(["-1,-2,3/4,5,6/7,8,-9:10:1.5"]).places
    assert isinstance(line, Along)
    np.testing.assert_allclose(line.points, [[-0.001, -0.002, 0.003], [0.004, 0.005, 0.006], [0.007, 0.008, -0.009]])
    assert (line.radius, line.edge) == (pytest.approx(0.01), pytest.approx(0.0015))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("thick", "--refine thick is not understood; use thin, clamp, auto, X,Y,Z:RADIUS"),
        ("1,2,3", "--refine 1,2,3 needs a radius"),
        ("1,2,3:0", "--refine 1,2,3:0 needs a radius"),
        ("1,2,3:5:-1", "--refine 1,2,3:5:-1 needs a radius"),
        ("1,2,3/4,5,6", "--refine 1,2,3/4,5,6 needs a radius, and may have an edge, in mm: X,Y,Z/X,Y,Z:RADIUS"),
        ("1,2,3/4,5:5", "--refine 1,2,3/4,5:5 is not understood"),
        ("1,2:5", "--refine 1,2:5 is not understood"),
        ("no.nii.gz:2", "--refine no.nii.gz:2 is not understood"),
    ],
)
def test_other_texts_are_refused(text, reason):
    with pytest.raises(UserError) as refusal:
        parse_refine([text])
    assert str(refusal.value).startswith(reason)


def test_an_organ_has_more_points_where_they_are_wanted(tmp_path, capsys):
    trimesh.creation.icosphere(subdivisions=3, radius=20.0).export(tmp_path / "ball.ply")
    words = ["build", "--surface", str(tmp_path / "ball.ply"), "--unit", "mm", "--points", "200", "--atoms", "4"]
    out = tmp_path / "o.npz"
    assert main([*words, "--refine", "20,0,0:6:2", "--refine", "clamp", "--out", str(out)]) == 0
    text = capsys.readouterr().out
    organ = Organ.load(out)
    assert f"refined to {organ.n_surface} points: edges from 2.0 mm on" in text
    assert organ.provenance["refine"] == ["20,0,0:6:2", "clamp"]
    edges, positions = 1e3 * local_edges(organ.surface_positions, organ.surface_triangles), organ.surface_positions
    assert edges[np.linalg.norm(positions - [0.02, 0.0, 0.0], axis=1) < 0.006].mean() == pytest.approx(2.0, rel=0.15)
    assert edges[positions[:, 0] < -0.015].mean() > 3.0


def test_what_does_not_go_with_it_is_refused(tmp_path, capsys):
    trimesh.creation.icosphere(subdivisions=2, radius=20.0).export(tmp_path / "ball.ply")
    words = ["build", "--surface", str(tmp_path / "ball.ply"), "--unit", "mm", "--refine", "auto"]
    np.save(tmp_path / "held.npy", np.arange(9))
    for further, reason in (
        (["--keep-points"], "--refine adds points, and --keep-points keeps those that there are"),
        (["--fixed", str(tmp_path / "held.npy")], "--fixed FILE.npy names nodes by number, and --refine changes those"),
    ):
        assert main([*words, *further, "--out", str(tmp_path / "o.npz")]) == 2
        error = capsys.readouterr().err
        assert reason in error
        assert error.count("\n") == 1
