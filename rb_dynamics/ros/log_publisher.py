"""`publish`: publish the messages of a log, byte for byte, with their stamps, at the pace of the run."""

from __future__ import annotations

import importlib.util
import re
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock

from rb_dynamics.formats.bag_source import open_source
from rb_dynamics.formats.log_metadata import RUN
from rb_dynamics.formats.mcap_records import McapChannel, Message
from rb_dynamics.formats.message_types import COMMAND, SCALAR, WRENCH
from rb_dynamics.formats.rosbag2_metadata import offered_qos
from rb_dynamics.logs.messages import APPLIED, decode_wrench
from rb_dynamics.ros.conversions import to_stamp
from rb_dynamics.ros.other_nodes import unconnected
from rb_dynamics.ros.pacing import Pacer

# Enough for a reader that is slow for a moment.
_DEPTH = 1000
# s: how long to look for readers, and for another after the last one. By default, Fast DDS and Cyclone DDS announce
# themselves every 3 s, and of readers that are there, one may be found by such an announcement only.
_SEARCH, _NEXT = 4.0, 1.5
# s: how long to wait until all that were found are connected, and until they have got all messages.
_CONNECT, _PATIENCE = 10.0, 3.0
_TYPE = re.compile(r"([a-z][a-z0-9_]*)/(?:msg/)?([A-Za-z][A-Za-z0-9]*)")


def publish(log: str | Path, rate: float = 1.0, clock: bool = False, ros_args: Sequence[str] = ()) -> int:
    """Publish every message of `log`; return their number.

    Starts after 4 s, when no new reader has appeared for 1.5 s and all are connected.

    Args:
        log: a bag, see `open_source`.
        rate: multiple of real time; 0 = as fast as possible.
        clock: publish `/clock` too, if the log has none.
        ros_args: remappings and so on, from `--ros-args` on.

    Raises:
        LogError: the log cannot be read.
    """
    # Read the whole log once first: this finds damage, and creates all topics before the first message.
    source = open_source(log)
    retimed = Counter(
        message.channel.topic
        for message in source.messages()
        if RUN in source.metadata and _may_act_at_another_time(message)
    )
    rclpy.init(args=list(ros_args), signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = Node("log_publisher")
        try:
            publishers = {channel.topic: _publisher(node, channel) for channel in source.channels.values()}
            ticks = node.create_publisher(Clock, "/clock", 1) if clock and "/clock" not in publishers else None
            known = {topic: each for topic, each in publishers.items() if each is not None}
            if retimed:
                told = ", ".join(f"{count} on {topic}" for topic, count in retimed.items())
                node.get_logger().warning(
                    f"commands ({told}) are stamped later than the simulation time at which they took effect, as those "
                    "of a node in real time, or not at all, as those to actuators: a node in lockstep does not repeat "
                    "this log from them; simulate LOG does"
                )
            wait_for_readers(node, list(known.values()))
            return _play(log, rate, known, ticks)
        finally:
            node.destroy_node()
    finally:
        rclpy.try_shutdown()


def _may_act_at_another_time(message: Message) -> bool:
    """Return whether a node in lockstep may let this command act at another time than the log says."""
    topic, kind = message.channel.topic, message.channel.type_name
    if kind != WRENCH:
        return kind == SCALAR and topic.endswith(COMMAND)
    return (
        not topic.endswith(APPLIED) and decode_wrench(kind, message.log_time, message.data).stamp_ns > message.log_time
    )


def _play(log: str | Path, rate: float, publishers: dict[str, Publisher], ticks: Publisher | None) -> int:
    count, last_ns = 0, None
    pacer = Pacer(rate or 1.0)
    for message in open_source(log).messages():
        if last_ns is None:
            pacer.restart(message.log_time)
        if message.log_time != last_ns:
            last_ns = message.log_time
            if rate > 0.0:
                time.sleep(pacer.seconds_until(last_ns))
            if ticks is not None:
                # To its readers a time of 0 means "not started": a node that follows it lost the first period.
                ticks.publish(Clock(clock=to_stamp(max(1, last_ns))))
        if message.channel.topic in publishers:
            publishers[message.channel.topic].publish(message.data)
            count += 1
    for publisher in publishers.values():
        publisher.wait_for_all_acked(Duration(seconds=_PATIENCE))
    return count


def _publisher(node: Node, channel: McapChannel) -> Publisher | None:
    """Return a publisher for a channel; None, with a warning, if type or topic name cannot be used."""
    kind = _message_type(channel.type_name)
    if kind is None:
        node.get_logger().warning(f"{channel.topic}: left out, its type {channel.type_name!r} is not installed")
        return None
    durability = DurabilityPolicy.TRANSIENT_LOCAL if _is_kept(channel) else DurabilityPolicy.VOLATILE
    try:
        return node.create_publisher(kind, channel.topic, QoSProfile(depth=_DEPTH, durability=durability))
    except NameValidationException as error:
        node.get_logger().warning(f"{channel.topic}: left out, this is no name of a topic: {error}")
        return None


def _message_type(name: str) -> Any | None:
    """Return the message type named in a log; None if it is not installed.

    Only message packages are imported: a file could name any module.
    """
    found = _TYPE.fullmatch(name)
    spec = importlib.util.find_spec(found[1]) if found else None
    if not found or spec is None or not any(Path(at, "msg").is_dir() for at in spec.submodule_search_locations or ()):
        return None
    try:
        kind = getattr(importlib.import_module(f"{found[1]}.msg"), found[2], None)
    except ImportError:
        return None
    return kind if hasattr(kind, "get_fields_and_field_types") else None


def _is_kept(channel: McapChannel) -> bool:
    """Return whether the log says that the topic was transient local."""
    (offered, *_) = offered_qos(channel) or [{}]
    # Before version 9 of the metadata, policies were numbers.
    return isinstance(offered, dict) and offered.get("durability") in ("transient_local", 1)


def wait_for_readers(node: Node, publishers: Sequence[Publisher]) -> None:
    """Return when those that are there are connected, with a warning if some cannot be."""
    readers, begin = 0, time.monotonic()
    enough = begin + _SEARCH
    missing = unconnected(node, publishers)
    while time.monotonic() < (enough + _CONNECT if missing else enough):
        found = sum(each.get_subscription_count() for each in publishers)
        if found > readers:
            readers, enough = found, max(enough, time.monotonic() + _NEXT)
        time.sleep(0.02)
        missing = unconnected(node, publishers)
    if missing:
        told = ", ".join(f"{topic} {connected} of {known}" for topic, (connected, known) in missing.items())
        node.get_logger().warning(
            f"not all readers are connected after {_CONNECT:g} s, the others miss messages: {told}; check that they "
            "run, in the same network and partition"
        )
