"""Identification of a ball: the model's own forces give back the stiffness that made them."""

import json

import numpy as np
import pytest

from helpers.exit_codes import exit_code_of
from tissue_sim.cli import main
from tissue_sim.errors import UserError
from tissue_sim.identification.fitted_organ import KEY, with_stiffness
from tissue_sim.identification.identify import Settings, identify, lines_of, provenance_of
from tissue_sim.identification.mixed_effects import Priors
from tissue_sim.identification.press_curves import curves_of
from tissue_sim.organ.organ import Organ

FACTOR = 0.63


def pressed(presses, random=None, offset=0.0):
    """The measurement that the model's curves give for another modulus."""
    measurement, curves = presses
    depths = np.array([press.depths for press in measurement.presses])
    random = random or np.random.default_rng(0)
    forces = FACTOR * curves.at(depths + offset * random.normal(size=(len(depths), 1)))[0]
    forces = forces * (1.0 + 0.02 * random.normal(size=forces.shape)) + 0.002 * random.normal(size=forces.shape)
    made = [one._replace(forces=force) for one, force in zip(measurement.presses, forces, strict=True)]
    return measurement._replace(presses=made)


def test_the_model_is_linear_in_the_modulus(organ, presses):
    """What makes one run of a press enough for all moduli, and the fitted organ feel as the fit says."""
    measurement, curves = presses
    softer = with_stiffness(organ, FACTOR, {})
    one = measurement._replace(presses=measurement.presses[:1])
    depths = measurement.presses[0].depths[None]
    deep = depths > 5e-4
    wanted = FACTOR * curves.some([0]).at(depths)[0][deep]
    np.testing.assert_allclose(curves_of(softer, one, 0.6).at(depths)[0][deep], wanted, rtol=0.01)
    scaled = FACTOR * curves_of(organ, one, 0.6, FACTOR).at(depths)[0][deep]
    np.testing.assert_allclose(scaled, wanted, rtol=0.01)


def test_the_modulus_comes_back(organ, presses):
    found = identify(organ, pressed(presses, offset=2e-4), Settings(with_map=False))
    assert found.modulus == pytest.approx(FACTOR * organ.youngs_modulus, rel=0.08)
    low, high = found.modulus_interval
    assert low < FACTOR * organ.youngs_modulus < high
    assert found.organ.youngs_modulus == pytest.approx(found.modulus)
    assert found.held_out is not None
    assert found.held_out.one < 0.12
    assert not found.diagnosis.stiffens
    lines = "\n".join(lines_of(found))
    assert "no stroke was found" in lines
    assert "no times" in lines
    assert "hardly determine the modulus" not in lines
    unsure = found._replace(interval=found.interval._replace(low=0.2, high=4.0))
    assert "warning: these presses hardly determine the modulus, its interval is a factor of 20 wide" in "\n".join(
        lines_of(unsure)
    )
    assert json.loads(json.dumps(provenance_of(found))) == found.organ.provenance[KEY]


def test_runs_of_the_model_are_kept(organ, presses):
    calls = []

    def remember(name, make):
        calls.append(name)
        return {"force": np.linspace(0.0, 1.0, 22)}

    identify(organ, pressed(presses), Settings(Priors(), with_map=False), remember)
    assert len(set(calls)) == len(calls) == 4


def test_a_tool_too_small_for_the_organ_is_refused(organ, presses):
    small = pressed(presses)._replace(radius=1e-3)
    with pytest.raises(UserError, match=r"--points \d+"):
        identify(organ, small)


def test_presses_that_miss_the_organ_are_refused(organ, presses):
    measurement = pressed(presses)
    astray = measurement.presses[2]._replace(place=measurement.presses[2].place + 0.01)
    with pytest.raises(UserError, match=r"press 2 begins .* mm from the surface"):
        identify(organ, measurement._replace(presses=[*measurement.presses[:2], astray]))


