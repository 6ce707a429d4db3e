"""What may import what: the core knows nothing of ROS, images stay out of the model, imports run one way.

And tests: what they share lies in test/helpers, and is imported from there by its full name.
"""

import ast
import functools
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path, PurePosixPath

import pytest

import tissue_sim

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "tissue_sim"

# The layers, and the layers that each may import besides itself.
MAY_IMPORT = {
    "rendering": set(),
    "organ": set(),
    "model": {"organ"},
    "contact": {"organ", "model", "rendering"},
    "calibration": {"organ", "model"},
    "environments": {"organ", "model", "contact", "rendering"},
    "ros": {"organ", "model", "contact", "calibration", "rendering", "environments"},
    "identification": {"organ", "model", "contact", "calibration"},
    "bench": {"organ", "model", "contact", "calibration", "rendering", "identification", "ros"},
    "commands": {
        "organ",
        "model",
        "contact",
        "calibration",
        "rendering",
        "identification",
        "environments",
        "ros",
        "bench",
    },
    "cli": {"commands"},
    "__main__": {"cli"},
    "__init__": {
        "organ",
        "model",
        "contact",
        "calibration",
        "rendering",
        "ros",
    },  # the public names; what is below has them directly
}
# Folders of a layer, each of which may import those before it; files beside them import all, and none imports those.
FOLDERS = {
    "model": ("data", "elasticity", "cutting", "contact", "regions", "stepping", "runtime"),
    "ros": ("shared", "bridge", "probes", "bags", "node", "viewer", "camera"),
    "ros/node": ("shared", "input", "settings", "tools", "contact", "output", "services"),
}
# What they find, others ask for and show.
LIBRARIES = {
    "rendering",
    "organ",
    "model",
    "contact",
    "calibration",
    "environments",
    "identification",
}
ROS_PACKAGE = re.compile(r"rclpy|rpyutils|rosidl\w*|ament_index_\w+|launch(_\w+)?|tf2\w*|\w+_(msgs|srvs|interfaces)")
TOP_LEVEL = {
    *(".ci", ".gitignore", ".python-version", "CHANGELOG.rst", "CONTRIBUTING.md", "LICENSE", "Makefile"),
    *("README.md", "constraints.txt", "package.xml", "rosdoc2.yaml", "ruff.toml", "setup.cfg", "setup.py"),
    *("bags", "config", "docs", "launch", "resource", "test", "tissue_sim"),
}
SOURCES = sorted(PACKAGE.rglob("*.py"))
TESTS = sorted((ROOT / "test").rglob("*.py"))


WRITERS = ("print", "stdout", "stderr")


def parsed(path: Path) -> Iterator[ast.AST]:
    """All that a source file consists of."""
    return ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path)))


@functools.cache
def imports_and_writers(path: Path) -> tuple[ast.AST, ...]:
    """What of a source file imports, or names what writes to the terminal: the file is parsed once for both."""
    return tuple(
        node
        for node in parsed(path)
        if isinstance(node, ast.Import | ast.ImportFrom) or getattr(node, "id", getattr(node, "attr", "")) in WRITERS
    )


def imported_modules(path: Path) -> Iterator[tuple[int, str]]:
    """Line and full name of everything that a source file imports, wherever in the file it does so."""
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    for node in imports_and_writers(path):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = ".".join([*package[: len(package) - node.level + 1]] if node.level else [])
            module = ".".join(part for part in (base, node.module) if part)
            yield from ((node.lineno, f"{module}.{alias.name}") for alias in node.names)


def layer_of(module: str) -> str | None:
    """The layer that a module of tissue_sim belongs to; None for what all share, and for other packages."""
    parts = module.split(".")
    return parts[1] if parts[0] == "tissue_sim" and len(parts) > 1 and parts[1] in MAY_IMPORT else None


def violations(path: Path) -> list[str]:
    """Imports of a source file that break the rules, as `file:line: what`."""
    own = layer_of(".".join(path.relative_to(ROOT).with_suffix("").parts))
    found = []
    for line, module in imported_modules(path):
        layer = layer_of(module)
        # What has no layer (errors, progress) is shared by all and so depends on none.
        if layer and layer != own and layer not in MAY_IMPORT.get(own or "", set()):
            found.append(f"{path.relative_to(ROOT)}:{line}: {own or 'a shared module'} imports {module}")
        if own != "__init__" and module.startswith("tissue_sim.") and module.split(".")[1] in tissue_sim.__all__:
            found.append(f"{path.relative_to(ROOT)}:{line}: imports {module} from the public names")
        if own != "ros" and ROS_PACKAGE.fullmatch(module.split(".")[0]):
            found.append(f"{path.relative_to(ROOT)}:{line}: imports {module} outside tissue_sim/ros")
        if own in LIBRARIES and module.split(".")[0] == "argparse":
            found.append(f"{path.relative_to(ROOT)}:{line}: a library imports {module}")
        if module.split(".")[0] == "tqdm" and path.name != "progress_reporter.py":
            found.append(f"{path.relative_to(ROOT)}:{line}: imports {module} instead of tissue_sim.progress")
    if own in LIBRARIES:
        found += [f"{path.relative_to(ROOT)}:{line}: a library prints" for line in prints(path)]
    return found


