"""What `trade` returns: the measured runs, the reference, the front, and the recommendation."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from statistics import median

from rb_dynamics.scene.model import Solver
from rb_dynamics.study.trade.refinement import TIME_IS_UP

USELESS = 1e-3
"""If the two methods of a reference differ by more (rad, or relative to the path), it cannot be used."""


HOPELESS = 1.0
"""A run with a larger error (rad, or relative to the path) has lost the motion: it is never on the front."""


@dataclass(frozen=True)
class TradeRow:
    """One run: a method with one setting.

    Attributes:
        method: its name.
        step: s; None if the accuracy sets the steps.
        accuracy: None if the step is fixed. Both are None if the whole motion has a closed form.
        attitude_error: difference from the reference at the end of the excerpt, rad.
        rate_error: the same of the angular velocity, rad/s.
        position_error: the same of the body origin, m.
        error: the larger of attitude_error and position_error / path, as `solver.accuracy` defines it; at least the
            error of the reference, and without what doubles of the size of the position cannot resolve.
        within_trust: whether attitude and position agree with the reference within its own error.
        energy_defect: T - T0 - work at the end, J.
        angular_momentum_defect: |L - L0 - integral of N dt| at the end, kg m^2/s.
        linear_momentum_defect: |p - p0 - integral of F dt| at the end, kg m/s.
        time_per_s: computing time per simulated second with all outputs of the scene, without compiling, loading and
            writing a log.
        real_time_factor: simulated seconds per second of computing, with all outputs.
        bare_time_per_s: as `time_per_s`, without outputs.
        steps: accepted steps in the excerpt.
        evaluations: of torque and force in these steps, error estimates included; None if it is not a fixed number: an
            implicit method iterates, a Taylor series has derivatives instead.
        compiled: whether kernels took some of the steps, as they would in a run of the whole scene.
        front: whether no other row is at least as fast and as accurate and better in one of the two, and the error is
            at most `HOPELESS`. A row of "auto" that made the same run as another row is left out: which was faster is
            chance.
        time_spread: how much longer the median of its runs without outputs took than the fastest, which counts,
            relative to that; None if it was run once.
    """

    method: str
    step: float | None
    accuracy: float | None
    attitude_error: float
    rate_error: float
    position_error: float
    error: float
    within_trust: bool
    energy_defect: float
    angular_momentum_defect: float
    linear_momentum_defect: float
    time_per_s: float
    real_time_factor: float
    bare_time_per_s: float
    steps: int
    evaluations: int | None
    compiled: bool
    front: bool = False
    time_spread: float | None = None

    @property
    def setting(self) -> str:
        """The setting, as text."""
        return setting(self.step, self.accuracy)

    @property
    def bare_real_time_factor(self) -> float:
        """Simulated seconds per second of computing, without outputs."""
        return 1.0 / self.bare_time_per_s

    @property
    def as_solver(self) -> Solver:
        """The solver of this row."""
        if self.step is None and self.accuracy is None:
            return Solver(self.method)
        return Solver(self.method, self.step, self.accuracy)

    @property
    def solver(self) -> str:
        """The line to write in a scene."""
        parts = [f"method: {self.method}"]
        parts += [
            f"{key}: {_decimal(value)}"
            for key, value in (("step", self.step), ("accuracy", self.accuracy))
            if value is not None
        ]
        return f"solver: {{{', '.join(parts)}}}"


@dataclass(frozen=True)
class Reference:
    """What the rows are compared with, and how accurate it is.

    Attributes:
        method: the method that made it, with its setting.
        check: the other method that it was compared with.
        attitude: their difference, at least the effect of rounding, rad.
        rate: the same of the angular velocity, rad/s.
        position: the same of the body origin, m.
        error: the larger of attitude and position / path.
        path: length of the path of the body origin during the excerpt, m.
    """

    method: str
    check: str
    attitude: float
    rate: float
    position: float
    error: float
    path: float

    @property
    def is_useful(self) -> bool:
        """Whether the two methods agree well enough."""
        return self.error <= USELESS

    def errors(self, row: TradeRow) -> tuple[str, str, str]:
        """Return the errors of attitude, rate and position as text: "<=" where the reference is no better."""
        pairs = (
            (row.attitude_error, self.attitude),
            (row.rate_error, self.rate),
            (row.position_error, self.position),
        )
        attitude, rate, position = (
            f"{error:.1e}" if error > trust else f"<={trust:.1e}" if trust > 0.0 else "0" for error, trust in pairs
        )
        return attitude, rate, position


@dataclass(frozen=True)
class Verdict:
    """The error of a row at the end of the scene, which may lie beyond the excerpt.

    Attributes:
        error: as `TradeRow.error` defines it.
        measured: whether the whole scene was run; otherwise the error is extrapolated by `grown`.
    """

    error: float
    measured: bool


@dataclass(frozen=True)
class Recommendation:
    """What to write in the scene.

    Attributes:
        solver: the line to paste.
        reason: why this row, and whether its error was only extrapolated.
        row: its measurement on the excerpt.
        whole: its error at the end of the scene, which is the one compared with the target.
    """

    solver: str
    reason: str
    row: TradeRow
    whole: Verdict


@dataclass(frozen=True)
class Trade:
    """Speed against accuracy on one scene.

    Attributes:
        scene: file name.
        trial_s: length of the excerpt in simulated seconds; the errors of rows are those at its end.
        reference: what errors are relative to.
        rows: by method in the order of `METHODS`, "auto" last, each from coarse to fine.
        recommended: None if no row meets the target or budget.
        target: the error required, rad and relative to the path; None if a speed was required.
        budget: the real-time factor required; None if an error was.
        ended: why the refinement of each method ended.
        kernels: time (s) to compile or load each kernel, by name; not part of any row.
        remarks: anything else a user should know.
        whole: length of the scene, s.
        checked_by: the row that recommended rows were compared with at the end of the scene; None if the excerpt is the
            whole scene or there was no time for it.
        enough_s: measuring time (s) that would probably be enough; None if the excerpt is the whole scene, or no
            measurement tells, or no more than was given.
    """

    scene: str
    trial_s: float
    reference: Reference
    rows: tuple[TradeRow, ...]
    recommended: Recommendation | None
    target: float | None
    budget: float | None
    ended: Mapping[str, str]
    kernels: Mapping[str, float]
    remarks: tuple[str, ...]
    whole: float
    checked_by: TradeRow | None
    enough_s: float | None = None

    @property
    def measured(self) -> str:
        """What has rows, as text; "auto" is not counted as a method."""
        methods = {row.method for row in self.rows}
        named = len(methods - {"auto"})
        parts = [f"{named} method{'s' * (named != 1)}"] if named else []
        return " and ".join([*parts, "auto"] if "auto" in methods else parts)

    @property
    def front(self) -> tuple[TradeRow, ...]:
        """The rows on the front, from fast to accurate."""
        return tuple(sorted((row for row in self.rows if row.front), key=lambda row: row.time_per_s))

    @property
    def time_spread(self) -> float:
        """How much longer a run took than the fastest of the same setting, relative: the median over all rows."""
        known = [row.time_spread for row in self.rows if row.time_spread is not None]
        return median(known) if known else 0.0

    @property
    def doubts(self) -> tuple[str, ...]:
        """What the measured times and the measuring time leave open about the recommendation, as text."""
        if self.recommended is None:
            return ()
        taken, said = self.recommended.row, []
        spread = max(self.time_spread, taken.time_spread or 0.0)
        slower = (1.0 + spread) * taken.time_per_s
        if self.budget is not None:
            if slower * self.budget > 1.0:
                said.append(f"its time varies by {spread:.0%} from run to run, so it may miss the budget")
        else:
            most = self.target or 0.0
            # Over the whole scene, only the recommended row is known to reach the target.
            most = most if self.trial_s == self.whole else min(most, taken.error)
            close: dict[str, TradeRow] = {}
            for row in sorted(_apart(self.rows), key=lambda row: row.time_per_s):
                if row != taken and row.error <= most and taken.time_per_s <= row.time_per_s <= slower:
                    close.setdefault(row.method, row)
            if close:
                named = "; ".join(f"{row.method}, {row.setting}" for row in close.values())
                said.append(f"times vary by {spread:.0%} from run to run, so these may be as fast: {named}")
        if late := self._out_of_time():
            said.append(
                f"no time to reach the {'budget' if self.budget else 'target'} with {', '.join(late)}: "
                "a better setting may be among theirs; more time (--time) tells"
            )
        return tuple(said)

    def _out_of_time(self) -> list[str]:
        """Return the methods whose time was up before they met the target, or left the budget."""
        found = []
        for method, why in self.ended.items():
            rows = [row for row in self.rows if row.method == method]
            if self.budget is not None:
                met = any(row.real_time_factor < self.budget for row in rows)
            else:
                met = any(row.error <= (self.target or 0.0) for row in rows)
            if why == TIME_IS_UP and not met:
                found.append(method)
        return found

    @property
    def shortfall(self) -> str:
        """Why nothing is recommended, and what to do; "" if something is."""
        reference = self.reference
        if self.recommended is not None:
            return ""
        if not reference.is_useful:
            return (
                f"{self.scene}: {reference.method} and {reference.check} differ after {self.trial_s:g} s by "
                f"{reference.attitude:.2g} rad and {reference.position:.2g} m, expected at most {USELESS:g}: "
                "nothing tells which is right, and the motion may be so unstable that rounding decides it; try a "
                "shorter duration or more time (--time)"
            )
        if not self.rows:
            why = "; ".join(f"{method}: {why}" for method, why in self.ended.items())
            return f"{self.scene}: nothing could be measured ({why}); take other methods or give more time (--time)"
        if self.budget is not None:
            best = max((row.real_time_factor for row in self.rows if row.error <= HOPELESS), default=0.0)
            if best >= self.budget:
                return (
                    f"{self.scene}: nothing measured at {self.budget:g} times real time or faster is known to follow "
                    f"the motion for all {self.whole:g} s; ask for less (--budget) or give more time (--time)"
                )
            return (
                f"{self.scene}: nothing measured follows the motion at {self.budget:g} times real time, the fastest "
                f"that does at {best:.3g}; ask for less (--budget)"
            )
        least = min((row.error for row in self.rows), default=math.inf)
        if self.trial_s < self.whole and least <= (self.target or 0.0):
            end = grown(least, self.whole / self.trial_s)
            found = (
                f"those that reach it after {self.trial_s:g} s are compared there with "
                f"{self.checked_by.method}, {self.checked_by.setting}"
                if self.checked_by is not None
                else f"there was no time to run to the end, and the best error, {least:.2g} after {self.trial_s:g} s, "
                f"is {end:.2g} there if it grows with the square of time"
            )
            more = "more time (--time)" if self.enough_s is None else f"more time (about --time {self.enough_s:g})"
            return (
                f"{self.scene}: no setting that was measured is known to reach an error of {self.target:g} after all "
                f"{self.whole:g} s: {found}; ask for less (--target) or give {more}"
            )
        return (
            f"{self.scene}: no setting that was measured is known to reach an error of {self.target:g}: the best has "
            f"{least:.2g}, and the reference is good to {reference.error:.2g}; ask for less (--target) or give more "
            "time (--time)"
        )

    def as_dict(self) -> dict[str, object]:
        """Return the fields by name, and the doubts."""
        return {**asdict(self), "doubts": self.doubts}


def with_front(rows: Sequence[TradeRow]) -> tuple[TradeRow, ...]:
    """Return the rows with those on the Pareto front of error and time marked."""
    fastest: dict[float, float] = {}
    least = math.nextafter(HOPELESS, math.inf)
    apart = _apart(rows)
    for row in sorted(apart, key=lambda row: (row.time_per_s, row.error)):
        if row.error < least:
            least = row.error
            fastest[row.error] = row.time_per_s
    return tuple(replace(row, front=row in apart and fastest.get(row.error) == row.time_per_s) for row in rows)


def _apart(rows: Sequence[TradeRow]) -> list[TradeRow]:
    """Return the rows without those of "auto" that made the same run as a named method."""
    named = {_run(row) for row in rows if row.method != "auto"}
    return [row for row in rows if row.method != "auto" or _run(row) not in named]


def _run(row: TradeRow) -> tuple[float, ...]:
    return (
        row.steps,
        row.attitude_error,
        row.rate_error,
        row.position_error,
        row.energy_defect,
        row.angular_momentum_defect,
        row.linear_momentum_defect,
    )


def grown(error: float, longer: float) -> float:
    """Extrapolate an error to a run `longer` times as long: it grows with the square of time.

    An energy error that grows linearly makes phase and position along the path grow quadratically; most errors grow
    more slowly.
    """
    return error * max(1.0, longer) ** 2


def as_measured(row: TradeRow) -> Verdict:
    """Return the verdict if the excerpt is the whole scene."""
    return Verdict(row.error, measured=True)


def recommend(
    rows: Sequence[TradeRow],
    target: float | None,
    budget: float | None,
    judge: Callable[[TradeRow], Verdict] = as_measured,
    trial_s: float = 0.0,
) -> Recommendation | None:
    """Return the fastest row that meets `target`, or the most accurate that meets `budget`; None if there is none.

    `judge` gives the error over the whole scene; if it only extrapolates from the first `trial_s`, the reason says so.
    A row that is `HOPELESS` meets no budget. If "auto" made the same run as a named method, the named one is
    recommended.
    """
    rows = _apart(rows)
    if budget is not None:
        able = [row for row in rows if row.real_time_factor >= budget and row.error <= HOPELESS]
        able.sort(key=lambda row: (row.error, row.time_per_s))
        most, reason = HOPELESS, f"the most accurate that runs at {budget:g} times real time or faster"
    else:
        most, reason = target or 0.0, f"the fastest with an error of at most {target:g}"
        accurate = sorted((row for row in rows if row.error <= most), key=lambda row: (row.time_per_s, row.error))
        able = []
        for row in accurate:
            # A slower row that is no more accurate need not be judged.
            if not able or row.error < able[-1].error:
                able.append(row)
    for row in able:
        verdict = judge(row)
        if verdict.error <= most:
            if not verdict.measured:
                reason += f" over the first {trial_s:g} s; extrapolated from there, not checked to the end"
            return Recommendation(row.solver, reason, row, verdict)
    return None


def setting(step: float | None, accuracy: float | None) -> str:
    """Return a setting as text."""
    if step is not None:
        return f"step {step:g} s"
    return "closed form" if accuracy is None else f"accuracy {accuracy:g}".replace("e-0", "e-")


def _decimal(value: float) -> str:
    """Return a number as YAML reads it: with a decimal point before the exponent."""
    mantissa, e, exponent = repr(value).partition("e")
    return f"{mantissa}{'' if '.' in mantissa else '.0'}e{int(exponent)}" if e else mantissa