def test_the_command_fits_a_table_and_info_tells_of_it(organ, presses, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    organ.save("ball.npz")
    measurement = pressed(presses)
    rows = ["press,depth,force,x,y,z,nx,ny,nz"]
    for number, press in enumerate(measurement.presses[:2]):
        place = [*(press.place + measurement.radius * press.direction), *-press.direction]
        rows += [
            ",".join(map(str, [number, depth, force, *place]))
            for depth, force in zip(press.depths, press.forces, strict=True)
        ]
    (tmp_path / "presses.csv").write_text("\n".join(rows))
    given = ["identify", "ball.npz", "--csv", "presses.csv", "--radius", "0.007", "--out", "fitted.npz"]
    assert main([*given, "--json", "found.json"]) == 0
    assert "Young's modulus" in capsys.readouterr().out
    found = Organ.load("fitted.npz")
    assert found.youngs_modulus == pytest.approx(FACTOR * organ.youngs_modulus, rel=0.08)
    np.testing.assert_allclose(found.cell_mu / organ.cell_mu, found.youngs_modulus / organ.youngs_modulus)
    assert json.loads((tmp_path / "found.json").read_text())["presses"] == 2
    assert not (tmp_path / ".fitted.npz.identification").exists()
    assert main(["info", "fitted.npz"]) == 0
    assert "identified" in capsys.readouterr().out


def test_the_next_press_is_clear_of_those_there_are(organ, presses):
    found = identify(organ, pressed(presses), Settings(with_map=False))
    following = found.next_press
    assert 0.0 < following.depth <= presses[0].radius
    apart = np.linalg.norm(following.places[:, None] - found.measurement.points, axis=2)
    assert apart.min() > 0.01
    assert (following.places[:, 2] > organ.surface_positions[organ.fixed][:, 2].max()).all()
    assert following.width < 0.5 * np.log(found.interval.high / found.interval.low)


@pytest.mark.extended
def test_a_stream_in_a_table_is_fitted_like_a_bag(organ, presses, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    organ.save("ball.npz")
    measurement, curves = presses
    rows, time = ["time,x,y,z,fx,fy,fz"], 0.0
    for row, press in enumerate(measurement.presses[:2]):
        depths = np.concatenate([np.linspace(-4e-3, 2e-3, 200), np.linspace(2e-3, -4e-3, 50)])
        forces = FACTOR * curves.some([row]).at(depths[None])[0][0]
        for depth, force in zip(depths, forces, strict=True):
            sample = [time, *(press.place + depth * press.direction), *(force * press.direction + [0.0, 0.1, 0.0])]
            rows.append(",".join(f"{value:.8g}" for value in sample))
            time += 0.005
    (tmp_path / "stream.csv").write_text("\n".join(rows))
    given = ["identify", "ball.npz", "--csv", "stream.csv", "--radius", "0.007", "--out", "fitted.npz"]
    assert main(given) == 2
    assert "--negate" in capsys.readouterr().err
    assert main([*given, "--negate"]) == 0
    assert Organ.load("fitted.npz").youngs_modulus == pytest.approx(FACTOR * organ.youngs_modulus, rel=0.08)


@pytest.mark.parametrize(
    ("given", "what"),
    [
        ([], "--csv"),
        (["--csv", "a.csv"], "needs --radius"),
        (["--csv", "a.csv", "--radius", "0.005"], "a.csv"),
        (["--radius", "2"], "outside"),
        (["--offset-deviation", "0"], "outside"),
        (["--friction", "-1"], "outside"),
        (["--bag", "none"], "bag none does not exist"),
        (["--bag", "none", "--pose-topic", "/tip"], "go together"),
        (["--bag", "none", "--unplaced"], "--unplaced is for --csv"),
        (["--bag", "a", "--csv", "b"], "not allowed with"),
        (["--out", "folder/fitted.npz"], "does not exist"),
        (["--out", "fitted.txt"], "must end in .npz"),
        (["--report", "fitted.pdf"], "--report fitted.pdf must end in .html"),
        (["--json", "fitted.npz"], "--json fitted.npz must end in .json"),
    ],
)
def test_wrong_use_is_reported(organ, tmp_path, monkeypatch, capsys, given, what):
    monkeypatch.chdir(tmp_path)
    organ.save("ball.npz")
    assert exit_code_of("identify", "ball.npz", "--out", "fitted.npz", *given) == 2
    assert what in capsys.readouterr().err
