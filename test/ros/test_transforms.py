"""`/tf` and `/tf_static`, against the real tf2_msgs if installed."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest
from geometry_msgs.msg import PoseStamped
from ros_harness import TRANSIENT, NodeProcess, Peer, running
from std_srvs.srv import Trigger

pytestmark = pytest.mark.ros

ABSENT = importlib.util.find_spec("tf2_msgs") is None


@pytest.mark.skipif(ABSENT, reason="tf2_msgs is not installed: it is not on PyPI")
def test_the_transform_is_the_pose_and_fixed_frames_are_static(scene: Path, peer: Peer) -> None:
    from tf2_msgs.msg import TFMessage

    with running(scene, start_paused=True, publish_tf=True) as node:
        moving, fixed = peer.listen(TFMessage, "/tf"), peer.listen(TFMessage, "/tf_static", TRANSIENT)
        poses = peer.listen(PoseStamped, "pose")
        peer.until(lambda: moving and fixed and poses, "transforms")
        peer.call("rigid_body/step", Trigger.Request())
        peer.until(lambda: len(moving) > 1 and len(poses) > 1, "motion")
        assert node.stop() == 0
    by_stamp = {(m.header.stamp.sec, m.header.stamp.nanosec): m.pose for m in poses}
    (transform,) = moving[-1].transforms
    pose = by_stamp[transform.header.stamp.sec, transform.header.stamp.nanosec]
    assert (transform.header.frame_id, transform.child_frame_id) == ("world", "body")
    assert transform.transform.rotation == pose.orientation
    assert transform.transform.translation.x == pose.position.x
    (thruster,) = fixed[0].transforms
    assert (thruster.header.frame_id, thruster.child_frame_id) == ("body", "thruster")
    assert thruster.transform.translation.y == 0.5
    assert thruster.header.stamp.nanosec == 1


@pytest.mark.skipif(not ABSENT, reason="tf2_msgs is installed")
def test_without_tf2_msgs_it_is_said_where_to_get_it(scene: Path) -> None:
    node = NodeProcess(scene, publish_tf=True)
    assert node.wait() == 2
    assert "ros-jazzy-tf2-msgs" in node.err
    assert "Traceback" not in node.err
