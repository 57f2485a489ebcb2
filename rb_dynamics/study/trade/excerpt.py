"""The excerpt of a scene that `trade` runs repeatedly: choose it, describe it, run it and time it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace

from rb_dynamics.errors import ConvergenceError, WrenchError
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.motion import METHODS
from rb_dynamics.motion.fixed_step_kernel import OnDemand, Tally, counted_by
from rb_dynamics.motion.result_cache import clear_caches
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import angle_between
from rb_dynamics.numerics.vector import norm, subtract
from rb_dynamics.run.plan import OPEN_END_HORIZON
from rb_dynamics.run.posting import Command, post_all
from rb_dynamics.run.sample import Sample
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.scene.model import Scene, Solver
from rb_dynamics.study.stopwatch import Stopwatch

_EPSILON = 2.0**-52

# The clock is read after each of these parts of a run.
_PARTS = 64

# A longer part, s, does not become cheaper.
_CHEAP = 1e-3

_SAMPLES = 256

# To measure the cost of outputs, run with them for this time (s) or for this share of a run without them.
_SHORT, _SHARE = 0.01, 0.25

# Resolution of a clock, s; avoids division by 0.
_TICK = 1e-9
# With fewer outputs than these the cost of one is not known.
_LEAST_OUTPUTS = 16.0

SHORTEST = 1e-6
"""The shortest excerpt, s."""


@dataclass(frozen=True)
class TimedRun:
    """Result of one run: last sample, names of the methods, steps, run time (s), and whether kernels took some steps.

    The time excludes what happens once, however long the run is.
    """

    sample: Sample
    methods: str
    steps: int
    time: float
    compiled: bool


@dataclass(frozen=True)
class Excerpt:
    """A scene, or the beginning of it, that is run repeatedly.

    Attributes:
        scene: its solver and duration are not used.
        commands: up to the end of the excerpt.
        seconds: simulated time of the excerpt.
        whole: length of the scene, s.
        clock: measures run time, s.
        pilot: a solver that can run it.
        horizon: time over which an accuracy applies, s; None for the open end of the scene.
        path: length of the path of the body origin, m.
        farthest: largest distance from the world origin, m.
        rate: largest angular rate, rad/s.
        end: last sample of the pilot's run.
    """

    scene: Scene
    commands: Sequence[Command]
    seconds: float
    whole: float
    clock: Stopwatch
    pilot: Solver
    horizon: float | None
    path: float = 0.0
    farthest: float = 0.0
    rate: float = 0.0
    end: Sample | None = None

    def run(self, solver: Solver, tally: Tally, limit: float = math.inf, parts: int = _PARTS) -> TimedRun | None:
        """Run with `solver` and the kernels that `tally` allows; return None if that takes longer than `limit` s.

        Raises:
            ConvergenceError: the method cannot take a step, or a plug-in method fails.
        """
        # Results cached by an earlier run would make this one look faster.
        clear_caches()
        run = self._new(solver, 1.0 / self.seconds)
        begin = self.clock()
        with counted_by(tally), _plugin_failures_as_refusals(solver.method):
            post_all(run, self.commands)
            run.advance(0)
            end_ns = run.next_output_ns()
            for part in range(1, parts + 1):
                run.advance(end_ns * part // parts)
                took = self.clock() - begin
                if part < parts and took > limit:
                    return None
        return TimedRun(run.sample, run.methods, run.steps, max(took, _TICK), bool(tally.used))

    def time_with_outputs(self, solver: Solver, used: Iterable[OnDemand], bare: float) -> float:
        """Return the computing time per simulated second with the outputs of the scene.

        `bare` is the same without outputs, and `used` are the kernels of that run. Outputs cost about the same
        throughout: if there are many, their cost is measured at the beginning and added.

        Raises:
            ConvergenceError: the method cannot take a step, or a plug-in method fails.
        """
        end_ns = round(self.seconds * NANOSECONDS)
        if 0.0 < self.scene.output_rate * self.seconds < 1.0:
            # The excerpt contains no output.
            return bare
        limit = max(_SHORT, _SHARE * bare * self.seconds)
        tally = self.as_the_whole(used)
        reached_ns, took = self._reached(solver, tally, self.scene.output_rate, end_ns, limit)
        seconds = reached_ns / NANOSECONDS
        # Run again with all kernels loaded, and with the step count of a whole run deciding on further ones.
        tally = self.clock.tally(self.whole / seconds)
        tally.used.update(used)

        def again(output_rate: float) -> float:
            return self._reached(solver, tally, output_rate, reached_ns)[1]

        took = min(took, again(self.scene.output_rate))
        if reached_ns == end_ns:
            return max(bare, took / seconds)
        # A difference of two times: neither may be that of a moment in which the machine stood still.
        alone = min(again(1.0 / self.seconds) for _ in range(2))
        return bare + max(0.0, took - alone) / seconds

    def _reached(
        self, solver: Solver, tally: Tally, output_rate: float, until_ns: int, limit: float = math.inf
    ) -> tuple[int, float]:
        """Run with outputs until `until_ns`, or about `limit` s; return the time reached (ns) and the run time (s)."""
        clear_caches()
        run = self._new(solver, output_rate)
        # A moment without outputs, in which the machine stood still, says nothing about the cost of outputs.
        least_ns = round(_LEAST_OUTPUTS / output_rate * NANOSECONDS) if output_rate > 0.0 else 0
        begin = self.clock()
        with counted_by(tally), _plugin_failures_as_refusals(solver.method):
            post_all(run, self.commands)
            part = max(1, until_ns >> 32) if limit < math.inf else until_ns
            while True:
                run.advance(min(part, until_ns))
                took = max(self.clock() - begin, _TICK)
                if part >= until_ns or (took > 0.5 * limit and part >= least_ns):
                    return min(part, until_ns), took
                part *= 2 if 32.0 * took > limit else 16

    def as_the_whole(self, used: Iterable[OnDemand] = ()) -> Tally:
        """Return a tally that decides on kernels as a run of the whole scene would.

        The kernels in `used` are active from the first step: in a long run, the few steps before they are loaded do not
        matter.
        """
        tally = self.clock.tally(self.whole / self.seconds)
        tally.used.update(used)
        return tally

    def warm_up(self, solver: Solver) -> None:
        """Run a moment of the scene, so that the method's imports and tables are not part of a measurement."""
        moment = replace(self, seconds=SHORTEST, horizon=SHORTEST, commands=self.commands[:1])
        with suppress(ConvergenceError):
            moment.run(solver, self.clock.tally(none=True), parts=1)

    def look(self, tally: Tally | None = None, limit: float = math.inf) -> Excerpt:
        """Return the excerpt with path, distance, rate and end filled in by a run, in plain Python without `tally`.

        Raises:
            ConvergenceError: the pilot cannot take a step, or the run takes longer than `limit` s.
        """
        run, samples = self._new(self.pilot, _SAMPLES / self.seconds), []
        begin = self.clock()
        post_all(run, self.commands)
        with counted_by(tally or self.clock.tally(none=True)):
            for _ in range(_SAMPLES + 1):
                run.advance(run.next_output_ns())
                samples.append(run.sample)
                if self.clock() - begin > limit:
                    raise ConvergenceError(f"{self.scene.source}: the motion takes more than {limit:.3g} s to run once")
        speeds = [norm(sample.linear_velocity_world) for sample in samples]
        return replace(
            self,
            path=math.fsum(speeds) / len(speeds) * self.seconds,
            farthest=max(norm(sample.position_world) for sample in samples),
            rate=max(norm(sample.angular_velocity_body) for sample in samples),
            end=samples[-1],
        )

    def part(self, seconds: float) -> Excerpt:
        """Return the first `seconds` of the excerpt, without path, distance, rate and end."""
        within = [(topic, wrench) for topic, wrench in self.commands if wrench.stamp_ns < seconds * NANOSECONDS]
        return replace(self, commands=within, seconds=seconds, horizon=seconds)

    def _new(self, solver: Solver, output_rate: float) -> Simulation:
        """Return a new run of the excerpt with this many outputs per second."""
        return Simulation(replace(self.scene, solver=solver, duration=self.horizon, output_rate=output_rate))

    def error(self, attitude: float, position: float) -> float:
        """Return the larger of the attitude error and the position error relative to the path."""
        # A difference below the resolution of the position in doubles is not an error of the method.
        drift = max(0.0, position - 4.0 * _EPSILON * self.farthest)
        return max(attitude, drift / self.path if self.path > 0.0 else float(drift > 0.0))

    def differences(self, a: Sample, b: Sample) -> tuple[float, float, float]:
        """Return the differences of two samples in attitude (rad), rate (rad/s) and position (m)."""
        return (
            angle_between(a.orientation_xyzw, b.orientation_xyzw),
            norm(subtract(a.angular_velocity_body, b.angular_velocity_body)),
            norm(subtract(a.position_world, b.position_world)),
        )


