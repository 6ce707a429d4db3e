"""Launch file of the node, the scripted haptic bridge and the viewer: `ros2 launch tissue_sim demo.launch.py`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackagePrefix, FindPackageShare

PASSED_ON = ("params_file", "profile", "organ_file", "scene_file", "namespace", "use_sim_time")


def generate_launch_description() -> LaunchDescription:
    """Return the node of tissue_node.launch.py with a bridge that pokes the organ and a viewer in the browser."""
    share = FindPackageShare("tissue_sim")
    # Not Node actions: those append --ros-args, which the sub-commands do not take.
    command = PathJoinSubstitution([FindPackagePrefix("tissue_sim"), "lib", "tissue_sim", "tissue_sim"])
    node = [LaunchConfiguration("namespace"), "/tissue_sim"]
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution([share, "config", "tissue_node.yaml"]),
                description="YAML file with the node's parameters: organ, rates, tools, contact.",
            ),
            DeclareLaunchArgument(
                "profile",
                default_value="",
                description="Haptic bridge whose topics and types the tools use, as in tissue_node.launch.py; the"
                " scripted bridge uses the same.",
            ),
            DeclareLaunchArgument(
                "organ_file",
                default_value="",
                description="Organ made by `tissue_sim build`; empty for that of params_file or the default one.",
            ),
            DeclareLaunchArgument(
                "scene_file",
                default_value="",
                description="Scene of several organs, instead of organ_file; the scripted bridge uses the first one.",
            ),
            DeclareLaunchArgument(
                "namespace",
                default_value="",
                description="Namespace of node, bridge and viewer.",
            ),
            DeclareLaunchArgument(
                "use_sim_time",
                default_value="false",
                choices=["true", "false", "True", "False"],
                description="Whether ticks follow /clock instead of wall time; needs bridge:=false.",
            ),
            DeclareLaunchArgument(
                "bridge",
                default_value="true",
                choices=["true", "false"],
                description="Whether the scripted haptic bridge moves the tools; false leaves them to a real one.",
            ),
            DeclareLaunchArgument(
                "viewer",
                default_value="true",
                choices=["true", "false"],
                description="Whether to show the organ at http://127.0.0.1:8080 (needs `pip install viser`).",
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(PathJoinSubstitution([share, "launch", "tissue_node.launch.py"])),
                launch_arguments={name: LaunchConfiguration(name) for name in PASSED_ON}.items(),
            ),
            ExecuteProcess(
                cmd=[command, "bridge", "--node", node],
                name="bridge",
                output="screen",
                condition=IfCondition(LaunchConfiguration("bridge")),
            ),
            ExecuteProcess(
                cmd=[command, "view", "--node", node],
                name="viewer",
                output="screen",
                condition=IfCondition(LaunchConfiguration("viewer")),
            ),
        ]
    )
