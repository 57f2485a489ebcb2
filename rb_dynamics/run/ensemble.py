"""Many bodies at once, and whole sequences of held wrenches in one call: arrays in, arrays out.

Each body moves as it would alone, with the same bits: steps of one length from the start of a hold, and a shorter one
to the time of an output (`motion/arc.py`). Bodies do not interact. With numba (extra `fast`) they run compiled if that
pays, in threads and vectorised over bodies; otherwise one after the other, some hundred times slower.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

from rb_dynamics.body.rigid_body import RigidBody, require_body
from rb_dynamics.body.state import State
from rb_dynamics.errors import WrenchError
from rb_dynamics.loads.combined_effects import CombinedEffects, Lasting
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.loads.wrench import largest_wrench, require_possible
from rb_dynamics.motion import METHODS, remedy
from rb_dynamics.motion.batch_kernel import Schedule, mover
from rb_dynamics.motion.fixed_step_kernel import LONGEST_STRETCH, takes_compiled
from rb_dynamics.motion.kernel_layout import PHASE, phase_numbers
from rb_dynamics.motion.method import Method
from rb_dynamics.motion.phase_state import PhaseState, inertia_of
from rb_dynamics.motion.plugin_kernels import plugin_kernels
from rb_dynamics.motion.step_control import FixedStep, WholeArc
from rb_dynamics.numerics.argument_checks import (
    as_array,
    instance,
    instances,
    number,
    shown,
    time_count,
    truth,
    whole_number,
)
from rb_dynamics.numerics.cores import cores
from rb_dynamics.numerics.nanoseconds import LONGEST, NANOSECONDS, SHORTEST_STEP
from rb_dynamics.numerics.vector import ZERO, Vector
from rb_dynamics.run.sample_arrays import Samples

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.numerics.array_types import Numbers

    Times = npt.NDArray[np.int64]


class _Hold(NamedTuple):
    """The held wrenches, and the grid of full steps that starts with them.

    Attributes:
        start_ns: start time.
        wrenches: four arrays (1, N, 3), see `Schedule`.
        reached: number of full steps taken so far.
        state: state after these steps.
    """

    start_ns: int
    wrenches: tuple[Numbers, ...]
    reached: int
    state: Numbers


class Ensemble:
    """Bodies that move side by side, each under its own wrenches.

    Forces act through the centre of mass; `*_body` parts rotate with the body. Until `hold` is called, all bodies
    coast.

    Attributes:
        time_ns: simulation time, integer nanoseconds.
    """

    def __init__(
        self,
        bodies: RigidBody | Sequence[RigidBody],
        states: Sequence[State],
        method: str,
        step: float | None = None,
        threads: int | None = None,
        effects: Sequence[CombinedEffects] = (),
    ) -> None:
        """Start from `states`, all at the same time.

        Args:
            bodies: one for all, or one for each state.
            states: of N bodies.
            method: name of a method with a step, or `exact` for motions with a closed form.
            step: s; required by every method except `exact`.
            threads: largest number of threads, by default one per available core; the bits do not depend on it.
            effects: on each of N bodies, such as `scene.combined_effects`; by default none. They must act all the time:
                uniform and central gravity, drag and buoyancy do, and compiled ones of plug-ins without knots.

        Raises:
            TypeError: an argument has the wrong type.
            ValueError: numbers of bodies and states, times, method, step, threads, a state or effects are not valid.
        """
        states = [state.checked(f"states[{k}]") for k, state in enumerate(instances(states, State, "states", _STATE))]
        if isinstance(bodies, RigidBody):
            many = [bodies] * len(states)
        else:
            many = list(instances(bodies, RigidBody, "bodies", "give one, or a list with one for each state"))
        if not states or len(many) != len(states):
            raise ValueError(
                f"there are {len(many)} bodies and {len(states)} states, expected at least one state and one body for "
                "all or one for each state"
            )
        times = sorted({state.time_ns for state in states})
        if len(times) > 1:
            raise ValueError(f"states begin between {times[0]} and {times[-1]} ns, expected the same time for all")
        lasting = _lasting(many, effects)
        takes = max((each.takes for each in effects), default=LoadDependence.HELD)
        self._steps = _Steps(method, step, takes)
        self._threads = _threads(threads)
        self._body = body_of_arrays(many)
        self._mass_properties = _mass_properties(many, [each.numbers for each in lasting])
        self._plugins = tuple(dict.fromkeys(kernel for each in lasting for kernel in plugin_kernels(each.numbers)))
        self._loads = [each.load_from(0.0) for each in effects] if takes > LoadDependence.HELD else []
        self._steady = _steady([each.force_world for each in lasting])
        self._particles = _particles(many)
        self._start = self._state = initial_phases(self._body, states)
        self._memory: list[Numbers] = []
        self.time_ns = times[0]
        self._largest = _largest(many)
        nothing = self._with_effects(_wrenches(1, len(many), self._particles, self._largest, 0, 0, 0, 0))
        self._hold = _Hold(self.time_ns, nothing, 0, self._state)

    def __len__(self) -> int:
        """Return the number of bodies."""
        return len(self._particles)

    def hold(
        self,
        force_body: npt.ArrayLike = 0.0,
        torque_body: npt.ArrayLike = 0.0,
        force_world: npt.ArrayLike = 0.0,
        torque_world: npt.ArrayLike = 0.0,
    ) -> None:
        """Hold these wrenches from now on: N and N m, each of a shape that broadcasts to (N, 3).

        A new grid of steps begins here, as at every command of a run.

        Raises:
            ValueError: a shape is wrong.
            WrenchError: a number is not finite, or a torque acts on a particle.
        """
        parts = _copies(force_body, torque_body, force_world, torque_world)
        wrenches = self._with_effects(_wrenches(1, len(self), self._particles, self._largest, *parts))
        self._hold = _Hold(self.time_ns, wrenches, 0, self._state)

    def advance(self, seconds: float) -> None:
        """Advance by `seconds`, rounded to whole nanoseconds; see `advance_to`."""
        seconds = number(
            seconds, "seconds", f"a finite number of 0 or more, at most {LONGEST:.1e} (s)", least=0.0, most=LONGEST
        )
        self.advance_to(self.time_ns + round(seconds * NANOSECONDS))

    def advance_to(self, time_ns: int) -> None:
        """Advance to `time_ns`; the steps, and so the later bits, do not depend on how time is divided into calls.

        Raises:
            ValueError: the time is in the past.
            ConvergenceError: a step of a body cannot be solved; names the body. The ensemble is unchanged.
        """
        # Python's integers do not overflow.
        time_ns = time_count(time_ns, "time_ns")
        if time_ns < self.time_ns:
            raise ValueError(f"time_ns is {time_ns}, expected {self.time_ns} or later: time only grows")
        self._hold, self._state = self._advanced(self._hold, time_ns)
        self.time_ns = time_ns

    def follow(
        self,
        times_ns: npt.ArrayLike,
        force_body: npt.ArrayLike = 0.0,
        torque_body: npt.ArrayLike = 0.0,
        force_world: npt.ArrayLike = 0.0,
        torque_world: npt.ArrayLike = 0.0,
    ) -> None:
        """Hold each of K wrenches until its time: equivalent to K calls of `hold` and `advance_to`, but faster.

        Args:
            times_ns: (K,), integers, not decreasing and not before now; the last wrench remains held.
            force_body: N, of a shape (3,) for all, (K, 3) for all bodies, or one that broadcasts to (K, N, 3).
            torque_body: N m, likewise.
            force_world: likewise.
            torque_world: likewise.

        Raises:
            ValueError: a shape is wrong, or times decrease.
            WrenchError: a number is not finite, or a torque acts on a particle.
            ConvergenceError: a step of a body cannot be solved; names the body. The ensemble is unchanged.
        """
        times = _times(times_ns, self.time_ns)
        parts = _copies(force_body, torque_body, force_world, torque_world)
        wrenches = self._with_effects(_wrenches(len(times), len(self), self._particles, self._largest, *parts))
        state = self._state
        before = tuple(wrench[:-1] for wrench in wrenches)
        for schedule in self._steps.schedules(self.time_ns, times[:-1], before):
            state = self._taken(schedule, state)
        start_ns = int(times[-2]) if len(times) > 1 else self.time_ns
        last = _Hold(start_ns, tuple(wrench[-1:] for wrench in wrenches), 0, state)
        self._hold, self._state = self._advanced(last, int(times[-1]))
        self.time_ns = int(times[-1])

    def samples(self) -> Samples:
        """Return the present samples of all bodies."""
        # Samples are computed lazily from the state, so its memory must not be reused.
        self._memory = [array for array in self._memory if array is not self._state]
        return Samples(self._body, self._start, self._state, self.time_ns)

    def _with_effects(self, wrenches: tuple[Numbers, ...]) -> tuple[Numbers, ...]:
        """Return `wrenches` with the forces that effects hold."""
        if self._steady is None:
            return wrenches
        return *wrenches[:2], wrenches[2] + self._steady, wrenches[3]

    def _advanced(self, hold: _Hold, time_ns: int) -> tuple[_Hold, Numbers]:
        """Return `hold` after its full steps up to `time_ns`, and the state at `time_ns`."""
        self._steps.require_few(time_ns - hold.start_ns)
        count, rest = self._steps.split(time_ns - hold.start_ns)
        state = hold.state
        # In pieces, so that a failed piece can be repeated body by body, and Ctrl-C works.
        for done in range(hold.reached, count, LONGEST_STRETCH):
            state = self._moved(hold, [min(LONGEST_STRETCH, count - done)], [0.0], state)
        hold = hold._replace(reached=count, state=state)
        return hold, self._moved(hold, [0], [rest], state) if rest > 0.0 else state

    def _moved(self, hold: _Hold, counts: list[int], rests: list[float], state: Numbers) -> Numbers:
        return self._taken(self._steps.schedule(counts, rests, hold.wrenches), state, hold.state)

    def _taken(self, schedule: Schedule, state: Numbers, *kept: Numbers) -> Numbers:
        """Return the state after `schedule`, in memory that nothing else uses."""
        needed = [self._state, self._hold.state, state, *kept]
        after = next((a for a in self._memory if all(a is not other for other in needed)), None)
        if after is None:
            # Allocating the memory of a large ensemble costs as much as a step.
            import numpy as np

            after = np.empty_like(state)
            self._memory.append(after)
        self._steps.mover.move(self._mass_properties, schedule, state, after, self._threads, self._loads, self._plugins)
        return after


def driven_motion(
    body: RigidBody,
    state: State,
    times_ns: npt.ArrayLike,
    *,
    method: str,
    step: float | None = None,
    force_body: npt.ArrayLike = 0.0,
    torque_body: npt.ArrayLike = 0.0,
    force_world: npt.ArrayLike = 0.0,
    torque_world: npt.ArrayLike = 0.0,
    last_only: bool = False,
) -> Samples:
    """Return the motion of `body` from `state` under K wrenches, at the K times until which each of them is held.

    The bits are those of `simulate` with the same commands, method and fixed step; a wrench held for less than a step
    takes one step of its own length.

    Args:
        body: the body that moves.
        state: initial state, at which the first wrench begins.
        times_ns: (K,), integers, not decreasing and not before the start.
        method: name of a method with a step, or `exact` for motions with a closed form.
        step: s; required by every method except `exact`.
        force_body: N, through the centre of mass, of a shape (3,) or (K, 3).
        torque_body: N m, likewise.
        force_world: likewise, world axes.
        torque_world: likewise.
        last_only: return only the last time, as one row.

    Raises:
        TypeError: an argument has the wrong type.
        ValueError: a shape or the state is not valid, times decrease, or there is no such method or step.
        WrenchError: a number is not finite, or a torque acts on a particle.
        ConvergenceError: a step cannot be solved.
    """
    import numpy as np

    require_body(body)
    state = instance(state, State, "state", _STATE).checked("state")
    steps, times = _Steps(method, step), _times(times_ns, state.time_ns)
    parts = (force_body, torque_body, force_world, torque_world)
    wrenches = _wrenches(len(times), 1, _particles([body]), _largest([body]), *parts)
    properties = _mass_properties([body])
    start = np.array([phase_numbers(PhaseState.of(body, state))], dtype=np.float64)
    if truth(last_only, "last_only"):
        now = start
        for schedule in steps.schedules(state.time_ns, times, wrenches):
            now, before = np.empty_like(start), now
            steps.mover.move(properties, schedule, before, now, 1)
        return Samples(body, start, now, times[-1:])
    # Store the numbers of one time contiguously, as they are written.
    trace, now, first = np.empty((len(times), PHASE)), start, 0
    for schedule in steps.schedules(state.time_ns, times, wrenches):
        last = first + len(schedule.counts)
        steps.mover.trace(properties, schedule, now, trace[first:last])
        now, first = trace[last - 1 : last], last
    return Samples(body, start, trace, times)


_STATE = "write State(...), or take scene.initial"
_PARTS = ("force_body", "torque_body", "force_world", "torque_world")


class _Steps:
    """Full steps of one length and a shorter one, as `Arc` takes them with `FixedStep`; `exact` has only shorter ones.

    Attributes:
        mover: takes the steps.
    """

    def __init__(self, name: object, step: float | None, takes: LoadDependence = LoadDependence.HELD) -> None:
        method = METHODS.get(name) if isinstance(name, str) else None
        if method is None:
            known, mend = ", ".join(METHODS), remedy(name, tuple(METHODS), "write one, as steps are fixed here")
            raise ValueError(f"method is {shown(name)}, expected one of {known}; {mend}")
        self._grid = grid = _grid(method, step)
        self._length, self._denominator = grid.length, grid.denominator
        self._h = self._length / (self._denominator * NANOSECONDS)
        loaded = takes > LoadDependence.HELD
        if loaded and not takes_compiled(method, takes):
            able = ", ".join(each.name for each in METHODS.usable() if takes_compiled(each, takes))
            raise ValueError(f"method is {name}, expected one that takes such effects side by side: {able}; write one")
        self.mover = mover(method, effects=loaded)

    def require_few(self, time_ns: int) -> None:
        """Check that a run of `time_ns` does not take too many steps.

        Raises:
            ValueError: it takes more than `MOST_STEPS` steps.
        """
        if isinstance(self._grid, FixedStep):
            self._grid.require_few(time_ns)

    def split(self, length_ns: int) -> tuple[int, float]:
        """Return the number of full steps in `length_ns`, and the length in s of the remaining step."""
        count, rest = divmod(length_ns * self._denominator, self._length)
        return count, rest / (self._denominator * NANOSECONDS)

    def schedule(self, counts: npt.ArrayLike, rests: npt.ArrayLike, wrenches: tuple[Numbers, ...]) -> Schedule:
        """Return the `Schedule` of these steps."""
        import numpy as np

        return Schedule(self._h, np.asarray(counts, dtype=np.int64), np.asarray(rests, dtype=np.float64), *wrenches)

    def schedules(self, start_ns: int, times: Times, wrenches: tuple[Numbers, ...]) -> Iterator[Schedule]:
        """Yield the schedules from `start_ns` to each of `times`, in pieces of about `LONGEST_STRETCH` steps at most.

        Each time ends one grid and begins the next.
        """
        import numpy as np

        if len(times) == 0:
            return
        self.require_few(int(times[-1]) - start_ns)
        lengths = np.diff(times, prepend=start_ns)
        per_second, largest = self._denominator * NANOSECONDS, int(lengths.max()) * self._denominator
        if max(per_second, largest, self._length) < 2**53:
            counts = lengths * self._denominator // self._length
            rests = (lengths * self._denominator - counts * self._length) / per_second
        else:
            # With Python's integers of any size, once per distinct length: mostly one.
            found, where = np.unique(lengths, return_inverse=True)
            splits = [self.split(length) for length in found.tolist()]
            counts = np.array([count for count, _ in splits])[where]
            rests = np.array([rest for _, rest in splits])[where]
        whole, total = self.schedule(counts, rests, wrenches), np.cumsum(counts + (rests > 0.0))
        first = 0
        while first < len(times):
            done = int(total[first - 1]) if first else 0
            last = max(first + 1, int(np.searchsorted(total, done + LONGEST_STRETCH, side="right")))
            yield whole.between(first, last)
            first = last


def _grid(method: Method, step: float | None) -> FixedStep | WholeArc:
    """Return the step control."""
    if method.order is None:
        return WholeArc()
    expected = f"a number of {SHORTEST_STEP:g} or more (s), as {method.name} needs one"
    if step is None:
        raise ValueError(f"step is None, expected {expected}")
    step = number(step, "step", expected, least=SHORTEST_STEP)
    return FixedStep(step)


def _threads(threads: int | None) -> int:
    if threads is None:
        return cores()
    count = whole_number(threads, "threads", "write how many, or None for one for each core")
    if count < 1:
        raise ValueError(f"threads is {count}, expected a whole number of at least 1")
    return count


def _times(times_ns: npt.ArrayLike, start_ns: int) -> Times:
    import numpy as np

    times = as_array(times_ns, "times_ns", "times in whole nanoseconds", None)
    if times.ndim != 1 or times.size == 0 or times.dtype.kind not in "iu":
        raise ValueError(
            f"times_ns has shape {times.shape} and type {times.dtype}, expected (K,) integers, K > 0: nanoseconds; "
            "round seconds by np.rint(1e9 * seconds).astype(np.int64)"
        )
    time_count(int(times.max()), "the largest of times_ns")
    times = times.astype(np.int64)
    # Compared, not subtracted: a difference of two 64-bit times may not fit into 64 bits.
    if (bad := np.flatnonzero(times < np.append(start_ns, times[:-1]))).size:
        k = int(bad[0])
        before = int(times[k - 1]) if k else start_ns
        raise ValueError(f"times_ns[{k}] is {times[k]}, expected {before} or later: time only grows")
    return times


def _copies(*parts: npt.ArrayLike) -> list[npt.ArrayLike]:
    """Return copies of the held wrenches, because the user's arrays may change."""
    import numpy as np

    named = zip(_PARTS, parts, strict=True)
    return [part if isinstance(part, float) else np.array(as_array(part, name, "numbers")) for name, part in named]


