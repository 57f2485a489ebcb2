"""Run a scene as a ROS 2 node: wrench commands in, pose, twist, momenta and energy out.

Everything behind --ros-args goes to ROS: parameters (-p lockstep:=true), remappings (-r wrench:=/cmd), namespaces
(-r __ns:=/robot_1). Scalar values of the scene can be overridden as parameters (-p body.mass:=17.0). The node runs to
the end of the scene's duration, or until it is stopped; SIGINT and SIGTERM close the logs and exit with code 0.
"""

from __future__ import annotations

import argparse

HELP = "run a scene as a ROS 2 node"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `node`."""
    parser.add_argument("scene", metavar="SCENE", help="scene file (YAML)")
    parser.epilog = "ROS arguments: --ros-args -p NAME:=VALUE ... -r FROM:=TO ..."


def run(args: argparse.Namespace) -> int:
    """Spin the node; exit code 0 after a clean stop."""
    try:
        import rclpy  # noqa: F401 - only to say what is missing
    except ImportError as error:
        from rb_dynamics.errors import MissingExtraError

        raise MissingExtraError("rclpy", "ros", "the node") from error
    from rb_dynamics.ros.arguments import parameter
    from rb_dynamics.ros.node import spin

    return spin(["--ros-args", "-p", parameter("scene", args.scene), "--", *args.ros_args])
