"""The viewer: its camera, texts, messages as arrays, and the real process with a page behind it."""

import re
import signal
import socket
import time
import types
import urllib.request

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point
from shape_msgs.msg import Mesh, MeshTriangle
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from helpers.exit_codes import exit_code_of
from helpers.patience import LIMIT
from helpers.ros.processes import STAND_IN, Process
from helpers.ros.stand_in import ball, cloud
from tissue_sim.cli import main
from tissue_sim.ports import free_port
from tissue_sim.rendering import organ_view as drawing
from tissue_sim.rendering.appearance import SCALE, tissue_colour
from tissue_sim.ros.shared import client
from tissue_sim.ros.viewer.tool_view import ToolView, arrow

pytest.importorskip("viser")
from tissue_sim.ros.viewer import panel


# the picture -----------------------------------------------------------------------------------
@pytest.mark.parametrize("size", [(900, 700), (1400, 900), (2500, 900), (400, 800)])
def test_the_camera_sees_all_of_the_organ_beside_the_panel(size):
    vertices, _ = ball()
    vertices = vertices + 3.0
    position, looked_at = drawing.camera_for(vertices, size)
    forward = (looked_at - position) / np.linalg.norm(looked_at - position)
    rays = vertices - position
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    depth, (width, height) = rays @ forward, size
    assert depth.min() > 0.02  # beyond the near plane
    focal = 0.5 * height / np.tan(0.5 * drawing.FIELD_OF_VIEW)
    across = 0.5 * width + focal * (rays @ right) / depth
    down = 0.5 * height - focal * (rays @ np.cross(right, forward)) / depth
    panel = drawing.PANEL if width > drawing.NARROW else 0
    assert 0.0 < across.min() < across.max() < width - panel
    assert 0.0 < down.min() < down.max() < height
    assert across.min() + across.max() == pytest.approx(width - panel, abs=0.03 * width), "in the middle"
    assert max(np.ptp(across) / (width - panel), np.ptp(down) / height) > 0.6, "as large as there is room"


def test_an_arrow_starts_at_the_tool_and_is_as_long_as_the_force():
    start, end = arrow(np.array([1.0, 2.0, 3.0]), np.array([0.0, -2.0, 0.0]), 0.005)[0]
    assert start == pytest.approx([1.0, 1.995, 3.0])
    assert end - start == pytest.approx([0.0, -0.06, 0.0], abs=1e-6)


def seen(kind, action=Marker.ADD, scale=(0.01, 0.01, 0.01), number=0, place=(0.0, 0.0, 0.0), points=()):
    marker = Marker(ns="left", id=number, type=kind, action=action, points=[Point(x=x, y=y, z=z) for x, y, z in points])
    marker.scale.x, marker.scale.y, marker.scale.z = scale
    marker.pose.position.x, marker.pose.position.y, marker.pose.position.z = place
    marker.pose.orientation.w = 1.0
    return marker


class Drawn:
    """A scene that keeps what is drawn."""

    def __init__(self):
        self.parts = {}

    def __getattr__(self, kind):
        def add(name, *_, **given):
            self.parts[name] = Handle(kind=kind, **given)
            return self.parts[name]

        return add


class Handle:
    def __init__(self, **given):
        self.dragged = self.removed = False
        self.__dict__.update(given)

    def on_drag(self, _):
        self.dragged = True

    def remove_drag_callback(self, _):
        self.dragged = False

    def remove(self):
        self.removed = True


@pytest.fixture
def tool():
    scene = Drawn()
    return ToolView(types.SimpleNamespace(scene=scene), "left", 0), scene.parts


def test_a_tool_looks_as_its_markers_say_and_shows_its_force(tool):
    view, parts = tool
    shaft = seen(Marker.CYLINDER, scale=(0.006, 0.006, 0.04), number=1, place=(0.1, 0.2, 0.28))
    blade = seen(Marker.TRIANGLE_LIST, number=2, points=[(0.0, 0.004, 0.002), (0.003, 0.0, -0.05), (0.0, 0.0, 0.009)])
    push = seen(Marker.ARROW, number=3, points=[(0.1, 0.2, 0.3), (0.1, 0.2, 0.33)])
    view.show([seen(Marker.SPHERE, place=(0.1, 0.2, 0.3)), shaft, blade, push])
    assert [parts[f"/tools/left/{k}"].kind for k in range(3)] == ["add_icosphere", "add_cylinder", "add_mesh_simple"]
    assert (parts["/tools/left/1"].radius, parts["/tools/left/1"].height) == (0.003, 0.04)
    assert parts["/tools/left/1"].position == (0.1, 0.2, 0.28)
    assert view.reach == pytest.approx(0.009)
    assert view.force == pytest.approx(1.0)
    assert parts["/forces/left"].points[0, 0] == pytest.approx([0.1, 0.2, 0.309])
    assert parts["/forces/left/label"].text == "left 1.00 N"
    still = seen(Marker.ARROW, action=Marker.DELETE, number=3, points=[(0.1, 0.2, 0.3)] * 2)
    view.show([seen(Marker.SPHERE), still])
    assert (view.force, parts["/forces/left"].visible) == (0.0, False)
    gone = [seen(kind, action=Marker.DELETE, number=k) for k, kind in enumerate((Marker.SPHERE, Marker.CYLINDER))]
    view.show([*gone, seen(Marker.TRIANGLE_LIST, Marker.DELETE, number=2, points=[(0.0, 0.0, 0.0)] * 3)])
    assert view.force is None
    assert not any(part.visible for part in parts.values())


