"""Which extended tests a change touches: by path, each with its reason."""

import importlib.machinery
import importlib.util
import subprocess
import sys

import pytest

from helpers.paths import ROOT

SCRIPT = str(ROOT / ".ci" / "touched")


@pytest.fixture
def touched(tmp_path, monkeypatch):
    """The script as a module, over a tree of tests of its own."""
    loader = importlib.machinery.SourceFileLoader("touched", SCRIPT)
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader("touched", loader))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    loader.exec_module(module)
    monkeypatch.setattr(module, "ROOT", tmp_path)
    marked, plain = "@pytest.mark.extended\n", "def test_it(): ...\n"
    for path, text in {
        "test/model/elasticity/test_cells.py": marked,
        "test/model/elasticity/test_forces.py": plain,
        "test/organ/test_kidney.py": "from helpers.solids import box\n" + marked,
        "test/ros/bags/test_bits.py": marked,
        "test/fuzz/test_files.py": marked,
        "test/test_pins.py": marked,
    }.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text)
    return module


def test_a_folder_is_tested_by_its_mirror_and_by_what_stands_on_it(touched):
    found = touched.touched(["tissue_sim/model/elasticity/cells.py", "README.md"])
    assert set(found) == {
        "test/model/elasticity/test_cells.py",
        "test/ros/bags/test_bits.py",
        "test/fuzz/test_files.py",
    }
    assert set(found.values()) == {"tissue_sim/model/elasticity/cells.py"}, "each with its reason"
    assert touched.touched(["CHANGELOG.rst"]) == {}


def test_a_test_is_touched_by_itself_and_by_its_helpers(touched):
    assert touched.touched(["test/model/elasticity/test_cells.py"]) == {
        "test/model/elasticity/test_cells.py": "test/model/elasticity/test_cells.py"
    }
    assert touched.touched(["test/helpers/solids.py"]) == {"test/organ/test_kidney.py": "test/helpers/solids.py"}
    assert set(touched.touched(["test/model/conftest.py"])) == {"test/model/elasticity/test_cells.py"}


def test_pins_and_packaging_are_touched_by_what_installs(touched):
    for path in ("setup.py", "constraints.txt", "Makefile", ".ci/venv"):
        assert set(touched.touched([path])) == {"test/test_pins.py"}


def test_every_rule_names_tests_that_are_there(touched, monkeypatch):
    monkeypatch.setattr(touched, "ROOT", ROOT)
    files = touched.test_files()
    for patterns in touched.TESTS_OF.values():
        for pattern in patterns:
            if "{folder}" not in pattern:
                assert touched.fnmatch.filter(files, pattern), pattern


def test_a_base_that_is_none_is_named():
    done = subprocess.run([sys.executable, SCRIPT, "no-such-commit"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == "touched: error: 'no-such-commit' is not a commit of this checkout\n"
