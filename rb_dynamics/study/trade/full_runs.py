"""Errors over the whole scene, if only an excerpt was measured: candidates for the recommendation are run to the end.

The length of the excerpt depends on how busy the machine is; the recommendation must not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.study.trade.excerpt import Excerpt
from rb_dynamics.study.trade.result import TradeRow, Verdict, grown

# Shares of the time available for the run that others are compared with: its limit, and its expected time without the
# outputs that describe the motion.
_FINEST, _EXPECTED = 0.5, 0.25


class FullRuns:
    """Judges rows by running the whole scene, as long as there is time.

    Attributes:
        checked_by: the row that others are compared with at the end of the scene; None if there was no time to run it.
    """

    def __init__(
        self, trial: Excerpt, commands: Sequence[tuple[str, Wrench]], rows: Sequence[TradeRow], seconds: float
    ) -> None:
        """Run the most accurate of `rows` that the time allows, with `commands`; all judging takes about `seconds`."""
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
        """Return the error of `row` over the whole scene: measured if there is time, else extrapolated.

        The run it is compared with has an error too: its share of the row's error is taken from the excerpt, at most 1.
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
