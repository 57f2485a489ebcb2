"""`WheelEnsemble`: bodies with wheels, magnetorquers and thrusters, advanced and commanded together, each as if alone.

The bits are those of a `Simulation` of each. It takes what `motion/wheel_arcs_kernel.py` does: bodies with as many
wheels, under effects that act all the time and have kernels, with one method and a step of whole nanoseconds or an
accuracy.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable, Hashable, Sequence
from fractions import Fraction
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, TypeVar, cast

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import SceneError
from rb_dynamics.loads.actuator import Actuator
from rb_dynamics.loads.compiled_load import NO_EFFECTS, WIDTH, source_numbers, with_dipoles
from rb_dynamics.loads.magnetorquer import Magnetorquer
from rb_dynamics.loads.reaction_wheel import ReactionWheel
from rb_dynamics.loads.thruster import Thruster
from rb_dynamics.loads.thruster_arrays import ThrusterArrays
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.loads.wheel_numbers import AXIS, BEFORE, EACH, invert_inertia
from rb_dynamics.loads.wheel_set import WheelSet
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.loads.wrench_channels import Channel
from rb_dynamics.motion import METHODS
from rb_dynamics.motion.auto_method import CANDIDATES
from rb_dynamics.motion.batch_kernel import each_part, parts_of
from rb_dynamics.motion.fixed_step_kernel import OnDemand
from rb_dynamics.motion.kernel_layout import CONSTANTS, PHASE, phase_of
from rb_dynamics.motion.method import Method
from rb_dynamics.motion.phase_state import PhaseState, in_principal_axes, inertia_of
from rb_dynamics.motion.stateful_kernel import WHEELS, StatefulKernels, StatefulSteps, layout, stateful_kernels
from rb_dynamics.motion.step_control import AccuracyControl, FixedStep
from rb_dynamics.motion.wheel_arcs_kernel import (
    ADVANCE_ALL,
    GRID_POINT,
    LANES,
    LEFT_BEHIND,
    LENGTH,
    WHOLE,
    size_of,
)
from rb_dynamics.motion.wheel_lanes_kernel import strides_beside
from rb_dynamics.numerics.cores import cores
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import rotate_inverse
from rb_dynamics.numerics.vector import ZERO, add, dot, norm, norm_of_arrays, scale
from rb_dynamics.run.ensemble import body_of_arrays, initial_phases
from rb_dynamics.run.plan import control_of
from rb_dynamics.run.sample import Sample, SampleBuilder, torque_impulse
from rb_dynamics.run.sample_arrays import Samples, field
from rb_dynamics.scene.model import Scene, Solver

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.numerics.array_types import Numbers

_Kind = TypeVar("_Kind", bound=Actuator)

# Times up to it are doubles without rounding, as the lengths of steps are.
_LATEST_NS = 2**53

# Force and torque of the held wrench, principal axes, among the numbers of a body; see `constants_at`.
_HELD = slice(4, 10)

# Steps of each body in a call, in those of `rk4`.
_STEPS = 20

# Steps of each body for which kernels are worth loading.
_AHEAD = 1000.0


def shared_by_wheels(scene: Scene) -> Hashable | None:
    """Return what bodies in one ensemble have in common with that of `scene`; None if it cannot be in one."""
    wheels, effects, actuators = scene.wheels, scene.combined_effects, actuators_of(scene)
    rods, thrusters = _of_kind(scene, Magnetorquer), _of_kind(scene, Thruster)
    lonely = scene.past is not None or not 0 < (scene.end_ns or 0) < _LATEST_NS or scene.body.is_particle
    others = len(actuators) != len(scene.actuators) or any(
        channel != Channel(channel.topic) for channel in scene.channels
    )
    gradual = any(each.rise or each.fall for each in thrusters)
    if not actuators or lonely or others or gradual or not all(wheel.is_balanced for wheel in wheels):
        return None
    numbers = _numbers(scene)
    if not wheels and numbers == NO_EFFECTS and effects.takes > LoadDependence.HELD:
        # Where no magnetorquer has a dipole, only the held wrench acts, whose steps are others.
        return None
    changing = bool(effects.knots() or effects.schedules()) or effects.storing() is not None
    if (
        numbers is None
        or changing
        or _kernels(scene.solver, effects.takes) is None
        or (rods and source_numbers(scene.effects) is None)
    ):
        return None
    names = tuple((type(each), each.name, getattr(each, "command", "")) for each in actuators)
    return scene.solver, scene.end_ns, names, len(numbers)


def actuators_of(scene: Scene) -> list[Actuator]:
    """Return the actuators that can be commanded here: wheels, magnetorquers, thrusters, each in the scene's order."""
    return [*scene.wheels, *_of_kind(scene, Magnetorquer), *_of_kind(scene, Thruster)]


