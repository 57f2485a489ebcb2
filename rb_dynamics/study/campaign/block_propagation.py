"""The bodies of a block of runs: side by side in the kernels of `Ensemble`, in turn, or one alone.

All give the same bits. Side by side is for runs with one method and a fixed step (or without effects and torque, in
closed form), under effects that act all the time and have kernels; runs with reaction wheels are in `wheel_bodies.py`.
Others that no one commands go in turn, each through `Simulation` from observation to observation, and are looked at
together; every other scene runs alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from rb_dynamics.errors import ConvergenceError, WrenchError
from rb_dynamics.formats.message_types import COMMAND
from rb_dynamics.loads.combined_effects import CombinedEffects
from rb_dynamics.loads.effect import Stored
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.loads.wrench_channels import Channel
from rb_dynamics.motion import METHODS
from rb_dynamics.motion.closed_form import EXACT
from rb_dynamics.motion.fixed_step_kernel import takes_compiled
from rb_dynamics.motion.kernel_layout import phase_of
from rb_dynamics.numerics.nanoseconds import NANOSECONDS, sample_ns
from rb_dynamics.numerics.vector import ZERO, Vector, subtract
from rb_dynamics.run.ensemble import Ensemble, body_of_arrays, initial_phases
from rb_dynamics.run.posting import rejected_words
from rb_dynamics.run.sample import Sample, torque_impulse
from rb_dynamics.run.sample_arrays import Samples
from rb_dynamics.run.simulation import Simulation, without_outputs
from rb_dynamics.scene.model import Scene
from rb_dynamics.study.campaign.control_inputs import NewestMeasurements, OnboardValues

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.numerics.array_types import Numbers
    from rb_dynamics.run.sink import Sink

    Times = npt.NDArray[np.int64]

CHANNEL = "control"
"""The wrench channel of the controller's commands."""

TORQUE, FORCE = "torque", "force"
"""What a controller commands in addition to actuators: a wrench on `CHANNEL`, body axes."""

Commands: TypeAlias = "Mapping[str, Numbers]"
"""`TORQUE` and `FORCE`, (N, 3), and commands to actuators by their names, (N,)."""

New: TypeAlias = "Mapping[str, npt.NDArray[np.bool_]]"
"""Which of N bodies a command comes to, by its name."""


def go_side_by_side(scenes: Sequence[Scene], driven: bool) -> bool:
    """Return whether the runs can go side by side; `driven`: by a controller."""
    first = scenes[0]
    shared = first.solver, first.duration
    if any((scene.solver, scene.duration) != shared for scene in scenes):
        return False
    if driven and any(scene.sensors or not _plain(scene) for scene in scenes):
        return False
    effects = [scene.combined_effects for scene in scenes]
    if any(each.effects for each in effects):
        return first.solver.step is not None and _lasting(scenes, effects, driven)
    if first.solver.method in ("auto", "exact"):
        return not driven
    return first.solver.step is not None


def _lasting(scenes: Sequence[Scene], effects: Sequence[CombinedEffects], driven: bool) -> bool:
    """Return whether an ensemble takes these effects; a law may measure a magnetic field."""
    if any(scene.actuators for scene in scenes) or (driven and any(each.magnetic for each in effects)):
        return False
    found = [each.lasting() for each in effects]
    lengths = {None if each is None else len(each.numbers) for each in found}
    method = METHODS.get(scenes[0].solver.method, EXACT)
    takes = max(each.takes for each in effects)
    able = method.order is not None and (takes == LoadDependence.HELD or takes_compiled(method, takes))
    return able and None not in lengths and len(lengths) == 1


def _plain(scene: Scene) -> bool:
    """Return whether the channel of the controller does nothing to its commands."""
    return all(channel == Channel(CHANNEL) for channel in scene.channels if channel.topic == CHANNEL)


def step_ns(scene: Scene) -> int | None:
    """Return the step of `scene` in nanoseconds; None if it has none, or it is not a whole number of them."""
    method = scene.solver.method
    if scene.solver.step is None or (method != "auto" and METHODS.get(method, EXACT).order is None):
        return None
    length = Fraction(repr(scene.solver.step)) * NANOSECONDS
    return int(length) if length.denominator == 1 else None


class Bodies(Protocol):
    """N bodies that move through time."""

    @property
    def failed(self) -> Mapping[int, str]:
        """Why some of them have stopped, by index; what is returned for them since then is not valid."""

    def samples(self) -> Samples:
        """Return their present state and bookkeeping."""

    def onboard(self) -> OnboardValues:
        """Return what a controller can measure, at the last `samples`."""

    def hold(self, commands: Commands, new: New) -> None:
        """Hold `commands` from now on, of which those of `new` come now, for the bodies marked there."""

    def advance_to(self, time_ns: int) -> None:
        """Advance to a later time.

        Raises:
            ConvergenceError: a step cannot be solved.
        """


