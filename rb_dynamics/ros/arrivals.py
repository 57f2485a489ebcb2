"""How the commands of a channel arrive: early, late, twice or out of order (`Arrivals`), or not at all (`Losses`)."""

from __future__ import annotations

import enum
import heapq
from collections.abc import Callable


class Arrival(enum.Enum):
    """How a command came, by its stamp; the value is the word that diagnostics use."""

    EARLY = "early"
    ON_TIME = "on time"
    LATE = "late"
    DUPLICATE = "duplicate"
    SUPERSEDED = "superseded"


class Arrivals:
    """The stamps of the commands of one channel, in simulation time."""

    def __init__(self) -> None:
        """Begin with none."""
        self._heap: list[int] = []
        self._waiting: set[int] = set()
        self._acted_ns: int | None = None

    def classify(self, stamp_ns: int, now_ns: int) -> Arrival:
        """Return how a command with this stamp came, now, and remember it.

        A duplicate has the stamp of one before it. A superseded command came so late that a newer one of its channel
        had taken effect already: it must not act any more.
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


class Losses:
    """How many commands of a channel never came: by the middleware's count or by gaps in their numbers, what is more.

    The middleware does not count what a full queue, the commander's or ours, replaced by something newer. The numbers
    are the publisher's own and do not tell it from another, so they count only where it is alone.
    """

    def __init__(self) -> None:
        """Begin with none."""
        self._last: int | None = None
        self._told = self._skipped = self._counted = 0

    def tell(self, lost: int) -> int:
        """Take what the middleware says was lost; return how many more that makes."""
        self._told += lost
        return self._more()

    def take(self, number: int | None, alone: Callable[[], bool]) -> int:
        """Take the number of a command that came, None where it has none; return how many more are missing."""
        last, self._last = self._last, number
        if number is None or last is None or number == last + 1:
            return 0
        if number <= last or not alone():
            # That of another publisher, which may be gone already; the next one may be from either.
            self._last = None
            return 0
        self._skipped += number - last - 1
        return self._more()

    def forget(self) -> None:
        """A publisher has come or gone: the last number may be that of another than the next."""
        self._last = None

    def _more(self) -> int:
        before, self._counted = self._counted, max(self._told, self._skipped)
        return self._counted - before
