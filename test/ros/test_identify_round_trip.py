"""A whole identification over DDS: a node plays a phantom, a script presses it and records, identify fits, and the node
of the fitted organ feels like the phantom at other places."""

import contextlib
import json

import numpy as np
import pytest

from helpers.ros.clients import Client
from helpers.ros.processes import UNHURRIED, running_node
from helpers.scenes import ball_of_cells
from tissue_sim.calibration.cases import surface_of
from tissue_sim.cli import main

STIFFNESS = 0.63
RADIUS = 0.007  # m
OUTSIDE, DEEP, STEP = 0.004, 0.0025, 5e-5  # m
FAR = 0.1  # m, from where the path to the next place leads past the ball: a tool doesn't go through it
DIRECTIONS = np.array([[0, 0, 1.0], [1, 0, 0.5], [-1, 0.2, 0.5], [0.2, 1, 0.6], [0.1, -1, 0.6]])
OTHERS = np.array([[0.5, 0.5, 1.0], [-0.6, -0.6, 0.8]])


def press(client, organ, direction):
    """Press at the surface node that faces a direction, slowly, from afar; the largest force along the normal."""
    surface = surface_of(organ)
    node = int(np.argmax(surface.normal @ (direction / np.linalg.norm(direction))))
    normal = surface.normal[node]
    way_in, way_out = np.arange(-OUTSIDE, DEEP, STEP), np.arange(DEEP, -OUTSIDE, -4 * STEP)
    there = np.full(80, -FAR)  # until the tool has arrived
    depths = np.concatenate([there, way_in, np.full(60, DEEP), way_out, [-FAR]])
    force = 0.0
    for depth in depths:
        client.ask(surface.positions[node] + (RADIUS - depth) * normal)
        client.spin(0.004)
        if depth == DEEP:
            force = float(client.wrenches[-1][1][:3] @ normal)
    return force


@contextlib.contextmanager
def client_of(folder, *parameters):
    folder.mkdir()
    given = ("tools:=[left]", f"left.radius:={RADIUS}", UNHURRIED, f"record_folder:={folder / 'bags'}", *parameters)
    with running_node(folder, *given):
        client = Client(markers=False)
        try:
            client.meet()
            yield client
        finally:
            client.close()


@pytest.mark.extended
def test_a_fitted_node_feels_like_the_one_that_was_pressed(tmp_path, capsys):
    organ, file, fitted = ball_of_cells(), tmp_path / "ball.npz", tmp_path / "fitted.npz"
    organ.save(file)
    with client_of(tmp_path / "phantom", f"organ_file:={file}", f"stiffness_scale:={STIFFNESS}") as client:
        assert client.record(True).success
        for direction in DIRECTIONS:
            press(client, organ, direction)
        assert client.record(False).success
        measured = [press(client, organ, direction) for direction in OTHERS]
    (bag,) = (tmp_path / "phantom" / "bags").iterdir()
    given = ["identify", str(file), "--bag", str(bag), "--out", str(fitted), "--one-modulus"]
    assert main([*given, "--json", str(tmp_path / "found.json")]) == 0
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["presses"] == len(DIRECTIONS)
    assert found["youngs_modulus_pa"] == pytest.approx(STIFFNESS * organ.youngs_modulus, rel=0.05)
    low, high = found["interval_95_percent_pa"]
    assert low < STIFFNESS * organ.youngs_modulus < high
    assert found["held_out_error_percent"] < 6.0
    assert "not identifiable" in capsys.readouterr().out
    with client_of(tmp_path / "fitted", f"organ_file:={fitted}") as client:
        force = [press(client, organ, direction) for direction in OTHERS]
    np.testing.assert_allclose(force, measured, rtol=0.06)
    assert min(measured) > 0.02, "there is something to feel"
