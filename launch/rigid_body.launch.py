"""Launches the rigid body node. Holds no defaults of its own but those of the node; decides nothing."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

# Name, default, type, meaning.
PARAMETERS = (
    ("scene", None, str, "scene file (YAML)"),
    ("mcap", "", str, "MCAP log to write; empty: none"),
    ("rerun", "", str, "Rerun recording to write; empty: none"),
    ("real_time_factor", "1.0", float, "simulated seconds per second; 0: as fast as possible"),
    ("lockstep", "false", bool, "let time stand still until the commands or ~/step move it"),
    ("use_sim_time", "false", bool, "take time from /clock"),
)


def generate_launch_description() -> LaunchDescription:
    """Return the description `ros2 launch rb_dynamics rigid_body.launch.py scene:=FILE` runs."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=meaning)
        for name, default, _, meaning in PARAMETERS
    ]
    namespace = DeclareLaunchArgument("namespace", default_value="", description="namespace of the node and its topics")
    node = Node(
        package="rb_dynamics",
        executable="rigid_body",
        namespace=LaunchConfiguration("namespace"),
        parameters=[
            {name: ParameterValue(LaunchConfiguration(name), value_type=kind) for name, _, kind, _ in PARAMETERS}
        ],
        output="screen",
    )
    return LaunchDescription([*arguments, namespace, node])
