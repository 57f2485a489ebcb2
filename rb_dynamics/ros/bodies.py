"""Several bodies in one process, each a node in its own namespace; the bodies do not interact.

They are copies of one scene side by side, or those of a file: {bodies: {tug: {scene: a.yaml, body.mass: 17.0}, ...}},
where any parameter of the node may be given. With publish_clock the first publishes /clock; each keeps its own pace, so
its stamps leave that clock after a pause, a reset or a lag of one of them.

`launch/bodies.launch.py` does the same with one process per body; docs/ros.md compares the cost. One thread advances
all bodies, so use the launch file if one core is not enough.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Mapping, Sequence

from rclpy.node import Node
from rclpy.parameter import Parameter

from rb_dynamics.errors import RigidBodyError, SceneError
from rb_dynamics.numerics.command_line_numbers import whole
from rb_dynamics.ros.node import RigidBodyNode, spin
from rb_dynamics.ros.start_arguments import LOGS, apart, bodies_in, is_bodies, parameter, side_by_side, spacing_of


def bodies(parameters: Mapping[str, Mapping[str, object]]) -> list[RigidBodyNode]:
    """Return a node for each body in `parameters`, by name, which is that of its namespace, its frame and its logs.

    Raises:
        RigidBodyError: a parameter, the scene or a log file is not valid; logs already opened are closed.
    """
    asked, names = _asked(), list(parameters)
    with contextlib.ExitStack() as undo:
        nodes: list[RigidBodyNode] = []
        for name in names:
            own = {"body.frame": name} | {log: apart(asked[log], name) for log in LOGS if asked.get(log)}
            if asked.get("publish_clock") and nodes:
                own |= {"publish_clock": False, "stamps": "simulation"}
            node = _body(name, own | dict(parameters[name]), [other for other in names if other != name])
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


def _body(name: str, own: Mapping[str, object], others: Sequence[str]) -> RigidBodyNode:
    return RigidBodyNode(
        others, namespace=name, parameter_overrides=[Parameter(key, value=value) for key, value in own.items()]
    )


def _asked() -> dict[str, object]:
    """Return the parameters that the arguments give to all bodies."""
    asking = Node("rigid_body", allow_undeclared_parameters=True, automatically_declare_parameters_from_overrides=True)
    try:
        return {name: each.value for name, each in asking.get_parameters_by_prefix("").items()}
    finally:
        asking.destroy_node()


def main(args: Sequence[str] | None = None) -> int:
    """Run the bodies; exit code 0 after a clean stop, 2 if one could not start."""
    parser = argparse.ArgumentParser(prog="python -m rb_dynamics.ros.bodies", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("scene", metavar="SCENE", help="scene file, or file of bodies (YAML)")
    parser.add_argument(
        "--count", type=whole("a number of bodies, 1 or more", lambda v: v >= 1), help="how many bodies (default: 2)"
    )
    parser.add_argument("--prefix", help="the namespaces are prefix1, prefix2, ... (default: body_)")
    parser.add_argument("--spacing", help="m from one body to the next, along y or as in [1.0, 0.0, 0.5] (default: 1)")
    known, ros = parser.parse_known_args(args)
    ros = [argument for argument in ros if argument != "--ros-args"]
    try:
        spacing = spacing_of("1" if known.spacing is None else known.spacing)
        scene = [] if is_bodies(known.scene) else ["-p", parameter("scene", known.scene)]
        return spin(["--ros-args", *scene, *ros], lambda: bodies(_parameters(known, spacing)))
    except (RigidBodyError, ValueError) as error:
        sys.stderr.write(f"bodies: {error}\n")
        return 2


def _parameters(known: argparse.Namespace, spacing: Sequence[float]) -> dict[str, dict[str, object]]:
    if not is_bodies(known.scene):
        prefix = "body_" if known.prefix is None else known.prefix
        return side_by_side(known.scene, _asked(), known.count or 2, prefix, spacing)
    given = [f"--{name}" for name in ("count", "prefix", "spacing") if getattr(known, name) is not None]
    if given:
        raise SceneError(f"{given[0]}: found it together with a file of bodies, which says that itself; leave it out")
    return bodies_in(known.scene)


if __name__ == "__main__":
    sys.exit(main())
