"""Run a scene as a ROS 2 node: wrench commands in, pose, twist, momenta and energy out.

Arguments after --ros-args go to ROS: parameters (-p lockstep:=true), remappings (-r wrench:=/cmd), namespaces (-r
__ns:=/robot_1). Scalar values of the scene can be overridden as parameters (-p body.mass:=17.0). The node runs to the
end of the scene's duration, or until it is stopped; SIGINT, SIGTERM and SIGHUP close the logs and exit with code 0.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from rb_dynamics.cli.parser import require_ros

HELP = "run a scene as a ROS 2 node"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `node`."""
    parser.add_argument("scene", metavar="SCENE", help="scene file (YAML)")
    parser.epilog = "ROS arguments: --ros-args -p NAME:=VALUE ... -r FROM:=TO ..."
    parser.set_defaults(advice=_as_parameters)


def run(args: argparse.Namespace) -> int:
    """Spin the node; exit code 0 after a clean stop."""
    require_ros("the node")
    from rb_dynamics.ros.node import spin
    from rb_dynamics.ros.start_arguments import parameter

    return spin(["--ros-args", "-p", parameter("scene", args.scene), "--", *args.ros_args])


def _as_parameters(words: Sequence[str]) -> str:
    """Return what to write for `words`, options of other commands or of ROS; "" if they are neither."""
    if words[0] in ("-p", "-r"):
        return f"; arguments of ROS come after --ros-args: --ros-args {' '.join(words)}"
    told = []
    for word, after in zip(words, [*words[1:], "--"], strict=True):
        option, equals, value = word.partition("=")
        if not option.startswith("--"):
            continue
        value = value if equals else "VALUE" if after.startswith("--") else after
        name = option.removeprefix("--").replace("-", "_")
        name = f"solver.{name}" if name in ("method", "step", "accuracy") else name
        told.append(f"-p {value.replace('=', ':=', 1) if name == 'set' else f'{name}:={value}'}")
    return f"; a node takes parameters instead: --ros-args {' '.join(told)}" if told else ""