def _numbers(scene: Scene) -> tuple[float, ...] | None:
    effects = scene.combined_effects
    return NO_EFFECTS if effects.takes == LoadDependence.HELD else effects.numbers(0.0)


def _of_kind(scene: Scene, kind: type[_Kind]) -> list[_Kind]:
    return [actuator for actuator in scene.actuators if isinstance(actuator, kind)]


def kernels_at_hand(scene: Scene) -> bool:
    """Return whether nothing has to be compiled for an ensemble."""
    kernels = _kernels(scene.solver, scene.combined_effects.takes)
    needed = () if kernels is None else (ADVANCE_ALL, kernels.step, kernels.pair, _side_by_side(scene))
    # Each is asked for, also if another is missing.
    found = [each.get(_AHEAD, _AHEAD) for each in needed if each is not None]
    return bool(found) and None not in found


@cache
def _kernels(solver: Solver, takes: LoadDependence) -> StatefulKernels | None:
    """Return the kernels of the method for such loads; None if it has none, or may use another method too."""
    method = _method(solver, takes)
    kernels = None if method is None else stateful_kernels(method, bare=takes == LoadDependence.HELD)
    if kernels is None or method is None:
        return None
    if solver.step is None:
        return None if kernels.pair is None or method.longest_step is not None else kernels
    return kernels if (Fraction(repr(solver.step)) * NANOSECONDS).denominator == 1 else None


def _side_by_side(scene: Scene) -> OnDemand | None:
    """Return the kernel for the strides of several bodies, if there is one."""
    method = _method(scene.solver, scene.combined_effects.takes)
    return None if scene.solver.step is not None or method is None else strides_beside(method, len(scene.wheels))


def _method(solver: Solver, takes: LoadDependence) -> Method | None:
    if solver.method != "auto":
        return METHODS.get(solver.method)
    if takes == LoadDependence.HELD:
        # It also takes the closed form.
        return None
    names = CANDIDATES[takes]
    return METHODS[names[0]] if len(names) == 1 or solver.step is not None else None


