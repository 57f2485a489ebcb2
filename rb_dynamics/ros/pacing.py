"""What simulation time should be now, by the steady clock (`Pacer`) or by a ROS clock (`ClockFollower`).

Both also say by how much stamps are ahead of simulation time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from rb_dynamics.numerics.nanoseconds import NANOSECONDS

# A lag beyond this is given up and counted: catching up without bound is a spiral.
LARGEST_LAG_NS = 100_000_000
# A clock that leaps this far at once is another clock, most likely: nobody waits for so much to be computed.
LARGEST_LEAP_NS = 10 * NANOSECONDS
# s of steady time after which a clock that does not move counts as paused.
_PAUSE = 1.0


class Pacer:
    """Maps the steady clock to simulation time by a factor, from the moment it was last restarted."""

    def __init__(self, factor: float) -> None:
        """Take the real-time factor, greater than 0."""
        self.factor = factor
        self.clear()
        self.begin(0)

    def clear(self) -> None:
        """Forget what was counted."""
        self._overruns = self._dropped_ns = self._largest_ns = 0

    def begin(self, offset_ns: int) -> None:
        """A run begins: simulation time is 0 now, and stamps are `offset_ns` ahead of it."""
        self.offset_ns: int | None = offset_ns
        self.restart(0)

    def restart(self, time_ns: int) -> None:
        """Let simulation time be `time_ns` now."""
        self._clock_ns, self._time_ns = time.monotonic_ns(), time_ns

    def due_ns(self, next_ns: int) -> int:
        """Return what simulation time should be, where `next_ns` is to be reached next; gives up too large a lag."""
        due = self._time_ns + int((time.monotonic_ns() - self._clock_ns) * self.factor)
        lag = int((due - next_ns) / self.factor)
        self._largest_ns = max(self._largest_ns, lag)
        if lag <= LARGEST_LAG_NS:
            return due
        self._overruns += 1
        self._dropped_ns += lag
        self.restart(next_ns)
        return next_ns

    def since(self, age_ns: int) -> int:
        """Return how much simulation time passes in so much steady time."""
        return int(age_ns * self.factor)

    def seconds_until(self, time_ns: int) -> float:
        """Return how long to wait (s, not negative) until simulation time should be `time_ns`."""
        ahead = (time_ns - self._time_ns) / self.factor - (time.monotonic_ns() - self._clock_ns)
        return max(0.0, ahead / NANOSECONDS)

    def values(self) -> dict[str, str]:
        """Return what diagnostics show."""
        return {
            "real-time factor": f"{self.factor:g}",
            "overruns": str(self._overruns),
            "time dropped": f"{self._dropped_ns / 1e9:.3f} s",
            "largest lag": f"{self._largest_ns / 1e6:.1f} ms",
        }

    def warning(self) -> str:
        """Return what a person should know, or ""."""
        if not self._overruns:
            return ""
        times = "once" if self._overruns == 1 else f"{self._overruns} times"
        return f"fell behind {times}, by {self._dropped_ns / 1e9:.3f} s in all: the machine is too slow for this"


class ClockFollower:
    """Lets simulation time pass as a ROS clock does; stands in for `Pacer` under `use_sim_time`.

    Only what the clock advances counts: a jump backwards, or a leap of more than 10 s, moves stamps and not the body.
    """

    def __init__(self, now: Callable[[], int], steady: Callable[[], float] = time.monotonic) -> None:
        """Take the clock to follow (ns; 0 before its first message), and the one that tells whether it stands."""
        self._now, self._steady = now, steady
        self._standing = False
        self.clear()
        self.begin(0)

    def clear(self) -> None:
        """Forget what was counted."""
        self._jumps_back = self._leaps = self._pauses = 0
        # Messages whose time is none; who reads them counts them.
        self.rejected = 0

    @property
    def offset_ns(self) -> int | None:
        """How far stamps are ahead of simulation time; None while the clock has not begun."""
        return self._clock_ns - self._time_ns if self._clock_ns else None

    def begin(self, offset_ns: int) -> None:
        """A run begins: simulation time is 0 now; what stamps are is the clock's to say."""
        self.restart(0)

    def restart(self, time_ns: int) -> None:
        """Let simulation time be `time_ns` now."""
        self._time_ns, self._clock_ns, self._moved = time_ns, self._now(), self._steady()

    def due_ns(self, next_ns: int) -> int:
        """Return what simulation time should be."""
        self._follow()
        return self._time_ns

    def since(self, age_ns: int) -> int:
        """Return 0: the clock that is followed says nothing of what happened between its messages."""
        return 0

    def seconds_until(self, time_ns: int) -> float:
        """Return how long to wait: for the clock's next message."""
        return math.inf

    def values(self) -> dict[str, str]:
        """Return what diagnostics show."""
        self._follow()
        state = "waiting for its first message" if not self._clock_ns else "paused" if self._standing else "running"
        return {
            "clock": state,
            "clock: jumps back": str(self._jumps_back),
            "clock: leaps ahead": str(self._leaps),
            "clock: pauses": str(self._pauses),
            "clock: rejected": str(self.rejected),
        }

    def warning(self) -> str:
        """Return what a person should know, or ""."""
        if not self._clock_ns:
            return "waiting for /clock, as use_sim_time is true: start its publisher"
        if self._jumps_back or self._leaps:
            return (
                f"jumps of the clock: {self._jumps_back} back, {self._leaps} ahead by more than 10 s; the body went on "
                "from where it was, only its stamps jumped; ~/reset starts again"
            )
        return ""

    def _follow(self) -> None:
        clock_ns = self._now()
        passed = clock_ns - self._clock_ns
        if not passed:
            standing = self._clock_ns != 0 and self._steady() - self._moved > _PAUSE
            self._pauses += standing and not self._standing
            self._standing = standing
            return
        if not self._clock_ns:
            pass
        elif passed < 0:
            self._jumps_back += 1
        elif passed > LARGEST_LEAP_NS:
            self._leaps += 1
        else:
            self._time_ns += passed
        self._clock_ns, self._moved, self._standing = clock_ns, self._steady(), False
