"""What nobody reads is not even made: what cannot be packed does no harm until somebody reads it."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.node import Node
from ros_harness import Peer

from rb_dynamics import Simulation, parse_scene
from rb_dynamics.ros.health import Health
from rb_dynamics.ros.publishers import Topics, TopicSink
from rb_dynamics.run.sink import RunInfo, Sample, Status

pytestmark = pytest.mark.ros

SCENE = parse_scene("body: {mass: 2.0, inertia: {diagonal: [1, 2, 2.5]}}\nwrenches: []\n", "scene.yaml")


def test_a_topic_that_nobody_reads_is_not_made(peer: Peer) -> None:
    node = Node("rigid_body", context=peer.context)
    sink = TopicSink(node, SCENE, Topics(), Health("rigid_body", (), print), lambda: 0, lambda: False)
    sink.open(RunInfo(SCENE, "exact"))
    nowhere: Any = ()
    unpackable = replace(Simulation(SCENE).sample, position_world=nowhere)
    no_level = Status(1, 256, "running", {})
    twists = peer.listen(TwistStamped, "twist")

    def is_made(event: Sample | Status) -> bool:
        try:
            sink.write(event)
        except (struct.error, ValueError):
            return True
        return False

    peer.until(lambda: is_made(no_level) or is_made(unpackable) or bool(twists), "the twist")
    assert not is_made(no_level)
    assert not is_made(unpackable)
    peer.listen(PoseStamped, "pose")
    peer.listen(DiagnosticArray, "/diagnostics")
    peer.until(lambda: is_made(unpackable), "the pose")
    peer.until(lambda: is_made(no_level), "the diagnostics")
    node.destroy_node()
