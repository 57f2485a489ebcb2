"""What a ROS 2 bag says: poses, twists, wrenches and scalars as arrays.

Any writer will do (rosbag2, this package, others), and so will a file that was cut off. Never needs ROS or the index of
the file, and keeps only messages of the types in `rb_dynamics.formats.cdr.LAYOUTS`.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.errors import LogError
from rb_dynamics.formats import cdr
from rb_dynamics.formats.bag_source import open_source
from rb_dynamics.formats.mcap_records import Channel
from rb_dynamics.formats.messages import (
    ODOMETRY,
    PLAIN_WRENCH,
    POSE,
    SCALAR,
    TWIST,
    VECTOR,
    WRENCH,
    decode_wrench,
)
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.run.provenance import DAMAGED, INTERRUPTED, MISSING_FILES, RESULT, next_file

Times = NDArray[np.int64]
Values = NDArray[np.float64]

# Of each kind of quantity: the types that carry it, and where it stands in their decoded values.
_POSES = {POSE: 2, ODOMETRY: 3}
_TWISTS = {TWIST: 2, ODOMETRY: 5}
_VECTORS = {VECTOR: 2}
_SCALARS = {SCALAR: 0}
WRENCHES = {PLAIN_WRENCH: 0, WRENCH: 2}


@dataclass
class Topic:
    """The messages of one topic, in the order of the file.

    Attributes:
        name: as recorded.
        type_name: message type, such as "std_msgs/msg/Float64"; with the encoding before it where that is not CDR.
        qos: `offered_qos_profiles` as recorded, YAML; "" where the writer gave none.
        log_times: ns, one for each message.
        publish_times: ns, one for each message.
        messages: the bytes of each message; empty for a type that is not in `cdr.LAYOUTS`.
    """

    name: str
    type_name: str
    qos: str = ""
    log_times: list[int] = field(default_factory=list)
    publish_times: list[int] = field(default_factory=list)
    messages: list[bytes] = field(default_factory=list)

    @property
    def count(self) -> int:
        """Number of messages."""
        return len(self.log_times)

    def decoded(self) -> list[tuple[Any, ...]]:
        """Return the values of each message, see `cdr.decode`.

        Raises:
            LogError: a message is cut short or not CDR.
        """
        return [cdr.decode(self.type_name, message) for message in self.messages]


@dataclass
class Bag:
    """A bag in memory.

    Attributes:
        path: the file or folder.
        complete: False for a file that was cut off, recovered or not; it holds what was written until then. False too
            for files of a bag of which another one is missing.
        topics: by name as recorded.
        metadata: key and value of each metadata record, by its name.
        attachments: content by name.
        whole: the file itself has its end, which a recovered one has too.
    """

    path: Path
    complete: bool
    topics: dict[str, Topic]
    metadata: dict[str, dict[str, str]]
    attachments: dict[str, bytes]
    whole: bool = True

    @property
    def ended(self) -> bool:
        """Whether the end of what was recorded is there, whatever is missing within."""
        if self.next_file:
            return False
        reason = self.metadata.get(INTERRUPTED, {}).get("reason")
        return self.complete or RESULT in self.metadata or (self.whole and reason == DAMAGED)

    @property
    def next_file(self) -> str:
        """The file in which the last one here says that it goes on, and which is not here; "" where it is the last."""
        return next_file(self.metadata)

    @property
    def missing_files(self) -> list[str]:
        """Names of files that are not here although later ones are."""
        return [*filter(None, self.metadata.get(INTERRUPTED, {}).get(MISSING_FILES, "").split(", "))]

    @property
    def missing(self) -> list[tuple[int, int]]:
        """First and last log time (ns) of each piece that is not here, in order: damaged, or between two files."""
        told = self.metadata.get(INTERRUPTED, {}).get("missing_ns", "")
        pieces = [(int(begin), int(end)) for begin, end in re.findall(r"([0-9]{1,19}) ([0-9]{1,19})", told)]
        return sorted((begin, end) for begin, end in pieces if begin <= end < 2**63)

    def poses(self, topic: str) -> tuple[Times, Values]:
        """Return stamps (ns) and rows of position (m) and quaternion x, y, z, w; of PoseStamped or Odometry.

        Raises:
            LogError: no such topic, another type, or a damaged message; so for the five functions below.
        """
        return self._series(topic, _POSES)

    def twists(self, topic: str) -> tuple[Times, Values]:
        """Return stamps (ns) and rows of linear (m/s) and angular (rad/s) velocity; of TwistStamped or Odometry."""
        return self._series(topic, _TWISTS)

    def vectors(self, topic: str) -> tuple[Times, Values]:
        """Return stamps (ns) and rows of x, y, z; of Vector3Stamped."""
        return self._series(topic, _VECTORS)

    def scalars(self, topic: str) -> tuple[Times, Values]:
        """Return log times (ns) and numbers; of Float64."""
        times, rows = self._series(topic, _SCALARS)
        return times, rows[:, 0]

    def wrenches(self, topic: str) -> list[tuple[int, Wrench]]:
        """Return log time (ns) and command for each message, in the order of the file; of WrenchStamped or Wrench."""
        source = self._topic(topic, WRENCHES)
        pairs = zip(source.log_times, source.messages, strict=True)
        return [(time_ns, decode_wrench(source.type_name, time_ns, message)) for time_ns, message in pairs]

    def frame_ids(self, topic: str) -> set[str]:
        """Return every `header.frame_id` on a topic of a stamped type."""
        stamped = {name: 1 for name, layout in cdr.LAYOUTS.items() if layout[:2] == (cdr.STAMP, cdr.STRING)}
        return {values[1] for values in self._topic(topic, stamped).decoded()}

    def _series(self, topic: str, places: dict[str, int]) -> tuple[Times, Values]:
        source = self._topic(topic, places)
        place = places[source.type_name]
        times, values = _alike(source, place) or _one_by_one(source, place)
        return (times if _stamped(source) else np.array(source.log_times, dtype=np.int64)), values

    def _topic(self, name: str, types: dict[str, int]) -> Topic:
        topic = self.topics.get(name)
        if topic is None or topic.type_name not in types:
            found = "no such topic" if topic is None else f"type {topic.type_name!r}"
            usable = [other.name for other in self.topics.values() if other.type_name in types]
            raise LogError(
                f"{self.path}: topic {name!r}: {found}, expected {' or '.join(types)}; the file has {usable}"
            )
        return topic


def read_bag(path: str | os.PathLike[str]) -> Bag:
    """Return what is in a bag: an MCAP file, or whatever `open_source` reads.

    Raises:
        LogError: the bag cannot be read or is damaged.
    """
    file = open_source(Path(path))
    bag = Bag(file.path, False, {}, file.metadata, file.attachments)
    for message in file.messages():
        topic = _topic_of(bag, message.channel)
        topic.log_times.append(message.log_time)
        topic.publish_times.append(message.publish_time)
        if topic.type_name in cdr.LAYOUTS:
            topic.messages.append(message.data)
    for channel in file.channels.values():
        _topic_of(bag, channel)
    bag.whole = file.complete
    bag.complete = file.complete and INTERRUPTED not in file.metadata and not bag.next_file
    return bag


def _stamped(topic: Topic) -> bool:
    return cdr.LAYOUTS[topic.type_name][0] == cdr.STAMP


def _one_by_one(topic: Topic, place: int) -> tuple[Times, Values]:
    """Return first field and numbers of each message."""
    rows = topic.decoded()
    times = np.array([row[0] if _stamped(topic) else 0 for row in rows], dtype=np.int64)
    return times, np.array([row[place] for row in rows], dtype=np.float64).reshape(len(rows), _width(topic, place))


def _alike(topic: Topic, place: int) -> tuple[Times, Values] | None:
    """Return the same straight from the bytes, much faster; None unless only stamps and numbers differ."""
    messages = topic.messages
    if len({len(message) for message in messages}) != 1:
        return None
    cdr.decode(topic.type_name, messages[0])
    raw = np.frombuffer(b"".join(messages), dtype=np.uint8).reshape(len(messages), -1)
    numbers = cdr.first_number(topic.type_name, messages[0])
    texts = raw[:, 12:numbers]
    if (raw[:, :2] != raw[0, :2]).any() or (texts != texts[0]).any():
        return None
    order = "<" if messages[0][1] else ">"
    stamps = raw[:, 4:12].copy().view([("s", order + "i4"), ("ns", order + "u4")])[:, 0]
    start = numbers + 8 * sum(_width(topic, earlier) for earlier in range(place))
    values = raw[:, start : start + 8 * _width(topic, place)].copy().view(order + "f8")
    return stamps["s"].astype(np.int64) * 1_000_000_000 + stamps["ns"], values.astype(np.float64)


def _width(topic: Topic, place: int) -> int:
    """Return how many float64 a field holds; 0 for a stamp or a string."""
    count = cdr.LAYOUTS[topic.type_name][place]
    return count if isinstance(count, int) else 0


def named_type(channel: Channel) -> str:
    """Return "pkg/msg/Type", for the older "pkg/Type" too; what is no CDR is given its encoding and so fits no type."""
    type_name = channel.type_name
    if channel.encoding != "cdr":
        return f"{channel.encoding}:{type_name}"
    return type_name.replace("/", "/msg/") if type_name.count("/") == 1 else type_name


def _topic_of(bag: Bag, channel: Channel) -> Topic:
    """Return the topic a channel belongs to, new where it is the first: a topic may have several publishers."""
    kind = named_type(channel)
    topic = bag.topics.setdefault(channel.topic, Topic(channel.topic, kind))
    if topic.type_name != kind:
        raise LogError(
            f"{bag.path}: topic {topic.name} has both types {topic.type_name} and {kind}, expected one; give them "
            "names of their own and record again"
        )
    topic.qos = topic.qos or channel.metadata.get("offered_qos_profiles", "")
    return topic
