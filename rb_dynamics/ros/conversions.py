"""Conversions between ROS messages and tuples, for stamps, states, and messages that the encoder does not cover.

Axes and reference points: `pose` is the body origin in the world; `twist` is the velocity of the body origin and the
angular velocity, both in body axes, as in REP-103 and nav_msgs/Odometry.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time
from geometry_msgs.msg import (
    Pose,
    Vector3,
)
from geometry_msgs.msg import Quaternion as QuaternionMessage
from nav_msgs.msg import Odometry

from rb_dynamics.body.state import State
from rb_dynamics.errors import SceneError
from rb_dynamics.loads.wrench import WrenchFrames, frame_name
from rb_dynamics.numerics.argument_checks import shown
from rb_dynamics.numerics.nanoseconds import NANOSECONDS, split_stamp
from rb_dynamics.numerics.rotation import rotate, rotate_inverse, unit
from rb_dynamics.numerics.vector import Vector
from rb_dynamics.run.sample import Sample

if TYPE_CHECKING:
    from simulation_interfaces.msg import EntityState


def to_stamp(time_ns: int) -> Time:
    """Return integer nanoseconds as a stamp.

    Raises:
        LogError: the time is beyond 2^31 s, the range of stamps.
    """
    seconds, nanoseconds = split_stamp(time_ns)
    return Time(sec=seconds, nanosec=nanoseconds)


def to_nanoseconds(stamp: Time) -> int:
    """Return a stamp as integer nanoseconds."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def to_state(message: Odometry, frames: WrenchFrames) -> State:
    """Return the state in the pose (world axes) and twist (body axes) of an odometry message.

    Raises:
        SceneError: a frame is unknown (empty frames are accepted), or the quaternion is zero.
    """
    for name, found, expected in (
        ("header.frame_id", message.header.frame_id, frames.world_frame),
        ("child_frame_id", message.child_frame_id, frames.body_frame),
    ):
        if frame_name(found) not in ("", expected):
            raise SceneError(f"{name} is {shown(found)}, expected {expected!r} or nothing; transform the state before")
    p, q = message.pose.pose.position, message.pose.pose.orientation
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    # The scene refuses an invalid quaternion.
    orientation = unit((q.x, q.y, q.z, q.w)) or (q.x, q.y, q.z, q.w)
    return State(
        0,
        (p.x, p.y, p.z),
        orientation,
        rotate(orientation, (linear.x, linear.y, linear.z)),
        (angular.x, angular.y, angular.z),
    )


def entity_state(
    sample: Sample, acceleration: tuple[Vector, Vector], stamp_ns: int, frames: WrenchFrames
) -> EntityState:
    """Return the state as simulation_interfaces defines it: everything in world axes, including angular velocity.

    Args:
        sample: the state.
        acceleration: of the body origin and angular, body axes.
        stamp_ns: stamp of the message.
        frames: names of the frames.
    """
    from simulation_interfaces.msg import EntityState

    message = EntityState()
    message.header.stamp, message.header.frame_id = to_stamp(stamp_ns), frames.world_frame
    _fill_pose(message.pose, sample)
    q = sample.orientation_xyzw
    message.twist.linear = _vector(sample.linear_velocity_world)
    message.twist.angular = _vector(rotate(q, sample.angular_velocity_body))
    message.acceleration.linear, message.acceleration.angular = (_vector(rotate(q, a)) for a in acceleration)
    return message


def with_entity_state(state: State, message: EntityState, pose: bool, twist: bool) -> State:
    """Return `state` with pose and twist, each if requested, from `message`, in world axes."""
    if pose:
        p, q = message.pose.position, message.pose.orientation
        # A new attitude must not change the twist in world axes.
        angular_world = rotate(state.orientation_xyzw, state.angular_velocity_body)
        # The scene refuses an invalid quaternion.
        orientation = unit((q.x, q.y, q.z, q.w)) or (q.x, q.y, q.z, q.w)
        state = replace(
            state,
            position_world=(p.x, p.y, p.z),
            orientation_xyzw=orientation,
            angular_velocity_body=rotate_inverse(orientation, angular_world),
        )
    if twist:
        v, w = message.twist.linear, message.twist.angular
        angular = rotate_inverse(state.orientation_xyzw, (w.x, w.y, w.z))
        state = replace(state, linear_velocity_world=(v.x, v.y, v.z), angular_velocity_body=angular)
    return state


def _vector(value: Vector) -> Vector3:
    x, y, z = value
    return Vector3(x=x, y=y, z=z)


def _fill_pose(target: Pose, sample: Sample) -> None:
    x, y, z = sample.position_world
    qx, qy, qz, qw = sample.orientation_xyzw
    target.position.x, target.position.y, target.position.z = x, y, z
    target.orientation = QuaternionMessage(x=qx, y=qy, z=qz, w=qw)
