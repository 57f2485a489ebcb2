"""Errors over the whole scene, if only an excerpt was measured: candidates for the recommendation are run to the end.

The length of the excerpt depends on how busy the machine is; the recommendation must not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.run.posting import Command
from rb_dynamics.scene.model import Solver
from rb_dynamics.study.trade.excerpt import Excerpt
from rb_dynamics.study.trade.result import TradeRow, Verdict, grown

# Shares of the time available for the run that others are compared with: its limit, and its expected time without the
# outputs that describe the motion.
_FINEST, _EXPECTED = 0.5, 0.25

# Accuracy of the run that checks the most accurate row: relative to that row's error, and the finest. Where rounding
# forbids it, coarser ones are tried.
_TIGHTER, _TIGHTEST = 0.01, 1e-14
_COARSER = tuple(10.0**k for k in range(5))


class FullRuns:
    """Judges rows by running the whole scene, as long as there is time.

    Attributes:
        checked_by: the row that others are compared with at the end of the scene; None if there was no time to run it.
    """

    def __init__(self, trial: Excerpt, commands: Sequence[Command], rows: Sequence[TradeRow], seconds: float) -> None:
        """Run the most accurate of `rows` that the time allows, with `commands`; all judging takes about `seconds`."""
        self.checked_by: TradeRow | None = None
        self._foretold = True
        begin = trial.clock()
        self._end, self._longer = begin + seconds, trial.whole / trial.seconds
        self._checker = trial.pilot.method
        whole = replace(trial, commands=commands, seconds=trial.whole, horizon=trial.scene.duration)
        able = [row for row in rows if row.bare_time_per_s * whole.seconds <= _EXPECTED * seconds]
        for finest in sorted(able, key=lambda row: (row.error, row.time_per_s)):
            limit = begin + _FINEST * seconds - trial.clock()
            if finest.bare_time_per_s * whole.seconds > limit:
                continue
            # A setting that does for the excerpt may be too coarse for what follows: then the next takes its place.
            try:
                self._whole = replace(whole, pilot=finest.as_solver).look(whole.as_the_whole(), limit)
            except ConvergenceError:
                # Refused, not out of time: the excerpt does not show what follows.
                self._foretold = self._foretold and trial.clock() >= begin + _FINEST * seconds
            else:
                self.checked_by = finest
                return

    def judge(self, row: TradeRow) -> Verdict:
        """Return the error of `row` over the whole scene: measured if there is time, else extrapolated.

        Once a run to the end was refused or worse than extrapolated, the excerpt does not show what follows it: then
        an extrapolated error is infinite.
        """
        extrapolated = grown(row.error, self._longer)
        measured = self._measured(row)
        if measured is None:
            return Verdict(extrapolated if self._foretold else math.inf, measured=False)
        self._foretold = self._foretold and measured <= extrapolated
        return Verdict(measured, measured=True)

    def _measured(self, row: TradeRow) -> float | None:
        """Return the error of `row` at the end of the scene, infinite if it is refused there; None if unknown.

        The run it is compared with has an error too, by its accuracy or by the excerpt: it may be this share of the
        row's, at most 1, at the end as well.
        """
        if self.checked_by is None:
            return None
        whole = self._whole
        if row.bare_time_per_s * whole.seconds > self._end - whole.clock():
            return None
        # The row that others are compared with is itself compared with a run so accurate that its steps are shorter
        # wherever they need to be: those of the same method with a finer setting may be the same, if commands end them.
        own = self.checked_by.solver == row.solver
        for solver in _checkers(row, self._checker) if own else [row.as_solver]:
            try:
                run = whole.run(solver, whole.as_the_whole(), self._end - whole.clock())
            except ConvergenceError:
                if not own:
                    return math.inf
                continue
            break
        else:
            return None
        if run is None or whole.end is None:
            return None
        attitude, _, position = whole.differences(run.sample, whole.end)
        other = (solver.accuracy or 0.0) if own else self.checked_by.error
        share = min(1.0, other / row.error) if row.error > 0.0 else 1.0
        return max(row.error, other, (1.0 + share) * whole.error(attitude, position))


def _checkers(row: TradeRow, method: str) -> list[Solver]:
    """Return solvers to check the end of `row` with, from fine to coarse; none for a closed form."""
    if row.step is None and row.accuracy is None:
        return []
    finest = max(_TIGHTER * row.error, _TIGHTEST)
    return [Solver(method, accuracy=factor * finest) for factor in _COARSER]


def enough(rows: Sequence[TradeRow], target: float, trial: Excerpt, share: float) -> float | None:
    """Return about the total time (s) needed to judge a row that meets `target`; judging gets a `share` of it.

    Judging needs a second row with a smaller error to compare with. Errors are assumed to grow linearly with time if
    some row then still meets the target. None if there are no two such rows.
    """
    longer = trial.whole / trial.seconds
    keeping = [row for row in rows if row.error * longer <= target] or [row for row in rows if row.error <= target]
    times = [
        max(finer.bare_time_per_s / _EXPECTED, row.bare_time_per_s / (1.0 - _FINEST))
        for row in keeping
        for finer in rows
        if finer.error < row.error
    ]
    return float(f"{1.2 * trial.whole * min(times) / share:.2g}") if times else None
