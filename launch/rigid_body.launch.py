"""Launches the rigid body node, and RViz if requested. Has no defaults other than those of the node."""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from rb_dynamics.ros.start_arguments import value_of, values_of

# Name, default, type, description. An empty text leaves the parameter out, so that the node's default or that of
# params_file holds.
PARAMETERS = (
    ("scene", None, str, "scene file (YAML)"),
    ("mcap", "", str, "MCAP log to write; empty: none"),
    ("bag", "", str, "rosbag2 folder to write instead; empty: none"),
    ("rerun", "", str, "Rerun recording to write; empty: none"),
    ("output_rate", "", float, "Hz of published and logged states; empty: the scene's"),
    ("real_time_factor", "", float, "simulated seconds per second (1.0); 0: as fast as possible"),
    ("lockstep", "", bool, "let time stand still until the commands or ~/step move it"),
    ("start_paused", "", bool, "begin paused"),
    ("apply_at", "", str, "when a command takes effect: arrival (default) or stamp"),
    ("stamps", "", str, "time of header.stamp: auto (default), ros or simulation"),
    ("use_sim_time", "", bool, "follow /clock"),
    ("publish_clock", "", bool, "be the publisher of /clock"),
    ("publish_tf", "", bool, "publish /tf and /tf_static"),
)
OTHERS = (
    ("namespace", "", "namespace of the node and its topics"),
    ("name", "rigid_body", "name of the node"),
    ("params_file", "", "parameter file (YAML) of this node or of a whole bringup; the other arguments go before it"),
    ("respawn", "false", "start the node again, one second after it has ended"),
    ("log_level", "info", "level of the node's own log: debug, info, warn or error"),
    ("overrides", "{}", "values of the scene and further parameters, as in '{body.mass: 17.0, solver.step: 0.01}'"),
    ("rviz", "false", "open RViz on the topics of the node"),
)
# Topics used by the layout for RViz.
DRAWN = ("pose", "odom", "twist", "wrench")


def start(context: LaunchContext) -> list[Node]:
    """Return the nodes selected by the arguments."""
    given = {name: LaunchConfiguration(name).perform(context) for name, *_ in (*PARAMETERS, *OTHERS)}
    parameters = {name: value_of(name, given[name], kind) for name, _, kind, _ in PARAMETERS if given[name]}
    namespace = given["namespace"].strip("/")
    logger = ".".join([*filter(None, namespace.split("/")), given["name"]])
    body = Node(
        package="rb_dynamics",
        executable="rigid_body",
        name=given["name"],
        namespace=namespace,
        parameters=[*filter(None, [given["params_file"]]), parameters | values_of("overrides", given["overrides"])],
        ros_arguments=["--log-level", f"{logger}:={given['log_level']}"],
        respawn=value_of("respawn", given["respawn"], bool),
        respawn_delay=1.0,
        output="screen",
    )
    if not value_of("rviz", given["rviz"], bool):
        return [body]
    layout = PathJoinSubstitution([FindPackageShare("rb_dynamics"), "config", "rigid_body.rviz"])
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        namespace=namespace,
        arguments=["-d", layout],
        remappings=[(f"/{topic}", topic) for topic in DRAWN],
    )
    # Started first: if RViz is not installed, launch would leave the body running.
    return [rviz, body]


def generate_launch_description() -> LaunchDescription:
    """Return the description `ros2 launch rb_dynamics rigid_body.launch.py scene:=FILE` runs."""
    arguments = [
        *((name, default, meaning) for name, default, _, meaning in PARAMETERS),
        *OTHERS,
    ]
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=text)
                for name, default, text in arguments
            ),
            OpaqueFunction(function=start),
        ]
    )
