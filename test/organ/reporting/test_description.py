"""What an organ holds, as figures and as words."""

import numpy as np
import pytest
import trimesh

from helpers.eggs import forked_egg
from helpers.scenes import ball
from tissue_sim.organ.cell_mesh import with_cells
from tissue_sim.organ.reporting.description import describe, label, shown, text_lines
from tissue_sim.organ.topology import assemble_organ


@pytest.fixture(scope="module")
def egg():
    return forked_egg()


def test_figures_are_those_of_the_organ(egg):
    found = describe(egg)
    assert found["volume_ml"] == pytest.approx(egg.volume * 1e6)
    np.testing.assert_allclose(found["extent_mm"], [40.0, 32.0, 64.0], rtol=1e-9)
    edges = np.linalg.norm(
        np.diff(egg.surface_positions[egg.angular_nodes[:, :2]], axis=1)[:, 0], axis=1
    )  # an angular spring on every edge
    surface = found["surface"]
    assert (surface["points"], surface["triangles"], surface["edges"]) == (642, 1280, len(edges)) == (642, 1280, 1920)
    assert surface["edge_mean_mm"] == pytest.approx(1e3 * edges.mean())
    assert surface["edge_variation"] == pytest.approx(edges.std() / edges.mean())
    assert surface["least_angle_deg"] == pytest.approx(
        np.rad2deg(trimesh.Trimesh(egg.surface_positions, egg.surface_triangles).face_angles.min())
    )
    assert (surface["held_points"], surface["euler_number"]) == (3, 2)
    skeleton = found["skeleton"]
    assert (skeleton["atoms"], skeleton["branches"], skeleton["tips"], skeleton["junctions"]) == (5, 3, 3, 1)
    assert skeleton["length_mm"] == pytest.approx(20.0 + 2.0 * np.hypot(5.0, 5.0))
    assert skeleton["radius_mm"] == pytest.approx({"least": 7.0, "median": 10.0, "largest": 12.0})
    springs = found["springs"]
    assert springs["edge"]["count"] == 1920
    assert springs["spoke"]["count"] == 642
    assert springs["virtual"]["count"] == 3 * 642
    assert springs["skeleton"]["count"] == 4
    assert sum(kind["count"] for name, kind in springs.items() if name not in ("angular", "return")) == len(
        egg.spring_stiffness
    )
    stiffness = egg.spring_stiffness[egg.spring_kind == 0]
    assert springs["edge"]["stiffness_n_per_m"]["largest"] == stiffness.max()
    assert found["mass_g"]["total"] == pytest.approx(1060.0 * egg.volume * 1e3)
    assert found["mass_g"]["surface"] + found["mass_g"]["atoms"] == pytest.approx(found["mass_g"]["total"])
    assert found["digest"] == egg.digest()


def test_one_atom_and_interior_atoms():
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.02)
    organ = assemble_organ(
        name="ball",
        surface_positions=ball.vertices,
        surface_triangles=ball.faces,
        atom_positions=[[0.0, 0.0, 0.0]],
        atom_radius=[0.019],
        atom_parent=[-1],
        interior_atoms=7,
    )
    found = describe(organ)
    assert found["interior_points"] == 7
    assert found["mass_g"]["interior"] > 0.0
    assert (found["skeleton"]["branches"], found["skeleton"]["length_mm"]) == (0, 0.0)
    assert "spacing_mm" not in found["skeleton"]


def test_cells_of_an_organ_that_has_them():
    assert "cells" not in describe(ball())
    organ = with_cells(ball(), (1.0, 0.5))
    cells = describe(organ)["cells"]
    assert cells["count"] == len(organ.cell_nodes)
    assert cells["filled_percent"] == pytest.approx(100.0, abs=5.0)
    assert cells["mu_pa"]["median"] == pytest.approx(organ.lame_moduli[0])
    assert cells["lambda_pa"]["largest"] == pytest.approx(0.5 * organ.lame_moduli[1])


def test_words_and_numbers():
    assert label("edge_mean_mm") == "edge mean (mm)"
    assert label("stiffness_n_per_m") == "stiffness (N/m)"
    assert label("tissue_sim") == "tissue_sim"
    assert [shown(value) for value in (None, True, 0.123456, 12345.6, 7, [], [1.0, 2.5])] == [
        *("not given", "yes", "0.1235", "12346", "7", "none", "1, 2.5")
    ]
    assert shown({"least": 1.0, "median": 2.0, "largest": 3.0}) == "1 to 3, median 2"
    assert list(text_lines({"a": [[1, 2], [3]]})) == ["a:", "  1: 1, 2", "  2: 3"]
