"""The minimum permissions of the node in a secured graph: an SROS2 policy file made from its own interface.

Starts the node with the given arguments, queries the graph for its publishers, subscriptions and services, and stops it
before the body moves. Keys and signatures are left to `ros2 security create_permission`.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterable, Sequence
from xml.etree import ElementTree

from rclpy.node import NodeNameNonExistentError
from rclpy.parameter import Parameter

from rb_dynamics.errors import RigidBodyError
from rb_dynamics.ros.node import RigidBodyNode, spin
from rb_dynamics.ros.start_arguments import LOGS, parameter

# The topics and services of an action are below this name.
_ACTION = "/_action/"
# s until the graph knows all of a node.
_PATIENCE = 10.0


def policy(node: RigidBodyNode, enclave: str) -> str:
    """Return the SROS2 policy (version 0.2.0) that allows `node`, in `enclave`, exactly what it does.

    Raises:
        RigidBodyError: the graph does not know all that it does.
    """
    name, namespace = node.get_name(), node.get_namespace()
    published, read, answered = _interface(node)
    root = ElementTree.Element("policy", version="0.2.0")
    profiles = ElementTree.SubElement(
        ElementTree.SubElement(ElementTree.SubElement(root, "enclaves"), "enclave", path=enclave), "profiles"
    )
    profile = ElementTree.SubElement(profiles, "profile", ns=namespace, node=name)
    actions = {service.partition(_ACTION)[0] for service in answered if _ACTION in service}
    for tag, right, names in (
        ("action", "execute", actions),
        ("service", "reply", _plain(answered)),
        ("topic", "subscribe", _plain(read)),
        ("topic", "publish", _plain(published)),
    ):
        if names:
            group = ElementTree.SubElement(profile, f"{tag}s", {right: "ALLOW"})
            for each in sorted(names):
                ElementTree.SubElement(group, tag).text = each
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _interface(node: RigidBodyNode) -> list[set[str]]:
    """Return the topics that the node publishes and reads and the services that it answers, those of rcl included.

    The graph learns of them one by one, after they were made.
    """
    made = [
        {each.topic_name for each in node.publishers},
        {each.topic_name for each in node.subscriptions},
        {each.service_name for each in node.services},
    ]
    looks = (
        node.get_publisher_names_and_types_by_node,
        node.get_subscriber_names_and_types_by_node,
        node.get_service_names_and_types_by_node,
    )
    give_up = time.monotonic() + _PATIENCE
    while True:
        try:
            known = [{name for name, _ in look(node.get_name(), node.get_namespace())} for look in looks]
        except NodeNameNonExistentError:
            known = [set(), set(), set()]
        if all(own <= found for own, found in zip(made, known, strict=True)):
            return known
        if time.monotonic() > give_up:
            raise RigidBodyError(f"the ROS graph does not know all of the node after {_PATIENCE:g} s; try it again")
        time.sleep(0.01)


def _plain(names: Iterable[str]) -> set[str]:
    return {name for name in names if _ACTION not in name}


def main(args: Sequence[str] | None = None) -> int:
    """Print the policy for a scene; exit code 0, or 2 if the node cannot start."""
    parser = argparse.ArgumentParser(prog="python -m rb_dynamics.ros.permissions", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("scene", metavar="SCENE", help="scene file (YAML)")
    parser.add_argument("--enclave", default="/rigid_body", help="path of the enclave (default: /rigid_body)")
    known, ros = parser.parse_known_args(args)
    ros = [argument for argument in ros if argument != "--ros-args"]
    try:
        return spin(["--ros-args", "-p", parameter("scene", known.scene), *ros], lambda: _print_policy(known.enclave))
    except RigidBodyError as error:
        sys.stderr.write(f"permissions: {error}\n")
        return 2


def _print_policy(enclave: str) -> list[RigidBodyNode]:
    """Print the policy of a node that keeps no log, and return no node to run."""
    node = RigidBodyNode(parameter_overrides=[Parameter(log, value="") for log in LOGS])
    try:
        sys.stdout.write(policy(node, enclave))
    finally:
        node.finish()
        node.destroy_node()
    return []


if __name__ == "__main__":
    sys.exit(main())
