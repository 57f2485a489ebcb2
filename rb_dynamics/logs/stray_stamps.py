"""`StrayStamps`: which few messages of a topic are stamped far from when they were recorded."""

from __future__ import annotations

import os
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.formats.topic_messages import Times
from rb_dynamics.numerics.distinct import distinct

# By more than so many times as long as all were recorded, or as a second.
_AWAY = 10
# At most this share are strays, or one, of so many messages.
_SHARE, _OF = 0.01, 8
# Delays are counted by this length, ns; by more than so many lengths, the stamps do not follow the log times.
_LENGTH_NS, _LENGTHS = 10_000_000_000, 1000


class Strays(NamedTuple):
    """The strays of a topic.

    Attributes:
        number: how many there are.
        of: of how many messages.
        usual_ns: by how much the others were recorded after their stamps.
        away_ns: a delay that differs by more from `usual_ns` is that of a stray.
        first: log time and stamp of the message that was recorded first, ns.
    """

    number: int
    of: int
    usual_ns: int
    away_ns: int
    first: tuple[int, int]

    def among(self, log_times: Times, stamps: Times) -> NDArray[np.bool_]:
        """Return which of some messages are strays."""
        more_ns = log_times - stamps - self.usual_ns
        kept = (log_times == self.first[0]) & (stamps == self.first[1]) & (more_ns > 0)
        found: NDArray[np.bool_] = (np.abs(more_ns) > self.away_ns) & (stamps != 0) & ~kept
        return found

    def placed(self, log_times: Times, stamps: Times) -> Times:
        """Return the stamps, of strays those with which they would have been sent."""
        found: Times = np.where(self.among(log_times, stamps), log_times - self.usual_ns, stamps)
        return found

    def told(self, path: str | os.PathLike[str], topic: str) -> str:
        """Return a sentence about them."""
        one = "is stamped far from when it was recorded, and acts then"
        more = "are stamped far from when they were recorded, and act then"
        return f"{path}: {self.number} of the {self.of} commands of {topic} {one if self.number == 1 else more}"


class StrayStamps:
    """Takes the messages of one topic, in any order and in pieces.

    A message from long before the others is no stray if it was recorded first: it may be kept for who joins late. Nor
    is a stamp of 0, see `UnsetStamps`.
    """

    def __init__(self) -> None:
        self._counts: dict[int, int] = {}
        self._sums_ns: dict[int, int] = {}
        self._first: tuple[int, int] | None = None
        self._last_ns = 0

    def add(self, log_times: Times, stamps: Times) -> None:
        """Take messages."""
        log_times, stamps = log_times[stamps != 0], stamps[stamps != 0]
        if not len(stamps) or len(self._counts) > _LENGTHS:
            return
        row = int(log_times.argmin())
        first, last_ns = (int(log_times[row]), int(stamps[row])), int(log_times.max())
        self._last_ns = last_ns if self._first is None else max(last_ns, self._last_ns)
        self._first = first if self._first is None or first[0] < self._first[0] else self._first
        lengths, beyond_ns = np.divmod(log_times - stamps, _LENGTH_NS)
        for length in distinct(lengths).tolist():
            of_length = beyond_ns[lengths == length]
            self._counts[length] = self._counts.get(length, 0) + len(of_length)
            self._sums_ns[length] = self._sums_ns.get(length, 0) + int(of_length.sum())

    @property
    def found(self) -> Strays | None:
        """The strays; None if there are none."""
        of = sum(self._counts.values())
        if self._first is None or of < _OF or len(self._counts) > _LENGTHS:
            return None
        behind_ns = {k: k * _LENGTH_NS + self._sums_ns[k] // count for k, count in self._counts.items()}
        ascending = sorted(self._counts)
        up_to = accumulate(self._counts[k] for k in ascending)
        usual_ns = behind_ns[next(k for k, count in zip(ascending, up_to, strict=True) if 2 * count >= of)]
        away_ns = max(_AWAY * (self._last_ns - self._first[0]), _AWAY * 1_000_000_000)
        count = sum(self._counts[k] for k, behind in behind_ns.items() if abs(behind - usual_ns) > away_ns)
        if self._first[0] - self._first[1] > usual_ns + away_ns:
            count -= 1
        return Strays(count, of, usual_ns, away_ns, self._first) if 0 < count <= max(1, _SHARE * of) else None