class SideBySide:
    """Bodies in an `Ensemble`."""

    def __init__(self, scenes: Sequence[Scene], threads: int | None) -> None:
        """Start at the initial states of the scenes."""
        solver = scenes[0].solver
        method = "exact" if solver.method == "auto" else solver.method
        self._ensemble = Ensemble(
            [scene.body for scene in scenes],
            [scene.initial for scene in scenes],
            method,
            solver.step,
            threads,
            _effects(scenes),
        )
        self.failed: Mapping[int, str] = {}

    def samples(self) -> Samples:
        """Return their state; see `Bodies`."""
        return self._ensemble.samples()

    def onboard(self) -> OnboardValues:
        """Return nothing; see `Bodies`: with sensors, a field or wheels, each body goes alone."""
        return OnboardValues()

    def hold(self, commands: Commands, new: New) -> None:
        """Hold the wrenches; see `Bodies`. On the grid of steps, holding the same ones again changes nothing."""
        self._ensemble.hold(commands.get(FORCE, 0.0), commands.get(TORQUE, 0.0))

    def advance_to(self, time_ns: int) -> None:
        """Advance; see `Bodies`."""
        self._ensemble.advance_to(time_ns)


def _effects(scenes: Sequence[Scene]) -> list[CombinedEffects] | tuple[()]:
    found = [scene.combined_effects for scene in scenes]
    return found if any(each.effects for each in found) else ()


def turn_of(scene: Scene, driven: bool) -> tuple[object, ...] | None:
    """Return what runs that go in turn together share; None if one cannot; `driven`: by a controller."""
    if driven or scene.actuators or scene.past is not None:
        return None
    return scene.end_ns, scene.combined_effects.storing() is None


_LOOKS = 256
"""Of each body until the next one goes: memory is bounded, and calls are few."""


class InTurn:
    """Bodies that go in turn, each through many observations at a time, in the loop that `simulate` runs."""

    def __init__(self, scenes: Sequence[Scene], period_ns: Fraction) -> None:
        """Start at the initial states of the scenes; they are observed every `period_ns`, and at the end."""
        import numpy as np

        self._body = body_of_arrays([scene.body for scene in scenes])
        self._start = initial_phases(self._body, [scene.initial for scene in scenes])
        self._period_ns, self._end_ns = period_ns, scenes[0].end_ns or 0
        self._times: Times = np.array([-1])
        self._looks = 0
        self._states, self._now = self._start[np.newaxis], 0
        storing = [scene.combined_effects.storing() for scene in scenes]
        self._storing = [each for each in storing if each is not None]
        self._bodies = [scene.body for scene in scenes]
        self._runs: list[Simulation | None] = [None] * len(scenes)
        # By index: since when (ns), and why.
        self._stopped: dict[int, tuple[int, str]] = {}
        for i, scene in enumerate(scenes):
            try:
                run = Simulation(without_outputs(scene))
                run.start()
                self._runs[i] = run
            except ConvergenceError as error:
                self._stopped[i] = 0, str(error)

    @property
    def failed(self) -> Mapping[int, str]:
        """Why some have stopped; see `Bodies`."""
        return {i: why for i, (since_ns, why) in self._stopped.items() if since_ns <= self._times[self._now]}

    def samples(self) -> Samples:
        """Return their state; see `Bodies`. Those that have stopped are where they were last seen."""
        storing = self._stored if self._storing else None
        return Samples(self._body, self._start, self._states[self._now], int(self._times[self._now]), storing)

    def _stored(self, states: Numbers) -> Stored:
        import numpy as np

        points = [phase_of(row).point(body) for row, body in zip(states.tolist(), self._bodies, strict=True)]
        found = [storing(point) for storing, point in zip(self._storing, points, strict=True)]
        momenta, energies = zip(*found, strict=True)
        columns: Any = tuple(np.array(momenta).T), np.array(energies)
        return Stored(*columns)

    def onboard(self) -> OnboardValues:
        """Return nothing; see `Bodies`: there is no controller."""
        return OnboardValues()

    def hold(self, commands: Commands, new: New) -> None:
        """Refuse; see `Bodies`.

        Raises:
            TypeError: always: these bodies have no commands.
        """
        raise TypeError("bodies that go in turn take no commands")

    def advance_to(self, time_ns: int) -> None:
        """Advance; see `Bodies`."""
        if time_ns > self._times[-1]:
            self._go_on()
        self._now = int(self._times.searchsorted(time_ns))

    def _go_on(self) -> None:
        """Advance each to the next observations."""
        import numpy as np

        looks = range(self._looks, self._looks + _LOOKS)
        times = sorted({min(self._end_ns, sample_ns(look, self._period_ns)) for look in looks})
        self._looks += _LOOKS
        before, self._times = self._states[-1], np.array(times, dtype=np.int64)
        self._states = np.empty((len(times), *before.shape))
        for i, run in enumerate(self._runs):
            done, seen = 0, self._states[:, i]
            while done < len(times) and i not in self._stopped and run is not None:
                try:
                    found = run.phases(self._times[done:])
                except ConvergenceError as error:
                    self._stopped[i] = times[done], str(error)
                else:
                    seen[done : done + len(found)] = found
                    done += len(found)
            seen[done:] = seen[done - 1] if done else before[i]


