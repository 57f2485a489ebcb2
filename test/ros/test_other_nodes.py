"""Other publishers and incompatible QoS on our topics are reported, and forgotten once they are gone."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from ros_harness import TRANSIENT, NodeProcess, Peer, running, values
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from rb_dynamics.ros.health import Health
from rb_dynamics.ros.other_nodes import Neighbours

pytestmark = pytest.mark.ros


def level(message: Any) -> int:
    return int.from_bytes(message.status[0].level, "little")


def test_a_reader_whose_qos_does_not_fit_is_a_warning_until_it_goes(scene: Path, peer: Peer) -> None:
    with running(scene) as node:
        diagnostics = peer.diagnostics()
        reader = peer.node.create_subscription(PoseStamped, "pose", lambda _: None, TRANSIENT)
        # Its name may come later than its QoS.
        named = "/pose: the QoS of the reader /peer is incompatible"
        peer.until(lambda: diagnostics and named in diagnostics[-1].status[0].message, "a word of it")
        assert level(diagnostics[-1]) == 1
        message = diagnostics[-1].status[0].message
        assert "let it ask VOLATILE, or start this node with" in message
        assert "-p qos_overrides./pose.publisher.durability:=transient_local" in message
        assert values(diagnostics[-1])["pose: incompatible QoS"] == "1"
        # It is not of the run: a reset does not change it.
        peer.call("rigid_body/reset", Trigger.Request())
        told = len(diagnostics)
        peer.until(lambda: len(diagnostics) > told + 1, "diagnostics")
        assert "QoS" in diagnostics[-1].status[0].message
        peer.node.destroy_subscription(reader)
        # A busy machine may leave a warning of its own.
        peer.until(lambda: "QoS" not in diagnostics[-1].status[0].message, "the all-clear")
        assert node.stop() == 0, node.err
    assert node.err.count("/peer is incompatible") == 1


def test_what_is_told_to_a_reader_helps(tmp_path: Path, peer: Peer) -> None:
    """Includes the parameter events published before it subscribed."""
    scene = tmp_path / "scene.yaml"
    scene.write_text("body: {mass: 1, inertia: {diagonal: [1, 1, 1]}}\noutput_rate: 0.001\nsolver: {step: 10}\n")
    parameters = {"qos_overrides./pose.publisher.durability": "transient_local"}
    with running(scene, publish_accel=True, **parameters) as node:
        diagnostics = peer.diagnostics()
        poses = peer.listen(PoseStamped, "pose", TRANSIENT)
        peer.until(lambda: bool(poses), "the newest pose, a thousand seconds before the next")
        told = len(diagnostics)
        peer.until(lambda: len(diagnostics) > told + 1, "diagnostics")
        assert "QoS" not in diagnostics[-1].status[0].message, diagnostics[-1]
        assert node.stop() == 0, node.err


def test_commands_to_actuators_that_are_not_there_are_a_warning_until_they_stop(tmp_path: Path, peer: Peer) -> None:
    """Not those that another node hears, of another type, or in another namespace."""
    scene = tmp_path / "scene.yaml"
    scene.write_text("""
