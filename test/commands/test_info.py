"""`tissue_sim info`: what an organ file holds, as text and as JSON, without the image libraries."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.eggs import forked_egg
from tissue_sim.cli import main
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.organ_file import SCHEMA_VERSION
from tissue_sim.organ.reporting.description import describe
from tissue_sim.organ.tool_resolution import mean_edge, points_for


@pytest.fixture(scope="module")
def egg():
    return forked_egg()


@pytest.fixture
def path(egg, tmp_path):
    egg.save(tmp_path / "egg.npz")
    return str(tmp_path / "egg.npz")


def test_text_says_it_all(path, egg, capsys):
    assert main(["info", path]) == 0
    lines = capsys.readouterr().out.splitlines()
    for line in (
        "name: egg <1>",
        f"schema version: {egg.schema_version}",
        "units: SI: m, kg, s, N, Pa",
        f"digest: {egg.digest()}",
        f"volume (mL): {egg.volume * 1e6:.4g}",
        "extent (mm): 40, 32, 64",
        "  held points: 3",
        "    count: 1920",
        "  Young's modulus (Pa): 5000",
        "  source: egg.ply",
        "  seed (mm): 1, -2.5, 3",
        "    noise: 12",
        "        mm: 0.5",
    ):
        assert line in lines


def test_a_law_is_reported(egg, tmp_path, capsys):
    replace(egg, stiffening=8.0, relaxation_fraction=0.3, relaxation_time=1.5).save(tmp_path / "law.npz")
    assert main(["info", str(tmp_path / "law.npz")]) == 0
    lines = capsys.readouterr().out.splitlines()
    at = lines.index("  stiffening (b of Demiray's law): 8")
    assert lines[at + 1] == "  of the cells, times that: 1"
    assert lines[at + 2 : at + 5] == ["  relaxation:", "    percent of the first force: 30", "    seconds: 1.5"]


def test_json_reads_back_with_the_same_figures(path, egg, capsys):
    assert main(["info", path, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found == json.loads(json.dumps(describe(Organ.load(path))))
    assert found["provenance"] == egg.provenance


def test_a_future_schema_is_refused_by_its_number(path, tmp_path, capsys):
    with np.load(path) as stored:
        content = dict(stored)
    header = json.loads(str(content["header"])) | {"schema_version": SCHEMA_VERSION + 1}
    content["header"] = np.array(json.dumps(header))
    np.savez(tmp_path / "future.npz", **content)
    assert main(["info", str(tmp_path / "future.npz")]) == 2
    assert f"has schema version {SCHEMA_VERSION + 1}" in capsys.readouterr().err


@pytest.mark.parametrize("damage", ["truncated", "altered", "no organ", "missing"])
def test_a_damaged_file_is_refused_in_one_line(path, tmp_path, capsys, damage):
    bad = tmp_path / "bad.npz"
    content = bytearray(Path(path).read_bytes())
    if damage == "truncated":
        bad.write_bytes(content[: len(content) // 2])
    elif damage == "altered":
        content[len(content) // 3] ^= 0x10
        bad.write_bytes(content)
    elif damage == "no organ":
        np.savez(bad, a=np.zeros(3))
    assert main(["info", str(bad)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert "bad.npz" in captured.err


@pytest.mark.extended
def test_needs_no_image_libraries(path):
    code = (
        "import sys\nsys.modules.update(dict.fromkeys(('SimpleITK', 'skimage', 'matplotlib')))\n"
        f"from tissue_sim.cli import main\nsys.exit(main(['info', {path!r}]))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert "egg <1>" in run.stdout


def test_it_tells_which_balls_the_surface_is_fine_enough_for_and_what_smaller_ones_need(path, egg, capsys):
    edge = 1e3 * mean_edge(egg)
    assert main(["info", path]) == 0
    lines = capsys.readouterr().out.splitlines()
    at = lines.index("least ball radius:")
    assert lines[at + 1 : at + 3] == [
        f"  within 8 percent (mm): {edge:.4g}",
        f"  within 15 percent (mm): {0.5 * edge:.4g}",
    ]
    assert main(["info", path, "--json", "--ball", "0.001"]) == 0
    assert json.loads(capsys.readouterr().out)["points_for_ball"] == {
        "radius_mm": 1.0,
        "within_8_percent": points_for(egg, 0.001, 1.0),
        "within_15_percent": points_for(egg, 0.001, 0.5),
    }
    for wrong in ("0", "nan", "-1"):
        assert main(["info", path, f"--ball={wrong}"]) == 2
        assert "--ball" in capsys.readouterr().err


def test_it_tells_what_a_cut_needs(path, egg, capsys):
    edge = mean_edge(egg)
    assert main(["info", path, "--json", "--cut", "0.004"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["least_cut_depth_mm"] == pytest.approx(2e3 * edge)
    assert found["points_for_cut"]["edge_mm"] == 2.0
    assert found["points_for_cut"]["points_everywhere"] == points_for(egg, 0.004, 2.0)
    assert "--refine=X,Y,Z/X,Y,Z:RADIUS:2 " in found["points_for_cut"]["resolved_by"]
    assert main(["info", path, "--cut", f"{2.1 * edge}"]) == 0
    assert "resolved by: nothing more" in capsys.readouterr().out
    for wrong in ("0", "nan", "-1"):
        assert main(["info", path, f"--cut={wrong}"]) == 2
        assert "--cut" in capsys.readouterr().err