def _wrenches(
    intervals: int,
    bodies: int,
    particles: npt.NDArray[np.bool_],
    largest: Numbers,
    *parts: npt.ArrayLike,
) -> tuple[Numbers, ...]:
    """Return force_body, torque_body, force_world and torque_world, each as (intervals, bodies, 3)."""
    import numpy as np

    found = []
    for name, part in zip(_PARTS, parts, strict=True):
        if isinstance(part, float) and part == 0.0:
            found.append(_nothing(intervals, bodies))
            continue
        array = given = as_array(part, name, "numbers")
        if intervals > 1 and array.ndim == 2:
            array = array[:, np.newaxis]
        try:
            array = np.broadcast_to(array, (intervals, bodies, 3))
        except ValueError:
            expected = f"({bodies}, 3)" if intervals == 1 else f"({intervals}, 3) or ({intervals}, {bodies}, 3)"
            raise ValueError(f"{name} has shape {given.shape}, expected one that broadcasts to {expected}") from None
        # Minimum and maximum reveal a number that is not finite, in two passes over the array instead of three.
        low, high = float(given.min(initial=0.0)), float(given.max(initial=0.0))
        if not (math.isfinite(low) and math.isfinite(high)):
            where = tuple(map(int, np.argwhere(~np.isfinite(given))[0]))
            raise WrenchError(
                f"{name}{list(where) if where else ''} is {given[where]}, expected finite numbers; correct its source"
            )
        if name.startswith("torque") and particles.any() and array[:, particles].any():
            raise WrenchError(
                f"{name} acts on body {int(np.flatnonzero(particles)[0])}, expected none: it has no inertia, it is a "
                "particle; give it an inertia, or command a force alone"
            )
        row = int(name.startswith("torque"))
        if max(high, -low) > largest[row].min():
            _require_possible(array, row, largest)
        found.append(array)
    return tuple(found)


