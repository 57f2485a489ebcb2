"""`Pacer`: what simulation time it should be now. Never sleeps and never reads a ROS clock."""

from __future__ import annotations

import time

_NANOSECONDS = 1_000_000_000
# A lag beyond this is given up and counted: catching up without bound is a spiral.
LARGEST_LAG_NS = 100_000_000


class Pacer:
    """Maps the steady clock to simulation time by a factor, from the moment it was last restarted."""

    def __init__(self, factor: float) -> None:
        """Take the real-time factor; 0 means that simulation time is never ahead of the clock."""
        self.factor = factor
        self.overruns = 0
        self.dropped_ns = 0
        self.restart(0)

    def restart(self, time_ns: int) -> None:
        """Let simulation time be `time_ns` now."""
        self._clock_ns, self._time_ns = time.monotonic_ns(), time_ns

    def due_ns(self, next_ns: int) -> int:
        """Return what simulation time should be, where `next_ns` is to be reached next; gives up too large a lag."""
        due = self.now_ns()
        lag = int((due - next_ns) / self.factor)
        if lag <= LARGEST_LAG_NS:
            return due
        self.overruns += 1
        self.dropped_ns += lag
        self.restart(next_ns)
        return next_ns

    def now_ns(self) -> int:
        """Return what simulation time should be by the clock."""
        return self._time_ns + int((time.monotonic_ns() - self._clock_ns) * self.factor)

    def seconds_until(self, time_ns: int) -> float:
        """Return how long to wait (s, not negative) until simulation time should be `time_ns`."""
        ahead = (time_ns - self._time_ns) / self.factor - (time.monotonic_ns() - self._clock_ns)
        return max(0.0, ahead / _NANOSECONDS)
