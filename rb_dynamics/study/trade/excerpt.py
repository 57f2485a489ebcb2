"""The excerpt of a scene that is run again and again: choose it, describe it, run it and time it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace

from rb_dynamics.errors import ConvergenceError, WrenchError
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.motion import METHODS
from rb_dynamics.motion.caching import clear_caches
from rb_dynamics.motion.fixed_step_kernel import WORTH_LOADING, OnDemand, Tally, counted_by
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import angle_between
from rb_dynamics.numerics.vector import norm, subtract
from rb_dynamics.run.sample import Sample
from rb_dynamics.run.simulation import Simulation, post_all
from rb_dynamics.scene.model import Scene, Solver
from rb_dynamics.scene.plan import OPEN_END_HORIZON
from rb_dynamics.study.stopwatch import Stopwatch

_EPSILON = 2.0**-52

# Parts of a run between which it looks at the clock.
_PARTS = 64

_SAMPLES = 256

# So long (s), or such a share of a run without them, do outputs run to tell what they cost.
_SHORT, _SHARE = 0.005, 0.25

# No clock tells less, s.
_TICK = 1e-9

SHORTEST = 1e-6
"""The shortest trial, s."""


@dataclass(frozen=True)
class Flight:
    """The end of a run, the methods and steps that led to it, the time they took (s), and whether kernels had a part.

    The time of what happens once, whatever the length of the run, is left out.
    """

    sample: Sample
    methods: str
    steps: int
    time: float
    compiled: bool


@dataclass(frozen=True)
class Excerpt:
    """What is run again and again.

    Attributes:
        scene: without its solver and duration.
        commands: until the end.
        seconds: simulated.
        whole: length of the scene, s.
        clock: s.
        pilot: a solver that runs it.
        horizon: over which an accuracy is kept, s; None for the scene's open end.
        path: of the body origin, m.
        farthest: from the origin of the world, m.
        rate: the largest, rad/s.
        end: of the motion, as the pilot runs it.
    """

    scene: Scene
    commands: Sequence[tuple[str, Wrench]]
    seconds: float
    whole: float
    clock: Stopwatch
    pilot: Solver
    horizon: float | None
    path: float = 0.0
    farthest: float = 0.0
    rate: float = 0.0
    end: Sample | None = None

    def fly(self, solver: Solver, tally: Tally, limit: float = math.inf, parts: int = _PARTS) -> Flight | None:
        """Return the end of a run whose kernels `tally` decides on; None if it is not over after `limit` s.

        Raises:
            ConvergenceError: the method refuses, or is one of a plug-in and fails.
        """
        # No run may find there what another one has computed.
        clear_caches()
        run = self._new(solver, 1.0 / self.seconds)
        begin = self.clock()
        with counted_by(tally), _failing_alone(solver.method):
            post_all(run, self.commands)
            run.advance(0)
            end_ns = run.next_output_ns()
            for part in range(1, parts + 1):
                run.advance(end_ns * part // parts)
                took = self.clock() - begin
                if part < parts and took > limit:
                    return None
        return Flight(run.sample, run.methods, run.steps, max(took, _TICK), bool(tally.used))

    def time_with_outputs(self, solver: Solver, used: Iterable[OnDemand], bare: float) -> float:
        """Return the seconds of computing for each simulated second with the outputs of the scene.

        Without them, that is `bare`, and `used` are the kernels. Outputs cost about the same all along: where there are
        many, those of the beginning tell what all of them add.

        Raises:
            ConvergenceError: the method refuses, or is one of a plug-in and fails.
        """
        end_ns = round(self.seconds * NANOSECONDS)
        if 0.0 < self.scene.output_rate * self.seconds < 1.0:
            # None lies within.
            return bare
        limit = max(_SHORT, _SHARE * bare * self.seconds)
        tally = self.as_the_whole(used)
        reached_ns, took = self._reached(solver, tally, self.scene.output_rate, end_ns, limit)
        seconds = reached_ns / NANOSECONDS
        if tally.asked or reached_ns == end_ns:
            # What is loaded now is not loaded in the middle of it; and a part has fewer steps than all of them.
            tally = self.clock.tally(self.whole / seconds, WORTH_LOADING)
            tally.used.update(used)
            took = min(took, self._reached(solver, tally, self.scene.output_rate, reached_ns)[1])
        if reached_ns == end_ns:
            return max(bare, took / seconds)
        alone = self._reached(solver, tally, 1.0 / self.seconds, reached_ns)[1]
        return bare + max(0.0, took - alone) / seconds

    def _reached(
        self, solver: Solver, tally: Tally, output_rate: float, until_ns: int, limit: float = math.inf
    ) -> tuple[int, float]:
        """Return how far (ns) a run with outputs comes until then, or in about `limit` s, and its time (s)."""
        clear_caches()
        run = self._new(solver, output_rate)
        begin = self.clock()
        with counted_by(tally), _failing_alone(solver.method):
            post_all(run, self.commands)
            part = max(1, until_ns >> 32) if limit < math.inf else until_ns
            while True:
                run.advance(min(part, until_ns))
                took = max(self.clock() - begin, _TICK)
                if part >= until_ns or took > 0.5 * limit:
                    return min(part, until_ns), took
                part *= 2 if 32.0 * took > limit else 16

    def as_the_whole(self, used: Iterable[OnDemand] = ()) -> Tally:
        """Return a tally that decides as a run of the whole scene would, with what is compiled here in its cache.

        The kernels `used` have a part from the first step on: the steps until they do cost such a run as much as
        loading them, and are as little a matter of its length.
        """
        tally = self.clock.tally(self.whole / self.seconds, WORTH_LOADING)
        tally.used.update(used)
        return tally

    def warm_up(self, solver: Solver) -> None:
        """Let the method import and tabulate what it needs."""
        moment = replace(self, seconds=SHORTEST, horizon=SHORTEST, commands=self.commands[:1])
        with suppress(ConvergenceError):
            moment.fly(solver, self.clock.tally(worth=math.inf), parts=1)

    def look(self, tally: Tally | None = None, limit: float = math.inf) -> Excerpt:
        """Return the trial with what its motion is like, flown in plain Python unless `tally` decides.

        Raises:
            ConvergenceError: the pilot refuses, or it is not over after `limit` s.
        """
        run, samples = self._new(self.pilot, _SAMPLES / self.seconds), []
        begin = self.clock()
        post_all(run, self.commands)
        with counted_by(tally or self.clock.tally(worth=math.inf)):
            for _ in range(_SAMPLES + 1):
                run.advance(run.next_output_ns())
                samples.append(run.sample)
                if self.clock() - begin > limit:
                    raise ConvergenceError(f"{self.scene.source}: the motion takes more than {limit:.3g} s to look at")
        speeds = [norm(sample.linear_velocity_world) for sample in samples]
        return replace(
            self,
            path=math.fsum(speeds) / len(speeds) * self.seconds,
            farthest=max(norm(sample.position_world) for sample in samples),
            rate=max(norm(sample.angular_velocity_body) for sample in samples),
            end=samples[-1],
        )

    def part(self, seconds: float) -> Excerpt:
        """Return the beginning of it; what its motion is like is not known."""
        within = [(topic, wrench) for topic, wrench in self.commands if wrench.stamp_ns < seconds * NANOSECONDS]
        return replace(self, commands=within, seconds=seconds, horizon=seconds)

    def _new(self, solver: Solver, output_rate: float) -> Simulation:
        """Return a run with so many outputs a second."""
        return Simulation(replace(self.scene, solver=solver, duration=self.horizon, output_rate=output_rate))

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


@contextmanager
def _failing_alone(method: str) -> Iterator[None]:
    """Turn what a plug-in's method raises into its refusal: the scene may not even name it."""
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


