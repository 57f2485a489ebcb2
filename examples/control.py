"""Pause, step or reset the node from Python, where there is no `ros2` command.

In the same environment as the node, of which --ros-args tells the namespace where it has one:

    .venv/bin/python examples/control.py {pause,go,step,reset} [--ros-args -r __ns:=/robot_1]
"""

from __future__ import annotations

import argparse
import sys

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args
from std_srvs.srv import SetBool, Trigger

# Service, its type and the request, by command.
WORDS = {
    "pause": ("pause", SetBool, SetBool.Request(data=True)),
    "go": ("pause", SetBool, SetBool.Request(data=False)),
    "step": ("step", Trigger, Trigger.Request()),
    "reset": ("reset", Trigger, Trigger.Request()),
}
PATIENCE = 10.0  # s


def main() -> str | None:
    """Send one of the commands to the node; return the error."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("word", choices=WORDS)
    word = parser.parse_args(remove_ros_args(sys.argv)[1:]).word
    # rclpy's own handlers would end the context on a signal while something waits for it.
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    try:
        return ask(rclpy.create_node("control"), *WORDS[word])
    finally:
        rclpy.try_shutdown()


def ask(node: Node, name: str, kind: type, request: object) -> str | None:
    """Call a service of the node and print its answer; return the error."""
    client = node.create_client(kind, f"rigid_body/{name}")
    if not client.wait_for_service(PATIENCE):
        return f"no service {client.srv_name} yet; start: rb-dynamics node config/free_flyer.yaml"
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=PATIENCE)
    if not future.done():
        return f"no answer of {client.srv_name} within {PATIENCE:g} s"
    answer = future.result()
    if not answer.success:
        return answer.message
    print(answer.message)
    return None


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
