"""The package as users get it: metadata in step, executables that answer, pinned versions, licences."""

import ast
import functools
import importlib.metadata
import importlib.util
import itertools
import os
import re
import runpy
import shutil
import signal
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import tissue_sim
from helpers.patience import LIMIT
from tissue_sim.cli import main

ROOT = Path(__file__).resolve().parents[1]
with mock.patch("setuptools.setup") as _setup, mock.patch.object(sys, "argv", ["setup.py"]):
    runpy.run_path(str(ROOT / "setup.py"))
SETUP = _setup.call_args.kwargs
EXTRAS = SETUP["extras_require"]
PINS = {
    canonicalize_name(name): version
    for name, version in re.findall(r"^([\w.-]+)==(\S+)$", (ROOT / "constraints.txt").read_text(), re.MULTILINE)
}
COMMANDS = ("demo", "build", "info", "export", "solve", "replay", "view", "bridge")
EXECUTABLES = dict(entry.split(" = ") for entry in SETUP["entry_points"]["console_scripts"])

# Modules whose distribution has another name, and the ROS packages that an extra brings as one.
DISTRIBUTION_OF = {
    "fcl": "python-fcl",
    "PIL": "pillow",
    "ruamel": "ruamel.yaml",
    "skimage": "scikit-image",
    "netgen": "netgen-mesher",
    "skfem": "scikit-fem",
    "SimpleITK": "simpleitk",
    "llvmlite": "numba",  # which brings it, in the version that it was made with
}
ROS_PACKAGES_OF = re.compile(r"rclpy|rpyutils|tf2_ros|rcl_interfaces|ament_index_python|(\w+_(msgs|srvs|interfaces))")

GPL_FAMILY = re.compile(r"GPL|General Public License|Affero|SSPL", re.IGNORECASE)
# Distributions whose metadata names a licence of the GPL family, and why they may stay.
CLEARED = {
    "pygame": "LGPL, unchanged and linked dynamically; comes with pypbd, for benchmarks alone",
    "netgen-mesher": "LGPL-2.1, unchanged and linked dynamically; for calibration alone",
    "netgen-occt": "LGPL-2.1, as netgen-mesher, which brings it",
    "docutils": "public domain and BSD; the GPL covers an Emacs mode that is not in the wheel; of colcon and Sphinx",
    "astroid": "LGPL-2.1, unchanged; reads the sources for the pages' reference alone",
}


