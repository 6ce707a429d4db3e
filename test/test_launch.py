"""What the launch files start. Over the wheels there is no `launch`, so simple classes stand for its own there."""

import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

ROOT = Path(__file__).resolve().parents[1]
MODULES = {
    "launch": ("LaunchContext", "LaunchDescription"),
    "launch.actions": (
        "DeclareLaunchArgument",
        "ExecuteProcess",
        "IncludeLaunchDescription",
        "OpaqueFunction",
        "Shutdown",
    ),
    "launch.conditions": ("IfCondition",),
    "launch.launch_description_sources": ("PythonLaunchDescriptionSource",),
    "launch.substitutions": ("LaunchConfiguration", "PathJoinSubstitution"),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
    "launch_ros.substitutions": ("FindPackagePrefix", "FindPackageShare"),
}


class StandIn:
    """Keeps what it was made with; a substitution of a name is what the context has for it."""

    def __init__(self, *words, **named):
        self.words, self.named = words, named

    def perform(self, context):
        return context[self.words[0]]


@pytest.fixture
def launch(monkeypatch):
    """Loads a launch file: its arguments by name, its functions."""
    for module, names in MODULES.items():
        stand_in = ModuleType(module)
        for name in names:
            setattr(stand_in, name, type(name, (StandIn,), {}))
        monkeypatch.setitem(sys.modules, module, stand_in)

    def load(name):
        module = runpy.run_path(str(ROOT / "launch" / name))
        (actions,) = module["generate_launch_description"]().words
        declared = [action for action in actions if type(action).__name__ == "DeclareLaunchArgument"]
        return SimpleNamespace(
            arguments={argument.words[0]: argument.named for argument in declared}, actions=actions, module=module
        )

    return load


@pytest.fixture
def fraction(tmp_path):
    """The package's share folder, with two profiles."""
    folder = tmp_path / "config" / "bridges"
    folder.mkdir(parents=True)
    for name in ("touch", "dvrk"):
        (folder / f"{name}.yaml").touch()
    return tmp_path


def start(launch, fraction, **given):
    """The node that the launch file starts with these arguments."""
    file = launch("tissue_node.launch.py")
    defaults = {name: named["default_value"] for name, named in file.arguments.items()}
    context = defaults | {"params_file": "params.yaml", "tissue_sim": str(fraction)} | given
    (node,) = file.module["_start_node"](context)
    return node.named


def test_node_takes_what_is_given_over_its_file(launch, fraction):
    plain = start(launch, fraction)
    assert plain["parameters"] == ["params.yaml", {"use_sim_time": False}]
    assert plain["namespace"] == ""
    assert plain["executable"] == "tissue_node"
    full = start(launch, fraction, profile="dvrk", organ_file="liver.npz", use_sim_time="True", namespace="ward")
    assert full["parameters"] == [
        "params.yaml",
        str(fraction / "config" / "bridges" / "dvrk.yaml"),
        {"organ_file": str(Path.cwd() / "liver.npz")},
        {"use_sim_time": True},
    ]
    assert full["namespace"] == "ward"


def test_unknown_profile_is_named_with_those_that_there_are(launch, fraction):
    with pytest.raises(RuntimeError, match="'phantom' is unknown; choose one of dvrk, touch"):
        start(launch, fraction, profile="phantom")


@pytest.mark.parametrize("name", ["tissue_node.launch.py", "demo.launch.py"])
def test_arguments_are_described(launch, name):
    arguments = launch(name).arguments
    assert {"params_file", "profile", "organ_file", "namespace", "use_sim_time"} <= set(arguments)
    assert all(named["description"].endswith(".") for named in arguments.values())


def test_demo_passes_on_what_the_node_takes(launch):
    demo, node = launch("demo.launch.py"), launch("tissue_node.launch.py")
    (include,) = (action for action in demo.actions if type(action).__name__ == "IncludeLaunchDescription")
    passed = {name for name, _ in include.named["launch_arguments"]}
    assert passed <= set(demo.arguments) & set(node.arguments)
    assert set(node.arguments) - passed == {"log_level"}
