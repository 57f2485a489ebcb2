"""Statistics of the commands of a channel: early, late, duplicate or superseded (`Arrivals`), or lost (`Losses`)."""

from __future__ import annotations

import enum
import heapq
from collections.abc import Callable


class Arrival(enum.Enum):
    """How a command arrived, judged by its stamp; the values are used in diagnostics."""

    EARLY = "early"
    ON_TIME = "on time"
    LATE = "late"
    DUPLICATE = "duplicate"
    SUPERSEDED = "superseded"


class Arrivals:
    """The stamps of the commands of one channel, in simulation time."""

    def __init__(self) -> None:
        """Start without commands."""
        self._heap: list[int] = []
        self._waiting: set[int] = set()
        self._acted_ns: int | None = None

    def classify(self, stamp_ns: int, now_ns: int) -> Arrival:
        """Classify a command with this stamp that arrives now, and record the stamp.

        A duplicate has the stamp of an earlier one. A superseded command arrived after a newer one of its channel had
        taken effect, so it must not act any more.
        """
        while self._heap and self._heap[0] <= now_ns:
            self._acted_ns = heapq.heappop(self._heap)
            self._waiting.discard(self._acted_ns)
        if stamp_ns == self._acted_ns or stamp_ns in self._waiting:
            return Arrival.DUPLICATE
        if self._acted_ns is not None and stamp_ns < self._acted_ns:
            return Arrival.SUPERSEDED
        if stamp_ns > now_ns:
            heapq.heappush(self._heap, stamp_ns)
            self._waiting.add(stamp_ns)
            return Arrival.EARLY
        self._acted_ns = stamp_ns
        return Arrival.ON_TIME if stamp_ns == now_ns else Arrival.LATE

    def hasten(self, by_ns: int | None) -> None:
        """Make all stamps this much earlier, as time passed without being simulated; None: what waits never acts."""
        self._heap = [] if by_ns is None else [stamp_ns - by_ns for stamp_ns in self._heap]
        self._waiting = set(self._heap)
        if self._acted_ns is not None and by_ns is not None:
            self._acted_ns -= by_ns


class Losses:
    """Counts lost commands of a channel: the larger of the middleware's count and the gaps in sequence numbers.

    The middleware does not count what a newer message replaced in a full queue, the publisher's or ours. Sequence
    numbers are the publisher's own and do not identify it, so they count only if there is one publisher.
    """

    def __init__(self) -> None:
        """Start without losses."""
        self._last: int | None = None
        self._told = self._skipped = self._counted = 0

    def tell(self, lost: int) -> int:
        """Take the middleware's count; return how many more were lost."""
        self._told += lost
        return self._more()

    def take(self, number: int | None, alone: Callable[[], bool]) -> int:
        """Take the sequence number of a command, None if it has none; return how many more were lost."""
        last, self._last = self._last, number
        if number is None or last is None or number == last + 1:
            return 0
        if number <= last or not alone():
            # It is from another publisher, which may be gone already; the next one may be from either.
            self._last = None
            return 0
        self._skipped += number - last - 1
        return self._more()

    def forget(self) -> None:
        """Call when a publisher appears or disappears: the last number may belong to another than the next."""
        self._last = None

    def _more(self) -> int:
        before, self._counted = self._counted, max(self._told, self._skipped)
        return self._counted - before
