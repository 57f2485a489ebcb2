"""Read a ROS 2 bag: poses, twists, wrenches and scalars as arrays.

The bag may come from any writer and may be cut off. Reading needs neither ROS nor the index of the file.
`topic_messages.py` says what is kept of each message.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from rb_dynamics.errors import LogError
from rb_dynamics.formats import message_types as types
from rb_dynamics.formats.bag_source import FileBoundary, SplitBag, open_source
from rb_dynamics.formats.channel_metadata import QOS
from rb_dynamics.formats.log_metadata import (
    DAMAGED,
    INTERRUPTED,
    MISSING_FILES,
    RESULT,
    RUN,
    TOPICS,
    UNPLACED,
    in_simulation_time,
    loss,
    missing_pieces,
    next_file,
    part_ns,
)
from rb_dynamics.formats.mcap_records import McapChannel
from rb_dynamics.formats.message_fields import is_other
from rb_dynamics.formats.message_types import COMMAND
from rb_dynamics.formats.topic_messages import Times, Topic, Values
from rb_dynamics.formats.transforms import transforms
from rb_dynamics.loads.actuator import Actuator
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.logs.own_log import logged_scene, require_types
from rb_dynamics.logs.stamp_clock import APART_NS, ClockLine, StampClock
from rb_dynamics.logs.unset_stamps import UnsetStamps

# Of each kind of quantity: the types that carry it, and where it stands in the numbers of a `Topic`.
# In the order in which they are preferred.
POSES = dict.fromkeys(
    (types.POSE, types.ODOMETRY, types.POSE_WITH_COVARIANCE, types.TRANSFORM, types.PLAIN_POSE), slice(0, 7)
)
TWISTS = dict.fromkeys((types.TWIST, types.ODOMETRY, types.TWIST_WITH_COVARIANCE, types.PLAIN_TWIST), slice(0, 6)) | {
    types.ODOMETRY: slice(7, 13)
}
IMUS = {types.IMU: slice(0, 13)}
ATTITUDES = {types.QUATERNION: slice(0, 4)}
_VECTORS = {types.VECTOR: slice(0, 3)}
_SCALARS = {types.SCALAR: slice(0, 1)}
WRENCHES = {types.PLAIN_WRENCH: slice(0, 6), types.WRENCH: slice(0, 6)}


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
        boundaries: where one file ends and the next begins, of several in which nothing is missing between the two.
        pairs: names of the topics that are a pair of frames.
        cut_ns: first and last log time of the part that was taken out of what was recorded, without what is held from
            before; None: this is the whole.
        window_ns: first and last time of such a part as they were asked for, on the clock of the motion.
        zero_ns: from when times of such a part count, as those of the whole do; None: from the start of the motion.
        unset: how many commands on a topic had a stamp of 0 that nobody set beside others: their stamps here are their
            log times, put on the clock of the stamps.

    Each pair of frames on a topic of TFMessage is a topic of its own too, named "/tf PARENT:CHILD", of
    TransformStamped; but not in a log of this package, where /tf says what the pose says.
    """

    path: Path
    complete: bool
    topics: dict[str, Topic]
    metadata: dict[str, dict[str, str]]
    attachments: dict[str, bytes]
    whole: bool = True
    boundaries: tuple[FileBoundary, ...] = ()
    pairs: set[str] = field(default_factory=set)
    cut_ns: tuple[int, int] | None = None
    window_ns: tuple[int, int] | None = None
    zero_ns: int | None = None
    unset: dict[str, int] = field(default_factory=dict)

    @property
    def begins_later(self) -> bool:
        """Whether this is a part that does not begin at time 0: counts of a node are those of the run until then."""
        return self.window_ns is not None and self.window_ns[0] > 0

    @property
    def actuated(self) -> list[str]:
        """Names of the topics that are taken for commands to actuators: numbers on NAME/command."""
        return sorted(
            name for name, topic in self.topics.items() if topic.type_name == types.SCALAR and name.endswith(COMMAND)
        )

    def actuated_of(self, actuator: Actuator) -> list[str]:
        """Return the names of the topics that are taken for commands to one actuator, in any namespace."""
        name = self.called(actuator.topic)
        return [each for each in self.actuated if each == name or f"/{each}".endswith(f"/{actuator.topic}")]

    @property
    def ended(self) -> bool:
        """Whether the end of what was recorded is there, whatever is missing within."""
        if self.next_file:
            return False
        reason = self.metadata.get(INTERRUPTED, {}).get("reason")
        return self.complete or RESULT in self.metadata or (self.whole and reason == DAMAGED)

    @property
    def next_file(self) -> str:
        """The missing file in which the last one here says that it continues; "" if none is missing."""
        return next_file(self.metadata)

    @property
    def missing_files(self) -> list[str]:
        """Names of files that are not here although later ones are."""
        return [*filter(None, self.metadata.get(INTERRUPTED, {}).get(MISSING_FILES, "").split(", "))]

    @property
    def missing(self) -> list[tuple[int, int]]:
        """First and last log time (ns) of each piece that is not here, in order: damaged, or between two files."""
        return missing_pieces(self.metadata)

    @property
    def unplaced(self) -> bool:
        """Whether something may be missing of which no time is known."""
        return UNPLACED in self.metadata.get(INTERRUPTED, {}).get("missing_ns", "")

    def called(self, name: str) -> str:
        """Return what the topic `name` of the scene is called in a log of this package."""
        return self.metadata.get(TOPICS, {}).get(name, name if name.startswith("/") else f"/{name}")

    def poses(self, topic: str) -> tuple[Times, Values]:
        """Return stamps (ns) and rows of position (m) and quaternion x, y, z, w; of a type in `POSES`.

        Raises:
            LogError: no such topic, another type, or a damaged message; so for the functions below.
        """
        return self._series(topic, POSES)

    def attitudes(self, topic: str) -> tuple[Times, Values]:
        """Return stamps (ns) and quaternions x, y, z, w; of QuaternionStamped, as of a star tracker."""
        return self._series(topic, ATTITUDES)

    def twists(self, topic: str) -> tuple[Times, Values]:
        """Return stamps (ns) and rows of linear (m/s) and angular (rad/s) velocity; of a type in `TWISTS`."""
        return self._series(topic, TWISTS)

    def imus(self, topic: str) -> tuple[Times, Values]:
        """Return stamps (ns) and rows of quaternion, angular velocity (rad/s) and specific force (m/s^2); of Imu.

        A part that the sensor does not measure, as element 0 of its covariance says, is NaN.
        """
        times, rows = self._series(topic, IMUS)
        parts = ((slice(0, 4), 4), (slice(5, 8), 8), (slice(9, 12), 12))
        return times, np.hstack([np.where(rows[:, [said]] == -1.0, np.nan, rows[:, part]) for part, said in parts])

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
        starts, texts = zip(*source.texts, strict=True) if source.texts else ((), ())
        frames = [text[0] if text else "" for text in texts]
        of_row = np.searchsorted(starts, np.arange(source.count), side="right") - 1
        columns = (source.log_times.tolist(), of_row.tolist(), source.stamps.tolist(), source.numbers.tolist())
        return [
            (at, Wrench((fx, fy, fz), (tx, ty, tz), frames[k], stamp_ns))
            for at, k, stamp_ns, (fx, fy, fz, tx, ty, tz) in zip(*columns, strict=True)
        ]

    def _series(self, topic: str, columns: Mapping[str, slice]) -> tuple[Times, Values]:
        source = self._topic(topic, columns)
        return source.stamps, source.numbers[:, columns[source.type_name]]

    def _topic(self, name: str, expected: Mapping[str, slice]) -> Topic:
        topic = self.topics.get(name)
        if topic is None or topic.type_name not in expected:
            found = "no such topic" if topic is None else f"type {topic.type_name!r}"
            usable = [other.name for other in self.topics.values() if other.type_name in expected]
            raise LogError(
                f"{self.path}: topic {name!r}: {found}, expected {' or '.join(expected)}; the file has {usable}"
            )
        return topic


