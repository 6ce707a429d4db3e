"""README and docs against the code: whatever they name is there, and what is there is named."""

import ast
import functools
import importlib.util
import inspect
import re
import runpy
import sys
from pathlib import Path
from unittest import mock

import pytest

from helpers.scenes import ball
from tissue_sim.contact.scene_file import SCENE_KEYS

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.glob("*.md"))]
# What isn't ours: options of other programs, and names that come from elsewhere.
FOREIGN_OPTIONS = {
    *("--ros-args", "--params-file", "--from-paths", "--ignore-src", "--share", "--help", "--package-path"),
    "--enclave",  # of rcl
    *("--nworkers", "--nthreads"),  # of dask worker
    "--system-site-packages",  # of venv
    *("--once", "--qos-reliability", "--frame-id", "--child-frame-id"),  # of ros2 topic and of tf2_ros
}
FOREIGN_TOPICS = {"/tf", "/tf_static"}  # published by tf2_ros for the node
ENVIRONMENT = r"^tissue_sim/\w+-v\d$"  # a name that Gymnasium knows
FOREIGN_WORDS = {"check_env", "foxglove_bridge", "use_sim_time", "rclpy", "SCHED_FIFO", "ROS_DOMAIN_ID", "namespace"}

COMMAND_LINE = re.compile(r"(?<!ros2 run )(?<!ros2 launch )(?<!from )(?<!/)\btissue_sim((?: [a-z]\w*\b(?![./]))+)")

_spec = importlib.util.spec_from_file_location("pages_reference", DOCS / "reference.py")
reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference)
reference.parser_of = functools.cache(reference.parser_of)


def by_page(check):
    """Make one test of a check of a page: it looks at all pages, and names each that fails, with the reason."""
    signature = inspect.signature(check)
    fixtures = [parameter for parameter in signature.parameters.values() if parameter.name != "page"]

    @functools.wraps(check)
    def over_all_pages(**named):
        wrong = []
        for page in PAGES:
            try:
                check(page=page, **named)
            except AssertionError as error:
                wrong.append(f"{page.name}: {error}")
        assert not wrong, "\n".join(wrong)

    over_all_pages.__signature__ = signature.replace(parameters=fixtures)
    return over_all_pages


@functools.cache
def snippets(page: Path) -> list[str]:
    """All code on a page: inline, and the lines of its blocks without their comments."""
    text = page.read_text(encoding="utf-8")
    blocks = re.compile(r"^(```|~~~)([^\n]*)\n(.*?)^\1$", re.MULTILINE | re.DOTALL)
    code = [block for _, kind, block in blocks.findall(text) if not kind.startswith("{")]
    lines = [line.split(" # ")[0].rstrip() for block in code for line in block.splitlines()]
    prose = blocks.sub("", text)
    return [part for line in lines for part in line.split("&&")] + re.findall(r"`([^`\n]+)`", prose.replace("\n", " "))


def tables(page: Path) -> list[list[list[str]]]:
    """The tables of a page: rows of cells, the head first."""
    found = re.findall(r"(?:^\|.*\n)+", page.read_text(encoding="utf-8") + "\n", re.MULTILINE)
    return [
        [[cell.strip() for cell in row.strip("| ").split(" | ")] for row in table.splitlines() if "|---" not in row]
        for table in found
    ]


def slug(heading: str) -> str:
    """The anchor of a heading."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


def option_names(*words: str) -> set[str]:
    return set(re.findall(r"--[\w-]+", " ".join(reference.options(*words))))


@pytest.fixture(scope="module")
def commands() -> dict[tuple[str, ...], set[str]]:
    """The options of every command and benchmark."""
    all_words = [(name,) for name in reference.subcommands()]
    all_words += [(*words, name) for words in all_words for name in reference.subcommands(*words)]
    return {words: option_names(*words) for words in all_words}


@pytest.fixture(scope="module")
def parameters() -> tuple[set[str], set[str]]:
    """Names of the node's parameters, and of those of each tool."""
    pytest.importorskip("rclpy")
    from tissue_sim.ros.shared.parameter_specs import NODE_SPECS, TOOL_SPECS

    return {spec.name for spec in NODE_SPECS} | {"tools", "use_sim_time"}, {spec.name for spec in TOOL_SPECS}


