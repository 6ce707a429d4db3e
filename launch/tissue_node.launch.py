"""Launch file of the node: `ros2 launch tissue_sim tissue_node.launch.py organ_file:=liver.npz profile:=dvrk`."""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def _start_node(context: LaunchContext) -> list[Node]:
    """Return the node with its parameters, the later over the earlier: params_file, profile, single ones."""

    def given(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    parameters: list[object] = [given("params_file")]
    if profile := given("profile"):
        folder = Path(FindPackageShare("tissue_sim").perform(context)) / "config" / "bridges"
        known = sorted(path.stem for path in folder.glob("*.yaml"))
        if profile not in known:
            raise RuntimeError(f"profile '{profile}' is unknown; choose one of {', '.join(known)}")
        parameters.append(str(folder / f"{profile}.yaml"))
    for file in ("organ_file", "scene_file"):
        if path := given(file):
            parameters.append({file: str(Path(path).absolute())})
    parameters.append({"use_sim_time": given("use_sim_time").lower() == "true"})
    node = Node(
        package="tissue_sim",
        executable="tissue_node",
        name="tissue_sim",
        namespace=given("namespace"),
        parameters=parameters,
        ros_arguments=["--log-level", given("log_level")],
        output="screen",
        emulate_tty=True,
        on_exit=Shutdown(reason="the node ended"),
    )
    return [node]


def generate_launch_description() -> LaunchDescription:
    """Return the node; the launch ends when it ends."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution([FindPackageShare("tissue_sim"), "config", "tissue_node.yaml"]),
                description="YAML file with the node's parameters: organ, rates, tools, contact.",
            ),
            DeclareLaunchArgument(
                "profile",
                default_value="",
                description="Haptic bridge whose topics and types the tools use: a file in config/bridges, without"
                " .yaml; empty for those of params_file.",
            ),
            DeclareLaunchArgument(
                "organ_file",
                default_value="",
                description="Organ made by `tissue_sim build`; empty for that of params_file or the default one.",
            ),
            DeclareLaunchArgument(
                "scene_file",
                default_value="",
                description="Scene of several organs, instead of organ_file; empty for that of params_file or none.",
            ),
            DeclareLaunchArgument(
                "namespace",
                default_value="",
                description="Namespace of the node and of its tools' topics, for more than one organ on a network.",
            ),
            DeclareLaunchArgument(
                "use_sim_time",
                default_value="false",
                choices=["true", "false", "True", "False"],
                description="Whether ticks follow /clock instead of wall time.",
            ),
            DeclareLaunchArgument(
                "log_level",
                default_value="info",
                choices=["debug", "info", "warn", "error", "fatal"],
                description="Least severity that the node logs.",
            ),
            OpaqueFunction(function=_start_node),
        ]
    )