def read_bag(path: str | os.PathLike[str], repeated: bool = True) -> Bag:
    """Return what is in a bag: an MCAP file, or whatever `open_source` reads.

    Without `repeated` the numbers of an Odometry that says again what pose and twist of a log of this package say are
    left out.

    Raises:
        LogError: the bag cannot be read or is damaged; of a log of this package also where a topic has another type.
    """
    file = open_source(Path(path))
    bag = Bag(file.path, False, {}, file.metadata, file.attachments)
    for block in file.blocks():
        topic = _topic_of(bag, block.channel, repeated)
        topic.take(block)
        if topic.type_name == types.TRANSFORMS and RUN not in bag.metadata:
            found = transforms(block)
            topic.lose(found.damaged, found.error)
            for part in found.blocks:
                _topic_of(bag, part.channel, repeated).take(part)
                bag.pairs.add(part.channel.topic)
    for channel in file.channels.values():
        _topic_of(bag, channel, repeated)
    alike: dict[tuple[int, ...], Times] = {}
    for topic in bag.topics.values():
        topic.join(alike)
    if RUN in file.metadata:
        require_types(file, logged_scene(file.attachments))
        # In a bag of several files RUN is known only when the first one has been read.
        for name in bag.pairs:
            del bag.topics[name]
        bag.pairs.clear()
    if not in_simulation_time(file.metadata):
        _stamp_commands(bag)
    bag.whole = file.complete
    bag.boundaries = tuple(file.boundaries) if isinstance(file, SplitBag) else ()
    bag.complete = not loss(file.complete, file.metadata)
    bag.cut_ns = part_ns(file.metadata)
    return bag


