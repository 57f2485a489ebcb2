"""What simulation time should be now, by the steady clock (`Pacer`) or by a ROS clock (`ClockFollower`).

Both also give the offset from simulation time to the stamps.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from rb_dynamics.numerics.nanoseconds import NANOSECONDS

# A larger lag is given up and counted: catching up without bound would never end.
LARGEST_LAG_NS = 100_000_000
# A clock that jumps this far at once was most likely replaced: the body is not simulated over the jump.
LARGEST_LEAP_NS = 10 * NANOSECONDS
# s of steady time after which a clock that does not advance counts as paused.
_PAUSE = 1.0
# After a jump back by more than this (ns), a stamp nearer to the time before is of that, for so much steady time (s).
_BACK_NS, _UNDER_WAY = NANOSECONDS, 1.0


class Pacer:
    """Maps the steady clock to simulation time by a factor, from the moment it was last restarted.

    Stamps are simulation time, or ROS time: then they are set by the ROS clock at each restart, after a pause or a lag
    too, and follow the steady clock in between.
    """

    def __init__(self, factor: float, ros_now: Callable[[], int] | None = None) -> None:
        """Use a real-time factor greater than 0, and a ROS clock (ns) if stamps are to be ROS time."""
        self.factor = factor
        self._ros_now = ros_now
        self.clear()
        self.begin(0)

    def clear(self) -> None:
        """Clear the counts."""
        self._overruns = self._dropped_ns = self._largest_ns = self._corrections = 0

    def begin(self, offset_ns: int) -> None:
        """Begin a run at simulation time 0, with stamps `offset_ns` ahead of it if they are simulation time."""
        self.offset_ns: int | None = offset_ns
        self.restart(0)

    def restart(self, time_ns: int) -> None:
        """Let the present simulation time be `time_ns`."""
        self._clock_ns, self._time_ns = time.monotonic_ns(), time_ns
        if self._ros_now is not None:
            self.offset_ns = self._ros_now() - time_ns

    def correct(self) -> None:
        """Follow a ROS clock that was set to another time; this does not move the body."""
        if self._ros_now is None or self.factor != 1.0:
            return
        time_ns = self._time_ns + time.monotonic_ns() - self._clock_ns
        offset_ns = self._ros_now() - time_ns
        if self.offset_ns is None or abs(offset_ns - self.offset_ns) > LARGEST_LAG_NS:
            self.offset_ns = offset_ns
            self._corrections += 1

    def due_ns(self, next_ns: int) -> int:
        """Return the simulation time due now, if `next_ns` is to be reached next; gives up a lag that is too large."""
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
        """Return the simulation time that passes in this much steady time."""
        return int(age_ns * self.factor)

    def seconds_until(self, time_ns: int) -> float:
        """Return how long to wait (s, at least 0) until simulation time `time_ns` is due."""
        ahead = (time_ns - self._time_ns) / self.factor - (time.monotonic_ns() - self._clock_ns)
        return max(0.0, ahead / NANOSECONDS)

    def values(self) -> dict[str, str]:
        """Return the values for diagnostics."""
        return {
            "real-time factor": f"{self.factor:g}",
            "stamps": "simulation time" if self._ros_now is None else "ROS time",
            "overruns": str(self._overruns),
            "time dropped": f"{self._dropped_ns / 1e9:.3f} s",
            "largest lag": f"{self._largest_ns / 1e6:.1f} ms",
        }

    def warning(self) -> str:
        """Return a warning, or ""."""
        if self._ros_now is not None and self.factor != 1.0:
            return (
                f"stamps are ROS time and go {self.factor:g} times as fast: they hold again at real_time_factor 1; "
                "start with stamps:=simulation and publish_clock:=true for another factor"
            )
        if self._corrections:
            return f"ROS time was set anew ({self._corrections}): stamps jumped with it, the body did not"
        if not self._overruns:
            return ""
        times = "once" if self._overruns == 1 else f"{self._overruns} times"
        return f"fell behind {times}, by {self._dropped_ns / 1e9:.3f} s in all: the machine is too slow, or busy"


class ClockFollower:
    """Lets simulation time follow a ROS clock; replaces `Pacer` under `use_sim_time`.

    Only normal advances of the clock count: a jump backwards, or ahead by more than 10 s, moves stamps and not the
    body.
    """

    def __init__(self, now: Callable[[], int], steady: Callable[[], float] = time.monotonic) -> None:
        """Use the clock to follow (ns; 0 before its first message), and a steady clock to detect that it is paused."""
        self._now, self._steady = now, steady
        self._standing, self._clock_ns = False, 0
        self._jump: int | None = 0
        self._before_ns, self._jumped = 0, -math.inf
        self.clear()
        self.begin(0)

    def clear(self) -> None:
        """Clear the counts."""
        self._jumps_back = self._leaps = self._pauses = 0
        # Messages with an invalid time, counted by their reader.
        self.rejected = 0

    @property
    def offset_ns(self) -> int | None:
        """By how much stamps are ahead of simulation time; None before the clock's first message."""
        return self._clock_ns - self._time_ns if self._clock_ns else None

    def begin(self, offset_ns: int) -> None:
        """Begin a run at simulation time 0; the clock determines the stamps."""
        self.restart(0)
        self._jump = 0

    def restart(self, time_ns: int) -> None:
        """Let the present simulation time be `time_ns`."""
        if 0 < self._now() < self._clock_ns:
            self._jump_back()
        self._time_ns, self._clock_ns, self._moved = time_ns, self._now(), self._steady()

    def jump(self) -> int | None:
        """Return by how much (ns) the clock has leapt ahead since this was asked last; None if it jumped back."""
        found, self._jump = self._jump, 0
        return found

    def is_over(self, stamp_ns: int) -> bool:
        """Return whether a stamp that comes now is of the time before the clock jumped back."""
        back_ns = self._before_ns - self._clock_ns
        recent = self._steady() - self._jumped < _UNDER_WAY
        return recent and back_ns > _BACK_NS and 2 * (stamp_ns - self._clock_ns) > back_ns

    def due_ns(self, next_ns: int) -> int:
        """Return the simulation time due now."""
        self._follow()
        return self._time_ns

    def since(self, age_ns: int) -> int:
        """Return 0: the clock says nothing about the time between its messages."""
        return 0

    def seconds_until(self, time_ns: int) -> float:
        """Return how long to wait for the clock's next message."""
        return math.inf

    def values(self) -> dict[str, str]:
        """Return the values for diagnostics."""
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
        """Return a warning, or ""."""
        if not self._clock_ns:
            return "waiting for /clock, as use_sim_time is true: start its publisher"
        if self._jumps_back or self._leaps:
            return (
                f"jumps of the clock: {self._jumps_back} back, {self._leaps} ahead by more than 10 s; only the stamps "
                "jumped, the body continued from where it was; after a jump back, commands of the time before never "
                "act; ~/reset starts again"
            )
        return ""

    def _jump_back(self) -> None:
        self._jump, self._before_ns, self._jumped = None, self._clock_ns, self._steady()

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
            self._jump_back()
        elif passed > LARGEST_LEAP_NS:
            self._leaps += 1
            self._jump = None if self._jump is None else self._jump + passed
        else:
            self._time_ns += passed
        self._clock_ns, self._moved, self._standing = clock_ns, self._steady(), False
