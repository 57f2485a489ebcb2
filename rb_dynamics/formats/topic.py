"""`Topic`: the messages of one topic of a bag as arrays, with a few bytes of overhead for each message."""

from __future__ import annotations

import itertools
from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.errors import LogError
from rb_dynamics.formats import cdr
from rb_dynamics.formats.messages import (
    DIAGNOSTICS,
    INERTIA,
    ODOMETRY,
    PLAIN_WRENCH,
    POSE,
    SCALAR,
    TWIST,
    VECTOR,
    WRENCH,
)

Times = NDArray[np.int64]
Values = NDArray[np.float64]

# Of each type that is kept as numbers: which of its fields they are. The covariances of an Odometry are not kept.
KEPT = {
    POSE: (2,),
    TWIST: (2,),
    VECTOR: (2,),
    SCALAR: (0,),
    INERTIA: (2,),
    WRENCH: (2,),
    PLAIN_WRENCH: (0,),
    ODOMETRY: (3, 5),
}
_BATCH = 1024


class Topic:
    """The messages of one topic, in the order of the file.

    Attributes:
        name: as recorded.
        type_name: message type, such as "std_msgs/msg/Float64"; with the encoding before it where that is not CDR.
        qos: `offered_qos_profiles` as recorded, YAML; "" where the writer gave none.
        log_times: ns, one for each message.
        messages: the bytes of each message, of DiagnosticArray alone: what is not kept as numbers.
    """

    def __init__(self, name: str, type_name: str, keeps: bool = True) -> None:
        """Begin with no message; of those to come only the times are kept if not `keeps`."""
        self.name, self.type_name, self.qos = name, type_name, ""
        self.log_times = array("q")
        self.messages: list[bytes] = []
        self._fields = KEPT.get(type_name, ()) if keeps else ()
        self._waiting: list[bytes] = []
        self._error: LogError | None = None
        # Stamps are mostly the log times: they are kept apart from the first on that is not.
        self._stamps: array[int] | None = None
        self._numbers = array("d")
        # First row, and the strings of a message, from where they change on.
        self._texts: list[tuple[int, tuple[str, ...]]] = []

    def add(self, log_time: int, data: bytes) -> None:
        """Add one message."""
        self.log_times.append(log_time)
        if self._fields and self._error is None:
            self._waiting.append(data)
            if len(self._waiting) == _BATCH:
                self._take()
        elif self.type_name == DIAGNOSTICS:
            self.messages.append(data)

    @property
    def count(self) -> int:
        """Number of messages."""
        return len(self.log_times)

    @property
    def stamped(self) -> bool:
        """Whether its messages have a header."""
        return cdr.LAYOUTS[self.type_name][0] == cdr.STAMP

    @property
    def stamps(self) -> Times:
        """Stamps (ns); the log times of a type without header.

        Raises:
            LogError: a message is cut short or not CDR; likewise of `numbers` and `texts`.
        """
        self._taken()
        return _view(self.log_times if self._stamps is None else self._stamps, "i8")

    @property
    def stamps_given(self) -> bool:
        """Whether its messages have a header, and one of them a time in it."""
        return self.stamped and bool(self.stamps.any())

    @property
    def numbers(self) -> Values:
        """One row for each message, of its numbers in their order; without covariances."""
        self._taken()
        return _view(self._numbers, "f8").reshape(self.count, self._width)

    @property
    def texts(self) -> list[tuple[int, tuple[str, ...]]]:
        """The strings of a message, where they change: from which row on, and what they are from there."""
        self._taken()
        return self._texts

    def decoded(self) -> list[tuple[Any, ...]]:
        """Return the values of each of `messages`, see `cdr.decode`.

        Raises:
            LogError: a message is cut short or not CDR.
        """
        return [cdr.decode(self.type_name, message) for message in self.messages]

    @property
    def _width(self) -> int:
        return sum(_length(self.type_name, field) for field in self._fields)

    def _taken(self) -> None:
        """Take what waits.

        Raises:
            LogError: a message could not be taken.
        """
        if self._waiting:
            self._take()
        if self._error is not None:
            raise self._error

    def _take(self) -> None:
        batch, self._waiting = self._waiting, []
        try:
            stamps, numbers, texts = _alike(self.type_name, self._fields, batch) or self._one_by_one(batch)
        except LogError as error:
            self._error = error
            return
        begin = len(self._numbers) // self._width
        if self.stamped:
            times = _view(self.log_times, "i8")[begin : begin + len(batch)]
            if self._stamps is None and (stamps != times).any():
                self._stamps = self.log_times[:begin]
            if self._stamps is not None:
                self._stamps.frombytes(stamps.tobytes())
        self._numbers.frombytes(numbers.tobytes())
        for row, text in texts:
            if not self._texts or self._texts[-1][1] != text:
                self._texts.append((begin + row, text))

    def _one_by_one(self, batch: list[bytes]) -> tuple[Times, Values, list[tuple[int, tuple[str, ...]]]]:
        rows = [cdr.decode(self.type_name, message) for message in batch]
        stamps = np.array([row[0] if self.stamped else 0 for row in rows], dtype=np.int64)
        numbers = [list(itertools.chain.from_iterable(row[field] for field in self._fields)) for row in rows]
        texts = [tuple(value for value in row if isinstance(value, str)) for row in rows]
        return stamps, np.array(numbers, dtype=np.float64), list(enumerate(texts))


def _alike(
    type_name: str, fields: tuple[int, ...], batch: list[bytes]
) -> tuple[Times, Values, list[tuple[int, tuple[str, ...]]]] | None:
    """Return stamps, numbers and strings straight from the bytes; None unless only stamps and numbers differ."""
    first = batch[0]
    if any(len(message) != len(first) for message in batch):
        return None
    texts = tuple(value for value in cdr.decode(type_name, first) if isinstance(value, str))
    raw = np.frombuffer(b"".join(batch), dtype=np.uint8).reshape(len(batch), -1)
    begin = cdr.first_number(type_name, first)
    same = raw[:, 12:begin]
    if (raw[:, :2] != raw[0, :2]).any() or (same != same[0]).any():
        return None
    order = "<" if first[1] else ">"
    columns = []
    for field in fields:
        at = begin + 8 * sum(_length(type_name, earlier) for earlier in range(field))
        columns.append(raw[:, at : at + 8 * _length(type_name, field)].copy().view(order + "f8"))
    stamps = raw[:, 4:12].copy().view([("s", order + "i4"), ("ns", order + "u4")])[:, 0]
    times = stamps["s"].astype(np.int64) * 1_000_000_000 + stamps["ns"]
    return times, np.concatenate(columns, axis=1).astype(np.float64), [(0, texts)]


def _length(type_name: str, field: int) -> int:
    """Return how many float64 a field holds; 0 for a stamp or a string."""
    count = cdr.LAYOUTS[type_name][field]
    return count if isinstance(count, int) else 0


def _view(values: array[Any], kind: str) -> NDArray[Any]:
    return np.frombuffer(values, dtype=kind) if values else np.empty(0, dtype=kind)
