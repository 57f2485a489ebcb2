"""Publish recorded wrench commands to a node in lockstep, and collect the resulting motion over DDS."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped, TwistStamped, Vector3, WrenchStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger

from rb_dynamics.errors import RigidBodyError
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.vector import Vector
from rb_dynamics.ros.conversions import to_nanoseconds, to_stamp
from rb_dynamics.ros.other_nodes import unconnected

# How many commands a channel may be ahead of the motion received, and how many messages may be queued.
_LEAD = 20
_DEPTH = 5000
# s
_PATIENCE = 60.0

Poses = dict[int, tuple[Vector, Quaternion]]
Twists = dict[int, tuple[Vector, Vector]]


@contextlib.contextmanager
def wrench_player(topics: Sequence[str]) -> Iterator[WrenchPlayer]:
    """Yield a player in its own ROS context, which ends with it."""
    rclpy.init(args=[])
    try:
        yield WrenchPlayer(topics)
    finally:
        rclpy.try_shutdown()


class WrenchPlayer(Node):
    """Plays wrench commands in the order of their stamps, never far ahead of the node."""

    def __init__(self, topics: Sequence[str]) -> None:
        """Prepare to publish `topics` and to read `pose` and `twist` of the node."""
        super().__init__("wrench_player")
        self.poses: Poses = {}
        self.twists: Twists = {}
        self._newest_pose = self._newest_twist = -1
        self._wrenches = {
            topic: self.create_publisher(WrenchStamped, topic, QoSProfile(depth=_DEPTH)) for topic in topics
        }
        self._readers = [
            self.create_subscription(PoseStamped, "pose", self._on_pose, QoSProfile(depth=_DEPTH)),
            self.create_subscription(TwistStamped, "twist", self._on_twist, QoSProfile(depth=_DEPTH)),
        ]
        self._step = self.create_client(Trigger, "rigid_body/step")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)

    def play(
        self,
        commands: Sequence[tuple[str, Wrench]],
        end_ns: int,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        """Publish `commands`, then step the node to `end_ns`; return when the motion up to then has arrived.

        Raises:
            RigidBodyError: the node did not answer for a minute.
        """
        self._wait(self._connected, "the node was not found")
        # A node sends its newest state to a new reader: from here on nothing is missed.
        self._wait_for_motion(0)
        stamps = sorted({wrench.stamp_ns for _, wrench in commands})
        position = {stamp: i for i, stamp in enumerate(stamps)}
        for topic, wrench in commands:
            behind = position[wrench.stamp_ns] - _LEAD
            if behind >= 0:
                self._wait_for_motion(stamps[behind])
            self._publish(topic, wrench)
            if progress is not None:
                progress(wrench.stamp_ns / end_ns)
        if stamps:
            self._wait_for_motion(stamps[-1])
        while self._newest_pose < end_ns:
            before = self._newest_pose
            self._executor.spin_until_future_complete(self._step.call_async(Trigger.Request()), _PATIENCE)
            self._wait_for_motion(before + 1)

    def _connected(self) -> bool:
        found = self._wrenches.values()
        ready = self._step.service_is_ready() and all(each.get_subscription_count() for each in found)
        return ready and not unconnected(self, found)

    def _wait_for_motion(self, time_ns: int) -> None:
        self._wait(lambda: self._newest_pose >= time_ns and self._newest_twist >= time_ns, f"no motion at {time_ns} ns")

    def _wait(self, condition: Callable[[], bool], problem: str) -> None:
        give_up = time.monotonic() + _PATIENCE
        while not condition():
            if time.monotonic() > give_up:
                raise RigidBodyError(
                    f"{problem} within {_PATIENCE:g} s, expected the node to answer; check that it runs in lockstep "
                    "and in the same ROS domain"
                )
            self._executor.spin_once(timeout_sec=0.05)

    def _publish(self, topic: str, wrench: Wrench) -> None:
        message: Any = WrenchStamped()
        message.header.stamp = to_stamp(wrench.stamp_ns)
        message.header.frame_id = wrench.frame_id
        message.wrench.force = Vector3(x=wrench.force[0], y=wrench.force[1], z=wrench.force[2])
        message.wrench.torque = Vector3(x=wrench.torque[0], y=wrench.torque[1], z=wrench.torque[2])
        self._wrenches[topic].publish(message)

    def _on_pose(self, message: PoseStamped) -> None:
        p, o = message.pose.position, message.pose.orientation
        time_ns = to_nanoseconds(message.header.stamp)
        self.poses[time_ns] = (p.x, p.y, p.z), (o.x, o.y, o.z, o.w)
        self._newest_pose = max(self._newest_pose, time_ns)

    def _on_twist(self, message: TwistStamped) -> None:
        v, w = message.twist.linear, message.twist.angular
        time_ns = to_nanoseconds(message.header.stamp)
        self.twists[time_ns] = (v.x, v.y, v.z), (w.x, w.y, w.z)
        self._newest_twist = max(self._newest_twist, time_ns)
