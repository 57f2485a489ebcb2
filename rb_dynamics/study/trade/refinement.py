"""Refine the settings of all methods in turns, coarse to fine, so that each method gets about the same time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.scene.model import Solver
from rb_dynamics.study.stopwatch import Clock

# After this many refusals in a row, finer settings do not help.
_REFUSALS = 12

# A compiled step is at least this many times as fast as in plain Python; most are a hundred times as fast.
_FASTER = 20.0


@dataclass
class Refinement:
    """The settings of one method, from coarse to fine, and how far it has come.

    Attributes:
        method: its name.
        settings: from coarse to fine.
        growth: estimated ratio of the run times of successive settings.
        spent: time used, s.
        expected: estimated time of the next run, s.
        runs: number of completed runs.
        ended: why it went no further; "" while it is still going.
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
        """The settings not yet tried."""
        return self.settings[self._next :]

    def foreseen(self, over: int, plain: float, share: float) -> None:
        """Skip `over` settings if together they would take longer than `share` s, and the one after them would not.

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
        """Measure the next setting, for at most `limit` s, and update the estimates."""
        setting, begin = self.settings[self._next], clock()
        self._next += 1
        try:
            took, self.ended = measure(setting, limit)
        except ConvergenceError as refusal:
            self._refused += 1
            # If the first settings are refused, a finer one may work; once one has worked, a refusal is final.
            if self.runs or self._refused == _REFUSALS or self._next == len(self.settings):
                self.ended = f"refused: {refusal}"
        else:
            self.runs += not math.isinf(took)
            self.expected = took * self.growth
            if self._next == len(self.settings):
                self.ended = self.ended or "its finest setting"
        self.spent += clock() - begin


Measure = Callable[[Solver, float], tuple[float, str]]
"""Takes a setting and a limit (s); returns the time of one run (s; inf if it was stopped), and why to end, or ""."""

Foresee = Callable[[Sequence[Solver]], tuple[int, float]]
"""Takes the settings left of a method; returns how many are far from the target, and after how many s a run
is compiled."""

TIME_IS_UP = "its time was up"


def refine(
    refinements: Sequence[Refinement],
    measure: Measure,
    end: float,
    clock: Clock,
    after: Callable[[], None] = lambda: None,
    foresee: Foresee = lambda _: (0, math.inf),
) -> None:
    """Refine each of `refinements` until `end` on the `clock`, giving all about the same time.

    The next to run is always the one that will have used the least time after its next run, so methods that end early
    leave their time to the others. No run is started that would not finish before the end. If there is no time for all
    settings, those far from the target are skipped.

    Args:
        refinements: changed in place.
        measure: runs one setting.
        end: time on the clock at which measuring ends.
        clock: s.
        after: called after each run.
        foresee: predicts which settings are far from the target.
    """
    while going := [refinement for refinement in refinements if not refinement.ended]:
        left = end - clock()
        refinement = min(going, key=lambda refinement: refinement.spent + refinement.expected)
        if left <= 0.0 or refinement.expected > left:
            refinement.ended = TIME_IS_UP
            continue
        share = left / len(going)
        refinement.go(measure, min(left, max(share, 3.0 * refinement.expected)), clock)
        if not refinement.ended:
            refinement.foreseen(*foresee(refinement.coming), share)
        after()