@contextmanager
def _plugin_failures_as_refusals(method: str) -> Iterator[None]:
    """Turn any exception of a plug-in's method into a ConvergenceError: the scene may not even name it."""
    try:
        yield
    except ConvergenceError:
        raise
    except Exception as error:
        if origin := METHODS.origin(method):
            raise ConvergenceError(
                f"{method}: a step failed in the plug-in {origin}, {type(error).__name__}: {error}; mend or uninstall "
                "that package"
            ) from error
        raise


def accepted(scene: Scene, commands: Sequence[Command]) -> list[Command]:
    """Return the commands that the scene does not reject."""
    solver = Solver("euler", step=1.0) if not scene.wheels else Solver()
    run = Simulation(replace(scene, solver=solver))
    honoured: list[Command] = []
    for topic, wrench in commands:
        with suppress(WrenchError):
            if isinstance(wrench, Wrench):
                run.check(topic, wrench).require()
            else:
                run.actuate(topic, wrench.value)
            honoured.append((topic, wrench))
    return honoured


def trial_of(scene: Scene, commands: Sequence[Command], limit: float, clock: Stopwatch) -> Excerpt:
    """Return the longest excerpt that a general method runs in about `limit` s in plain Python.

    Plain Python, because not every method has a kernel, and because the errors of a longer run would be mostly
    round-off.

    Raises:
        ConvergenceError: no general method can run the scene.
    """
    whole = scene.duration or OPEN_END_HORIZON
    refusal = ConvergenceError(f"{scene.source}: no method was found to try the scene with")
    for name in (name for name in ("taylor", "dop853") if METHODS[name].takes >= scene.combined_effects.takes):
        for accuracy in (1e-9, 1e-6, 1e-3):
            solver = Solver(name, accuracy=accuracy)
            try:
                return _longest(Excerpt(scene, commands, whole, whole, clock, solver, whole), limit)
            except ConvergenceError as error:
                refusal = error
    raise refusal


def _longest(trial: Excerpt, limit: float) -> Excerpt:
    """Return the longest part of `trial` that its pilot runs in about `limit` s, by trying longer and longer ones.

    Raises:
        ConvergenceError: the pilot cannot take a step.
    """
    whole = trial.seconds
    part = shorter = trial.part(min(whole, max(SHORTEST, whole * 2.0**-40)))
    part.warm_up(trial.pilot)
    most = 4.0 * limit
    while (run := part.run(trial.pilot, trial.clock.tally(none=True), most)) is not None:
        times, most = min(16.0, 0.7 * limit / run.time), limit
        if times < 1.2 and part.seconds < _CHEAP:
            # In a very short part, rounding hides when a wheel lets go, and to look for that may take most of the time.
            times, most = 16.0, 1.2 * run.time
        if part.seconds == whole or times < 1.2:
            break
        shorter, part = part, trial.part(min(whole, float(f"{times * part.seconds:.3g}")))
    return (part if run else shorter).look()