@lru_cache(maxsize=4)
def _nothing(intervals: int, bodies: int) -> Numbers:
    """Return zeros for an omitted part of a wrench: read-only, (intervals, bodies, 3), 8 bytes in all."""
    import numpy as np

    return np.broadcast_to(np.array(0.0), (intervals, bodies, 3))


def _largest(bodies: Sequence[RigidBody]) -> Numbers:
    """Return the largest force and torque with which each of `bodies` can be simulated, (2, N)."""
    import numpy as np

    return np.array([largest_wrench(body) for body in bodies], dtype=np.float64).T


def _require_possible(array: Numbers, row: int, largest: Numbers) -> None:
    """Check forces (row 0) or torques (row 1), (intervals, bodies, 3), against the largest for each body."""
    import numpy as np

    sizes = np.abs(array).max(axis=(0, 2), initial=0.0)
    for k in np.flatnonzero(sizes > largest[row])[:1].tolist():
        size, (force, torque) = float(sizes[k]), largest[:, k].tolist()
        try:
            require_possible(*((0.0, size) if row else (size, 0.0)), (force, torque))
        except WrenchError as error:
            raise WrenchError(f"body {k}: {error}" if len(sizes) > 1 else str(error)) from error


def _particles(bodies: Sequence[RigidBody]) -> npt.NDArray[np.bool_]:
    import numpy as np

    return np.array([body.is_particle for body in bodies])