def test_a_tool_of_another_node_is_drawn_anew_and_can_still_be_dragged(tool):
    view, parts = tool
    view.show([seen(Marker.SPHERE)])
    view.drag(print)
    before = parts["/tools/left/0"]
    assert before.dragged
    view.show([seen(Marker.SPHERE, scale=(0.02, 0.02, 0.02))])
    assert before.removed
    assert parts["/tools/left/0"].dragged
    view.drag(None)
    assert not parts["/tools/left/0"].dragged


def test_the_legend_names_every_band():
    legend = panel.legend_html()
    for level, colour in SCALE:
        assert f">{level:g}<" in legend
        assert f"rgb{colour}" in legend


def test_the_status_shows_what_is_there_and_survives_what_is_not():
    text = panel.status_text(
        {"tick_rate_hz": "999.61", "force_n": "0.4567", "left.state": "fresh", "left.force_n": "x", "recording": "/a/b"}
    )
    assert "| Tick rate | 1000 Hz |" in text
    assert "| Force | 0.46 N |" in text
    assert "| Tool left | fresh, - |" in text
    assert "| Late ticks | - |" in text
    assert "`/a/b`" in text


# messages --------------------------------------------------------------------------------------
def test_meshes_and_clouds_become_arrays():
    mesh = Mesh(
        vertices=[Point(x=1.0, y=2.0, z=3.0), Point(z=1.0), Point(y=-1.0)],
        triangles=[MeshTriangle(vertex_indices=np.array([0, 2, 1], dtype=np.uint32))],
    )
    vertices, triangles = client.mesh_arrays(mesh)
    assert vertices.tolist() == [[1.0, 2.0, 3.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]
    assert triangles.tolist() == [[0, 2, 1]]
    columns = np.arange(12.0, dtype=np.float32).reshape(3, 4)
    assert np.array_equal(client.cloud_array(cloud(columns)), columns)


def test_the_headline_is_as_high_whatever_it_says_and_the_details_are_complete():
    assert "warns: a &lt; b</span> (2 more below)" in panel.headline("tissue_sim", 1, "a < b; c; d")
    assert "fails: e</span>" in panel.headline("tissue_sim", 2, "e")
    height = [re.search(r"height:([^;]+);", panel.headline_html(line))[1] for line in ("", "warned " * 50)]
    assert height[0] == height[1]
    said = panel.detail(1, "; ".join(f"warning {k}: a < b" for k in range(20)))
    assert all(f"warning {k}: a &lt; b" in said for k in range(20))
    assert said.count("<br>") == 19


def test_organs_are_named_beside_their_colours():
    legend = panel.organs_html(["liver", "left<kidney"])
    assert f"rgb{tissue_colour('liver')}" in legend
    assert "left&lt;kidney" in legend


def test_the_newest_status_of_the_right_node_counts():
    def report(name, rate):
        status = DiagnosticStatus(name=name, values=[KeyValue(key="tick_rate_hz", value=rate)])
        return DiagnosticArray(header=Header(stamp=Time(sec=1)), status=[status])

    names = ("tissue_sim: physics", "ward/tissue_sim: physics", "ward/tissue_sim: physics", "camera: driver")
    reports = [report(name, str(rate)) for rate, name in enumerate(names)]
    assert client.physics_status(reports, "ward/tissue_sim") == {"tick_rate_hz": "2"}
    assert client.physics_status(reports, "tissue_sim") == {"tick_rate_hz": "0"}
    assert client.physics_status(reports[3:], "tissue_sim") is None


# the process -----------------------------------------------------------------------------------
@pytest.fixture
def start(tmp_path):
    """Starts a process that ends with the test at the latest."""
    started = []

    def start(*words):
        started.append(Process(list(words), tmp_path / f"{len(started)}.log"))
        return started[-1]

    yield start
    for process in started:
        process.child.kill()
        process.child.wait()


@pytest.mark.extended
def test_the_page_is_there_before_the_node_and_after_it(start):
    port = free_port()
    viewer = start("-m", "tissue_sim", "view", "--port", str(port))
    viewer.wait_for(f"http://127.0.0.1:{port}")
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=LIMIT) as page:
        assert page.status == 200
        said = page.read()
        assert b"<html" in said
        assert b"<title>tissue_sim</title>" in said
    for words in ([STAND_IN], [STAND_IN, "--smaller"]):  # a node comes, and then one with another organ
        node = start(*words)
        node.wait_for("up")
        time.sleep(1.0)
        assert node.stop() == 0
    assert viewer.stop(signal.SIGINT) == 0
    assert viewer.text() == f"open http://127.0.0.1:{port}\n"


def test_a_taken_port_is_one_line_and_exit_code_2(capfd):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert main(["view", "--port", str(port)]) == 2
    error = capfd.readouterr().err
    assert error == f"tissue_sim: error: port {port} of 127.0.0.1 is taken; choose another with --port\n"


@pytest.mark.parametrize("words", [["--host", "no such host"], ["--port", "0"], ["--tools", "left,left"]])
def test_wrong_use_is_one_line_and_exit_code_2(words, capfd):
    assert exit_code_of("view", *words) == 2
    assert capfd.readouterr().err.count("\n") == 1