def accepted(scene: Scene, commands: Sequence[tuple[str, Wrench]]) -> list[tuple[str, Wrench]]:
    """Return the commands that can be honoured."""
    run = Simulation(replace(scene, solver=Solver("euler", step=1.0)))
    honoured = []
    for topic, wrench in commands:
        with suppress(WrenchError):
            run.check(topic, wrench).require()
            honoured.append((topic, wrench))
    return honoured


def trial_of(scene: Scene, commands: Sequence[tuple[str, Wrench]], limit: float, clock: Stopwatch) -> Excerpt:
    """Return the trial over as much of the scene as a general method runs in about `limit` s in plain Python.

    In plain Python, as not every method has a kernel, and the errors of a long trial are those of rounding.

    Raises:
        ConvergenceError: none of them can.
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
    """Return the longest part of `trial` that its pilot runs in about `limit` s, found by lengthening.

    Raises:
        ConvergenceError: it refuses.
    """
    whole = trial.seconds
    part = shorter = trial.part(min(whole, max(SHORTEST, whole * 2.0**-40)))
    part.warm_up(trial.pilot)
    while (flight := part.fly(trial.pilot, trial.clock.tally(worth=math.inf), limit)) is not None:
        longer = min(16.0, 0.7 * limit / flight.time) * part.seconds
        if part.seconds == whole or longer < 1.2 * part.seconds:
            break
        shorter, part = part, trial.part(min(whole, float(f"{longer:.3g}")))
    return (part if flight else shorter).look()
