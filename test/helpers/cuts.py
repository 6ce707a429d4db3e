"""Organs after cuts, without a simulation, and checks that nothing of them is lost."""

import numpy as np
import pytest
import trimesh

from tissue_sim.model.cutting.cut import cut_again, without_cuts
from tissue_sim.model.cutting.holes import open_edges
from tissue_sim.model.cutting.sheet import sheet_of
from tissue_sim.organ.surface_checks import signed_volume


def cut(organ, *cuts):
    """The organ after cuts, without a simulation."""
    made = without_cuts(organ)
    for one in cuts:
        made = cut_again(made, sheet_of(organ, *one))
    return made


def closed_surface(made):
    points = made.surface.at(made.organ.rest_positions)
    assert len(open_edges(made.surface.triangles.astype(np.int64))) == 0
    assert np.array_equal(np.unique(made.surface.triangles), np.arange(len(made.surface.nodes)))
    np.testing.assert_allclose(made.surface.weights.sum(axis=1), 1.0, rtol=1e-12)
    return trimesh.Trimesh(points, made.surface.triangles, process=False)


def assert_whole(made, organ, volume=1e-9):
    """Nothing is lost: volume, stiffness, mass."""
    surface = closed_surface(made)
    assert signed_volume(surface.vertices, made.surface.triangles) == pytest.approx(organ.volume, rel=volume)
    np.testing.assert_allclose(np.bincount(made.cell_of, made.fraction), 1.0, rtol=1e-12)
    assert made.fraction.min() > 0.0
    source = np.concatenate([np.arange(organ.n_nodes), made.organ.virtual_of])
    np.testing.assert_allclose(np.bincount(source, made.organ.mass), organ.mass, rtol=1e-12)
    np.testing.assert_array_equal(np.unique(made.organ.cell_nodes), np.arange(made.organ.n_nodes))