def _stamp_commands(bag: Bag) -> None:
    """Give commands of which nobody set the stamp, beside others, that of when they were recorded."""
    for topic in bag.topics.values():
        if topic.type_name != types.WRENCH or not topic.count or not topic.stamps_given:
            continue
        stamps = UnsetStamps()
        stamps.add(topic.log_times, topic.stamps)
        if found := stamps.found:
            rows = found.among(topic.log_times, topic.stamps)
            bag.unset[topic.name] = int(rows.sum())
            topic.stamp(rows, found.placed(topic.log_times[rows], _line_of(bag, topic)))


def _line_of(bag: Bag, commands: Topic) -> ClockLine:
    """Return how log times of commands follow their stamps: as those of the motion do, unless its clock is another."""
    own = StampClock.of(commands.log_times, commands.stamps).line
    moving = [each for each in bag.topics.values() if each.type_name in {*POSES, *TWISTS, *IMUS} and each.count]
    lines = [StampClock.of(each.log_times, each.stamps).line for each in moving if each.stamps_given]
    of_motion = min(lines, key=lambda each: abs(each.behind_ns), default=own)
    apart_ns = own.behind_ns - int(of_motion.behind(np.array(own.begin_ns)))
    line = of_motion if abs(apart_ns) <= APART_NS else own
    return replace(line, behind_ns=0) if line.one_clock else line


def named_type(channel: McapChannel) -> str:
    """Return "pkg/msg/Type", for the older "pkg/Type" too.

    A type that is not CDR, or that the bag defines with other fields, gets a prefix, so that it is no known type.
    """
    type_name = channel.type_name
    if channel.encoding != "cdr":
        return f"{channel.encoding}:{type_name}"
    if is_other(channel.schema):
        return f"other fields:{type_name}"
    return type_name.replace("/", "/msg/") if type_name.count("/") == 1 else type_name


def _topic_of(bag: Bag, channel: McapChannel, repeated: bool) -> Topic:
    """Return the topic a channel belongs to, new where it is the first: a topic may have several publishers."""
    kind, topic = named_type(channel), bag.topics.get(channel.topic)
    if topic is None:
        keeps = (
            repeated
            or kind != types.ODOMETRY
            or RUN not in bag.metadata
            or not ({types.POSE, types.TWIST} <= {topic.type_name for topic in bag.topics.values() if topic.count})
        )
        topic = bag.topics[channel.topic] = Topic(channel.topic, kind, keeps, bears=True)
    if topic.type_name != kind:
        raise LogError(
            f"{bag.path}: topic {topic.name} has both types {topic.type_name} and {kind}, expected one; give them "
            "names of their own and record again"
        )
    topic.qos = topic.qos or channel.metadata.get(QOS, "")
    return topic
