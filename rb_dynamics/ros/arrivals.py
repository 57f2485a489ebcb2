"""`Arrivals`: what a channel's stamped commands tell about the way they took (early, late, twice, out of order)."""

from __future__ import annotations

import enum
import heapq


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