def _lasting(bodies: Sequence[RigidBody], effects: object) -> list[Lasting]:
    """Return the lasting effects on each of `bodies`; empty without effects."""
    expected = "give scene.combined_effects of each body, or leave them out"
    many = instances(effects, CombinedEffects, "effects", expected) if effects != () else ()
    if not many:
        return []
    if len(many) != len(bodies) or any(each.body != body for each, body in zip(many, bodies, strict=False)):
        raise ValueError(f"effects has {len(many)} entries for {len(bodies)} bodies, expected one on each; {expected}")
    found: list[Lasting] = []
    for k, each in enumerate(many):
        lasting = each.lasting()
        if lasting is None or len(lasting.numbers) != len((found or [lasting])[0].numbers):
            kinds = ", ".join(effect.kind for effect in each.effects) or "none"
            raise ValueError(
                f"effects[{k}] is {kinds}, expected the kinds of effects[0], each acting all the time with numbers for "
                "kernels, and nothing that moves inside the body; simulate this body alone"
            )
        found.append(lasting)
    return found


def _steady(forces: Sequence[Vector]) -> Numbers | None:
    """Return held forces (N, 3); None if there are none."""
    import numpy as np

    return np.array(forces, dtype=np.float64) if any(force != ZERO for force in forces) else None