def run(executable: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Call an executable as its installed script does."""
    module, function = EXECUTABLES[executable].split(":")
    code = f"import sys; sys.argv[0] = {executable!r}; from {module} import {function}; sys.exit({function}())"
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    )


# metadata


def test_package_xml_agrees_with_setup():
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    assert package.get("format") == "3"
    assert package.findtext("name") == SETUP["name"] == "tissue_sim"
    assert package.findtext("version") == SETUP["version"] == tissue_sim.__version__
    assert package.findtext("license") == SETUP["license"] == "Apache-2.0"
    assert package.findtext("export/build_type") == "ament_python"
    assert "Apache License" in (ROOT / "LICENSE").read_text()[:200]


def test_package_xml_says_where_the_package_lives_and_who_writes_it():
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    assert {url.get("type") for url in package.findall("url")} == {"website", "repository", "bugtracker"}
    assert all(url.text.startswith("https://") for url in package.findall("url"))
    assert package.findtext("author")
    assert package.find("maintainer").get("email") == SETUP["maintainer_email"]
    assert (ROOT / package.findtext("export/rosdoc2")).is_file()


def test_least_versions_agree_and_the_pins_reach_them():
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    least = {
        element.text.removeprefix("python3-"): element.get("version_gte")
        for element in package.findall("exec_depend")
        if element.get("version_gte")
    }
    asked = {need.name: str(need.specifier) for need in requirements(None) if need.specifier}
    assert asked == {name: f">={version}" for name, version in least.items()}
    assert {"numpy", "scipy", "numba"} <= set(asked)
    assert all(need.specifier.contains(PINS[canonicalize_name(need.name)]) for need in requirements(None))


def test_changelog_is_as_bloom_reads_it():
    """A title for the package, then Forthcoming or this version, then older ones with their dates."""
    lines = (ROOT / "CHANGELOG.rst").read_text().splitlines()
    assert lines[1] == "Changelog for package tissue_sim"
    assert {lines[0], lines[2]} == {"^" * len(lines[1])}
    marked = [(above, line) for above, line in itertools.pairwise(lines) if re.fullmatch("-+", line)]
    assert marked
    assert all(len(above) == len(line) for above, line in marked)
    first, *older = [above for above, _ in marked]
    release = r"\d+\.\d+\.\d+ \(\d{4}-\d\d-\d\d\)"
    assert first == "Forthcoming" or re.fullmatch(release, first)
    assert all(re.fullmatch(release, heading) for heading in older)
    released = [heading.split()[0] for heading in (first, *older) if heading != "Forthcoming"]
    assert released[:1] in ([], [SETUP["version"]])


def test_contributions_are_under_the_licence_and_signed_off():
    text = (ROOT / "CONTRIBUTING.md").read_text()
    clause = re.search(
        r"5\. Submission of Contributions\..*?such Contributions\.", (ROOT / "LICENSE").read_text(), re.DOTALL
    )
    assert " ".join(clause[0].split()) in " ".join(text.split())
    assert "Signed-off-by" in text
    assert "https://developercertificate.org/" in text


@pytest.mark.extended
def test_package_xml_names_every_ros_package_that_is_imported():
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    named = {element.text for element in package.findall("exec_depend")}
    imported = {name for name in third_party_imports("tissue_sim", "launch") if is_ros(name) or "launch" in name}
    # Its services are served where it is installed, and nobody has to install it.
    assert imported - {"simulation_interfaces"} <= named


def test_configuration_is_installed():
    installed = {file for _, files in SETUP["data_files"] for file in files}
    assert {path.relative_to(ROOT).as_posix() for path in (ROOT / "config").rglob("*") if path.is_file()} <= installed


def test_everything_imported_is_declared():
    declared = {
        canonicalize_name(Requirement(line).name)
        for lines in (SETUP["install_requires"], *EXTRAS.values())
        for line in lines
    }
    imported = {name for name in third_party_imports("tissue_sim") if not is_ros(name)}
    assert {canonicalize_name(DISTRIBUTION_OF.get(name, name)) for name in imported} <= declared


def is_ros(name: str) -> bool:
    """Whether a module comes with ROS."""
    return bool(ROS_PACKAGES_OF.fullmatch(name))


def third_party_imports(*folders: str) -> set[str]:
    """Top-level names of all that the sources import from outside the standard library and the package."""
    names = {name for folder in folders for path in (ROOT / folder).rglob("*.py") for name in imports_of(path)}
    return names - set(sys.stdlib_module_names) - {"tissue_sim"}


@functools.cache
def imports_of(path: Path) -> set[str]:
    """Top-level names of all that a source file imports by their full names."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names.update(alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module.split(".")[0])
    return names


# executables


@pytest.mark.extended
def test_node_explains_itself():
    pytest.importorskip("rclpy")
    answer = run("tissue_node", "--help")
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.startswith("usage: tissue_node ")


def test_help_lists_the_commands():
    answer = run("tissue_sim", "--help")
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.startswith("usage: tissue_sim ")
    assert set(COMMANDS) <= set(re.findall(r"^ {4}(\w+) ", answer.stdout, re.MULTILINE))


def ended(*arguments: str) -> int:
    """Exit code of the command line, called in this process: to start one for each would take a minute."""
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    return caught.value.code


@pytest.mark.parametrize("command", COMMANDS)
def test_command_explains_itself(command, capsys):
    assert ended(command, "--help") == 0
    assert capsys.readouterr().out.startswith(f"usage: tissue_sim {command} ")


def test_wrong_use_ends_with_2():
    answer = run("tissue_sim", "no-such-command")
    assert answer.returncode == 2
    assert re.fullmatch(r"tissue_sim.*: error: .+\n", answer.stderr)


@pytest.mark.parametrize("arguments", [[], *([command, "--no-such-option"] for command in COMMANDS)])
def test_wrong_use_takes_one_line(arguments, capsys):
    assert ended(*arguments) == 2
    assert re.fullmatch(r"tissue_sim.*: error: .+\n", capsys.readouterr().err)


# make


@pytest.fixture
def checkout(tmp_path):
    """What make needs of a checkout, without an environment."""
    scripts = (".ci/alive", ".ci/venv")
    for name in ("Makefile", "constraints.txt", "setup.cfg", "setup.py", *scripts, "tissue_sim/version.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    return tmp_path


@pytest.mark.skipif(not shutil.which("make"), reason="make is not installed")
@pytest.mark.parametrize("target", ["demo", "test"])
def test_make_says_in_one_line_that_python_is_missing(checkout, target):
    tools = checkout / "bin"
    tools.mkdir()
    for tool in ("sh", "dirname"):
        (tools / tool).symlink_to(shutil.which(tool))
    environment = {"PATH": str(tools), "HOME": str(checkout)}
    make = subprocess.run(
        [shutil.which("make"), target], cwd=checkout, env=environment, capture_output=True, text=True, check=False
    )
    assert make.returncode != 0
    assert re.fullmatch(r".*needs CPython 3\.12.*install it.*\n", make.stdout + make.stderr)
    assert not (checkout / ".venv").exists()


def test_what_make_runs_is_not_silent(tmp_path):
    """The first line comes after three seconds, the others ten apart; and the command's exit code is its own."""
    sleep = tmp_path / "sleep"
    log, real = tmp_path / "slept", shutil.which("sleep")
    sleep.write_text(f'#!/bin/sh\necho "$1" >> {log}\n[ "$(wc -l < {log})" -le 3 ] || exec {real} 10\n')
    sleep.chmod(0o755)
    command = [str(ROOT / ".ci/alive"), "mypy", "sh", "-c", "read line; exit 7"]
    environment = {"PATH": f"{tmp_path}:{os.environ['PATH']}", "ALIVE": "echo 3 packages"}
    streams = {"stdin": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, env=environment, text=True, **streams) as process:
        lines = [process.stderr.readline() for _ in range(3)]
        process.communicate("go on\n", timeout=LIMIT)
    assert process.returncode == 7
    assert all(re.fullmatch(r"mypy: \d+ s, 3 packages\n", line) for line in lines)
    assert log.read_text().split()[:3] == ["3", "10", "10"]


def test_ctrl_c_in_what_make_runs_says_what_is_left():
    # Through Python, as a job in the background is started without the signal, and hands that down.
    code = "import os, signal, sys; signal.signal(signal.SIGINT, signal.SIG_DFL); os.execv(sys.argv[1], sys.argv[1:])"
    command = [sys.executable, "-c", code, str(ROOT / ".ci/alive"), "mypy", "sh", "-c", "echo begun; exec sleep 3600"]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    environment = os.environ | {"LEAVES": "make begins it again"}
    with subprocess.Popen(command, env=environment, text=True, process_group=0, **streams) as process:
        assert process.stdout.readline() == "begun\n"
        os.killpg(process.pid, signal.SIGINT)
        assert process.wait(LIMIT) == 130
        assert process.stderr.read() == "mypy: stopped; make begins it again\n"


def test_continuous_integration_runs_make_test():
    assert os.access(ROOT / ".ci/run", os.X_OK)
    text = (ROOT / ".ci/run").read_text()
    assert re.search(r"^make test <", text, re.MULTILINE)
    assert re.search(r"^exec make test-touched\b", text, re.MULTILINE)


# what an installation holds


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """A copy of the sources, in which an installation may leave what it makes."""
    source = tmp_path_factory.mktemp("source")
    for name in ("config", "launch", "resource", "tissue_sim", "package.xml", "setup.cfg", "setup.py"):
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
        elif (ROOT / name).exists():
            shutil.copy(ROOT / name, source)
    return source


@pytest.fixture(scope="module")
def prefix(source, tmp_path_factory):
    """Where the package was installed the way colcon does it, from a copy of the sources."""
    prefix = tmp_path_factory.mktemp("prefix")
    command = [sys.executable, "-W", "ignore", "setup.py", "--quiet", "install", "--prefix", str(prefix)]
    command += ["--single-version-externally-managed", "--record", str(prefix / "record")]
    done = subprocess.run(command, cwd=source, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return prefix


@pytest.mark.extended
def test_installation_is_an_ament_package(prefix):
    assert (prefix / "share/ament_index/resource_index/packages/tissue_sim").is_file()
    assert (prefix / "share/tissue_sim/package.xml").is_file()
    for executable in ("tissue_node", "tissue_sim"):
        assert os.access(prefix / "lib/tissue_sim" / executable, os.X_OK)


@pytest.mark.extended
def test_installation_has_configuration_and_launch_files(prefix):
    for folder in ("config", "launch"):
        wanted = {path.relative_to(ROOT) for path in (ROOT / folder).rglob("*.*") if path.suffix != ".pyc"}
        share = prefix / "share/tissue_sim"
        assert {path.relative_to(share) for path in (share / folder).rglob("*.*")} == wanted
    assert (prefix / "share/tissue_sim/config/tissue_node.yaml").is_file()
    assert list((prefix / "share/tissue_sim/config/organs").glob("*.npz"))


@pytest.mark.extended
def test_installation_has_every_module_and_template(prefix):
    (site,) = prefix.glob("lib/python3*/site-packages")
    for kind in ("*.py", "*.jinja"):
        wanted = {path.relative_to(ROOT) for path in (ROOT / "tissue_sim").rglob(kind)}
        assert wanted
        assert {path.relative_to(site) for path in (site / "tissue_sim").rglob(kind)} == wanted


@pytest.mark.extended
def test_a_script_beside_the_checkout_imports_the_package(source, tmp_path):
    command = [sys.executable, "-W", "ignore", "setup.py", "--quiet", "editable_wheel", "--dist-dir", str(tmp_path)]
    done = subprocess.run(command, cwd=source, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("*.whl")
    shutil.unpack_archive(wheel, tmp_path / "site", "zip")
    beside = tmp_path / "beside"
    (beside / "tissue_sim").mkdir(parents=True)  # a checkout's own folder, which has no __init__.py
    script = "import site; site.addsitedir('../site'); import tissue_sim; print(tissue_sim.__file__)"
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-S", "-c", script], cwd=beside, env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout.strip() == str(source / "tissue_sim" / "__init__.py"), done.stderr


@pytest.mark.parametrize("path", sorted((ROOT / "launch").glob("*.py")), ids=lambda path: path.name)
def test_launch_file(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert "generate_launch_description" in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)]
    arguments = [call for call in calls if call.func.id == "DeclareLaunchArgument"]
    assert arguments
    assert all("description" in {keyword.arg for keyword in call.keywords} for call in arguments)
    if importlib.util.find_spec("launch_ros"):
        assert runpy.run_path(str(path))["generate_launch_description"]().entities


# dependencies

# All that is installed with an extra; what is always installed is looked at first, the rest where setup.py changed.
by_extra = pytest.mark.parametrize(
    "extra", [None, *(pytest.param(extra, marks=pytest.mark.extended) for extra in EXTRAS)], ids=str
)


def requirements(extra: str | None) -> list[Requirement]:
    """What setup.py asks for: always (None) or with an extra."""
    return [Requirement(line) for line in (EXTRAS[extra] if extra else SETUP["install_requires"])]


def with_dependencies(wanted: list[Requirement]) -> Iterator[importlib.metadata.Distribution]:
    """The installed distributions of the requirements, and of all that these require in turn."""
    queue = [(need.name, extra) for need in wanted for extra in ("", *need.extras)]
    seen = set()
    while queue:
        name, extra = queue.pop()
        if (canonicalize_name(name), extra) in seen:
            continue
        seen.add((canonicalize_name(name), extra))
        distribution = distribution_of(name)
        yield distribution
        for need in requirements_of(name):
            if need.marker is None or need.marker.evaluate({**default_environment(), "extra": extra}):
                queue += [(need.name, inner) for inner in ("", *need.extras)]


@functools.cache
def distribution_of(name: str) -> importlib.metadata.Distribution:
    """The installed distribution of a name: one for all extras that bring it."""
    return importlib.metadata.distribution(name)


@functools.cache
def requirements_of(name: str) -> list[Requirement]:
    """What a distribution requires, with all of its extras."""
    return [Requirement(line) for line in distribution_of(name).requires or []]


@functools.cache
def installed(extra: str | None) -> list[importlib.metadata.Distribution]:
    """The distributions behind an extra; skips the test where it is not installed from the package index."""
    try:
        return list(with_dependencies(requirements(extra)))
    except importlib.metadata.PackageNotFoundError as error:
        pytest.skip(f"{error.name} is not installed")


@functools.cache
def licence_of(distribution: importlib.metadata.Distribution) -> str:
    """Licence as a distribution states it: expression, classifiers, a short field, package.xml, or a file's heading."""
    metadata = distribution.metadata
    found = [metadata.get("License-Expression") or ""]
    found += [line for line in metadata.get_all("Classifier") or [] if line.startswith("License ::")]
    if not any(found) and len(metadata.get("License") or "") < 200:
        found.append(metadata.get("License") or "")
    for file in distribution.files or []:
        if file.name == "package.xml":
            found += [element.text or "" for element in ElementTree.parse(file.locate()).iter("license")]
    if not any(found):
        own = [file for file in distribution.files or [] if file.parts[0].endswith(".dist-info")]
        found += [" ".join(file.read_text()[:300].split()) for file in own if file.name.startswith("LICENSE")]
    return "; ".join(filter(None, found))


def is_gpl(licence: str) -> bool:
    """Whether a licence is of the GPL family; with GCC's runtime exception it binds nobody who links to it."""
    return bool(GPL_FAMILY.search(re.sub(r"GPL-[\w.-]+ WITH GCC-exception-[\d.]+", "", licence)))


@pytest.mark.parametrize("extra", [None, *EXTRAS], ids=str)
def test_direct_dependencies_are_pinned(extra):
    assert {canonicalize_name(need.name) for need in requirements(extra)} <= set(PINS)


@by_extra
def test_all_dependencies_are_pinned(extra):
    assert {canonicalize_name(distribution.name) for distribution in installed(extra)} <= set(PINS)


def test_build_tools_are_pinned():
    assert {"pip", "setuptools"} <= set(PINS)


@by_extra
def test_no_dependency_is_gpl(extra):
    licences = {canonicalize_name(distribution.name): licence_of(distribution) for distribution in installed(extra)}
    # A collection of other packages (a name and dependencies, no files of its own) has nothing to license.
    empty = {canonicalize_name(d.name) for d in installed(extra) if all(".dist-info" in str(f) for f in d.files or [])}
    assert {name for name, licence in licences.items() if not licence} <= empty
    assert {name: licence for name, licence in licences.items() if is_gpl(licence)}.keys() <= CLEARED.keys()


@pytest.mark.parametrize(
    ("licence", "gpl"),
    [
        ("GPL-3.0-or-later", True),
        ("License :: OSI Approved :: GNU General Public License v3 (GPLv3)", True),
        ("AGPL-3.0-only", True),
        ("License :: OSI Approved :: GNU Affero General Public License v3", True),
        ("MIT; GPLv2", True),
        ("License :: OSI Approved :: GNU Library or Lesser General Public License (LGPL)", True),
        ("MPL-2.0", False),
        ("BSD-3-Clause AND GPL-3.0-or-later WITH GCC-exception-3.1", False),
    ],
)
def test_gpl_family_is_recognized(licence, gpl):
    assert is_gpl(licence) is gpl


def test_ros_comes_only_with_its_extra():
    always = {canonicalize_name(need.name) for need in requirements(None)}
    assert not {name for name in always if name.startswith("ros-")}
    assert all(need.name.startswith("ros-") for need in requirements("ros"))
