"""`Topic`: the messages of one topic of a bag as arrays, with a few bytes of overhead for each message."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.errors import LogError
from rb_dynamics.formats import cdr
from rb_dynamics.formats import message_types as types
from rb_dynamics.formats.mcap_records import MessageBlock
from rb_dynamics.numerics.growing_array import GrowingArray

Times = NDArray[np.int64]
Values = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Prints = NDArray[np.uint64]

# Of each type that is kept as numbers: which of its fields they are. Covariances are not kept, but for those elements
# of an Imu that say whether a quantity was measured.
KEPT = {
    kind: tuple(k for k, field in enumerate(cdr.LAYOUTS[kind]) if isinstance(field, int) and field not in (8, 36))
    for kind in (
        *(types.POSE, types.PLAIN_POSE, types.POSE_WITH_COVARIANCE, types.TRANSFORM),
        *(types.TWIST, types.PLAIN_TWIST, types.TWIST_WITH_COVARIANCE, types.ODOMETRY, types.ACCELERATION, types.IMU),
        *(types.WRENCH, types.PLAIN_WRENCH, types.VECTOR, types.SCALAR, types.INERTIA, types.QUATERNION),
    )
}
_BATCH = 512


class Topic:
    """The messages of one topic, in the order of the file.

    Attributes:
        name: as recorded.
        type_name: message type, such as "std_msgs/msg/Float64"; with the encoding before it where that is not CDR.
        qos: `offered_qos_profiles` as recorded, YAML; "" if the writer gave none.
        count: messages.
        messages: the bytes of each message that is not damaged, of DiagnosticArray alone: what is not kept as numbers.
        damaged: rows of messages that are cut short or not CDR: their numbers are NaN, their stamps the log times.
        error: what is wrong with the first of them; None if there are none.
    """

    def __init__(
        self,
        name: str,
        type_name: str,
        keeps: bool = True,
        bears: bool = False,
        fields: tuple[int, ...] | None = None,
    ) -> None:
        """Begin with no message.

        Args:
            name: as recorded.
            type_name: of its messages.
            keeps: keep the numbers of those to come, or else only their fingerprints.
            bears: count damaged messages, unless all are; or else one is an error.
            fields: which fields are kept, by their place in the layout; None: those of `KEPT`.
        """
        self.name, self.type_name, self.qos = name, type_name, ""
        self.count = 0
        self.messages: list[bytes] = []
        self.damaged: list[int] = []
        self._fields = KEPT.get(type_name, ()) if fields is None else fields
        self._keeps, self._bears = keeps, bears
        self._numbers_of_one = sum(_length(type_name, field) for field in self._fields)
        # Numbers of a message that are kept, or fingerprints.
        self._width = self._numbers_of_one if keeps else len(self._fields)
        self._form: _Form | None = None
        self._times: list[Times] = []
        # Content of messages of which the numbers are not taken yet; rows of one array are of one length.
        self._waiting: list[Bytes] = []
        self.error: LogError | None = None
        # Stamps are mostly the log times: they are kept apart from the first on that is not.
        self._stamps: GrowingArray | None = None
        self._numbers = GrowingArray()
        # First row, and the strings of a message, from where they change on.
        self._texts: list[tuple[int, tuple[str, ...]]] = []

    def take(self, block: MessageBlock) -> None:
        """Add messages."""
        self._times.append(block.log_times)
        self.count += len(block.log_times)
        if self._fields and (self.error is None or self._bears):
            enough = self.count - len(self._numbers) // self._width >= _BATCH
            self._waiting += block.rows() if enough else [rows.copy() for rows in block.rows()]
            if enough:
                self._take()
        elif self.type_name == types.DIAGNOSTICS:
            content = (row.tobytes() for rows in block.rows() for row in rows)
            for row, message in enumerate(content, self.count - len(block.log_times)):
                try:
                    cdr.decode(self.type_name, message)
                    self.messages.append(message)
                except LogError:
                    self.damaged.append(row)

    def lose(self, rows: Sequence[int], error: LogError | None) -> None:
        """Count as damaged these rows of the block that was added last; of a type whose numbers are not kept here."""
        begin = self.count - len(self._times[-1])
        self.damaged += [begin + row for row in rows]
        self.error = self.error or (error and LogError(f"topic {self.name}: {error}"))

    @property
    def unread(self) -> str:
        """How many of its messages are damaged, and which is the first, as text."""
        return unread_words(len(self.damaged), self.count, self.damaged[0])

    def join(self, alike: dict[tuple[int, ...], Times]) -> None:
        """Put the log times into one array, that of another topic in `alike` where it has the same blocks of times."""
        times = alike.setdefault(tuple(map(id, self._times)), self.log_times)
        self._times = [times] if len(times) else []

    def only(self, rows: NDArray[np.bool_]) -> Topic:
        """Return the topic with these of its messages."""
        self._taken()
        kept = Topic(self.name, self.type_name, self._keeps, self._bears, self._fields)
        kept.qos, kept.count = self.qos, int(rows.sum())
        kept._times = [self.log_times[rows]]
        if self._stamps is not None:
            kept._stamps = GrowingArray()
            kept._stamps.add(self.stamps[rows])
        if self._width:
            kept._numbers.add(self._numbers.view("u8").reshape(self.count, self._width)[rows])
        before = np.concatenate([[0], np.cumsum(rows)]).tolist()
        texts = {before[row]: text for row, text in self._texts}
        kept._texts = [(row, text) for row, text in texts.items() if row < kept.count]
        kept.damaged = [int(before[row]) for row in self.damaged if rows[row]]
        readable = np.delete(rows, self.damaged).tolist()
        kept.messages = [message for message, keep in zip(self.messages, readable, strict=False) if keep]
        return kept

    @property
    def log_times(self) -> Times:
        """Times (ns) at which the messages were logged."""
        if len(self._times) > 1:
            self._times = [np.concatenate(self._times)]
        return self._times[0] if self._times else np.empty(0, np.int64)

    @property
    def stamped(self) -> bool:
        """Whether its messages have a header; False of a type whose fields are not known."""
        return cdr.LAYOUTS.get(self.type_name, ("",))[0] == cdr.STAMP

    @property
    def stamps(self) -> Times:
        """Stamps (ns); the log times of a type without header.

        Raises:
            LogError: a message is cut short or not CDR; likewise of `numbers` and `texts`.
        """
        self._taken()
        return self.log_times if self._stamps is None else self._stamps.view("i8")

    def stamp(self, rows: NDArray[np.bool_], stamps: Times) -> None:
        """Give these of its messages other `stamps` (ns), one for each."""
        every = self.stamps.copy()
        every[rows] = stamps
        self._stamps = GrowingArray()
        self._stamps.add(every)

    def move(self, moved: Callable[[Times], Times]) -> None:
        """Put log times and stamps on another clock; messages that get one stamp then come in the order of theirs."""
        before, self._times = self.stamps, [moved(self.log_times)]
        stamps = moved(before)
        order = np.empty(self.count, dtype=np.intp)
        order[np.argsort(stamps, kind="stable")] = np.lexsort((before, stamps))
        self.stamp(np.ones(self.count, dtype=bool), stamps)
        if np.array_equal(order, np.arange(self.count)):
            return
        if self._width:
            rows = self._numbers.view("u8").reshape(self.count, self._width)[order]
            self._numbers = GrowingArray()
            self._numbers.add(rows)
        begins = [row for row, _ in self._texts]
        of_row = (np.searchsorted(begins, order, side="right") - 1).tolist()
        changes = [row for row, text in enumerate(of_row) if not row or text != of_row[row - 1]]
        self._texts = [(row, self._texts[of_row[row]][1]) for row in changes if of_row[row] >= 0]
        self.damaged = np.flatnonzero(np.isin(order, self.damaged)).tolist()

    @property
    def stamps_given(self) -> bool:
        """Whether its messages have a header, and one of them a time in it."""
        return self.stamped and bool(self.stamps.any())

    @property
    def numbers(self) -> Values:
        """One row for each message, of its numbers in their order; without covariances. Empty if they are not kept."""
        self._taken()
        return self._numbers.view("f8").reshape(self.count, self._width) if self._keeps else np.empty((self.count, 0))

    def fingerprints(self, rows: slice | NDArray[np.intp]) -> Prints:
        """Return for each message one whole number for each of its fields: equal for equal bits, else hardly ever."""
        self._taken()
        if self._keeps:
            return _fingerprints(self.type_name, self._fields, self.numbers[rows])
        found: Prints = self._numbers.view("u8").reshape(self.count, self._width)[rows]
        return found

    @property
    def texts(self) -> list[tuple[int, tuple[str, ...]]]:
        """The strings of a message, where they change: from which row on, and what they are from there."""
        self._taken()
        return self._texts

    @property
    def kinds(self) -> tuple[list[tuple[str, ...]], NDArray[np.intp]]:
        """The different strings of messages, commonest first, and which each message has; -1 for a damaged one."""
        texts, numbers = self.texts, dict[tuple[str, ...], int]()
        of_text = [numbers.setdefault(text, len(numbers)) for _, text in texts]
        ends = [*(row for row, _ in texts[1:]), self.count][: len(texts)]
        of_row = np.repeat(np.array(of_text, dtype=np.intp), np.diff([0, *ends]))
        of_row[self.damaged] = -1
        order = np.argsort(-np.bincount(of_row[of_row >= 0], minlength=len(numbers)), kind="stable")
        different = list(numbers)
        return [different[k] for k in order], np.append(np.argsort(order), -1)[of_row]

    def decoded(self) -> list[tuple[Any, ...]]:
        """Return the values of each of `messages`, see `cdr.decode`."""
        return [cdr.decode(self.type_name, message) for message in self.messages]

    def _taken(self) -> None:
        """Take what waits.

        Raises:
            LogError: a message could not be taken.
        """
        if self._waiting:
            self._take()
        if self.error is not None and (not self._bears or len(self.damaged) == self.count):
            raise self.error

    def _take(self) -> None:
        waiting, self._waiting = self._waiting, []
        try:
            stamps, numbers, texts = self._alike(waiting) or self._one_by_one(waiting)
        except LogError as error:
            self.error = LogError(f"topic {self.name}: {error}")
            return
        begin = len(self._numbers) // self._width
        if self.stamped:
            if self._stamps is None and (stamps != self._last_times(len(stamps))).any():
                self._stamps = GrowingArray()
                self._stamps.add(self.log_times[:begin])
            if self._stamps is not None:
                self._stamps.add(stamps)
        kept = numbers if self._keeps else _fingerprints(self.type_name, self._fields, numbers)
        self._numbers.add(kept)
        for row, text in texts:
            if not self._texts or self._texts[-1][1] != text:
                self._texts.append((begin + row, text))

    def _last_times(self, count: int) -> Times:
        """Return the log times of the last `count` messages."""
        parts: list[Times] = []
        for part in reversed(self._times):
            if count <= 0:
                break
            parts.append(part[-count:])
            count -= len(part)
        return np.concatenate(parts[::-1])

    def _alike(self, waiting: list[Bytes]) -> tuple[Times, Values, list[tuple[int, tuple[str, ...]]]] | None:
        """Return stamps, numbers and strings straight from the bytes; None unless only stamps and numbers differ."""
        if any(messages.shape[1] != waiting[0].shape[1] for messages in waiting):
            return None
        raw = waiting[0] if len(waiting) == 1 else np.concatenate(waiting)
        if self._form is None or not self._form.fits(raw):
            try:
                self._form = _Form(self.type_name, self._fields, raw[0].tobytes())
            except LogError:
                return None
            if not self._form.fits(raw):
                return None
        stamps = self._form.stamps(raw) if self.stamped else np.empty(0, np.int64)
        return stamps, self._form.numbers(raw), [(0, self._form.texts)]

    def _one_by_one(self, waiting: list[Bytes]) -> tuple[Times, Values, list[tuple[int, tuple[str, ...]]]]:
        content = [message.tobytes() for messages in waiting for message in messages]
        begin = len(self._numbers) // self._width
        stamps, numbers = self._last_times(len(content)).copy(), np.full((len(content), self._numbers_of_one), np.nan)
        texts: list[tuple[int, tuple[str, ...]]] = []
        for k, message in enumerate(content):
            try:
                row = cdr.decode(self.type_name, message)
            except LogError as error:
                if not self._bears:
                    raise
                self.error = self.error or LogError(f"topic {self.name}: {error}")
                self.damaged.append(begin + k)
                continue
            stamps[k] = row[0] if self.stamped else 0
            numbers[k] = [*itertools.chain.from_iterable(row[field] for field in self._fields)]
            texts.append((k, tuple(value for value in row if isinstance(value, str))))
        return stamps, numbers, texts


def unread_words(damaged: int, count: int, first: int) -> str:
    """Return how many of `count` messages are damaged, and which is the first, as text; rows count from 0."""
    return f"{damaged} of {count} messages are cut short or damaged, the first is number {first + 1}"


class _Form:
    """What messages have in common of which only stamps and numbers differ.

    Attributes:
        texts: the strings in each.
    """

    def __init__(self, type_name: str, fields: tuple[int, ...], message: bytes) -> None:
        """Take it from one of the messages; of the numbers, `fields` are kept.

        Raises:
            LogError: it is cut short or not CDR.
        """
        self.texts = tuple(value for value in cdr.decode(type_name, message) if isinstance(value, str))
        begin = cdr.first_number(type_name, message)
        self._length = len(message)
        # Without a stamp, the numbers begin before where strings would.
        self._same = [(part, message[part]) for part in (slice(0, 2), slice(12, begin))]
        self._order = "<" if message[1] else ">"
        self._columns: list[slice] = []
        for field in fields:
            at = begin + 8 * sum(_length(type_name, earlier) for earlier in range(field))
            self._columns.append(slice(at, at + 8 * _length(type_name, field)))

    def fits(self, raw: Bytes) -> bool:
        """Whether it is that of all of these messages, (n, length)."""
        # Copies are compared three times as fast as rows that lie apart.
        return raw.shape[1] == self._length and all(
            raw[:, part].tobytes() == same * len(raw) for part, same in self._same
        )

    def stamps(self, raw: Bytes) -> Times:
        """Return the stamps of messages that have one."""
        times = raw[:, 4:8].view(self._order + "i4")[:, 0].astype(np.int64)
        times *= 1_000_000_000
        times += raw[:, 8:12].view(self._order + "u4")[:, 0]
        return times

    def numbers(self, raw: Bytes) -> Values:
        """Return the numbers of each message."""
        columns = [raw[:, column].copy().view(self._order + "f8") for column in self._columns]
        numbers = columns[0] if len(columns) == 1 else np.concatenate(columns, axis=1)
        return numbers.astype(np.float64, copy=False)


def _fingerprints(type_name: str, fields: tuple[int, ...], numbers: Values) -> Prints:
    """Return a sum of the bits of the numbers of each field, each times an odd number: a changed number changes it."""
    bits = np.ascontiguousarray(numbers).view(np.uint64)
    ends = list(itertools.accumulate(_length(type_name, field) for field in fields))
    parts = [bits[:, begin:end] for begin, end in itertools.pairwise([0, *ends])]
    factors = 0x9E3779B97F4A7C15 * np.arange(1, 2 * max(ends, default=0), 2, dtype=np.uint64)
    return np.stack([part @ factors[: part.shape[1]] for part in parts], axis=1)


def _length(type_name: str, field: int) -> int:
    """Return how many float64 a field holds; 0 for a stamp or a string."""
    count = cdr.LAYOUTS[type_name][field]
    return count if isinstance(count, int) else 0
