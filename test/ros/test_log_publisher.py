"""`replay --into ros` publishes the messages of a log unchanged and in order."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import threading
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: pip install '.[ros]'")
pytest.importorskip("mcap", reason="extra 'log' is not installed")
pytest.importorskip("rosbags", reason="extra 'log' is not installed")

from command_line import command
from geometry_msgs.msg import InertiaStamped, PoseStamped, WrenchStamped
from mcap.writer import Writer as McapWriter
from nav_msgs.msg import Odometry
from rclpy.time import Time
from ros_harness import KEEP_ALL, TRANSIENT, Peer, running
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from rosgraph_msgs.msg import Clock

from rb_dynamics import Setpoint, Simulation, Wrench, parse_scene, simulate
from rb_dynamics.formats.log_metadata import RESULT
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.ros.log_publisher import wait_for_readers
from rb_dynamics.sinks.mcap_sink import McapSink

pytestmark = pytest.mark.ros

SCENE = parse_scene(
    "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\ninitial: {angular_velocity_body: [0.1, 2, 0.1]}\n"
    "wrenches: [{topic: wrench}]\nduration: 1\noutput_rate: 50\n"
)


def test_a_log_is_published_with_its_stamps(tmp_path: Path, peer: Peer) -> None:
    log = tmp_path / "run.mcap"
    command = Wrench((1.0, 0.0, 0.0), (0.0, 0.5, 0.0), "body", 300_000_000)
    simulate(SCENE, [("wrench", command)], [McapSink(log)])
    kinds = {"/truth": PoseStamped, "/wrench": WrenchStamped, "/clock": Clock, "/inertia": InertiaStamped}
    for topic, kind in kinds.items():
        peer.heard[topic] = []
        # The readers are there before the log is played.
        peer.node.create_subscription(
            kind, topic, peer.heard[topic].append, TRANSIENT if topic == "/inertia" else KEEP_ALL
        )
    arguments = [sys.executable, "-m", "rb_dynamics", "replay", str(log), "--into", "ros", "--rate", "4", "--clock"]
    process = subprocess.Popen(
        [*arguments, "--ros-args", "-r", "/pose:=/truth"], stdout=subprocess.PIPE, text=True, env=os.environ
    )
    try:
        expected = {"/truth": 51, "/wrench": 1, "/inertia": 1}
        peer.until(lambda: all(len(peer.heard[topic]) == count for topic, count in expected.items()), "the whole log")
        said, _ = process.communicate(timeout=40.0)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 0
    bag = read_bag(log)
    known = [topic for name, topic in bag.topics.items() if name != "/tf" or importlib.util.find_spec("tf2_msgs")]
    assert f"published {sum(topic.count for topic in known)} messages" in said
    times, rows = bag.poses("/pose")
    for message, time_ns, row in zip(peer.heard["/truth"], times, rows, strict=True):
        stamp, pose = message.header.stamp, message.pose
        assert stamp.sec * 10**9 + stamp.nanosec == time_ns
        assert [pose.position.x, pose.orientation.y, pose.orientation.w] == [row[0], row[4], row[6]]
    (wrench,) = peer.heard["/wrench"]
    assert (wrench.header.stamp.nanosec, wrench.wrench.torque.y) == (300_000_000, 0.5)
    assert peer.heard["/inertia"][0].inertia.m == 2.0
    ticks = [each.clock.sec * 10**9 + each.clock.nanosec for each in peer.heard["/clock"]]
    assert ticks == sorted(set(ticks))
    # No clock is ever zero: to its readers that means that it has not started.
    assert ticks[0] == 1


@pytest.mark.parametrize("epoch_ns", [0, 10**18])
def test_commands_by_ros_time_are_said_to_repeat_no_log(
    epoch_ns: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """A node in lockstep ran to its end without any of them."""
    log = tmp_path / "run.mcap"
    run = Simulation(SCENE, [McapSink(log)])
    run.start()
    run.post("wrench", Wrench(torque=(0.0, 0.5, 0.0), stamp_ns=300_000_000 + epoch_ns), 300_000_000)
    run.advance(10**9)
    run.finish()
    assert command("replay", str(log), "--into", "ros", "--rate", "0").returncode == 0
    assert ("commands (1 on /wrench) are stamped later" in capfd.readouterr().err) == bool(epoch_ns)


def test_commands_to_actuators_are_said_to_repeat_no_log(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """They have no stamps: a node in lockstep took them before the wrench that moved its time to theirs."""
    log = tmp_path / "run.mcap"
    wheel = "{type: reaction_wheel, name: wheel, axis: [1, 0, 0], inertia: 0.01}"
    scene = parse_scene(f"{SCENE.text}actuators: [{wheel}]\n")
    simulate(scene, [("wheel/command", Setpoint(0.1, stamp_ns=300_000_000))], [McapSink(log)])
    assert command("replay", str(log), "--into", "ros", "--rate", "0").returncode == 0
    assert "commands (1 on /wheel/command) are stamped later" in capfd.readouterr().err


def test_readers_that_are_found_late_are_waited_for(peer: Peer) -> None:
    """A reader that was there was found up to 2.3 s after another one, by the next of its announcements."""
    publisher = peer.node.create_publisher(PoseStamped, "/late", KEEP_ALL)
    peer.node.create_subscription(PoseStamped, "/late", print, KEEP_ALL)
    # It can never receive, and is not waited for.
    peer.node.create_subscription(PoseStamped, "/late", print, TRANSIENT)
    connected: list[int] = []

    def wait() -> None:
        wait_for_readers(peer.node, [publisher])
        connected.append(publisher.get_subscription_count())

    waiting = threading.Thread(target=wait)
    waiting.start()
    time.sleep(2.3)
    peer.node.create_subscription(PoseStamped, "/late", print, KEEP_ALL)
    waiting.join(8.0)
    assert connected == [2]


def test_a_reader_that_is_known_but_never_connected_is_named(
    tmp_path: Path, peer: Peer, capfd: pytest.CaptureFixture[str]
) -> None:
    """Readers of another partition are known to the graph, and are not connected."""
    log, profile = tmp_path / "run.mcap", tmp_path / "profile.xml"
    simulate(replace(SCENE, duration=0.1, text=""), sinks=[McapSink(log)])
    profile.write_text(
        '<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"><data_reader profile_name="elsewhere" '
        'is_default_profile="true"><qos><partition><names><name>other</name></names></partition></qos></data_reader>'
        "</profiles>"
    )
    reader = subprocess.Popen(
        [sys.executable, "-c", _READER],
        env={**os.environ, "FASTRTPS_DEFAULT_PROFILES_FILE": str(profile), "RMW_FASTRTPS_USE_QOS_FROM_XML": "1"},
    )
    try:
        peer.until(lambda: peer.node.count_subscribers("/pose") == 1, "the reader")
        done = command("replay", str(log), "--into", "ros", "--rate", "0")
    finally:
        reader.kill()
        reader.wait()
    assert done.returncode == 0, done.stderr
    assert "the others miss messages: /pose 0 of 1;" in capfd.readouterr().err


_READER = """
import time, rclpy
from geometry_msgs.msg import PoseStamped
rclpy.init()
node = rclpy.create_node("reader")
reader = node.create_subscription(PoseStamped, "/pose", print, 10)
time.sleep(60.0)
"""


def test_a_log_neither_imports_what_it_names_nor_ends_the_replay(tmp_path: Path) -> None:
    log, package = tmp_path / "odd.mcap", tmp_path / "innocent"
    package.mkdir()
    (package / "__init__.py").write_text("raise SystemExit('a log had me imported')\n", encoding="utf-8")
    channels = {
        "/imports": ("innocent/msg/Pose", ""),
        "/no_such_message": ("geometry_msgs/msg/Nope", ""),
        "/a module": ("geometry_msgs/msg/Pose", ""),
        "/good": ("geometry_msgs/msg/Vector3", "[not: yaml"),
        "/a_list": ("geometry_msgs/msg/Vector3", "[1, 2]"),
    }
    with log.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2")
        for topic, (kind, qos) in channels.items():
            schema = writer.register_schema(kind, "ros2msg", b"float64 x\nfloat64 y\nfloat64 z\n")
            channel = writer.register_channel(topic, "cdr", schema, {"offered_qos_profiles": qos})
            writer.add_message(channel, log_time=1, publish_time=1, data=bytes([0, 1, 0, 0]) + bytes(24))
        writer.finish()
    done = subprocess.run(
        [sys.executable, "-m", "rb_dynamics", "replay", str(log), "--into", "ros", "--rate", "0"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "published 2 messages" in done.stdout
    said = done.stdout + done.stderr
    for topic in ("/imports", "/no_such_message", "/a module"):
        assert f"{topic}: left out" in said


def test_a_bag_of_the_topics_of_a_node_flies_another_to_the_same_bits(tmp_path: Path, peer: Peer) -> None:
    """As a recorder writes it: the bytes that came, in their order, by their times of arrival."""
    scene, folder = tmp_path / "scene.yaml", tmp_path / "bag"
    scene.write_text(SCENE.text)
    logs = [tmp_path / name for name in ("first.mcap", "again.mcap")]
    came: list[tuple[str, int, bytes]] = []
    kinds = {"/odom": Odometry, "/wrench": WrenchStamped}
    for topic, kind in kinds.items():
        record = partial(lambda topic, data: came.append((topic, time.time_ns(), data)), topic)
        peer.node.create_subscription(kind, topic, record, KEEP_ALL, raw=True)
    with running(scene, lockstep=True, mcap=logs[0]) as node:
        commands = peer.node.create_publisher(WrenchStamped, "/wrench", KEEP_ALL)
        # The recorder and the node.
        peer.until(lambda: commands.get_subscription_count() == 2 and bool(came), "the node")
        peer.spin(0.1)
        for k in range(1, 51):
            stamped = WrenchStamped()
            stamped.header.stamp, stamped.wrench.torque.x = Time(nanoseconds=20_000_000 * k).to_msg(), 0.1 * k
            commands.publish(stamped)
        peer.until(lambda: [topic for topic, *_ in came].count("/wrench") == 50, "every command recorded")
        assert node.wait() == 0, node.err
    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        store = get_typestore(Stores.ROS2_JAZZY)
        names = {"/odom": "nav_msgs/msg/Odometry", "/wrench": "geometry_msgs/msg/WrenchStamped"}
        opened = {topic: writer.add_connection(topic, name, typestore=store) for topic, name in names.items()}
        for topic, time_ns, data in came:
            writer.write(opened[topic], time_ns, data)
    assert [bag.topics["/wrench"].count for bag in (read_bag(folder), read_bag(logs[0]))] == [50, 50]
    with running(scene, lockstep=True, mcap=logs[1]) as node:
        peer.until(lambda: peer.node.count_subscribers("/wrench") == 2, "the node beside the recorder")
        arguments = ["replay", folder, "--into", "ros", "--rate", "0", "--ros-args", "-r", "/odom:=/recorded"]
        played = command(*map(str, arguments))
        assert played.returncode == 0, played.stderr
        assert node.wait() == 0, node.err
    assert len({read_bag(log).metadata[RESULT]["states_sha256"] for log in logs}) == 1