class WheelEnsemble:
    """N bodies with wheels.

    Attributes:
        rows: (groups, ..., `LANES`), their numbers, see `wheel_arcs_kernel.py`.
        time_ns: how far they have come.
    """

    def __init__(self, scenes: Sequence[Scene], threads: int | None = None) -> None:
        """Start at the initial states of scenes that share what `shared_by_wheels` returns.

        Args:
            scenes: one for each body.
            threads: at most this many, by default one per available core; the bits do not depend on it.

        Raises:
            SceneError: one of them does not suit its solver.
            LookupError: the kernels are not there, and not worth compiling now.
        """
        import numpy as np

        self._scenes, first, self._threads = tuple(scenes), scenes[0], threads or cores()
        kernels = _kernels(first.solver, first.combined_effects.takes)
        if kernels is None:
            raise SceneError(f"{first.source}: found a scene that cannot be in an ensemble with wheels")
        ahead = _AHEAD * len(scenes)
        step: Any = kernels.step.get(ahead, ahead)
        pair: Any = step if kernels.pair is None else kernels.pair.get(ahead, ahead)
        found = ADVANCE_ALL.get(ahead, ahead), step, pair
        if None in found:
            raise LookupError("the kernels for wheels are not there")
        pairs = _side_by_side(first)
        together = None if pairs is None else pairs.get(ahead, ahead)
        self._kernel: Any
        self._kernel = found[0]
        self._body = body_of_arrays([scene.body for scene in scenes])
        self._start = initial_phases(self._body, [scene.initial for scene in scenes])
        self.time_ns, self._clipped = 0, np.zeros(len(scenes))
        self._limits = np.array([[_limit(each) for each in actuators_of(s)] for s in scenes])
        self._most = np.array([[getattr(each, "most", math.inf) for each in actuators_of(s)] for s in scenes])
        self._none, self._dipoles = np.full((len(scenes), len(first.wheels) + 1), np.nan), _Dipoles.of(scenes)
        self._commands, self._samples = self._none, cast("weakref.ref[WheelSamples] | None", None)
        self._stands = False
        # How far each has come.
        self._times = np.zeros(len(scenes), dtype=np.int64)
        thrusters = [_of_kind(scene, Thruster) for scene in scenes]
        self._thrusters = None
        if thrusters[0]:
            frames, bodies = [scene.frames for scene in scenes], [scene.body for scene in scenes]
            self._thrusters = ThrusterArrays(thrusters, frames, bodies)
        alike: dict[int, list[int]] = {}
        for i, scene in enumerate(scenes):
            alike.setdefault(id(scene.actuators), []).append(i)
        begun: Any = [_beginning([scenes[i] for i in which], kernels, self._start[which]) for which in alike.values()]
        order = np.concatenate(list(alike.values())).argsort()
        rows, arcs, whole = (np.concatenate(parts)[order] for parts in zip(*begun, strict=True))
        self.rows, self._arcs, self._whole = _in_lanes(rows), _in_lanes(arcs), _in_lanes(whole)
        self._states, self._sums, _ = layout(rows[0])
        groups, size = len(self.rows), size_of(self._states)
        spare, results = np.tile(rows[0], (groups, 1)), np.zeros((groups, size + PHASE, LANES))
        self._handed = (step, pair, together or step, 0 if together is None else 1, spare, results)
        self._begin = self.phases

    def __len__(self) -> int:
        """Return the number of bodies."""
        return len(self._scenes)

    @property
    def phases(self) -> Numbers:
        """(N, `PHASE` + ...), a copy of the present phases, with the sums of the wheels' states and their rounding."""
        import numpy as np

        # Each number of all bodies in a row: so they are read.
        columns = np.empty((size_of(self._states), len(self.rows), LANES))
        for at, begin, count in ((0, CONSTANTS, PHASE), (PHASE, self._sums, 2 * self._states)):
            columns[at : at + count] = self.rows[:, begin : begin + count].transpose(1, 0, 2)
        return columns.reshape(len(columns), -1)[:, : len(self)].T

    @property
    def left_behind(self) -> npt.NDArray[np.bool_]:
        """(N,), which bodies could not go on: they are to be simulated alone."""
        found: npt.NDArray[np.bool_] = (self._whole[:, LEFT_BEHIND] != 0).reshape(-1)[: len(self)]
        return found

    def rejects(self, commands: Numbers) -> npt.NDArray[np.bool_]:
        """Return for which bodies, (N,), a wheel rejects its command: they are to be simulated alone."""
        import numpy as np

        found: npt.NDArray[np.bool_] = (np.minimum(np.abs(commands), self._limits) > self._most).any(axis=1)
        return found

    @property
    def clipped(self) -> Numbers:
        """(N,), commands that the limits of an actuator have reduced."""
        return self._clipped if self._thrusters is None else self._clipped + self._thrusters.clipped

    @property
    def rejected(self) -> Numbers:
        """(N,), commands that a thruster has rejected."""
        return 0.0 * self._clipped if self._thrusters is None else self._thrusters.rejected

    def command(self, commands: Numbers, which: npt.NDArray[np.bool_] | None = None) -> None:
        """Command `actuators_of` the scenes, (N, actuators), from now on; NaN for no command.

        `which`, (N,), are the bodies that it comes to: without it all.
        """
        import numpy as np

        commands = commands if which is None else np.where(which[:, np.newaxis], commands, np.nan)
        beyond, wheels = np.abs(commands) > self._limits, self._none.shape[1] - 1
        if beyond.any():
            self._clipped = self._clipped + beyond.sum(axis=1)
            commands = np.where(beyond, np.copysign(self._limits, commands), commands)
        told = np.concatenate((commands[:, :wheels], self._none[:, wheels:]), axis=1)
        if self._dipoles is not None:
            rods = commands[:, wheels : wheels + self._dipoles.count]
            told[:, wheels] = np.where(np.isnan(rods).all(axis=1), np.nan, 1.0)
            ends, body = self._dipoles.commanded(rods), np.arange(len(self))
            self.rows[body // LANES, -ends.shape[1] :, body % LANES] = ends
        if self._thrusters is not None:
            self._thrusters.receive(commands[:, -self._thrusters.count :], self._times)
        self._commands = told if self._commands is self._none else np.where(np.isnan(told), self._commands, told)

    def advance_to(self, time_ns: int) -> None:
        """Advance to `time_ns`, not before the last time."""
        import numpy as np

        if self._stands and time_ns == self.time_ns and self._commands is self._none:
            return
        self._go_to(np.full(len(self), time_ns))
        self.time_ns, self._stands = time_ns, True

    def advance_some(self, times_ns: npt.NDArray[np.int64], which: npt.NDArray[np.bool_]) -> None:
        """Advance the bodies `which`, (N,), each to its own time."""
        import numpy as np

        if self._commands is self._none and (times_ns[which] == self.time_ns).all():
            # They are there; a stride chosen now would not be taken if commands follow.
            return
        self._go_to(np.where(which, times_ns, -1))

    def _go_to(self, until_ns: npt.NDArray[np.int64]) -> None:
        """Advance each to its time, by way of the changes of its thrusters before then; negative: it stays."""
        import numpy as np

        while self._thrusters is not None:
            change_ns = self._thrusters.next_ns
            due = change_ns < until_ns
            if not due.any():
                break
            ahead = due & (change_ns > self._times)
            if ahead.any():
                self._move_to(np.where(ahead, change_ns, -1))
            bodies, wrenches = self._thrusters.change(due)
            self.rows[bodies // LANES, _HELD, bodies % LANES] = wrenches
            self._commands = self._commands.copy()
            self._commands[bodies, -1] = 1.0
        self._move_to(until_ns)

    def _move_to(self, until_ns: npt.NDArray[np.int64]) -> None:
        """Advance each to its time, with its commands; negative: it stays, and they wait."""
        import numpy as np

        if self._samples is not None and (samples := self._samples()) is not None:
            # Somebody may read them later.
            samples.keep()
        self._samples, self._stands = None, False
        times_ns = np.full(len(self.rows) * LANES, -1)
        times_ns[: len(self)] = until_ns
        what = self.rows, self._arcs, self._whole, _in_lanes(self._commands), times_ns.reshape(-1, LANES)
        parts = parts_of(len(times_ns), LANES, self._threads, _STEPS)
        each_part(lambda part: self._kernel(*what, *(end // LANES for end in part), *self._handed), parts)
        goes = until_ns >= 0
        self._times = np.where(goes, until_ns, self._times)
        self._commands = self._none if goes.all() else np.where(goes[:, np.newaxis], np.nan, self._commands)

    def samples(self) -> Samples:
        """Return their present state and bookkeeping, with wheels `WheelSamples`."""
        if not self._scenes[0].wheels:
            return Samples(self._body, self._start, self.phases[:, :PHASE], self.time_ns)
        found = None if self._samples is None else self._samples()
        if found is None:
            time_ns = self.time_ns
            found = WheelSamples(
                self._body,
                self._start,
                time_ns,
                lambda: self.phases,
                self._speeds,
                lambda phases: self._told(phases, time_ns),
            )
            self._samples = weakref.ref(found)
        return found

    def _speeds(self, phases: Numbers) -> Numbers:
        import numpy as np

        inertias, axes = self._wheels
        count, states = inertias.shape[1], (phases.shape[1] - PHASE) // 2
        momenta = phases[:, PHASE : PHASE + count] + phases[:, PHASE + states : PHASE + states + count]
        x, y, z = (phases[:, i, np.newaxis] for i in (4, 5, 6))
        speeds: Numbers = momenta / inertias - (axes[:, :, 0] * x + axes[:, :, 1] * y + axes[:, :, 2] * z)
        return speeds

    @cached_property
    def _wheels(self) -> tuple[Numbers, Numbers]:
        """Inertias, (N, wheels), and axes in principal axes, (N, wheels, 3)."""
        import numpy as np

        inertias = [[wheel.inertia for wheel in scene.wheels] for scene in self._scenes]
        return np.array(inertias), np.array([[w.axis_in(scene.body) for w in scene.wheels] for scene in self._scenes])

    @cached_property
    def _observers(self) -> list[tuple[SampleBuilder, Sample]]:
        """What computes the samples of each body, and its first one."""
        found = []
        for scene, row in zip(self._scenes, self._begin.tolist(), strict=True):
            phase = _phase(row)
            observer = SampleBuilder(scene.combined_effects, phase, WheelSet(scene.wheels, scene.body))
            found.append((observer, observer.sample(phase, 0)))
        return found

    def _told(self, phases: Numbers, time_ns: int) -> list[tuple[Sample, Sample]]:
        """Return the first sample of each body, and that of its phase; twice the first of one that is left behind.

        Its phase may be no numbers, for which an effect with a potential would refuse the samples of all.
        """
        found = zip(self._observers, phases.tolist(), self.left_behind.tolist(), strict=True)
        return [
            (first, first if is_left else observer.sample(_phase(row), time_ns))
            for (observer, first), row, is_left in found
        ]


def _phase(row: Sequence[float]) -> PhaseState:
    """Return the phase, with states, of a row of `WheelEnsemble.phases`."""
    phase, states = phase_of(tuple(row[:PHASE])), (len(row) - PHASE) // 2
    high, low = row[PHASE : PHASE + states], row[PHASE + states :]
    return phase._replace(high=(*phase.high, *high), low=(*phase.low, *low))


class WheelSamples(Samples):
    """State and bookkeeping of bodies with wheels; the books are made up for each body, and only if they are read."""

    def __init__(
        self,
        body: RigidBody,
        start: Numbers,
        time_ns: int,
        phases: Callable[[], Numbers],
        speeds: Callable[[Numbers], Numbers],
        told: Callable[[Numbers], list[tuple[Sample, Sample]]],
    ) -> None:
        """Describe `body` (of arrays).

        The functions return the phases, as in `WheelEnsemble`, and for them the speeds of the wheels, and the first
        sample of each body and the present one.
        """
        super().__init__(body, start, start, time_ns)
        self._read, self._speeds, self._tell = phases, speeds, told

    @cached_property
    def _state(self) -> Numbers:
        # No function that is given to these samples may hold them: then they would outlive their last reader.
        return self.phases[:, :PHASE]

    @cached_property
    def phases(self) -> Numbers:
        """As in `WheelEnsemble`."""
        return self._read()

    def keep(self) -> None:
        """Read the phases before the bodies move on."""
        _ = self.phases

    @field
    def wheel_speeds(self) -> Any:
        """(N, wheels), relative to the body, rad/s."""
        return self._speeds(self.phases)

    @cached_property
    def _told(self) -> list[tuple[Sample, Sample]]:
        return self._tell(self.phases)

    @field
    def angular_momentum_world(self) -> Any:
        """(N, 3), about the centre of mass, kg m^2/s."""
        return [sample.angular_momentum_world for _, sample in self._told]

    @field
    def kinetic_energy(self) -> Any:
        """(N,), translation and rotation, J."""
        return [sample.kinetic_energy for _, sample in self._told]

    @field
    def work(self) -> Any:
        """(N,), of all loads since the start, J."""
        return [sample.work for _, sample in self._told]

    @field
    def energy_defect(self) -> Any:
        """(N,), T - T0 - work, J; see `SampleBuilder`."""
        return [sample.energy_defect for _, sample in self._told]

    @field
    def torque_impulse_world(self) -> Any:
        """(N, 3), integral of the torque about the centre of mass since the start, N m s."""
        return [torque_impulse(first, sample) for first, sample in self._told]


def _limit(actuator: Actuator) -> float:
    """Return the largest size of its commands, except of a thruster: see `ThrusterArrays`."""
    if isinstance(actuator, ReactionWheel):
        return actuator.max_torque if actuator.command == "torque" else actuator.max_speed
    return actuator.max_dipole if isinstance(actuator, Magnetorquer) else math.inf


class _Dipoles:
    """The magnetorquers of N bodies.

    Attributes:
        count: how many each has.
    """

    def __init__(self, scenes: Sequence[Scene]) -> None:
        """Begin without commands."""
        import numpy as np

        rods = [_of_kind(scene, Magnetorquer) for scene in scenes]
        self.count = len(rods[0])
        self._values = np.zeros((len(scenes), self.count))
        self._axes = np.array([[rod.axis for rod in each] for each in rods])
        self._lengths = np.array([[norm(rod.axis) for rod in each] for each in rods])
        self._principal: Any = tuple(np.array([scene.body.principal_orientation_xyzw for scene in scenes]).T)
        self._numbers = np.array([scene.combined_effects.numbers(0.0) for scene in scenes])
        self._sources = np.array([source_numbers(scene.effects) for scene in scenes])

    @classmethod
    def of(cls, scenes: Sequence[Scene]) -> _Dipoles | None:
        """Return those of bodies that have some."""
        return cls(scenes) if _of_kind(scenes[0], Magnetorquer) else None

    def commanded(self, dipoles: Numbers) -> Numbers:
        """Command dipoles, (N, rods), NaN for no command; return the numbers of the effects with them."""
        import numpy as np

        self._values = np.where(np.isnan(dipoles), self._values, dipoles)
        # As `ActuatorBank.dipole` adds them up.
        total: Any = ZERO
        for k in range(self._values.shape[1]):
            total = add(total, scale(self._values[:, k] / self._lengths[:, k], tuple(self._axes[:, k].T)))
        return with_dipoles(self._numbers, self._sources, np.stack(rotate_inverse(self._principal, total), axis=1))


def _in_lanes(given: npt.NDArray[Any]) -> Any:
    """Return rows in groups of `LANES`, (groups, ..., `LANES`); the last one stands for those that are missing."""
    import numpy as np

    if missing := -len(given) % LANES:
        given = np.concatenate((given, np.repeat(given[-1:], missing, axis=0)))
    return np.ascontiguousarray(given.reshape(-1, LANES, given.shape[1]).transpose(0, 2, 1))


def _beginning(
    scenes: Sequence[Scene], kernels: StatefulKernels, start: Numbers
) -> tuple[Numbers, Numbers, npt.NDArray[np.int64]]:
    """Return the numbers of bodies with the same actuators, of their arcs, and the whole ones, a row for each.

    `start` are their phases; see `wheel_arcs_kernel.py`.
    """
    import numpy as np

    first, bodies = scenes[0], [scene.body for scene in scenes]
    effects: list[tuple[float, ...]] = [_numbers(scene) or () for scene in scenes]
    wheels = WheelSet(first.wheels, first.body).now
    # Functions of numbers take columns, too: one number of each body.
    columns: Any = np.array([(b.mass, *b.principal_moments, *b.principal_orientation_xyzw) for b in bodies]).T
    mass, moments, turn, omega = columns[0], tuple(columns[1:4]), tuple(columns[4:]), tuple(start.T[4:7])
    now, momenta = list[Any](wheels), list[Any]()
    for k, wheel in enumerate(first.wheels):
        axis = rotate_inverse(turn, wheel.axis)
        a, axis = BEFORE + EACH * k + AXIS, scale(1.0 / norm_of_arrays(axis), axis)
        now[a : a + 3] = axis
        momenta.append(wheel.inertia * (wheel.speed + dot(axis, omega)))
    invert_inertia(now, 0, moments)
    if _of_kind(first, Magnetorquer):
        # Room for a dipole.
        effects = [(*(0.0,) * WIDTH, *each) for each in effects]
    held = in_principal_axes(first.body, HeldWrench())
    steps = StatefulSteps(kernels, inertia_of(first.body), held, wheels, effects[0])
    rows = np.tile(np.frombuffer(steps.numbers), (len(scenes), 1))
    count, sums, states = layout(rows[0])
    rows[:, :4], rows[:, CONSTANTS : CONSTANTS + PHASE] = columns[:4].T, start
    for at, column in ((WHEELS, now), (sums, momenta), (states, [each + 0.0 for each in momenta])):
        for k, each in enumerate(column):
            rows[:, at + k] = each
    rows[:, rows.shape[1] - len(effects[0]) :] = effects
    arcs = np.zeros((len(scenes), GRID_POINT + 2 * size_of(count)))
    whole = np.zeros((len(scenes), WHOLE), dtype=np.int64)
    takes = first.combined_effects.takes
    method, (x, y, z) = _method(first.solver, takes), tuple(start.T[7:10] + start.T[21:24])
    # A step that suits one body may not suit another.
    stepped = scenes if first.solver.step is not None else scenes[:1]
    controls = [control_of(each, method, ZERO, each.duration or 0.0) for each in stepped] if method else [None]
    control = controls[0]
    if isinstance(control, FixedStep):
        whole[:, LENGTH] = control.length
    elif isinstance(control, AccuracyControl):
        for k, each in enumerate(control.goal._replace(mass=mass, x=x, y=y, z=z)):
            arcs[:, k] = each
    return rows, arcs, whole
