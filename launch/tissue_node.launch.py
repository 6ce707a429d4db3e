"""Starts the node: `ros2 launch tissue_sim tissue_node.launch.py params_file:=my.yaml`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """The node with a parameter file; the launch ends when the node ends."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution([FindPackageShare("tissue_sim"), "config", "tissue_node.yaml"]),
                description="YAML file with the node's parameters: organ, rates, tools, contact.",
            ),
            DeclareLaunchArgument(
                "namespace",
                default_value="",
                description="Namespace of the node and of its tools' topics, for more than one organ on a network.",
            ),
            DeclareLaunchArgument(
                "log_level",
                default_value="info",
                choices=["debug", "info", "warn", "error", "fatal"],
                description="Least severity that the node logs.",
            ),
            Node(
                package="tissue_sim",
                executable="tissue_node",
                name="tissue_sim",
                namespace=LaunchConfiguration("namespace"),
                parameters=[LaunchConfiguration("params_file")],
                ros_arguments=["--log-level", LaunchConfiguration("log_level")],
                output="screen",
                emulate_tty=True,
                on_exit=Shutdown(reason="the node ended"),
            ),
        ]
    )
