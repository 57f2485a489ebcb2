"""Errors over a whole scene where only an excerpt was measured: what is about to be recommended is flown to the end.

The length of an excerpt depends on how busy the machine is; the recommendation should not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.study.trade.excerpt import Excerpt
from rb_dynamics.study.trade.result import TradeRow, Verdict, grown

# Of the time that there is, for the run that others are compared with: what it may take, and what it may be expected to
# take without the looks at its motion.
_FINEST, _EXPECTED = 0.5, 0.25


class FullRuns:
    """Judges rows of a trial by flying the whole scene, as long as there is time.

    Attributes:
        checked_by: the row that others are compared with at the end of the scene; None where there was no time for it.
    """

    def __init__(
        self, trial: Excerpt, commands: Sequence[tuple[str, Wrench]], rows: Sequence[TradeRow], seconds: float
    ) -> None:
        """Fly the most accurate of `rows` that there is time for, under `commands`; all of it takes about `seconds`."""
        self.checked_by: TradeRow | None = None
        begin = trial.clock()
        self._end, self._longer = begin + seconds, trial.whole / trial.seconds
        whole = replace(trial, commands=commands, seconds=trial.whole, horizon=trial.scene.duration)
        able = [row for row in rows if row.bare_time_per_s * whole.seconds <= _EXPECTED * seconds]
        finest = min(able, key=lambda row: (row.error, row.time_per_s), default=None)
        if finest is None:
            return
        try:
            self._whole = replace(whole, pilot=finest.as_solver).look(whole.as_the_whole(), _FINEST * seconds)
        except ConvergenceError:
            return
        self.checked_by = finest

    def judge(self, row: TradeRow) -> Verdict:
        """Return the error of `row` over the whole scene: flown where there is time, or else grown from the trial.

        The finest run is wrong, too: by as much less than the row as in the trial, and never by more.
        """
        guess = Verdict(grown(row.error, self._longer), measured=False)
        if self.checked_by is None or self.checked_by.solver == row.solver:
            return guess
        whole = self._whole
        limit = self._end - whole.clock()
        if row.bare_time_per_s * whole.seconds > limit:
            return guess
        try:
            flight = whole.fly(row.as_solver, whole.as_the_whole(), limit)
        except ConvergenceError:
            return Verdict(math.inf, measured=True)
        if flight is None or whole.end is None:
            return guess
        attitude, _, position = whole.differences(flight.sample, whole.end)
        share = min(1.0, self.checked_by.error / row.error) if row.error > 0.0 else 1.0
        return Verdict(max(row.error, (1.0 + share) * whole.error(attitude, position)), measured=True)


def enough(rows: Sequence[TradeRow], target: float, trial: Excerpt, share: float) -> float | None:
    """Return with about how much time (s) a row that keeps `target` can be judged, of which it has a `share`.

    That takes another one to compare with, which has a smaller error. Errors are taken to grow with time where that
    leaves any; None if no two rows will do.
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