def launch_arguments() -> dict[str, set[str]]:
    return {
        path.name: set(re.findall(r'DeclareLaunchArgument\(\s*"(\w+)"', path.read_text(encoding="utf-8")))
        for path in (ROOT / "launch").glob("*.py")
    }


@pytest.fixture(scope="module")
def topics() -> dict[str, str]:
    """Type of every topic and service of the node, by its name; a tool's as its bridge has them by default."""
    pytest.importorskip("rclpy")
    from tissue_sim.ros.shared.parameter_specs import TOOL_SPECS
    from tissue_sim.ros.shared.parameter_values import usual_topics

    default = {spec.name: spec.default for spec in TOOL_SPECS}
    types = {
        "measured_cp": default["pose_type"],
        "external_cf": default["force_type"],
        "servo_cf": default["wrench_type"],
        "measured_js": "JointState",
    }
    usual = usual_topics("<tool>") | {"external_cf": "<tool>/external_cf"}  # its name is up to the user
    found = {name: types[topic] for topic, name in usual.items()} | {"/clock": "Clock"}
    for path in (ROOT / "tissue_sim" / "ros" / "node").rglob("*.py"):
        # {below} is the node's name, or in a scene an organ's below it.
        made = re.findall(
            r"(?:create_(?:publisher|subscription|service)\(\s*|DeferredService\(node, )"
            r'(\w+), f?"((?:~|/|\{below\})\S+)"',
            path.read_text(encoding="utf-8"),
        )
        found |= {re.sub(r"\{[\w.]+\}", "<tool>", name.replace("{below}", "~")): kind for kind, name in made}
    return found


def make_targets() -> set[str]:
    """Those that `make help` lists."""
    return set(re.findall(r"^([a-z-]+):[^#\n]*##", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))


# what the pages name is there


@by_page
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        path, _, anchor = target.partition("#")
        if path.startswith("https://"):
            continue
        if path.startswith("api/"):  # made from the sources
            assert (ROOT / path.removeprefix("api/").removesuffix("/index")).is_dir(), target
            continue
        goal = (page.parent / path) if path else page
        assert goal.is_file(), target
        if anchor:
            assert anchor in {
                slug(line) for line in re.findall(r"^#+ (.+)$", goal.read_text(encoding="utf-8"), re.MULTILINE)
            }, target


def test_every_picture_is_shown():
    shown = {
        Path(name).name
        for page in PAGES
        for name in re.findall(r"!\[[^]]*\]\(([^)]+)\)", page.read_text(encoding="utf-8"))
    }
    assert {path.name for path in [*(DOCS / "images").iterdir(), *(DOCS / "examples").glob("*.png")]} == shown


@by_page
def test_files_exist(page):
    folders = "bags|config|docs|launch|resource|test|tissue_sim"
    folders_of_code = ("tissue_sim", "launch", "docs/examples")
    modules = {path.name for folder in folders_of_code for path in (ROOT / folder).rglob("*.py")}
    for snippet in snippets(page):
        for path in re.findall(rf"(?<![\w./~:])(?:{folders})/[\w./-]*", snippet):
            assert (ROOT / path).exists() or re.search(ENVIRONMENT, path), snippet
        for name in re.findall(r"(?<![\w./])[\w.]+\.py\b", snippet):
            assert name in modules | {"setup.py"}, snippet
        for name in re.findall(r"^(?:[A-Z]+\.\w+|package\.xml|constraints\.txt)$", snippet):
            assert (ROOT / name).is_file(), snippet