def prints(path: Path) -> Iterator[int]:
    """Lines of a source file that name what writes to the terminal."""
    for node in imports_and_writers(path):
        if isinstance(node, ast.Name | ast.Attribute):
            yield node.lineno


@pytest.mark.parametrize("layer", [*MAY_IMPORT, None], ids=str)
def test_imports_run_one_way(layer):
    own = [path for path in SOURCES if layer_of(".".join(path.relative_to(ROOT).with_suffix("").parts)) == layer]
    assert own, "no such layer"
    assert not [line for path in own for line in violations(path)]


@pytest.mark.parametrize(
    ("file", "code"),
    [
        ("organ/a.py", "from tissue_sim.model import forces"),
        ("organ/a.py", "from tissue_sim import model"),
        ("rendering/a.py", "from tissue_sim.organ.organ import Organ"),
        ("organ/a.py", "from ..model.forces import spring_forces"),
        ("model/a.py", "def late():\n    import tissue_sim.contact.tools"),
        ("contact/a.py", "import rclpy"),
        ("model/a.py", "from geometry_msgs.msg import PoseStamped"),
        ("ros/a.py", "import tissue_sim.cli"),
        ("commands/a.py", "import rclpy"),
        ("ros/a.py", "from tissue_sim.commands import COMMANDS"),
        ("organ/a.py", "from argparse import ArgumentParser"),
        ("calibration/a.py", "def late():\n    from tqdm import tqdm"),
        ("bench/a.py", "import tqdm"),
        ("ros/a.py", "from tissue_sim.identification.identify import identify"),
        ("identification/a.py", "from tissue_sim.ros.bags.reading import read_bag"),
        ("model/a.py", "print(1)"),
        ("organ/a.py", "making = Progress(print)"),
        ("contact/a.py", "import sys\nsys.stderr.write('x')"),
        ("errors.py", "from tissue_sim.organ.organ import Organ"),
        ("model/a.py", "from tissue_sim import Organ"),
        ("__init__.py", "from tissue_sim.bench.organs import bean"),
    ],
)
def test_the_check_sees_a_violation(tmp_path, monkeypatch, file, code):
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    path = tmp_path / "tissue_sim" / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(code)
    assert len(violations(path)) == 1


def rank_of(place: tuple[str, ...], folders: tuple[str, ...]) -> int:
    """Return how high a module stands, by its names below the layer: its folder's number, or above all of them."""
    return folders.index(place[0]) if len(place) > 1 and place[0] in folders else len(folders)


def upward_imports(layer: str) -> list[str]:
    """Return imports of a layer from a folder that stands above the importing one, as `file:line: what`."""
    folders, base = FOLDERS[layer], PACKAGE / layer
    prefix = ".".join(("tissue_sim", *PurePosixPath(layer).parts)) + "."
    found = []
    for path in sorted(base.rglob("*.py")):
        own = rank_of(path.relative_to(base).parts, folders)
        for line, module in imported_modules(path):
            place = tuple(module.removeprefix(prefix).split("."))
            if module.startswith(prefix) and rank_of((*place, ""), folders) > own:
                found.append(f"{path.relative_to(ROOT)}:{line}: imports {module}")
    return found


@pytest.mark.parametrize("layer", FOLDERS)
def test_folders_of_a_layer_import_one_way(layer):
    assert {path.name for path in (PACKAGE / layer).iterdir() if path.is_dir() and path.name != "__pycache__"} == set(
        FOLDERS[layer]
    )
    assert not upward_imports(layer)


def test_the_check_sees_an_upward_import(tmp_path, monkeypatch):
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    monkeypatch.setitem(globals(), "PACKAGE", tmp_path / "tissue_sim")
    for folder, code in {
        "data": "from tissue_sim.model.elasticity.forces import elastic_forces",
        "stepping": "from tissue_sim.model import simulation",
        "runtime": "from tissue_sim.model.data.arrays import copy",
    }.items():
        (tmp_path / "tissue_sim/model" / folder).mkdir(parents=True)
        (tmp_path / "tissue_sim/model" / folder / "a.py").write_text(code)
    assert [line.split("/")[2] for line in upward_imports("model")] == ["data", "stepping"]


