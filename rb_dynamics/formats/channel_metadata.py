"""What the metadata of a channel say, as rosbag2 writes them: QoS profile and type hash."""

from __future__ import annotations

import re

from rb_dynamics.formats.mcap_records import McapChannel, Schema
from rb_dynamics.formats.message_definitions import TYPE_HASHES, schema_text

QOS, TYPE_HASH = "offered_qos_profiles", "topic_type_hash"

_FOREVER = "\n    sec: 9223372036\n    nsec: 854775807\n"


def qos_profile(depth: int, durability: str = "volatile") -> str:
    """Return a reliable profile in the words of rosbag2 in Jazzy (bag metadata version 9)."""
    return (
        f"- history: keep_last\n  depth: {depth}\n  reliability: reliable\n  durability: {durability}\n"
        f"  deadline:{_FOREVER}  lifespan:{_FOREVER}"
        f"  liveliness: automatic\n  liveliness_lease_duration:{_FOREVER}"
        "  avoid_ros_namespace_conventions: false"
    )


def is_latched(topic: str, qos: str) -> bool:
    """Return whether a message of a topic holds until the next, by its profile in the words of any rosbag2.

    Those of /tf_static, and of its pairs of frames, hold without a profile, too.
    """
    return (
        topic.partition(" ")[0].endswith("tf_static")
        or re.search(r"durability: (?:transient_local|1)\b", qos) is not None
    )


def log_channel(topic: str, type_name: str, qos: str) -> McapChannel:
    """Return the channel of a topic in a log."""
    schema = Schema(type_name, "ros2msg", schema_text(type_name).encode())
    return McapChannel(topic, schema, "cdr", {QOS: qos, TYPE_HASH: TYPE_HASHES[type_name]})
