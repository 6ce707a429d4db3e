"""The command `tissue_sim solve`."""

import numpy as np
import pytest

from helpers.exit_codes import exit_code_of
from helpers.scenes import ball
from tissue_sim.model.simulation import Simulation


@pytest.fixture
def organ_file(tmp_path):
    path = tmp_path / "ball.npz"
    ball().save(path)
    return path


def write_loads(path, forces):
    np.savez(path, forces=forces)
    return path


def two_loads():
    forces = np.zeros((2, 42, 3))
    top = int(np.argmax(ball().surface_positions[:, 2]))
    forces[0, top] = [0.0, 0.0, -0.1]
    forces[1, top] = [0.1, 0.05, 0.0]
    return forces


def solve(organ, loads, out, *options):
    return exit_code_of("solve", str(organ), "--loads", str(loads), "--out", str(out), *options)


@pytest.mark.parametrize("variant", ["surface", "volume", "hybrid"])
def test_displacements_are_those_of_settle(organ_file, tmp_path, variant, capsys):
    loads = write_loads(tmp_path / "loads.npz", two_loads())
    assert solve(organ_file, loads, tmp_path / "u.npz", "--model", variant) == 0
    with np.load(tmp_path / "u.npz") as result:
        assert sorted(result.files) == ["converged", "displacements", "seconds"]
        assert result["displacements"].shape == (2, 42, 3)
        assert result["displacements"].dtype == np.float64
        assert result["seconds"].shape == result["converged"].shape == (2,)
        assert result["seconds"].dtype == np.float64
        assert result["converged"].dtype == np.bool_
        assert np.all(result["converged"])
        assert np.all(result["seconds"] > 0.0)
        simulation = Simulation(ball(), model=variant)
        for load, found in zip(two_loads(), result["displacements"], strict=True):
            np.testing.assert_array_equal(found, simulation.settle(load, 1e-3, 5.0)[0])
            # Metres: a tenth of a newton dents 10 kPa by some tenths of a millimetre, along the force.
            assert 5e-5 < np.linalg.norm(found, axis=1).max() < 5e-3
            assert np.vdot(found, load) > 0.0
    assert "2 loads, 2 converged" in capsys.readouterr().out


def test_frozen_region_moves_the_nodes_around_the_load_alone(organ_file, tmp_path):
    organ = ball(3)
    organ.save(organ_file)
    forces = np.zeros((1, organ.n_surface, 3))
    forces[0, int(np.argmax(organ.surface_positions[:, 2]))] = [0.0, 0.0, -0.05]
    loads = write_loads(tmp_path / "loads.npz", forces)
    assert solve(organ_file, loads, tmp_path / "u.npz", "--local-region", "frozen") == 0
    with np.load(tmp_path / "u.npz") as result:
        moved = np.any(result["displacements"][0] != 0.0, axis=1)
    assert moved.sum() == 19


def test_load_that_does_not_settle_is_reported_and_is_no_failure(organ_file, tmp_path, capsys):
    loads = write_loads(tmp_path / "loads.npz", two_loads())
    assert solve(organ_file, loads, tmp_path / "u.npz", "--longest", "0.02") == 0
    with np.load(tmp_path / "u.npz") as result:
        assert not np.any(result["converged"])
    assert "2 loads, 0 converged" in capsys.readouterr().out


def test_no_loads_give_no_displacements(organ_file, tmp_path):
    loads = write_loads(tmp_path / "loads.npz", np.zeros((0, 42, 3)))
    assert solve(organ_file, loads, tmp_path / "u.npz") == 0
    with np.load(tmp_path / "u.npz") as result:
        assert result["displacements"].shape == (0, 42, 3)


# refusals --------------------------------------------------------------------------------------
def refusal(capsys, *arguments):
    """The one line on stderr of a refused command."""
    assert solve(*arguments) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert captured.err.startswith("tissue_sim: error: ")
    return captured.err


def test_missing_organ_is_refused(tmp_path, capsys):
    loads = write_loads(tmp_path / "loads.npz", two_loads())
    assert "nowhere.npz does not exist" in refusal(capsys, tmp_path / "nowhere.npz", loads, tmp_path / "u.npz")


