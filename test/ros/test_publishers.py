"""Published messages are the logged ones, and messages without a subscriber are not made."""

from __future__ import annotations

import importlib.util
import struct
from dataclasses import replace
from functools import partial
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.node import Node
from ros_harness import Peer

from rb_dynamics import Simulation, parse_scene
from rb_dynamics.formats import cdr
from rb_dynamics.logs.messages import sample_encoder, sample_topics
from rb_dynamics.ros.health import Health
from rb_dynamics.ros.pacing import Pacer
from rb_dynamics.ros.publishers import Topics, TopicSink
from rb_dynamics.ros.runner import Mode, Runner
from rb_dynamics.run.sink import RunInfo, Sample, Status

pytestmark = pytest.mark.ros

SCENE = parse_scene("body: {mass: 2.0, inertia: {diagonal: [1, 2, 2.5]}}\nwrenches: []\n", "scene.yaml")

NOBODY: Any = None


def test_a_topic_that_nobody_reads_is_not_made(peer: Peer) -> None:
    node = Node("rigid_body", context=peer.context)
    health = Health("rigid_body", (), print)
    sink = TopicSink(node, SCENE, Topics(), health, Runner(SCENE, Mode(), Pacer(1.0), health, NOBODY))
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


def test_topics_have_the_bytes_of_the_log_and_only_those_of_the_run(peer: Peer) -> None:
    transforms = importlib.util.find_spec("tf2_msgs") is not None
    with_gravity = parse_scene(
        SCENE.text + "effects: [{type: uniform_gravity, acceleration_world: [0, 0, -9.8]}]\n", "scene.yaml"
    )
    node = Node("rigid_body", context=peer.context)
    health = Health("rigid_body", (), print)
    runner = Runner(SCENE, Mode(), Pacer(1.0), health, NOBODY)
    runner.pacer.begin(7)
    sink = TopicSink(node, with_gravity, Topics(clock=True, transforms=transforms, acceleration=True), health, runner)
    acceleration = ((1.0, 2.0, 3.0), (4.0, 5.0, 6.0))
    names = {name for name, _ in sample_topics(with_gravity, accel=True) if transforms or name != "/tf"} | {"/clock"}
    heard: dict[str, bytes] = {}

    published = {each.topic_name: each for each in sink.publishers}
    for name in names:
        publisher = published[f"/{name.lstrip('/')}"]
        peer.node.create_subscription(
            publisher.msg_type, publisher.topic_name, partial(heard.__setitem__, name), 1, raw=True
        )
        peer.until(publisher.get_subscription_count, "a reader")
    for scene in (with_gravity, SCENE):
        sink.open(RunInfo(scene, "exact", acceleration=lambda: acceleration))
        heard.clear()
        sample = Simulation(scene).sample
        sink.write(sample)
        encoded = sample_encoder(scene, lambda: acceleration)(replace(sample, time_ns=7))
        logged = zip(sample_topics(scene, accel=True), encoded, strict=True)
        expected = {name: data for (name, _), data in logged if name in names}
        expected["/clock"] = cdr.encode("rosgraph_msgs/msg/Clock", 7)
        peer.until(lambda: heard.keys() >= expected.keys(), "every topic")  # noqa: B023
        assert heard == expected
    node.destroy_node()
