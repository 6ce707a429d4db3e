"""VTK files: what is stored, whatever the processor's byte order."""

import numpy as np

from helpers.vtk_file import read_vtk
from tissue_sim.organ.reporting.vtk_xml import polydata


def test_big_endian_arrays_are_turned(tmp_path):
    values = np.arange(3, dtype=">f8")
    path = tmp_path / "points.vtp"
    path.write_bytes(polydata(np.eye(3), {"x": values}, comment="a--b"))
    found, _ = read_vtk(path)
    np.testing.assert_array_equal(found["PointData/x"], [0.0, 1.0, 2.0])