def import_graph() -> dict[str, set[str]]:
    """Return the modules of tissue_sim that each of them imports: at its top, within functions, or for types."""
    named = {}
    for path in SOURCES:
        parts = path.relative_to(ROOT).with_suffix("").parts
        named[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    graph: dict[str, set[str]] = {}
    for name, path in named.items():
        modules = (module for _, module in imported_modules(path))
        found = {module if module in named else module.rpartition(".")[0] for module in modules}
        graph[name] = found & (set(named) - {name})
    return graph


def test_no_circle_of_imports():
    TopologicalSorter(import_graph()).prepare()  # raises CycleError, which names the circle


def test_a_circle_is_found():
    with pytest.raises(CycleError, match="a"):
        TopologicalSorter({"a": {"b"}, "b": {"a"}}).prepare()


def test_programs_that_are_started_by_name_exist():
    """A benchmark doesn't notice when one that only listens has failed to start."""
    started = {name for path in SOURCES for name in re.findall(r'\.start\("([a-z_.]+)"', path.read_text())}
    assert "probes.marker_subscriber" in started
    assert not [name for name in started if not (PACKAGE / "ros" / f"{name.replace('.', '/')}.py").exists()]


PARAMETERS = re.compile(r"^Parameters\n-+\n(.*?)(?=^\w[^\n]*\n-{3,}\n|\Z)", re.MULTILINE | re.DOTALL)
STALE = '''
def f(a):
    """Do it.

    Parameters
    ----------
    b : int
        It.
    """
'''


def undefined_parameters(source: str) -> list[str]:
    """Return the names that a docstring's Parameters section describes, and its function or class doesn't have."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            continue
        section = PARAMETERS.search(ast.get_docstring(node) or "")
        lines = section[1].splitlines() if section else []
        described = {
            name.strip(" *") for line in lines if line and line[0] != " " for name in line.split(":")[0].split(",")
        }
        # Of a class: those of its constructor, or its fields.
        own = {one.arg for one in ast.walk(node) if isinstance(one, ast.arg)}
        own |= {one.target.id for one in ast.walk(node) if isinstance(one, ast.AnnAssign) and hasattr(one.target, "id")}
        found += [f"{node.name}: {name}" for name in sorted(described - own)]
    return found


@pytest.mark.extended
def test_docstrings_describe_parameters_that_exist():
    found = [(path.name, one) for path in SOURCES for one in undefined_parameters(path.read_text(encoding="utf-8"))]
    assert not found
    assert undefined_parameters(STALE) == ["f: b"]


def crossings(path: Path) -> list[str]:
    """Imports of a test or helper that are relative, or of another test module, as `file:line: what`."""
    found = []
    for node in parsed(path):
        if isinstance(node, ast.ImportFrom):
            names = [node.module or "", *(alias.name for alias in node.names)]
            relative = bool(node.level)
        elif isinstance(node, ast.Import):
            names, relative = [alias.name for alias in node.names], False
        else:
            continue
        parts = {part for name in names for part in name.split(".")}
        if relative or parts & {"test", "conftest"} or any(part.startswith("test_") for part in parts):
            found.append(f"{path}:{node.lineno}: imports {', '.join(names)}")
    return found


@pytest.mark.extended
def test_tests_share_only_named_helpers():
    assert not [line for path in TESTS for line in crossings(path)]
    are_tests = {path for path in TESTS if path.name.startswith("test_") or path.name == "conftest.py"}
    in_helpers = {path for path in TESTS if (ROOT / "test" / "helpers") in path.parents}
    assert are_tests == set(TESTS) - in_helpers, "what tests share lies in test/helpers"


@pytest.mark.parametrize(
    "code",
    [
        "from .test_forces import deformed",
        "from ..scenes import ball",
        "from test.model.test_forces import deformed",
        "from model.test_forces import deformed",
        "from model import test_forces",
        "def late():\n    import test_forces",
    ],
)
def test_the_check_sees_what_a_test_takes_from_another(tmp_path, code):
    path = tmp_path / "test_a.py"
    path.write_text(code)
    assert len(crossings(path)) == 1


def import_with_blocked(module: str, *blocked: str) -> subprocess.CompletedProcess[str]:
    """Import a module in a fresh interpreter in which the blocked packages cannot be imported."""
    code = f"import sys\nsys.modules.update(dict.fromkeys({blocked!r}))\nimport {module}\n"
    return subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)


def test_model_needs_neither_ros_nor_images_nor_meshes():
    run = import_with_blocked("tissue_sim.model.simulation", "rclpy", "SimpleITK", "trimesh", "fcl", "rosbags")
    assert run.returncode == 0, run.stderr


def test_command_line_starts_without_ros():
    run = import_with_blocked("tissue_sim.cli", "rclpy", "SimpleITK", "skimage", "viser", "trimesh", "fcl", "rosbags")
    assert run.returncode == 0, run.stderr


def test_top_level_holds_only_what_it_should():
    if not (ROOT / ".git").exists() or not shutil.which("git"):
        pytest.skip("not a git checkout")
    listed = subprocess.run(["git", "-C", ROOT, "ls-files"], capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip(f"git does not read this checkout: {listed.stderr.strip()}")
    assert {name.split("/")[0] for name in listed.stdout.splitlines()} <= TOP_LEVEL
