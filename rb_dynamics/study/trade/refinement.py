"""Refine the settings of all methods in turns, coarse to fine, so that each method gets about the same time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.scene.model import Solver
from rb_dynamics.study.stopwatch import Clock

# So many refusals in a row tell that no finer setting helps.
_REFUSALS = 12

# A step that is compiled is at least so many times as fast; most are a hundred times.
_FASTER = 20.0


@dataclass
class Climber:
    """A method on its way from its coarsest setting to its finest.

    Attributes:
        method: by name.
        settings: from coarse to fine.
        growth: how much longer a run takes than the one before it.
        spent: time it has had, s.
        expected: time of its next run, as the last one tells, s.
        runs: that came to their end.
        ended: why it goes no further; "" while it does.
    """

    method: str
    settings: Sequence[Solver]
    growth: float
    spent: float = 0.0
    expected: float = 0.0
    runs: int = 0
    ended: str = ""
    _next: int = 0
    _refused: int = 0

    @property
    def coming(self) -> Sequence[Solver]:
        """The settings that it has not tried."""
        return self.settings[self._next :]

    def foreseen(self, over: int, plain: float, share: float) -> None:
        """Pass over so many settings if all of them would take longer than `share` s, and the one behind does not.

        A run is compiled after `plain` s.
        """

        def time_of(expected: float) -> float:
            return min(expected, plain + expected / _FASTER)

        times = [time_of(self.expected * self.growth**k) for k in range(over + 1)]
        self.expected = times[0]
        if sum(times[:-1]) > share >= times[-1]:
            self._next += over
            self.expected = times[-1]

    def go(self, measure: Measure, limit: float, clock: Clock) -> None:
        """Measure the next setting, for at most `limit` s, and see what follows from it."""
        setting, begin = self.settings[self._next], clock()
        self._next += 1
        try:
            took, self.ended = measure(setting, limit)
        except ConvergenceError as refusal:
            self._refused += 1
            # Refused at first, a finer setting may do; refused after others were taken, none will.
            if self.runs or self._refused == _REFUSALS or self._next == len(self.settings):
                self.ended = f"refused: {refusal}"
        else:
            self.runs += not math.isinf(took)
            self.expected = took * self.growth
            if self._next == len(self.settings):
                self.ended = self.ended or "its finest setting"
        self.spent += clock() - begin


Measure = Callable[[Solver, float], tuple[float, str]]
"""Takes a setting and a limit in s; returns the time of one run in s, inf if it was cut off, and why to end, or ""."""

Foresee = Callable[[Sequence[Solver]], tuple[int, float]]
"""Takes the settings of a method to come; returns how many of them are far from what is asked for, and after how long a
run is compiled, s."""

TIME_IS_UP = "its time was up"


def climb(
    climbers: Sequence[Climber],
    measure: Measure,
    end: float,
    clock: Clock,
    after: Callable[[], None] = lambda: None,
    foresee: Foresee = lambda _: (0, math.inf),
) -> None:
    """Let each of `climbers` go as far as it gets until `end` on the `clock`, all with about the same time.

    Always the one goes on that will have had the least time after its next run, so what one leaves the others share. No
    run is started that is expected to last beyond the end. Where there is no time for all settings on the way to what
    is asked for, those far from it are passed over.

    Args:
        climbers: are changed.
        measure: runs a setting.
        end: time on the clock at which nothing may run any more.
        clock: s.
        after: called after each run.
        foresee: tells what is far.
    """
    while going := [climber for climber in climbers if not climber.ended]:
        left = end - clock()
        climber = min(going, key=lambda climber: climber.spent + climber.expected)
        if left <= 0.0 or climber.expected > left:
            climber.ended = TIME_IS_UP
            continue
        share = left / len(going)
        climber.go(measure, min(left, max(share, 3.0 * climber.expected)), clock)
        if not climber.ended:
            climber.foreseen(*foresee(climber.coming), share)
        after()