_FIELDS = [name for name in Sample.__slots__ if name in vars(Samples)]


class Alone:
    """One body, in the loop that `simulate` runs; `sinks` receive its outputs."""

    def __init__(self, scene: Scene, sinks: Sequence[Sink] = (), driven: bool = False) -> None:
        """Start at the initial state of the scene; `driven`: by a controller, which gets its sensors' messages."""
        self._scene, self._newest = scene, NewestMeasurements(scene) if driven and scene.sensors else None
        newest = [self._newest] if self._newest else []
        self._run = Simulation(scene if sinks else without_outputs(scene), [*sinks, *newest])
        self._rejected, self._seen = list[str](), self._run.sample
        self._now_ns, self._body_frame = 0, scene.frames.body_frame
        self._first, self._began = self._run.sample, self._run.phase
        self._inside = bool(scene.wheels) or scene.combined_effects.storing() is not None
        self.failed: Mapping[int, str] = {}
        self._run.start()

    def samples(self) -> Samples:
        """Return its state; see `Bodies`."""
        import numpy as np

        first, phase, began = self._first, self._run.phase, self._began
        self._seen = sample = self._run.sample_of(phase)
        columns = {name: np.array([getattr(sample, name)]) for name in _FIELDS}
        gained = subtract(phase.torque_impulse_world, began.torque_impulse_world)
        if self._inside:
            gained = torque_impulse(first, sample)
        columns["impulse_world"] = np.array([subtract(phase.impulse_world, began.impulse_world)])
        columns["torque_impulse_world"] = np.array([gained])
        if sample.wheel_speeds is not None:
            columns["wheel_speeds"] = np.array([sample.wheel_speeds])
        columns["clipped_commands"] = np.array([float(self._run.clipped)])
        columns["rejected_commands"] = np.array([float(len(self._rejected) + len(self._run.taken_back))])
        return Samples.known(sample.time_ns, **columns)

    def onboard(self) -> OnboardValues:
        """Return what a controller can measure; see `Bodies`."""
        import numpy as np

        sample, effects, newest = self._seen, self._scene.combined_effects, self._newest
        speeds = zip(self._scene.wheels, sample.wheel_speeds or (), strict=True)
        field = effects.magnetic_field(sample.time_ns / NANOSECONDS) if effects.magnetic else None
        found = OnboardValues(
            {},
            {wheel.name: np.array([speed]) for wheel, speed in speeds},
            None if field is None else lambda: np.array([field(sample.position_world)]),
        )
        if newest is None:
            return found
        attitude, rate = newest.orientation(), newest.angular_velocity()
        return found._replace(
            sensors=newest.sensors(),
            orientation_xyzw=None if attitude is None else np.array([attitude]),
            angular_velocity_body=None if rate is None else np.array([rate]),
            silent=newest.silent,
        )

    def hold(self, commands: Commands, new: New) -> None:
        """Hold the commands; see `Bodies`. What a channel or an actuator rejects is counted, as in the node."""
        if not new.keys().isdisjoint((TORQUE, FORCE)):
            force, torque = (self._vector(commands, name) for name in (FORCE, TORQUE))
            self._count(self._run.post, CHANNEL, Wrench(force, torque, self._body_frame, self._now_ns))
        for name in new:
            if name not in (TORQUE, FORCE):
                self._count(self._run.actuate, name + COMMAND, float(commands[name][0]))

    def _vector(self, commands: Commands, name: str) -> Vector:
        x, y, z = commands[name][0].tolist() if name in commands else ZERO
        return x, y, z

    def _count(self, command: Callable[[str, Any, int], bool], topic: str, value: Wrench | float) -> None:
        try:
            command(topic, value, self._now_ns)
        except WrenchError as error:
            self._rejected.append(str(error))

    def advance_to(self, time_ns: int) -> None:
        """Advance; see `Bodies`."""
        self._run.advance(time_ns)
        self._now_ns = time_ns

    def tell(self, warnings: Sequence[str]) -> None:
        """Pass warnings to the sinks, and those of the run."""
        self._run.tell([*warnings, *self._run.remarks, *rejected_words(self._rejected)])

    def finish(self) -> None:
        """Close the sinks; a run that was not advanced to its end is marked as cut off."""
        self._run.finish()