def test_another_ending_is_refused(organ_file, tmp_path, capsys):
    loads = write_loads(tmp_path / "loads.npz", two_loads())
    assert "u.csv must end in .npz" in refusal(capsys, organ_file, loads, tmp_path / "u.csv")
    assert not (tmp_path / "u.csv").exists()


def test_missing_loads_are_refused(organ_file, tmp_path, capsys):
    assert "none.npz does not exist" in refusal(capsys, organ_file, tmp_path / "none.npz", tmp_path / "u.npz")


@pytest.mark.parametrize(
    ("forces", "message"),
    [
        (np.zeros((42, 3)), "(L, 42, 3)"),
        (np.zeros((2, 41, 3)), "(2, 41, 3)"),
        (np.full((1, 42, 3), np.nan), "not finite"),
        (np.full((1, 42, 3), np.inf), "not finite"),
        (np.full((1, 42, 3), "much"), "loads.npz"),
    ],
)
def test_wrong_forces_are_refused(organ_file, tmp_path, capsys, forces, message):
    loads = write_loads(tmp_path / "loads.npz", forces)
    assert message in refusal(capsys, organ_file, loads, tmp_path / "u.npz")
    assert not (tmp_path / "u.npz").exists()


def test_file_without_forces_is_refused(organ_file, tmp_path, capsys):
    np.savez(tmp_path / "loads.npz", pushes=two_loads())
    assert "'forces'" in refusal(capsys, organ_file, tmp_path / "loads.npz", tmp_path / "u.npz")


def write_text(path):
    path.write_text("0 0 -1\n")


def write_array(path):
    with path.open("wb") as stream:
        np.save(stream, two_loads())


def write_pickle(path):
    np.savez(path, forces=np.array([{"a": 1}], dtype=object))


def write_half(path):
    write_loads(path, two_loads())
    path.write_bytes(path.read_bytes()[:300])


@pytest.mark.parametrize("write", [write_text, write_array, write_pickle, write_half])
def test_what_is_no_npz_of_loads_is_refused(organ_file, tmp_path, capsys, write):
    write(tmp_path / "loads.npz")
    assert "loads.npz" in refusal(capsys, organ_file, tmp_path / "loads.npz", tmp_path / "u.npz")


def test_folder_instead_of_loads_is_refused(organ_file, tmp_path, capsys):
    assert str(tmp_path) in refusal(capsys, organ_file, tmp_path, tmp_path / "u.npz")


def test_output_that_cannot_be_written_is_refused(organ_file, tmp_path, capsys):
    loads = write_loads(tmp_path / "loads.npz", two_loads())
    message = refusal_of_output(capsys, organ_file, loads, tmp_path / "missing" / "u.npz")
    assert "u.npz" in message


def refusal_of_output(capsys, *arguments):
    """As `refusal`, with the progress bar before the line."""
    assert solve(*arguments) == 2
    return capsys.readouterr().err.splitlines()[-1]


def test_result_is_in_the_file_that_was_named(organ_file, tmp_path):
    loads = write_loads(tmp_path / "loads.npz", two_loads()[:1])
    assert solve(organ_file, loads, tmp_path / "RESULT.NPZ") == 0
    assert (tmp_path / "RESULT.NPZ").is_file()


@pytest.mark.parametrize(
    "options", [["--tolerance", "0"], ["--tolerance", "1"], ["--longest", "0"], ["--longest", "nan"], ["--rate", "0"]]
)
def test_option_out_of_range_is_refused(organ_file, tmp_path, capsys, options):
    loads = write_loads(tmp_path / "loads.npz", two_loads())
    assert options[0].strip("-") in refusal(capsys, organ_file, loads, tmp_path / "u.npz", *options)


@pytest.mark.parametrize("options", [["--model", "jelly"], ["--tolerance", "some"], ["--longest", "inf"]])
def test_option_that_makes_no_sense_is_refused(organ_file, tmp_path, capsys, options):
    loads = write_loads(tmp_path / "loads.npz", two_loads())
    assert solve(organ_file, loads, tmp_path / "u.npz", *options) == 2
    assert options[0] in capsys.readouterr().err.splitlines()[-1]
