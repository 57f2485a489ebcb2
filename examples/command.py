"""Command the node from rclpy: a torque about the body's z axis for one second, and watch the rate grow.

Start the node first, in the same environment:

    rb-dynamics node config/free_flyer.yaml
"""

import argparse
import contextlib
import time

import rclpy
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.parse_args(remove_ros_args()[1:])
    # rclpy's own handlers would end the context on a signal, and the next spin_once would fail.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("commander")
    commands = node.create_publisher(WrenchStamped, "wrench", 10)
    newest: list[Odometry] = []
    node.create_subscription(Odometry, "odom", lambda odom: newest.__setitem__(slice(None), [odom]), 10)
    # A command published before the node has been discovered is lost.
    patience = time.monotonic() + 3.0
    while not (commands.get_subscription_count() and newest):
        rclpy.spin_once(node, timeout_sec=0.1)
        if time.monotonic() > patience:
            print(f"no node on {commands.topic_name} yet; start: rb-dynamics node config/free_flyer.yaml", flush=True)
            patience = float("inf")

    command = WrenchStamped()
    command.header.frame_id = "body"  # the axes follow from the header, not from the name of the topic
    command.wrench.torque.z = 0.01
    commands.publish(command)  # held until the next command
    begun = newest[0].header.stamp.sec + newest[0].header.stamp.nanosec * 1e-9
    while (now := newest[0].header.stamp.sec + newest[0].header.stamp.nanosec * 1e-9) < begun + 1.0:
        rclpy.spin_once(node, timeout_sec=0.1)
    commands.publish(WrenchStamped())
    rate = newest[0].twist.twist.angular.z
    print(f"after {now - begun:.2f} s the body turns at {rate:.4f} rad/s")
    rclpy.try_shutdown()


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main()
