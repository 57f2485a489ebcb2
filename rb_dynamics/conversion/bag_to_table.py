"""Bags of other programs as tables: one row for each message, with its numbers as recorded and where they come from.

A table has the columns that its messages need: source, topic, type, frames, log time, stamp, and the quantities, each
with its unit at the end of its name. What a message does not have is empty. Memory does not grow with the bag.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.errors import LogError
from rb_dynamics.formats import message_types as types
from rb_dynamics.formats.bag_source import open_source
from rb_dynamics.formats.mcap_records import MessageBlock
from rb_dynamics.formats.tables import Column, Rows
from rb_dynamics.formats.topic_messages import Times, Topic, Values, unread_words
from rb_dynamics.formats.transforms import transforms
from rb_dynamics.logs.bag_reader import named_type

# Rows that are sorted by log time and written together.
_ROWS = 20_000


class Quantity(NamedTuple):
    """Numbers of a message that belong together: name, components, unit, and the unit as a column name ends in it.

    `units` are those of the components, if they differ.
    """

    name: str
    axes: tuple[str, ...]
    unit: str
    suffix: str
    units: tuple[str, ...] = ()

    @property
    def columns(self) -> list[Column]:
        """Of a table."""
        units = self.units or (self.unit,) * len(self.axes)
        parts = [filter(None, (self.name, axis, self.suffix)) for axis in self.axes]
        return [Column("_".join(part), unit=unit) for part, unit in zip(parts, units, strict=True)]


_XYZ, _XYZW = ("x", "y", "z"), ("x", "y", "z", "w")
POSITION = Quantity("position", _XYZ, "m", "m")
ORIENTATION = Quantity("orientation", _XYZW, "", "")
LINEAR_VELOCITY = Quantity("linear_velocity", _XYZ, "m/s", "m_s")
ANGULAR_VELOCITY = Quantity("angular_velocity", _XYZ, "rad/s", "rad_s")
LINEAR_ACCELERATION = Quantity("linear_acceleration", _XYZ, "m/s^2", "m_s2")
ANGULAR_ACCELERATION = Quantity("angular_acceleration", _XYZ, "rad/s^2", "rad_s2")
FORCE = Quantity("force", _XYZ, "N", "N")
TORQUE = Quantity("torque", _XYZ, "N m", "N_m")
VECTOR_PART = Quantity("vector", _XYZ, "", "")
MAGNETIC = Quantity("magnetic_field", _XYZ, "T", "T")
VALUE = Quantity("value", ("",), "", "")
MASS = Quantity("mass", ("",), "kg", "kg")
CENTER_OF_MASS = Quantity("center_of_mass", _XYZ, "m", "m")
INERTIA_PART = Quantity("inertia", ("xx", "xy", "xz", "yy", "yz", "zz"), "kg m^2", "kg_m2")

# Of each type: its quantities, and where each begins in the numbers of a `Topic`.
_POSE, _TWIST = ((POSITION, 0), (ORIENTATION, 3)), ((LINEAR_VELOCITY, 0), (ANGULAR_VELOCITY, 3))
QUANTITIES: dict[str, tuple[tuple[Quantity, int], ...]] = {
    **dict.fromkeys((types.POSE, types.POSE_WITH_COVARIANCE, types.TRANSFORM, types.PLAIN_POSE), _POSE),
    types.ODOMETRY: (*_POSE, (LINEAR_VELOCITY, 7), (ANGULAR_VELOCITY, 10)),
    **dict.fromkeys((types.TWIST, types.TWIST_WITH_COVARIANCE, types.PLAIN_TWIST), _TWIST),
    types.ACCELERATION: ((LINEAR_ACCELERATION, 0), (ANGULAR_ACCELERATION, 3)),
    types.IMU: ((ORIENTATION, 0), (ANGULAR_VELOCITY, 5), (LINEAR_ACCELERATION, 9)),
    **dict.fromkeys((types.WRENCH, types.PLAIN_WRENCH), ((FORCE, 0), (TORQUE, 3))),
    types.VECTOR: ((VECTOR_PART, 0),),
    types.SCALAR: ((VALUE, 0),),
    types.INERTIA: ((MASS, 0), (CENTER_OF_MASS, 1), (INERTIA_PART, 4)),
    types.QUATERNION: ((ORIENTATION, 0),),
    types.MAGNETIC_FIELD: ((MAGNETIC, 0),),
}
# Fields of the types that only tables have, and no analysis reads.
_FIELDS = {types.QUATERNION: (2,), types.MAGNETIC_FIELD: (2,)}

_SIX, _THREE = ("x", "y", "z", "rx", "ry", "rz"), ("x", "y", "z")
_PRODUCTS = {("", ""): "m^2", ("r", "r"): "rad^2"}
POSE_COVARIANCE, TWIST_COVARIANCE = (
    Quantity(
        f"{name}_covariance",
        tuple(f"{row}_{column}" for row in _SIX for column in _SIX),
        "",
        "",
        tuple(_PRODUCTS.get((row[:-1], column[:-1]), "m rad") + per for row in _SIX for column in _SIX),
    )
    for name, per in (("pose", ""), ("twist", "/s^2"))
)
_IMU_COVARIANCES = {
    measured: Quantity(
        f"{measured.name}_covariance", tuple(f"{row}_{column}" for row in _THREE for column in _THREE), unit, suffix
    )
    for measured, unit, suffix in (
        (ORIENTATION, "rad^2", "rad2"),
        (ANGULAR_VELOCITY, "rad^2/s^2", "rad2_s2"),
        (LINEAR_ACCELERATION, "m^2/s^4", "m2_s4"),
    )
}
# Of each type: its covariances, in their order, and the fields of its layout that hold them.
_COVARIANCES: dict[str, tuple[tuple[Quantity, ...], tuple[int, ...]]] = {
    types.POSE_WITH_COVARIANCE: ((POSE_COVARIANCE,), (3,)),
    types.TWIST_WITH_COVARIANCE: ((TWIST_COVARIANCE,), (3,)),
    types.ODOMETRY: ((POSE_COVARIANCE, TWIST_COVARIANCE), (4, 6)),
    types.IMU: (tuple(_IMU_COVARIANCES.values()), (3, 4, 6, 7, 9, 10)),
}
_ORDER = dict.fromkeys(quantity for parts in QUANTITIES.values() for quantity, _ in parts) | dict.fromkeys(
    quantity for parts, _ in _COVARIANCES.values() for quantity in parts
)
# Element 0 of the covariance of each quantity of an Imu: -1 where it is not measured.
_MEASURED = {ORIENTATION: 4, ANGULAR_VELOCITY: 8, LINEAR_ACCELERATION: 12}

PROVENANCE = (
    Column("source", "text"),
    Column("topic", "text"),
    Column("type", "text"),
    Column("frame_id", "text"),
    Column("child_frame_id", "text"),
    Column("log_time_ns", "whole", "ns"),
    Column("stamp_ns", "whole", "ns"),
)


@dataclass(frozen=True)
class Messages:
    """Messages of one topic as arrays.

    Attributes:
        topic: as recorded; "/tf PARENT:CHILD" for a pair of frames.
        type_name: message type.
        log_times: ns, (n,).
        stamps: ns, (n,); None for a type without header.
        frames: `header.frame_id` and `child_frame_id` of each; None if the type has none.
        values: (n, components) of each quantity.
    """

    topic: str
    type_name: str
    log_times: Times
    stamps: Times | None
    frames: list[tuple[str | None, str | None]] | None
    values: dict[Quantity, Values]


class Poses(NamedTuple):
    """Poses (n, 7) of the second of two frames in the first, at stamps (n,), from `topics`."""

    topics: str
    frames: tuple[str, str]
    stamps: Times
    values: Values

    def rows(self, source: str) -> Rows:
        """Return the rows of a table; rows composed of several messages have no log time."""
        count = len(self.stamps)
        texts = (source, self.topics, types.TRANSFORM, *self.frames)
        return [*([text] * count for text in texts), [None] * count, self.stamps.tolist(), *self.values.T.tolist()]


class Span(NamedTuple):
    """First and last log time (ns) that are wanted."""

    first_ns: float = -math.inf
    last_ns: float = math.inf

    def __contains__(self, time_ns: object) -> bool:
        """Return whether a time is wanted."""
        return isinstance(time_ns, int) and self.first_ns <= time_ns <= self.last_ns


ALL = Span()


Skip = Callable[[Path, LogError], None]
"""Called with each file and a description of what is left out of it, and why."""


@dataclass
class _Unread:
    """The messages of one topic that cannot be read, among those met so far: their number, the first, and its fault."""

    met: int = 0
    damaged: int = 0
    first: int = 0
    error: LogError | None = None

    def add(self, log_times: Times, rows: Sequence[int], error: LogError | None, span: Span) -> None:
        """Count the messages of one block, of which these rows are damaged; those outside of `span` are not wanted."""
        rows = [row for row in rows if int(log_times[row]) in span]
        if rows and not self.damaged:
            self.first, self.error = self.met + rows[0], error
        self.damaged += len(rows)
        self.met += len(log_times)


def messages_of(
    path: Path,
    topics: Sequence[str] = (),
    span: Span = ALL,
    covariances: bool = False,
    skip: Skip | None = None,
) -> Iterator[Messages]:
    """Yield the messages of a bag that have quantities, in blocks of one topic.

    Args:
        path: of the bag.
        topics: names of those that are wanted; all, if empty.
        span: log times that are wanted.
        covariances: whether they are wanted, too.
        skip: called, at the end, with each topic with damaged messages, which are left out; without it, or if no other
            message is wanted, they are an error.

    Raises:
        LogError: the bag cannot be read, or a message, see `skip`.
    """
    wanted, found = {name.lstrip("/") for name in topics}, False
    unread: dict[str, _Unread] = {}
    for block in open_source(path).blocks():
        parts, name = [block], block.channel.topic
        if named_type(block.channel) == types.TRANSFORMS:
            parts, rows, error = transforms(block)
            if not wanted or any(each.startswith(f"{name.lstrip('/')} ") for each in wanted):
                unread.setdefault(name, _Unread()).add(block.log_times, rows, error, span)
        for part in parts:
            kind, name = named_type(part.channel), part.channel.topic
            if kind in QUANTITIES and (not wanted or name.lstrip("/") in wanted):
                whole = _taken(part, kind)
                unread.setdefault(name, _Unread()).add(part.log_times, whole.damaged, whole.error, span)
                if len(whole.damaged) < whole.count:
                    messages = _within(_messages(part, whole, covariances), span)
                    found = found or bool(len(messages.log_times))
                    yield messages
        if skip is None:
            _refuse(unread)
    if not found:
        _refuse(unread)
    for name, lost in unread.items():
        if skip is not None and lost.damaged:
            skip(path, LogError(f"{path}: topic {name}: {unread_words(lost.damaged, lost.met, lost.first)}"))


def _refuse(unread: Mapping[str, _Unread]) -> None:
    """Raise the error of the first topic that has one."""
    for each in unread.values():
        if each.error is not None:
            raise each.error


def _taken(block: MessageBlock, kind: str, fields: tuple[int, ...] | None = None) -> Topic:
    """Return the messages of a block as arrays, with what is damaged among them counted."""
    topic = Topic(block.channel.topic, kind, bears=True, fields=fields or _FIELDS.get(kind))
    topic.take(block)
    with contextlib.suppress(LogError):
        _ = topic.numbers
    return topic


def _messages(block: MessageBlock, whole: Topic, covariances: bool) -> Messages:
    """Return those messages of a block that can be read."""
    kind, readable = whole.type_name, np.ones(whole.count, dtype=bool)
    readable[whole.damaged] = False
    topic = whole.only(readable) if whole.damaged else whole
    stamps, numbers, texts = topic.stamps, topic.numbers, topic.texts
    values = {quantity: numbers[:, begin : begin + len(quantity.axes)].copy() for quantity, begin in QUANTITIES[kind]}
    if covariances and kind in _COVARIANCES:
        parts, fields = _COVARIANCES[kind]
        spread = _taken(block, kind, fields).numbers[readable]
        values |= zip(parts, np.split(spread, len(parts), axis=1), strict=True)
    if kind == types.IMU:
        for quantity, said in _MEASURED.items():
            for part in (quantity, _IMU_COVARIANCES[quantity]):
                if part in values:
                    values[part][numbers[:, said] == -1.0] = np.nan
    frames: list[tuple[str | None, str | None]] | None = None
    if topic.stamped:
        row = np.searchsorted([start for start, _ in texts], np.arange(topic.count), side="right") - 1
        pairs: list[tuple[str | None, str | None]] = [
            (text[0], text[1] if len(text) > 1 else None) for _, text in texts
        ]
        frames = [pairs[k] for k in row.tolist()]
    return Messages(topic.name, kind, topic.log_times, stamps if topic.stamped else None, frames, values)


def _within(found: Messages, span: Span) -> Messages:
    if span == ALL:
        return found
    rows = (found.log_times >= span.first_ns) & (found.log_times <= span.last_ns)
    return replace(
        found,
        log_times=found.log_times[rows],
        stamps=None if found.stamps is None else found.stamps[rows],
        frames=found.frames and [pair for pair, wanted in zip(found.frames, rows.tolist(), strict=True) if wanted],
        values={quantity: values[rows] for quantity, values in found.values.items()},
    )


def quantities_of(
    kinds: Iterable[tuple[str, str]], where: str, topics: Sequence[str] = (), covariances: bool = False
) -> list[Quantity]:
    """Return which quantities there are, in the order of the columns.

    Args:
        kinds: topics and their types; a topic may have several.
        where: the name of the bags in error messages.
        topics: those that are wanted; all, if empty.
        covariances: whether they are wanted, too.

    Raises:
        LogError: there are none, or not the topics that are wanted.
    """
    pairs = {*kinds}
    wanted = {name.lstrip("/") for name in topics}
    here = [kind for name, kind in pairs if not wanted or name.lstrip("/") in wanted]
    found = {quantity for kind in here for quantity, _ in QUANTITIES.get(kind, ())}
    if covariances:
        found |= {part for kind in here for part in _COVARIANCES.get(kind, ((),))[0]}
    missing = sorted(wanted - {name.lstrip("/") for name, _ in pairs})
    if missing or not found:
        known = {pair for pair in pairs if pair[1] in QUANTITIES} or pairs
        listed = ", ".join(f"{name} ({kind})" for name, kind in sorted(known)) or "none"
        raise LogError(
            f"{where}: found {'no topic ' + missing[0] if missing else 'nothing to convert'}, expected a topic of a "
            f"pose, a twist, an IMU, a wrench or another type whose quantities are known; "
            + (f"those are {listed}: name one of these" if known is not pairs else f"the topics are {listed}")
        )
    return [quantity for quantity in _ORDER if quantity in found]


def table_of(
    bags: Sequence[Path],
    quantities: Sequence[Quantity],
    topics: Sequence[str] = (),
    spans: Mapping[Path, Span] = MappingProxyType({}),
    skip: Skip | None = None,
) -> Iterator[Rows]:
    """Yield the rows of a table of bags, one for each message, by log time within each block.

    `spans` says which log times are wanted of a bag; all, if it does not. `skip`: as in `messages_of`; called with each
    bag of several of which nothing can be read, too.
    """
    some = False
    covariances = any(quantity in parts for parts, _ in _COVARIANCES.values() for quantity in quantities)
    for path in bags:
        waiting: list[Messages] = []
        try:
            for each in messages_of(path, topics, spans.get(path, ALL), covariances, skip):
                some, waiting = True, waiting + ([each] if len(each.log_times) else [])
                if sum(len(part.log_times) for part in waiting) >= _ROWS:
                    yield _rows(str(path), waiting, quantities)
                    waiting = []
        except LogError as error:
            if skip is None or (path == bags[-1] and not some):
                raise
            skip(path, error)
        if waiting:
            yield _rows(str(path), waiting, quantities)


def columns_of(quantities: Sequence[Quantity]) -> list[Column]:
    """Return the columns of a table."""
    return [*PROVENANCE, *(column for quantity in quantities for column in quantity.columns)]


def _rows(source: str, parts: list[Messages], quantities: Sequence[Quantity]) -> Rows:
    order = np.argsort(np.concatenate([part.log_times for part in parts]), kind="stable")
    count = len(order)
    places = order.tolist()

    def texts(one: Sequence[Sequence[str | None]]) -> list[str | None]:
        flat = [text for each in one for text in each]
        return [flat[k] for k in places]

    nameless: list[tuple[str | None, str | None]] = [(None, None)]
    frames = [part.frames or nameless * len(part.log_times) for part in parts]
    stamps = [[None] * len(part.log_times) if part.stamps is None else part.stamps.tolist() for part in parts]
    flat_stamps = [stamp for each in stamps for stamp in each]
    block: list[Sequence[object] | None] = [
        [source] * count,
        texts([[part.topic] * len(part.log_times) for part in parts]),
        texts([[part.type_name] * len(part.log_times) for part in parts]),
        texts([[pair[0] for pair in each] for each in frames]),
        texts([[pair[1] for pair in each] for each in frames]),
        np.concatenate([part.log_times for part in parts])[order].tolist(),
        [flat_stamps[k] for k in places],
    ]
    for quantity in quantities:
        block += _cells(parts, quantity, order)
    return block


def _cells(parts: list[Messages], quantity: Quantity, order: NDArray[np.intp]) -> list[Sequence[object] | None]:
    """Return the columns of a quantity; a row whose message does not have it is None."""
    if not any(quantity in part.values for part in parts):
        return [None] * len(quantity.axes)
    empty = np.full((1, len(quantity.axes)), None, dtype=object)
    rows = []
    for part in parts:
        if quantity in part.values:
            rows.append(part.values[quantity].astype(object))
            if part.type_name == types.IMU:
                rows[-1][np.isnan(part.values[quantity])] = None
        else:
            rows.append(np.repeat(empty, len(part.log_times), axis=0))
    return [column.tolist() for column in np.concatenate(rows)[order].T]