@by_page
def test_commands_and_their_options_exist(page, commands):
    everywhere = set().union(*commands.values()) | FOREIGN_OPTIONS
    for snippet in snippets(page):
        given = set(re.findall(r"(?<!\S)--[a-z][\w-]*", snippet))
        if module := re.search(r"python -m (tissue_sim[\w.]*)", snippet):
            source = (ROOT / module[1].replace(".", "/")).with_suffix(".py").read_text(encoding="utf-8")
            assert all(f'"{option}"' in source for option in given), snippet
        elif words := COMMAND_LINE.search(snippet):
            first, *rest = words[1].split()
            assert (first,) in commands, snippet
            own = (first,)
            if first == "bench" and rest:
                own = ("bench", rest[0])
                assert own in commands, snippet
            assert given <= commands[own] | {"--help"}, snippet
        else:
            assert given <= everywhere, snippet
        if target := re.match(r"make ([a-z-]+)", snippet):
            assert target[1] in make_targets(), snippet
        if launched := re.search(r"ros2 launch tissue_sim (\S+)(.*)", snippet):
            assert set(re.findall(r"(\w+):=", launched[2])) <= launch_arguments()[launched[1]], snippet


@by_page
def test_parameters_exist(page, parameters):
    of_node, of_tool = parameters
    launched = set().union(*launch_arguments().values())
    for snippet in snippets(page):
        for name in re.findall(r"([\w.]+):=", snippet):
            assert name in of_node | ({"__ns"} if "-r " in snippet else launched), snippet
        for name in re.findall(r"^(?:<tool>)?\.(\w+)$", snippet):
            assert name in of_tool | {"venv"}, snippet
        if setting := re.match(r"(\w+): \w", snippet):
            assert setting[1] in of_node | set(SCENE_KEYS), snippet
    for head, *rows in tables(page):
        for row in rows if head[0] == "parameter" else []:
            for name in re.findall(r"`([^`]+)`", row[0]):
                assert name in of_node or re.sub(r"^(<tool>)?\.", "", name) in of_tool, row


@by_page
def test_topics_exist(page, topics):
    bridges = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "config" / "bridges").glob("*.yaml"))
    policy = set(re.findall(r'[>"](/[\w/]+)', (ROOT / "config" / "sros2_policy.xml").read_text(encoding="utf-8")))
    known = {*topics, *FOREIGN_TOPICS, *policy, "/tissue_sim", "/ward/tissue_sim"}
    for snippet in snippets(page):
        if re.fullmatch(r"(~|<tool>|~/<tool>|left|right)(/\w+)+", snippet):
            name = re.sub(r"^(~/<tool>|left|right)/", "<tool>/", snippet)
            assert {name, snippet} & topics.keys(), snippet
        for name in re.findall(r"(?<![\w.:/<>~])/[a-zA-Z]\w+(?:/\w+)*(?![\w.])", snippet):
            own = re.sub("^/tissue_sim/", "~/", re.sub("^/left/", "<tool>/", name)).replace("~/left/", "~/<tool>/")
            if not name.startswith("/etc/") and "__ns:=" not in snippet:
                assert known & {own, name, name.removeprefix("/ward")} or name in bridges, snippet


@functools.cache
def words_of_the_code() -> set[str]:
    folders = [ROOT / name for name in ("tissue_sim", "launch", "config")]
    files = [path for folder in folders for path in folder.rglob("*.*") if path.suffix in (".py", ".yaml", ".xml")]
    files += [ROOT / name for name in ("setup.py", "package.xml", "Makefile", "constraints.txt", "docs/conf.py")]
    known = set(re.findall(r"\w+", "\n".join(path.read_text(encoding="utf-8") for path in files)))
    known |= {part for path in files for part in path.relative_to(ROOT).parts}
    return known


@by_page
def test_names_are_those_of_the_code(page):
    """A lone word in code font is a word of the sources, so that what is renamed is noticed."""
    known = words_of_the_code() | FOREIGN_WORDS
    for snippet in snippets(page):
        if re.fullmatch(r"[A-Za-z_]\w+", snippet) and not snippet.isupper():
            assert snippet in known, snippet


