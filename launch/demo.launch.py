"""Starts the node, the scripted haptic bridge and the viewer: `ros2 launch tissue_sim demo.launch.py`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackagePrefix, FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """The node of tissue_node.launch.py with a bridge that pokes the organ and a viewer in the browser."""
    share = FindPackageShare("tissue_sim")
    # Not Node actions: those append --ros-args, which the sub-commands do not take.
    command = PathJoinSubstitution([FindPackagePrefix("tissue_sim"), "lib", "tissue_sim", "tissue_sim"])
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution([share, "config", "tissue_node.yaml"]),
                description="YAML file with the node's parameters: organ, rates, tools, contact.",
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
                launch_arguments={"params_file": LaunchConfiguration("params_file")}.items(),
            ),
            ExecuteProcess(
                cmd=[command, "bridge"],
                name="bridge",
                output="screen",
                condition=IfCondition(LaunchConfiguration("bridge")),
            ),
            ExecuteProcess(
                cmd=[command, "view"],
                name="viewer",
                output="screen",
                condition=IfCondition(LaunchConfiguration("viewer")),
            ),
        ]
    )
