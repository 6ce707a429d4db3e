"""The command `bench table1`: loads, the paper's figures, deviations and Figure 6."""

import json
from io import BytesIO

import numpy as np
import pytest

from helpers.scenes import ball, kidney
from tissue_sim.bench import table1
from tissue_sim.bench.figure6 import JAW, pictures_of, pinch_and_release
from tissue_sim.bench.timing import Timing
from tissue_sim.cli import main
from tissue_sim.contact.local_compliance import OF_BALLS
from tissue_sim.figures import png

# Table 1 of Zhang, Gu et al. 2006, ms an update.
PAPER = {
    "Surface MS": [0.531, 0.547, 0.546, 0.563, 1.891],
    "Hybrid MS": [0.766, 0.829, 0.812, 0.859, 11.187],
    "Hybrid LR frozen": [0.750, 0.765, 0.782, 0.797, 7.938],
}
UNIT = 0.002


def cells(organ):
    """Made-up cells for every row and column."""
    cell = table1.Entry(Timing(3e-4, 4e-4, 100), 4, 990, True, 0.005, 0.25, np.zeros((organ.n_surface, 3)))
    return {force.name: {variant.name: cell for variant in table1.VARIANTS} for force in table1.FORCES}


def test_forces_are_those_of_the_paper():
    assert [(force.magnitude, force.points) for force in table1.FORCES] == [
        *((size, 1) for size in (25, 50, 75, 100)),
        (500, 10),
    ]


@pytest.mark.parametrize("force", table1.FORCES, ids=lambda force: force.name)
def test_load_is_the_magnitude_times_the_unit(force):
    nodes, forces = table1.load(kidney(), force, UNIT)
    assert len(np.unique(nodes)) == force.points
    assert np.linalg.norm(forces.sum(axis=0)) == pytest.approx(UNIT * force.magnitude)


def test_table_prints_the_papers_figures_and_the_unit():
    noise = Timing(1e-4, 1.1e-4, 100)
    found = table1.as_json(kidney(), UNIT, cells(kidney()), noise)
    shown = table1.text(found).splitlines()
    for name, figures in PAPER.items():
        lines = [line for line in shown if f"  {name}  " in line]
        assert len(lines) == 5
        for line, figure in zip(lines, figures, strict=True):
            assert f" {figure:.3f} " in line
            assert f" {figure / 0.3:.1f} " in line
    assert any("994 surface points, 48 medial atoms" in line for line in shown)
    assert any("LF(100) is 0.2 N" in line for line in shown)
    assert any(line.endswith("25.0 %") for line in shown)


@pytest.fixture(scope="module")
def found():
    return table1.measure(ball(2), 2e-4, quick=True)[0]


@pytest.mark.extended
def test_every_cell_is_measured(found):
    assert len(found) * len(found["LF(25)"]) == 25
    for row in found.values():
        for cell in row.values():
            assert cell.timing.median > 0.0
            assert cell.settled
            assert cell.largest > 0.0


@pytest.mark.extended
def test_deviation_is_against_the_whole_hybrid_model(found):
    for row in found.values():
        assert row[table1.WHOLE].deviation == 0.0
        assert row["Surface MS"].deviation > 0.02
    # A frozen region holds a statically loaded organ back; the modal one doesn't.
    local = found["LF(100)"]
    assert local["Hybrid LR frozen"].deviation > 3.0 * local["Hybrid LR modal"].deviation


def test_unit_out_of_range_is_named(capsys):
    assert main(["bench", "table1", "--unit", "0"]) == 2
    assert "--unit" in capsys.readouterr().err


def test_command_prints_json(monkeypatch, capsys):
    made = cells(kidney()), Timing(1e-4, 1.1e-4, 100)
    monkeypatch.setattr(table1, "in_one_thread", lambda *_: made)
    assert main(["bench", "table1", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert len(rows) == 25
    assert all(row["median_ms"] > 0.0 for row in rows)


# Figure 6 --------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def pinched():
    return pinch_and_release(kidney())


@pytest.mark.extended
def test_nip_takes_the_top_and_nothing_else(pinched):
    nip, _ = pinched
    rest = kidney().surface_positions
    moved = np.linalg.norm(nip.positions - rest, axis=1)
    assert moved.max() > 0.002
    near = np.linalg.norm(rest - rest[moved.argmax()], axis=1) < 0.02
    assert moved[near].max() > 5.0 * np.median(moved[~near])
    for jaw in nip.jaws:
        # What lies between nodes gives way.
        assert np.linalg.norm(nip.positions - jaw, axis=1).min() > (1.0 - OF_BALLS.most) * JAW


@pytest.mark.extended
def test_released_organ_is_back_at_rest(pinched):
    _, release = pinched
    assert np.abs(release.positions - kidney().surface_positions).max() < 1e-5
    assert "at rest" in release.title


@pytest.mark.extended
def test_pictures_show_the_organ(pinched):
    image = pytest.importorskip("matplotlib.image")
    organ = kidney()
    made = cells(organ)
    panels = [*pinched, *table1.panels(organ, UNIT, made, with_nip=False)]
    drawn = pictures_of(organ, panels)
    assert list(drawn) == [
        "figure6.png",
        *(f"figure6_{name}.png" for name in ("nip", "release", "global", "surface_global")),
    ]
    pictures = [image.imread(BytesIO(png(draw(), 130.0)))[..., :3] for draw in drawn.values()]
    for pixels in pictures:
        assert 0.1 < np.mean(pixels.min(axis=2) < 0.97) < 0.8, "an organ on white"
    size = min(pictures[1].shape, pictures[2].shape)
    assert np.abs(pictures[1][: size[0], : size[1]] - pictures[2][: size[0], : size[1]]).max() > 0.2


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_whole_table_of_the_kidney(capsys, tmp_path):
    pytest.importorskip("matplotlib")
    assert main(["bench", "table1", "--quick", "--out", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert shown.count("Hybrid LR modal") == 5
    assert (tmp_path / "figure6.png").is_file()
