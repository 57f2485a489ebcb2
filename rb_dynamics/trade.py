"""`trade`: speed against accuracy of all methods that can run a scene, measured on the scene itself, and what to take.

Every method goes from coarse settings to fine ones, in turns, so that each has had about the same time; what it reached
is compared with a reference on which two methods of different families agree. Never changes anything.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from itertools import pairwise

from rb_dynamics.diagnostics import Sample
from rb_dynamics.errors import ConvergenceError, SceneError, WrenchError
from rb_dynamics.explain import probe_commands
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.motion import METHODS
from rb_dynamics.motion.exact import EXACT
from rb_dynamics.motion.free import _tumble
from rb_dynamics.motion.step_control import NANOSECONDS
from rb_dynamics.motion.taylor import _expand
from rb_dynamics.rotation import angle_between
from rb_dynamics.scene.compile import OPEN_END_HORIZON
from rb_dynamics.scene.model import Scene, Solver
from rb_dynamics.simulate import Simulation
from rb_dynamics.vector import norm, subtract

Clock = Callable[[], float]
"""Returns the time in s; only differences count."""

USELESS = 1e-3
"""A reference whose two methods differ by more is none: rad, or relative to the path."""

_EPSILON = 2.0**-52

# Of the time there is: one run of the whole scene may take so much, and finding the reference.
_PILOT, _REFERENCE = 1.0 / 60.0, 0.4

_ACCURACIES = tuple(10.0**-k for k in range(3, 13))
_REFERENCE_ACCURACIES = (1e-4, 1e-7, 1e-9, 1e-11, 1e-12, 1e-13, 1e-14)

# One of each family, in the order in which they are tried.
_FAMILIES = ("exact", "taylor", "dop853", "dlm6", "rkmk54", "radau", "midpoint6")

# A short run (s) is timed this often, and the best counts.
_SHORT, _REPEATS = 0.05, 3

# Parts of a run between which it looks at the clock.
_PARTS = 64

# So many refusals in a row, and so many runs that are no better, tell that no finer setting helps.
_REFUSALS, _NO_BETTER = 12, 3

_SAMPLES = 256

_SHORTEST_TRIAL = 1e-6


@dataclass(frozen=True)
class Row:
    """One run: a method with one setting.

    Attributes:
        method: by name.
        step: s; None where the accuracy sets the steps.
        accuracy: None where the step is fixed; both are None where all of the motion has a closed form.
        attitude_error: at the end of the trial, against the reference, rad.
        rate_error: likewise, of the angular velocity, rad/s.
        position_error: likewise, of the body origin, m.
        error: the larger of attitude_error and position_error / path, as `solver.accuracy` counts it; not less than
            what the reference is good for, and without what doubles of the size of the position cannot resolve.
        within_trust: whether attitude and position are as good as the reference, so that it cannot tell the error.
        energy_defect: T - T0 - work at the end, J.
        angular_momentum_defect: |L - L0 - integral of N dt| at the end, kg m^2/s.
        linear_momentum_defect: |p - p0 - integral of F dt| at the end, kg m/s.
        time_per_s: seconds of computing for each simulated second.
        real_time_factor: simulated seconds for each second of computing.
        steps: taken in the trial; those tried and refused are not counted.
        front: whether no other row is as fast and as accurate, and better in one of the two.
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
    steps: int
    front: bool = False

    @property
    def setting(self) -> str:
        """The setting, for a person."""
        return _setting(self.step, self.accuracy)

    @property
    def solver(self) -> str:
        """The line that says it in a scene."""
        parts = [f"method: {self.method}"]
        parts += [
            f"{key}: {_decimal(value)}"
            for key, value in (("step", self.step), ("accuracy", self.accuracy))
            if value is not None
        ]
        return f"solver: {{{', '.join(parts)}}}"