@by_page
def test_python_names_exist(page):
    for snippet in snippets(page):
        for dotted in re.findall(r"(?<![\w/])tissue_sim(?:\.\w+)+", snippet):
            path, names = ROOT, dotted.split(".")
            while names and ((path / names[0]).is_dir() or (path / f"{names[0]}.py").is_file()):
                path = path / names.pop(0)
            module = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
            assert module.is_file(), dotted
            assert len(names) <= 1, dotted
            defined = {
                node.name for node in ast.parse(module.read_text(encoding="utf-8")).body if hasattr(node, "name")
            }
            assert set(names) <= defined, dotted


@pytest.fixture
def smaller_organ_ships(monkeypatch, tmp_path):
    """What the pages load is a ball, which finds its shape without weight a hundred times sooner than a kidney."""
    ball(3).save(tmp_path / "ball.npz")
    monkeypatch.setattr("tissue_sim.organ.organ.shipped_organ", lambda name: tmp_path / "ball.npz")


def test_examples_in_the_readme_run():
    run_examples(ROOT / "README.md")


def test_examples_for_python_run(smaller_organ_ships):
    run_examples(DOCS / "python.md")


def test_the_tutorial_runs(smaller_organ_ships, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    forces = run_blocks(DOCS / "tutorial.md")["forces"]
    assert forces[0] == 0.0
    assert forces[-1] == max(forces) > 0.1
    assert (tmp_path / "press.png").stat().st_size > 5000


@pytest.mark.extended
def test_examples_of_cutting_cut_and_print(capsys):
    run_blocks(DOCS / "cutting.md")
    areas = re.findall(r"^([\d.]+) mm\^2 cut", capsys.readouterr().out, re.MULTILINE)
    assert len(areas) == 4
    assert all(float(area) > 150.0 for area in areas), "of a plane twice, of a knife, and of scissors"


@pytest.mark.extended
def test_examples_for_python_run_with_the_organ_that_ships():
    run_examples(DOCS / "python.md")


def run_blocks(page):
    """The names that a page's blocks of Python define, run one after the other."""
    names: dict = {}
    for block in re.findall(r"^```python\n(.*?)^```$", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL):
        exec(compile(block, page.name, "exec"), names)
    return names


def run_examples(page):
    import numpy as np

    names = run_blocks(page)
    organ, simulation = names["organ"], names["simulation"]
    assert simulation.positions.shape == (organ.n_nodes, 3)
    assert np.any(simulation.positions != organ.rest_positions)  # it was pushed
    if "scene" in names:
        assert names["scene"].wrenches.shape == (1, 6)


def test_a_page_that_is_wrong_is_named_with_the_reason(monkeypatch, tmp_path):
    page = tmp_path / "wrong.md"
    page.write_text("See [it](nowhere.md) and `no_such_word`.\n")
    monkeypatch.setattr(sys.modules[__name__], "PAGES", [ROOT / "README.md", page])
    for check, reason in (
        (test_links_lead_somewhere, "nowhere.md"),
        (test_names_are_those_of_the_code, "no_such_word"),
    ):
        with pytest.raises(AssertionError, match=rf"(?s)wrong\.md: .*{reason}"):
            check()


# what is there is named on the pages


def test_every_parameter_is_listed(parameters):
    page = (DOCS / "parameters.md").read_text(encoding="utf-8")
    for of, names, prefix in (("node", parameters[0], ""), ("tool", parameters[1], "<tool>.")):
        assert f"```{{parameters}} {of}\n```" in page
        listed = set(re.findall(r"^\| `([^`]+)` \|", "\n".join(reference.parameters_table(of)), re.MULTILINE))
        assert listed == {prefix + name for name in names if name != "use_sim_time"}


def test_every_topic_is_listed_with_its_type(topics):
    (rows,) = (rows for head, *rows in tables(DOCS / "topics.md") if head[0] == "name")
    listed = {row[0].strip("`"): row[1] for row in rows}
    assert listed.keys() == topics.keys() | {"/tf_static`, `/tf"}
    for name, kind in topics.items():
        assert re.match(rf"\w+/{kind}\b", listed[name]), name


def test_every_topic_of_the_camera_is_listed_with_its_type():
    pytest.importorskip("rclpy")
    from tissue_sim.ros.camera.topic_names import TOPICS

    (rows,) = (rows for head, *rows in tables(DOCS / "camera.md") if head[0] == "camera topic")
    listed = {row[0].strip("`"): row[1] for row in rows}
    assert listed == {name: f"sensor_msgs/{kind.__name__}" for name, kind in TOPICS.items()} | {
        "pose": "geometry_msgs/PoseStamped"
    }


def test_every_command_is_listed():
    page = (DOCS / "commands.md").read_text(encoding="utf-8")
    (rows,) = (rows for head, *rows in tables(DOCS / "commands.md") if head[0] == "command")
    names = set(reference.subcommands())
    assert {row[0].strip("`") for row in rows} == {"tissue_node", *(f"tissue_sim {name}" for name in names)}
    for name in names:
        assert f"## tissue_sim {name}\n" in page
        assert f"```{{options}} {name}\n```" in page


def test_every_option_is_explained(commands):
    for words in commands:
        help_texts = reference.options(*words)
        assert all(help_texts.values()), words
        listed = "\n".join(reference.options_table(*words))
        assert all(f"`{written}`" in listed.replace(r"\|", "|") for written in help_texts)
    assert "`tissue_sim bench tick`" in "\n".join(reference.options_table("bench"))


def test_every_benchmark_has_its_place(commands):
    text = (DOCS / "benchmarks.md").read_text(encoding="utf-8")
    for name in reference.subcommands("bench"):
        assert f"`tissue_sim bench {name}" in text
    for section in text.split("\n## ")[1:]:
        assert re.search(r"`tissue_sim bench \w+", section), f"no command prints: {section.splitlines()[0]}"


def test_every_launch_argument_extra_and_target_is_named():
    named = "\n".join(snippet for page in PAGES for snippet in snippets(page))
    for argument in set().union(*launch_arguments().values()):
        assert re.search(rf"\b{argument}\b", "\n".join(snippets(DOCS / "installing.md"))), argument
    with mock.patch("setuptools.setup") as setup, mock.patch.object(sys, "argv", ["setup.py"]):
        runpy.run_path(str(ROOT / "setup.py"))
    (extras,) = (rows for head, *rows in tables(DOCS / "installing.md") if head[0] == "extra")
    assert {row[0].strip("`") for row in extras} == set(setup.call_args.kwargs["extras_require"])
    for target in make_targets():
        assert re.search(rf"\bmake {target}\b", named), target


def test_every_folder_of_the_package_is_described():
    (rows,) = (rows for head, *rows in tables(DOCS / "how_it_is_built.md") if head[0] == "folder")
    folders = {path.parent for path in (ROOT / "tissue_sim").glob("*/__init__.py")}
    assert {row[0].strip("`") for row in rows} == {path.relative_to(ROOT).as_posix() for path in folders}


# the first page


def test_readme_is_one_page():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 150


def test_every_result_in_the_readme_has_its_command():
    (rows,) = (rows for head, *rows in tables(ROOT / "README.md") if "command" in head[-1])
    for row in rows:
        assert re.fullmatch(r"`(tissue_sim|pytest) .+`", row[-1]), row


def test_every_page_is_in_the_contents():
    contents = re.findall(
        r"^```\{toctree\}\n(.*?)^```$", (DOCS / "index.md").read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )
    listed = set(re.findall(r"^(\w+)$", "\n".join(contents), re.MULTILINE))
    assert listed == {path.stem for path in DOCS.glob("*.md")} - {"index"}