def _mass_properties(bodies: Sequence[RigidBody], effects: Sequence[tuple[float, ...]] = ()) -> Numbers:
    """Return mass, moments, rotation from principal to body axes, and numbers of the effects of each body."""
    import numpy as np

    numbers = effects or ((),) * len(bodies)
    rows = [
        (body.mass, *inertia_of(body).moments, *body.principal_orientation_xyzw, *more)
        for body, more in zip(bodies, numbers, strict=True)
    ]
    return np.array(rows, dtype=np.float64)


class _Bodies(RigidBody):
    """A body whose fields are arrays over bodies, each already validated."""

    __slots__ = ()

    def __post_init__(self) -> None:
        """Skip validation."""


def body_of_arrays(bodies: Sequence[RigidBody]) -> RigidBody:
    """Return a body whose fields are arrays over `bodies`, so that functions of floats work on all of them at once."""

    def columns(rows: list[Any]) -> Any:
        import numpy as np

        # With the axis of bodies last, rows unpack like tuples.
        return tuple(np.moveaxis(np.array(rows, dtype=np.float64), 0, -1))

    return _Bodies(
        columns([(body.mass,) for body in bodies])[0],
        columns([body.inertia for body in bodies]),
        columns([body.center_of_mass for body in bodies]),
        columns([body.principal_moments for body in bodies]),
        columns([body.principal_orientation_xyzw for body in bodies]),
    )


def initial_phases(body: RigidBody, states: Sequence[State]) -> Numbers:
    """Return the phases of `states` as (N, 35)."""
    import numpy as np

    fields = State.__slots__[1:]
    columns: Any = [tuple(np.array([getattr(s, field) for s in states], dtype=np.float64).T) for field in fields]
    phase = PhaseState.of(body, State(0, *columns))
    return np.stack([np.broadcast_to(row, (len(states),)) for row in phase_numbers(phase)], axis=-1)
