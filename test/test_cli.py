"""The command line as a whole: what may have been meant by a word that is none."""

import re

import pytest

from tissue_sim.cli import main


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["bulid"], "invalid choice: 'bulid'"),
        (["build", "ct.nii", "--pionts=300"], "tissue_sim build: error: unrecognized arguments: --pionts=300"),
        (["export", "a.npz", "b.ply", "--skeletom", "c.vtp"], "unrecognized arguments: --skeletom c.vtp"),
        (["bench", "tikc"], "invalid choice: 'tikc'"),
        (
            ["export", "a.npz", "a.ply", "--out", "b"],
            "unrecognized arguments: --out b (see 'tissue_sim export --help')",
        ),
        (["calibrate", "a.npz", "--out=b.npz", "--points", "-3"], "unrecognized arguments: --points=-3 (see "),
        (["info", "a.npz", "--wholly-else"], "unrecognized arguments: --wholly-else (see 'tissue_sim info --help')"),
    ],
)
def test_what_was_meant_is_asked(capsys, words, expected):
    meant = {"bulid": "build", "--pionts=300": "--points", "--skeletom": "--skeleton", "tikc": "tick"}
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2
    error = capsys.readouterr().err
    assert expected in error
    assert error.count("\n") == 1
    asked = [f"; did you mean {other}? (see" in error for word, other in meant.items() if word in words]
    assert all(asked) if asked else "did you mean" not in error


@pytest.mark.parametrize(
    ("words", "option", "default"),
    [
        (["build"], "--inclusion N:TIMES", None),  # an empty list: no default to speak of
        (["calibrate"], "--refine WHERE", None),
        (["build"], "--points POINTS", "994"),
        (["calibrate"], "--sharp N", "10"),
        (["view"], "--patience PATIENCE", "5.0"),
    ],
)
def test_help_names_the_default_of_an_option_once(capsys, monkeypatch, words, option, default):
    monkeypatch.setenv("COLUMNS", "500")
    with pytest.raises(SystemExit):
        main([*words, "--help"])
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith(f"  {option} ")]
    assert re.findall(r"\(default:? (.*?)\)", line) == ([default] if default else [])
    assert "(default " not in line