body: {mass: 2, inertia: {diagonal: [0.1, 0.2, 0.25]}}
wrenches: []
actuators: [{type: reaction_wheel, name: wheel_x, axis: [1, 0, 0], inertia: 1.0e-3}]
""")
    peer.node.create_subscription(Float64, "/sat/arm/command", lambda _: None, 1)
    others = ("/sat/wheel_x/command", "/sat/arm/command", "/sat/wheel_q/speed", "/other/wheel_q/command")
    for topic in others:
        peer.node.create_publisher(Float64, topic, 1)
    peer.node.create_publisher(PoseStamped, "/sat/goal/command", 1)
    absent = peer.node.create_publisher(Float64, "/sat/wheel_q/command", 1)
    with running(scene, "-r", "__ns:=/sat") as node:
        diagnostics = peer.diagnostics()
        told = "/sat/wheel_q/command: commands that no node receives, expected those of an actuator here: "
        peer.until(lambda: diagnostics and told in diagnostics[-1].status[0].message, "a word of it")
        assert diagnostics[-1].status[0].message == f"{told}/sat/wheel_x/command"
        assert values(diagnostics[-1])["topics of absent actuators"] == "1"
        peer.node.destroy_publisher(absent)
        peer.until(lambda: "topics of absent actuators" not in values(diagnostics[-1]), "the all-clear")
        assert node.stop() == 0, node.err
    assert node.err.count(told) == 1


def test_another_node_with_our_topics_is_a_warning_until_it_stops(scene: Path, peer: Peer) -> None:
    with running(scene) as node:
        diagnostics = peer.diagnostics()
        peer.until(lambda: bool(diagnostics), "diagnostics")
        # Its own diagnostics elsewhere: it may find the first node before the first node finds it.
        with running(scene, "-r", "/diagnostics:=/elsewhere") as second:
            peer.until(lambda: "another publisher" in diagnostics[-1].status[0].message, "a word of it")
            assert level(diagnostics[-1]) == 1
            peer.until(lambda: "of the same name" in diagnostics[-1].status[0].message, "its name")
            assert second.stop() == 0, second.err
        one = "another publisher of what this node publishes"
        peer.until(lambda: one not in diagnostics[-1].status[0].message, "the all-clear")
        assert node.stop() == 0, node.err
    assert one in node.err
    assert "by /rigid_body (of the same name)" in node.err


def test_each_topic_is_looked_at_once_a_second_and_each_other_node_named(peer: Peer) -> None:
    now, said = [0.0], []
    node = Node("rigid_body", context=peer.context)
    best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    publishers = [node.create_publisher(Float64, f"energy/{name}", best_effort) for name in ("a", "b", "c", "d")]
    shared = node.create_publisher(Float64, "/tf", 1)
    health = Health("rigid_body", (), lambda level, message: said.append((level, message)))
    neighbours = Neighbours(node, [*publishers, shared], health, lambda: now[0])

    def looked() -> list[str]:
        said.clear()
        for _ in range(10):
            now[0] += 0.1
            neighbours.look()
        return [message for _, message in said]

    assert looked() == []
    rivals = [peer.node.create_publisher(Float64, each.topic_name, 1) for each in (*publishers, shared)]
    reader = peer.node.create_subscription(
        Float64, "energy/b", print, QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    )
    give_up = time.monotonic() + 20.0
    while len(found := looked()) < 2 and time.monotonic() < give_up:
        time.sleep(0.02)
    assert [level for level, _ in said] == [1, 1]
    assert "/energy/a, /energy/b, /energy/c and 1 more by /peer; expected one" in found[0]
    assert "let it ask BEST_EFFORT and VOLATILE" in found[1]
    assert "-p" not in found[1]
    # It is said once.
    assert looked() == []
    for rival in rivals:
        peer.node.destroy_publisher(rival)
    peer.node.destroy_subscription(reader)
    looked()
    assert not any(health._conditions.values())
    node.destroy_node()


@pytest.mark.parametrize(
    ("name", "arguments", "expected"),
    [
        ("/wrnch.subscription.reliability", (), "did you mean qos_overrides./wrench.subscription.reliability"),
        pytest.param(
            "/tug/thurst.subscription.depth",
            ("-r", "wrench:=/tug/thrust"),
            "did you mean qos_overrides./tug/thrust.subscription.depth?",
            marks=pytest.mark.slow,
        ),
        ("/pose.publisher.deadline", (), "qos_overrides./pose.publisher.depth or"),
        ("/elsewhere", (), "there are those of /"),
        ("/wrench.subscription.reliability", ("-p", "lockstep:=true"), "in lockstep no command may be lost"),
        pytest.param("/accel.publisher.depth", (), "there are those of /", marks=pytest.mark.slow),
    ],
)
def test_an_override_that_matches_no_topic_is_refused_before_there_is_a_log(
    scene: Path, tmp_path: Path, name: str, arguments: tuple[str, ...], expected: str
) -> None:
    value = {"depth": "5", "deadline": "5"}.get(name.rpartition(".")[2], "best_effort")
    log = tmp_path / "run.mcap"
    node = NodeProcess(scene, *arguments, "-p", f"qos_overrides.{name}:={value}", mcap=log)
    assert node.wait() == 2, node.err
    assert node.err.splitlines()[-1].startswith(f"rb-dynamics: parameter qos_overrides.{name}: found no topic that")
    assert expected in node.err
    assert "Traceback" not in node.err
    assert not log.exists()


def test_overrides_of_topics_that_are_not_always_there_are_taken(tmp_path: Path, peer: Peer) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text(
        "body: {mass: 1, inertia: {diagonal: [1, 1, 1]}}\n"
        "effects: [{type: uniform_gravity, acceleration_world: [0, 0, -1]}]\n"
    )
    names = ("/accel", "/energy/potential", "/clock")
    parameters = {f"qos_overrides.{name}.publisher.depth": 3 for name in names}
    # By the name before remapping.
    remapped = ("-r", "pose:=/tug/pose", "-p", "qos_overrides./pose.publisher.depth:=7")
    with running(scene, *remapped, publish_accel=True, publish_clock=True, **parameters) as node:
        asked = GetParameters.Request(names=["qos_overrides./tug/pose.publisher.depth"])
        assert peer.call("rigid_body/get_parameters", asked, GetParameters).values[0].integer_value == 7
        peer.listen(Float64, "energy/potential")
        assert node.stop() == 0, node.err
