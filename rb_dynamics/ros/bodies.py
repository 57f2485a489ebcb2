"""Several bodies of one scene in one process, each a node in its own namespace; the bodies do not interact.

`launch/bodies.launch.py` does the same with one process per body; docs/ros.md compares the cost. One thread advances
all bodies, so use the launch file if one core is not enough.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Sequence

from rclpy.node import Node
from rclpy.parameter import Parameter

from rb_dynamics.errors import RigidBodyError
from rb_dynamics.numerics.option_types import real, whole
from rb_dynamics.ros.node import RigidBodyNode, spin
from rb_dynamics.ros.start_arguments import LOGS, apart, parameter


def bodies(count: int, prefix: str, spacing: float) -> list[RigidBodyNode]:
    """Return `count` nodes with numbered namespaces, frames and logs, placed side by side along y of the world (m).

    Raises:
        RigidBodyError: a parameter, the scene or a log file is not valid; logs already opened are closed.
    """
    logs, names = _logs(), [f"{prefix}{index + 1}" for index in range(count)]
    with contextlib.ExitStack() as undo:
        nodes = []
        for index in range(count):
            name = names[index]
            node = _body(name, spacing * index, logs, [other for other in names if other != name])
            for last_first in (node.destroy_node, node.finish):
                undo.callback(last_first)
            if node.get_fully_qualified_name() != f"/{name}/rigid_body":
                raise RigidBodyError(
                    f"--ros-args: found the name {node.get_fully_qualified_name()} for every body, expected one for "
                    "each; leave out -r __ns and __node, and give --prefix, or take bodies.launch.py with namespace"
                )
            nodes.append(node)
        undo.pop_all()
    return nodes


def _body(name: str, y: float, logs: dict[str, object], others: Sequence[str]) -> RigidBodyNode:
    own: dict[str, object] = {"body.frame": name, "initial.position_world": [0.0, y, 0.0]}
    own |= {log: apart(target, name) for log, target in logs.items()}
    return RigidBodyNode(
        others, namespace=name, parameter_overrides=[Parameter(key, value=value) for key, value in own.items()]
    )


def _logs() -> dict[str, object]:
    """Return the logs in the arguments; each body has its own."""
    asking = Node("rigid_body", allow_undeclared_parameters=True, automatically_declare_parameters_from_overrides=True)
    try:
        found = {log: asking.get_parameter_or(log, Parameter(log, value="")).value for log in LOGS}
        return {log: target for log, target in found.items() if target}
    finally:
        asking.destroy_node()


def main(args: Sequence[str] | None = None) -> int:
    """Run the bodies; exit code 0 after a clean stop, 2 if one could not start."""
    parser = argparse.ArgumentParser(prog="python -m rb_dynamics.ros.bodies", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("scene", metavar="SCENE", help="scene file (YAML)")
    parser.add_argument(
        "--count",
        type=whole("a number of bodies, 1 or more", lambda v: v >= 1),
        default=2,
        help="how many bodies (default: 2)",
    )
    parser.add_argument("--prefix", default="body_", help="the namespaces are prefix1, prefix2, ... (default: body_)")
    parser.add_argument(
        "--spacing", type=real("a finite number of metres"), default=1.0, help="m between the bodies (default: 1)"
    )
    known, ros = parser.parse_known_args(args)
    ros = [argument for argument in ros if argument != "--ros-args"]
    try:
        return spin(
            ["--ros-args", "-p", parameter("scene", known.scene), *ros],
            lambda: bodies(known.count, known.prefix, known.spacing),
        )
    except RigidBodyError as error:
        sys.stderr.write(f"bodies: {error}\n")
        return 2


if __name__ == "__main__":
    sys.exit(main())