@dataclass(frozen=True)
class Reference:
    """What the rows are compared with, and how far it can be trusted.

    Attributes:
        method: made it, with its setting.
        check: of another family, made the one it was compared with.
        attitude: their difference, but not less than what rounding does, rad.
        rate: likewise, rad/s.
        position: likewise, m.
        error: the larger of attitude and position / path.
        path: of the body origin during the trial, m.
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
        """Whether the two methods agree well enough for anything."""
        return self.error <= USELESS

    def errors(self, row: Row) -> tuple[str, str, str]:
        """Return the errors of attitude, rate and position for a person: "<=" the trust where they are below it."""
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
class Recommendation:
    """What to write into the scene.

    Attributes:
        solver: the line to paste.
        reason: why this row.
        row: what it was measured to do.
    """

    solver: str
    reason: str
    row: Row


@dataclass(frozen=True)
class Trade:
    """Speed against accuracy on one scene.

    Attributes:
        scene: file name.
        trial_s: simulated seconds that were measured; errors are those at their end.
        reference: what the errors are errors against.
        rows: by method in the order of `METHODS`, "auto" last, each from coarse to fine.
        recommended: None where no row does what is asked for.
        target: the error asked for, rad and relative to the path; None where a speed was.
        budget: the real-time factor asked for; None where an error was.
        ended: why each method went no further.
        remarks: what else a user should know.
    """

    scene: str
    trial_s: float
    reference: Reference
    rows: tuple[Row, ...]
    recommended: Recommendation | None
    target: float | None
    budget: float | None
    ended: Mapping[str, str]
    remarks: tuple[str, ...]

    @property
    def front(self) -> tuple[Row, ...]:
        """The rows on the front, from fast to accurate."""
        return tuple(sorted((row for row in self.rows if row.front), key=lambda row: row.time_per_s))

    @property
    def shortfall(self) -> str:
        """Why nothing is recommended, and what to do; "" where something is."""
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
        if self.budget is not None:
            best = max((row.real_time_factor for row in self.rows), default=0.0)
            return (
                f"{self.scene}: nothing measured runs at {self.budget:g} times real time, the fastest at {best:.3g}; "
                "ask for less (--budget)"
            )
        least = min((row.error for row in self.rows), default=math.inf)
        return (
            f"{self.scene}: nothing measured is known to have an error of at most {self.target:g}: the best has "
            f"{least:.2g}, and the reference is good to {reference.error:.2g}; ask for less (--target) or give more "
            "time (--time)"
        )

    def as_dict(self) -> dict[str, object]:
        """Return the fields by name."""
        return asdict(self)


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

TIME_IS_UP = "its time was up"


def climb(
    climbers: Sequence[Climber],
    measure: Measure,
    end: float,
    clock: Clock,
    after: Callable[[], None] = lambda: None,
) -> None:
    """Let each of `climbers` go as far as it gets until `end` on the `clock`, all with about the same time.

    Always the one goes on that will have had the least time after its next run, so what one leaves the others share. No
    run is started that is expected to last beyond the end.

    Args:
        climbers: are changed.
        measure: runs a setting.
        end: time on the clock at which nothing may run any more.
        clock: s.
        after: called after each run.
    """
    while going := [climber for climber in climbers if not climber.ended]:
        left = end - clock()
        climber = min(going, key=lambda climber: climber.spent + climber.expected)
        if left <= 0.0 or climber.expected > left:
            climber.ended = TIME_IS_UP
            continue
        climber.go(measure, min(left, max(left / len(going), 3.0 * climber.expected)), clock)
        after()


def trade(
    scene: Scene,
    commands: Sequence[tuple[str, Wrench]] = (),
    *,
    target: float | None = None,
    budget: float | None = None,
    time_s: float = 30.0,
    progress: Callable[[float], None] | None = None,
    clock: Clock = time.perf_counter,
) -> Trade:
    """Return how fast and how accurate each method that can run `scene` is on it.

    Args:
        scene: is not changed; its solver gives the target where none is asked for.
        commands: wrench commands of the scene's channels; without any, the channels are tried with a probe.
        target: error to be kept, in attitude (rad) and in position relative to the path.
        budget: real-time factor to be kept; then the most accurate row is recommended.
        time_s: about how long all of it may take, s.
        progress: called now and then with the fraction done.
        clock: what is measured with, s.

    Raises:
        SceneError: the scene has nothing to measure.
        ConvergenceError: no two methods can run the scene in the time.
    """
    begin = clock()

    def told() -> None:
        if progress is not None:
            progress(min(1.0, (clock() - begin) / time_s))

    if scene.duration == 0.0:
        raise SceneError(f"{scene.source}: duration: found 0, expected a motion to measure; give a longer one")
    if target is None and budget is None:
        target = scene.solver.accuracy or 1e-9
    remarks = []
    if scene.channels and not commands:
        commands = probe_commands(scene, scene.duration or OPEN_END_HORIZON)
        remarks.append(
            "the channels were tried with a probe, a force and a torque that reverse every second; with --wrench BAG "
            "the commands of a bag are tried instead"
        )
    accepted = _accepted(scene, commands)
    if len(accepted) < len(commands):
        remarks.append(f"{len(commands) - len(accepted)} of {len(commands)} wrench commands were rejected")
    trial = _trial(scene, accepted, _PILOT * time_s, clock)
    whole = scene.duration or OPEN_END_HORIZON
    if trial.seconds < whole:
        remarks.append(
            f"measured over the first {trial.seconds:.6g} s of {whole:g} s: errors are those after them, and more time "
            "(--time) measures more"
        )
    reference, truth = _reference(trial, begin + _REFERENCE * time_s, told)
    table = _Table(replace(trial, horizon=scene.duration), reference, truth)
    climbers = _climbers(trial) if reference.is_useful else []
    climb(climbers, table.measure, begin + time_s, clock, told)
    rows = with_front([row for climber in climbers for row in table.rows.get(climber.method, ())])
    if progress is not None:
        progress(1.0)
    return Trade(
        scene.source,
        trial.seconds,
        reference,
        rows,
        recommend(rows, target, budget),
        target,
        budget,
        {climber.method: climber.ended for climber in climbers},
        tuple(remarks),
    )


def with_front(rows: Sequence[Row]) -> tuple[Row, ...]:
    """Return the rows, those on the Pareto front of error and time marked."""
    fastest: dict[float, float] = {}
    least = math.inf
    for row in sorted(rows, key=lambda row: (row.time_per_s, row.error)):
        if row.error < least:
            least = row.error
            fastest[row.error] = row.time_per_s
    return tuple(replace(row, front=fastest.get(row.error) == row.time_per_s) for row in rows)


def recommend(rows: Sequence[Row], target: float | None, budget: float | None) -> Recommendation | None:
    """Return the fastest row that keeps `target`, or the most accurate that keeps `budget`; None where none does."""
    if budget is not None:
        fast = [row for row in rows if row.real_time_factor >= budget]
        row = min(fast, key=lambda row: (row.error, row.time_per_s), default=None)
        reason = f"the most accurate that runs at {budget:g} times real time or faster"
    else:
        accurate = [row for row in rows if target is not None and row.error <= target]
        row = min(accurate, key=lambda row: row.time_per_s, default=None)
        reason = f"the fastest with an error of at most {target:g}"
    return None if row is None else Recommendation(row.solver, reason, row)


@dataclass(frozen=True)
class _Flight:
    """The end of a run, the methods and steps that led to it and the time they took, s."""

    sample: Sample
    methods: str
    steps: int
    time: float


@dataclass(frozen=True)
class _Trial:
    """What is run again and again.

    Attributes:
        scene: without its solver, duration and outputs.
        commands: until the end.
        seconds: simulated.
        clock: s.
        horizon: over which an accuracy is kept, s; None for the scene's open end.
        path: of the body origin, m.
        farthest: from the origin of the world, m.
        rate: the largest, rad/s.
    """

    scene: Scene
    commands: Sequence[tuple[str, Wrench]]
    seconds: float
    clock: Clock
    horizon: float | None
    path: float = 0.0
    farthest: float = 0.0
    rate: float = 0.0

    def fly(self, solver: Solver, limit: float = math.inf, parts: int = _PARTS) -> _Flight | None:
        """Return the end of a run; None if it is not over after `limit` s.

        Raises:
            ConvergenceError: the method refuses.
        """
        # No run may find there what another one has computed.
        _tumble.cache_clear()
        _expand.cache_clear()
        begin = self.clock()
        run = self.start(solver, 1)
        run.advance(0)
        end_ns = run.next_output_ns()
        for part in range(1, parts + 1):
            run.advance(end_ns * part // parts)
            took = self.clock() - begin
            if part < parts and took > limit:
                return None
        return _Flight(run.sample, run.methods, run.steps, took)

    def warm_up(self, solver: Solver) -> None:
        """Let the method import and tabulate what it needs."""
        moment = replace(self, seconds=_SHORTEST_TRIAL, horizon=_SHORTEST_TRIAL, commands=self.commands[:1])
        with suppress(ConvergenceError):
            moment.fly(solver, parts=1)

    def start(self, solver: Solver, outputs: int) -> Simulation:
        """Return a run with so many outputs, the last at the end of the trial."""
        scene = replace(self.scene, solver=solver, duration=self.horizon, output_rate=outputs / self.seconds)
        run = Simulation(scene)
        for topic, wrench in self.commands:
            run.post(topic, wrench, wrench.stamp_ns)
        return run

    def error(self, attitude: float, position: float) -> float:
        """Return the larger of the attitude error and the position error relative to the path."""
        # What the numbers of the position itself cannot tell is no error of a method.
        drift = max(0.0, position - 4.0 * _EPSILON * self.farthest)
        return max(attitude, drift / self.path if self.path > 0.0 else float(drift > 0.0))

    def differences(self, a: Sample, b: Sample) -> tuple[float, float, float]:
        """Return how far two ends are apart in attitude (rad), rate (rad/s) and position (m)."""
        return (
            angle_between(a.orientation_xyzw, b.orientation_xyzw),
            norm(subtract(a.angular_velocity_body, b.angular_velocity_body)),
            norm(subtract(a.position_world, b.position_world)),
        )


class _Table:
    """Measures rows of `trial` against `truth`."""

    def __init__(self, trial: _Trial, reference: Reference, truth: Sample) -> None:
        self.rows: dict[str, list[Row]] = {}
        self._trial, self._reference, self._truth = trial, reference, truth

    def measure(self, solver: Solver, limit: float) -> tuple[float, str]:
        """Run a setting and add its row; see `Measure`."""
        rows = self.rows.setdefault(solver.method, [])
        if not rows:
            self._trial.warm_up(solver)
        flight = self._trial.fly(solver, limit)
        if flight is None:
            return math.inf, TIME_IS_UP
        best = flight.time
        for _ in range(_REPEATS - 1 if flight.time < min(_SHORT, limit / _REPEATS) else 0):
            again = self._trial.fly(solver, parts=1)
            best = min(best, again.time if again else math.inf)
        row = self._row(solver, flight, best)
        # The same steps again: a setting that changes nothing is not worth a row.
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

    def _row(self, solver: Solver, flight: _Flight, took: float) -> Row:
        trial, reference, end = self._trial, self._reference, flight.sample
        attitude, rate, position = trial.differences(end, self._truth)
        return Row(
            method=solver.method,
            step=solver.step,
            # Where all of the motion has a closed form, no accuracy sets anything.
            accuracy=None if flight.methods == EXACT.name else solver.accuracy,
            attitude_error=attitude,
            rate_error=rate,
            position_error=position,
            error=trial.error(max(attitude, reference.attitude), max(position, reference.position)),
            within_trust=attitude <= reference.attitude and position <= reference.position,
            energy_defect=end.energy_defect,
            angular_momentum_defect=norm(end.angular_momentum_defect_world),
            linear_momentum_defect=norm(end.linear_momentum_defect_world),
            time_per_s=took / trial.seconds,
            real_time_factor=trial.seconds / took,
            steps=flight.steps,
        )


def _run(row: Row) -> tuple[int, float, float]:
    return row.steps, row.attitude_error, row.position_error


def _accepted(scene: Scene, commands: Sequence[tuple[str, Wrench]]) -> list[tuple[str, Wrench]]:
    """Return the commands that can be honoured."""
    run, accepted = Simulation(replace(scene, solver=Solver("euler", step=1.0))), []
    for topic, wrench in commands:
        with suppress(WrenchError):
            run.post(topic, wrench, wrench.stamp_ns)
            accepted.append((topic, wrench))
    return accepted


def _trial(scene: Scene, commands: Sequence[tuple[str, Wrench]], limit: float, clock: Clock) -> _Trial:
    """Return the trial over as much of the scene as a general method runs in about `limit` s.

    Raises:
        ConvergenceError: none of them can.
    """
    whole = scene.duration or OPEN_END_HORIZON
    refusal = ConvergenceError(f"{scene.source}: no method was found to try the scene with")
    for name in (name for name in ("taylor", "dop853") if METHODS[name].takes >= scene.acting.takes):
        for accuracy in (1e-9, 1e-6, 1e-3):
            solver = Solver(name, accuracy=accuracy)
            try:
                return _measured(_longest(scene, commands, solver, whole, limit, clock), solver)
            except ConvergenceError as error:
                refusal = error
    raise refusal


def _longest(
    scene: Scene, commands: Sequence[tuple[str, Wrench]], solver: Solver, whole: float, limit: float, clock: Clock
) -> _Trial:
    """Return the trial over the longest part of `whole` s that `solver` runs in about `limit` s, found by lengthening.

    Raises:
        ConvergenceError: it refuses.
    """
    trial = shorter = _part(
        _Trial(scene, (), whole, clock, whole), commands, min(whole, max(_SHORTEST_TRIAL, whole * 2.0**-40))
    )
    trial.warm_up(solver)
    while (flight := trial.fly(solver, limit)) is not None:
        longer = min(16.0, 0.7 * limit / flight.time) * trial.seconds
        if trial.seconds == whole or longer < 1.2 * trial.seconds:
            break
        shorter, trial = trial, _part(trial, commands, min(whole, float(f"{longer:.3g}")))
    return trial if flight else shorter


def _part(trial: _Trial, commands: Sequence[tuple[str, Wrench]], seconds: float) -> _Trial:
    within = [(topic, wrench) for topic, wrench in commands if wrench.stamp_ns < seconds * NANOSECONDS]
    return replace(trial, commands=within, seconds=seconds, horizon=seconds)


def _measured(trial: _Trial, solver: Solver) -> _Trial:
    """Return the trial with what its motion is like."""
    run, samples = trial.start(solver, _SAMPLES), []
    for _ in range(_SAMPLES + 1):
        run.advance(run.next_output_ns())
        samples.append(run.sample)
    speeds = [norm(sample.linear_velocity_world) for sample in samples]
    return replace(
        trial,
        path=math.fsum(speeds) / len(speeds) * trial.seconds,
        farthest=max(norm(sample.position_world) for sample in samples),
        rate=max(norm(sample.angular_velocity_body) for sample in samples),
    )


def _reference(trial: _Trial, end: float, after: Callable[[], None]) -> tuple[Reference, Sample]:
    """Return the reference and the end of its motion: two families go on to the finest that they can keep.

    Raises:
        ConvergenceError: not two of them came to the end of the trial in the time.
    """
    found: dict[str, tuple[Solver, Sample]] = {}
    reasons = []

    def measure(solver: Solver, limit: float) -> tuple[float, str]:
        flight = trial.fly(solver, limit)
        if flight is None:
            return math.inf, TIME_IS_UP
        found[solver.method] = solver, flight.sample
        return flight.time, ""

    for name in _FAMILIES:
        if METHODS[name].takes >= trial.scene.acting.takes and len(found) < 2:
            climber = Climber(name, _accuracies(name, _REFERENCE_ACCURACIES), growth=2.0)
            trial.warm_up(climber.settings[0])
            # No more than half of what is left, so that another one can be tried.
            climb([climber], measure, 0.5 * (trial.clock() + end), trial.clock, after)
            reasons.append(f"{name}: {climber.ended}")
    if len(found) < 2:
        raise ConvergenceError(
            f"{trial.scene.source}: no reference could be made, which takes two methods that can run the scene; give "
            f"more time (--time) or mend what they refuse. {'; '.join(reasons)}"
        )
    best = sorted(found.values(), key=lambda one: _accuracy(one[0]) or 0.0)
    (solver, truth), (other, check) = best
    apart = trial.differences(truth, check)
    turned = trial.rate * trial.seconds
    floors = (
        4.0 * _EPSILON * (1.0 + turned),
        4.0 * _EPSILON * trial.rate,
        4.0 * _EPSILON * (trial.farthest + trial.path),
    )
    attitude, rate, position = map(max, apart, floors)
    made, checked = (f"{one.method}, {_setting(None, _accuracy(one))}" for one in (solver, other))
    return Reference(made, checked, attitude, rate, position, trial.error(attitude, position), trial.path), truth


def _climbers(trial: _Trial) -> list[Climber]:
    """Return all methods that can take the scene, with their settings."""
    steps = _steps(trial)
    climbers = []
    for method in METHODS.values():
        if method.takes < trial.scene.acting.takes:
            continue
        if method.order is None or method.pair is not None or method.longest_step is not None:
            climbers.append(Climber(method.name, _accuracies(method.name, _ACCURACIES), growth=1.5))
        else:
            settings = [Solver(method.name, step=step, accuracy=None) for step in steps]
            climbers.append(Climber(method.name, settings, growth=math.sqrt(2.0)))
    return [*climbers, Climber("auto", _accuracies("auto", _ACCURACIES), growth=1.5)]


def _accuracies(name: str, accuracies: Sequence[float]) -> list[Solver]:
    """Return the settings of a method that finds its own steps; a closed form has only one."""
    return [Solver(name)] if name == EXACT.name else [Solver(name, accuracy=accuracy) for accuracy in accuracies]


def _accuracy(solver: Solver) -> float | None:
    return None if solver.method == EXACT.name else solver.accuracy


def _steps(trial: _Trial) -> list[float]:
    """Return steps (s) of two digits from 2 rad down, none longer than what lies between two commands."""
    edges = sorted({0.0, trial.seconds, *(max(0, wrench.stamp_ns) / NANOSECONDS for _, wrench in trial.commands)})
    longest = max(after - before for before, after in pairwise(edges))
    natural = min(longest, 0.5 * trial.seconds, 2.0 / trial.rate if trial.rate > 0.0 else math.inf)
    return [float(f"{natural * 2.0 ** (-0.5 * k):.2g}") for k in range(60)]


def _setting(step: float | None, accuracy: float | None) -> str:
    if step is not None:
        return f"step {step:g} s"
    return "closed form" if accuracy is None else f"accuracy {accuracy:g}".replace("e-0", "e-")


def _decimal(value: float) -> str:
    """Return a number as YAML reads it: with a point in front of an exponent."""
    mantissa, e, exponent = repr(value).partition("e")
    return f"{mantissa}{'' if '.' in mantissa else '.0'}e{int(exponent)}" if e else mantissa
