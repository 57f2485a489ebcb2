"""Measure error and run time of every setting of every method that can run the scene."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from statistics import median

from rb_dynamics.motion import METHODS
from rb_dynamics.motion.closed_form import EXACT
from rb_dynamics.motion.fixed_step_kernel import longest_in_plain
from rb_dynamics.numerics.nanoseconds import NANOSECONDS, SHORTEST
from rb_dynamics.numerics.vector import norm
from rb_dynamics.run.sample import Sample
from rb_dynamics.scene.model import Solver
from rb_dynamics.study.trade.excerpt import Excerpt, TimedRun
from rb_dynamics.study.trade.load_evaluations import evaluations_in
from rb_dynamics.study.trade.reference import settings_of
from rb_dynamics.study.trade.refinement import TIME_IS_UP, Refinement
from rb_dynamics.study.trade.result import HOPELESS, USELESS, Reference, TradeRow

_ACCURACIES = tuple(10.0**-k for k in range(3, 13))

# A run shorter than this (s) is repeated, and the shortest time counts.
_SHORT, _REPEATS = 0.05, 3

# After this many runs without improvement, finer settings do not help.
_NO_BETTER = 3

# Measure this many settings coarser than the predicted one, since the prediction may be wrong.
_BEFORE = 2


class WorkPrecision:
    """Measures rows of the excerpt `trial` against `truth`; `target` is the error aimed at, if there is one."""

    def __init__(self, trial: Excerpt, reference: Reference, truth: Sample, target: float | None = None) -> None:
        self.rows: dict[str, list[TradeRow]] = {}
        self._trial, self._reference, self._truth, self._target = trial, reference, truth, target

    def measure(self, solver: Solver, limit: float) -> tuple[float, str]:
        """Run one setting and add its row; see `Measure`."""
        rows = self.rows.setdefault(solver.method, [])
        if not rows:
            self._trial.warm_up(solver)
        tally = self._trial.as_the_whole()
        run = self._trial.run(solver, tally, limit)
        if run is None:
            return math.inf, TIME_IS_UP
        is_short = run.time < min(_SHORT, limit / _REPEATS)
        repeats = _REPEATS - 1 if is_short else int(run.compiled)
        again = [self._trial.run(solver, self._trial.as_the_whole(tally.used), parts=1) for _ in range(repeats)]
        times = [each.time for each in (run, *again) if each]
        best = min(times)
        bare = best / self._trial.seconds
        row = replace(
            self._row(solver, run, bare, self._trial.time_with_outputs(solver, tally.used, bare)),
            time_spread=median(times) / best - 1.0 if len(times) > 1 else None,
        )
        # A setting that gives the same steps as the one before has no row.
        if not rows or _run(rows[-1]) != _run(row):
            rows.append(row)
        if row.within_trust:
            return best, "as good as the reference"
        errors = [row.error for row in rows]
        if (
            len(errors) > _NO_BETTER
            and min(errors) < USELESS
            and min(errors[-_NO_BETTER:]) >= min(errors[:-_NO_BETTER])
        ):
            return best, "finer settings are no better: round-off"
        return best, ""

    def foresee(self, coming: Sequence[Solver]) -> tuple[int, float]:
        """Predict from the measured rows which of the remaining settings of a method can be skipped; see `Foresee`."""
        rows = self.rows.get(coming[0].method, [])
        far = far_from(self._target, rows, coming) if self._target is not None else 0
        if not rows or rows[-1].step is None or rows[-1].compiled:
            return far, math.inf
        last = rows[-1]
        most = longest_in_plain(METHODS[last.method]) * self._trial.seconds / self._trial.whole
        # If an earlier run took more steps in plain Python than that, nothing is compiled.
        return far, last.bare_time_per_s * self._trial.seconds * most / last.steps if last.steps <= most else math.inf

    def _row(self, solver: Solver, run: TimedRun, bare: float, time_per_s: float) -> TradeRow:
        trial, reference, end = self._trial, self._reference, run.sample
        attitude, rate, position = trial.differences(end, self._truth)
        return TradeRow(
            method=solver.method,
            step=solver.step,
            # If the whole motion has a closed form, accuracy has no effect.
            accuracy=None if run.methods == EXACT.name else solver.accuracy,
            attitude_error=attitude,
            rate_error=rate,
            position_error=position,
            error=trial.error(max(attitude, reference.attitude), max(position, reference.position)),
            within_trust=attitude <= reference.attitude and position <= reference.position,
            energy_defect=end.energy_defect,
            angular_momentum_defect=norm(end.angular_momentum_defect_world),
            linear_momentum_defect=norm(end.linear_momentum_defect_world),
            time_per_s=time_per_s,
            real_time_factor=1.0 / time_per_s,
            bare_time_per_s=bare,
            steps=run.steps,
            evaluations=evaluations_in(run.methods, run.steps, by_accuracy=solver.step is None),
            compiled=run.compiled,
        )


def far_from(target: float, rows: Sequence[TradeRow], coming: Sequence[Solver]) -> int:
    """Return how many of the settings `coming` are still far from an error of `target`, at the observed order.

    The errors are assumed to fall at least at the order of the method, so that rather too few are skipped.
    """
    if len(rows) < 2 or not target < rows[-1].error < rows[-2].error <= HOPELESS:
        return 0
    before, last = rows[-2:]
    fall = math.log(before.error / last.error) / math.log(_size(before) / _size(last))
    order = METHODS[last.method].order if last.step is not None else 1
    near = _size(last) * math.exp(math.log(target / last.error) / max(fall, order or 1))
    return max(0, sum(_size(one) > near for one in coming) - _BEFORE)


def _size(one: TradeRow | Solver) -> float:
    """Return the step or the accuracy."""
    return one.step or one.accuracy or 0.0


def _run(row: TradeRow) -> tuple[int, float, float]:
    return row.steps, row.attitude_error, row.position_error


def refinements_for(trial: Excerpt) -> list[Refinement]:
    """Return all methods that can run the scene, with their settings."""
    steps = _steps(trial)
    refinements = []
    for method in METHODS.usable():
        if method.takes < trial.scene.combined_effects.takes:
            continue
        if method.order is None or method.pair is not None or method.longest_step is not None:
            refinements.append(Refinement(method.name, settings_of(method.name, _ACCURACIES), growth=1.5))
        else:
            settings = [Solver(method.name, step=step, accuracy=None) for step in steps]
            refinements.append(Refinement(method.name, settings, growth=math.sqrt(2.0)))
    return [*refinements, Refinement("auto", settings_of("auto", _ACCURACIES), growth=1.5)]


def _steps(trial: Excerpt) -> list[float]:
    """Return steps (s, two digits) from 2 rad of rotation down to 1 ns, none longer than between two commands."""
    edges = sorted({0.0, trial.seconds, *(max(0, wrench.stamp_ns) / NANOSECONDS for _, wrench in trial.commands)})
    longest = max(after - before for before, after in pairwise(edges))
    natural = min(longest, 0.5 * trial.seconds, 2.0 / trial.rate if trial.rate > 0.0 else math.inf)
    halved = (float(f"{natural * 2.0 ** (-0.5 * k):.2g}") for k in range(60))
    return [step for step in halved if step >= SHORTEST] or [SHORTEST]
