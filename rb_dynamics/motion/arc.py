"""`Arc`: the motion between two changes of the load, with a constant held wrench, as a function of time.

An arc steps on a grid that starts where the arc starts. A time between two grid points is reached by one shorter step
from the last grid point, and the next step starts from that point again. So outputs at any rate do not change the
motion, and advancing in many small pieces gives the same bits as advancing at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.adaptive_kernel import RATES, Progress, Strides, fastest_rate_by_kernel, strides_by
from rb_dynamics.motion.array_steps import are_finite, steps_from
from rb_dynamics.motion.fixed_step_kernel import LONGEST_STRETCH, gradual_kernel, kernel
from rb_dynamics.motion.inner_states import StagedLoad, staged
from rb_dynamics.motion.kernel_layout import phase_numbers
from rb_dynamics.motion.load_time_scale import fastest_rate, steady_time
from rb_dynamics.motion.method import Inertia, Load, Method
from rb_dynamics.motion.phase_state import PhaseState
from rb_dynamics.motion.plugin_kernels import are_ready, plugin_kernels
from rb_dynamics.motion.propagation import ArcState, countable
from rb_dynamics.motion.stateful_kernel import StatefulSteps, stateful_kernels
from rb_dynamics.motion.step_control import AccuracyControl, FixedStep, OwnControl, StepControl, WholeArc
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.vector import Vector, norm, scale

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.numerics.array_types import Numbers

    Whole = npt.NDArray[np.int64]

LoadFrom = Callable[[PhaseState], Load]
"""Returns the load in addition to the held wrench, for a step that starts in a phase."""

OfPhase = Callable[[PhaseState], float]

Enough = Callable[[], bool]
"""Says whether whoever asked for the motion has no more time for it; asked after each stride or call of a kernel."""


class OutOfTime(Exception):  # noqa: N818
    """Enough strides have been taken for now; asking again continues from there."""


def stop_if(enough: Enough | None, more: bool) -> None:
    """Raise `OutOfTime` if it is `enough` while there is `more` to do."""
    if enough is not None and more and enough():
        raise OutOfTime


class LoadScales(NamedTuple):
    """What the effects of a scene predict about the load; a field is None if they predict nothing.

    Attributes:
        slowing: the rate (1/s) at which differences of velocity decay in a phase.
        sight: for how long (s) the load in a phase predicts the load ahead.
        strength: the sum of the magnitudes (N) of the effects' forces in a phase.
        numbers: load and predictions as numbers for kernels, see `compiled_load.py`; empty if there is no such form.
        wheels: likewise for reaction wheels, see `WheelSet.now`.
        settled: when (s of the run) a gradual change of the load ends next; infinite for other loads.
    """

    slowing: OfPhase | None = None
    sight: OfPhase | None = None
    strength: OfPhase | None = None
    numbers: tuple[float, ...] = ()
    wheels: tuple[float, ...] = ()
    settled: float = math.inf


Choose = Callable[[PhaseState, Callable[[Method], "Stepper"]], tuple[Method, StepControl]]
"""Return the method and its control for the motion after a phase; both controls use the same unit of time."""

_NO_SCALES = LoadScales()

_LEARNING = AccuracyControl, OwnControl

_CHOOSE_AGAIN = 64

# Strides in plain Python after which outputs are passed on: a few tenths of a second.
_MOST_IN_PLAIN = 1000

# Number of strides from which the number of further ones is estimated.
_ENOUGH = 16


class Arc:
    """The motion from `start_ns` on with one held wrench (body parts in principal axes); times must not decrease.

    Attributes:
        methods: names of the methods used, in order.
        expected_ns: the expected end; it decides only whether a kernel is asked for.
    """

    def __init__(
        self,
        method: Method,
        inertia: Inertia,
        held: HeldWrench,
        control: StepControl,
        start_ns: int,
        phase: PhaseState,
        load_from: LoadFrom | None = None,
        choose_again: Choose | None = None,
        scales: LoadScales = _NO_SCALES,
        first: float = math.inf,
    ) -> None:
        """Start in `phase` at `start_ns`.

        `load_from` gives the load in addition to `held`, if there is one, and `scales` what is known about it in
        advance; `choose_again` selects another method, after `_CHOOSE_AGAIN` strides and whenever their number has
        doubled, so that a transient does not decide for the whole arc. The first stride by accuracy is at most about
        `first` s.
        """
        self.methods = [method.name]
        self._what_acts = inertia, held, load_from, scales
        self._use(method, control)
        if isinstance(control, AccuracyControl):
            control.start(first)
        self._choose_again = choose_again
        self._start_ns = self.expected_ns = start_ns
        self._phase = phase
        # In units of 1/denominator ns since the start: the grid point reached and the next stride. The stride is chosen
        # when it is first needed, so that an arc that ends at once costs nothing.
        self._reached = 0
        self._strides = 0
        self._stride: int | None = None
        self._after: PhaseState | None = None

    def _use(self, method: Method, control: StepControl) -> None:
        self._method, self._control = method, control
        self._advance = self._stepper(method)
        self._kernel = self._advance.strides(control)

    def _stepper(self, method: Method) -> Stepper:
        return Stepper(method, *self._what_acts)

    @property
    def load(self) -> tuple[LoadFrom | None, LoadScales]:
        """The load in addition to the held wrench."""
        return self._what_acts[2], self._what_acts[3]

    @property
    def state(self) -> ArcState:
        """The present state."""
        # A stride that has been chosen but not taken will be chosen again.
        stride = self._stride or 0 if self._after is not None else 0
        return ArcState(
            self._method,
            self._control,
            self._what_acts[1],
            self._start_ns,
            self._phase,
            self._reached,
            self._strides,
            stride,
            self._after or self._phase,
            _CHOOSE_AGAIN if self._choose_again else 0,
        )

    def resume(self, arc_state: ArcState) -> None:
        """Continue from this state of the same arc; the method is chosen again if it is time."""
        more = arc_state.strides > self._strides
        self._phase, self._reached, self._strides = arc_state.phase, arc_state.reached, arc_state.strides
        self._stride, self._after = (arc_state.stride, arc_state.after) if arc_state.stride else (None, None)
        if isinstance(self._control, _LEARNING):
            self._control.learnt, self._control.following = arc_state.learnt, arc_state.following
        if more:
            self._count(0)

    @property
    def reached_ns(self) -> int:
        """Time of the grid point reached, rounded up to nanoseconds: no earlier phase can be had."""
        return self._start_ns - (-self._reached // self._control.denominator)

    def at(self, time_ns: int, enough: Enough | None = None) -> PhaseState:
        """Return the phase at `time_ns`, not before the last time requested nor the start.

        Raises:
            ConvergenceError: a step could not be solved.
            OutOfTime: it was `enough` before.
        """
        self.advance(time_ns, enough)
        denominator, parts = self._control.denominator, self._control.parts
        h = ((time_ns - self._start_ns) * denominator - self._reached) / (denominator * NANOSECONDS) / parts
        if h <= 0.0:
            return self._phase
        phase = self._advance.stretch(self._phase, h, parts, parts, parts)
        if phase is None:
            phase = self._phase
            for _ in range(parts):
                phase = self._advance(phase, h)
        if isinstance(self._control, WholeArc):
            self._control.require_known(self._phase, phase, h)
        return phase

    def advance(self, time_ns: int, enough: Enough | None = None) -> None:
        """Take the strides that end by `time_ns`, so that later requests cost less.

        Raises:
            ConvergenceError: a step could not be solved; the arc is as it was.
            OutOfTime: it was `enough` before.
        """
        undo = self._undo()
        try:
            self._advance_to(time_ns, enough)
        except ConvergenceError:
            # Another load may act from any time on that was requested: its arc must not know of what failed.
            undo()
            raise

    def _undo(self) -> Callable[[], None]:
        """Return what undoes the strides taken after this."""
        control = self._control
        before = self._phase, self._reached, self._strides, self._stride, self._after
        learnt = (control.learnt, control.following) if isinstance(control, _LEARNING) else None
        method, methods = self._method, len(self.methods)

        def undo() -> None:
            if control is not self._control:
                self._use(method, control)
                del self.methods[methods:]
            self._phase, self._reached, self._strides, self._stride, self._after = before
            if isinstance(control, _LEARNING) and learnt is not None:
                control.learnt, control.following = learnt

        return undo

    def outputs(self, times_ns: Whole, enough: Enough | None = None) -> Numbers | None:
        """Return the phases at the first k of these times, (k, `PHASE`), as `at` would one by one, by array steps.

        None if the arc has none, or there is one by one an error before, or `enough`.
        """
        import numpy as np

        control, stepper, undo = self._control, self._advance, self._undo()
        if not stepper.takes_arrays or not countable(control, int(times_ns[-1]) - self._start_ns, int(times_ns[-1])):
            return None
        grid, counts, taken = list[tuple[float, ...]](), list[int](), 0
        reached, strides = list[int](), self._strides
        while taken < len(times_ns) and self._strides - strides < _MOST_IN_PLAIN:
            try:
                self.advance(int(times_ns[taken]), enough)
            except (ConvergenceError, OutOfTime):
                break
            if self._advance is not stepper:
                break
            end_ns = self._start_ns - (-(self._reached + (self._stride or 1)) // control.denominator)
            counts.append(int(times_ns.searchsorted(end_ns)) - taken)
            taken += counts[-1]
            grid.append(phase_numbers(self._phase))
            reached.append(self._reached)
        if not taken:
            return None
        found = np.repeat(np.array(grid), counts, axis=0).T
        ahead = (times_ns[:taken] - self._start_ns) * control.denominator - np.repeat(reached, counts)
        h = ahead / (control.denominator * NANOSECONDS) / control.parts
        between = h > 0.0
        there = stepper.from_many(found[:, between], h[between], control.parts) if between.any() else found[:, between]
        if there is not None:
            found[:, between] = there
        if there is None or not are_finite(self._what_acts[0], found):
            undo()
            return None
        return found.T

    def _advance_to(self, time_ns: int, enough: Enough | None) -> None:
        target = (time_ns - self._start_ns) * self._control.denominator
        if isinstance(self._control, FixedStep):
            self._take_equal_strides(self._control.length, target, enough)
        while target > self._reached:
            if self._kernel is None or not self._take_strides(target):
                end = self._reached + self._next_stride()
                self._control.begin()
                if end > target:
                    return
                self._take_stride()
            stop_if(enough, self.reached_ns < time_ns)

    def _take_equal_strides(self, length: int, target: int, enough: Enough | None) -> None:
        """Take strides of `length` in a kernel, as far as it can; the rest are taken one by one."""
        h = length / (self._control.denominator * NANOSECONDS)
        while (left := (target - self._reached) // length) > 0:
            count, ahead = min(left, self._most_strides()), self._ahead(target) // length
            phase = self._advance.stretch(self._phase, h, count, ahead, left)
            if phase is None:
                return
            self._phase, self._reached = phase, self._reached + count * length
            self._stride = self._after = None
            self._count(count)
            stop_if(enough, count < left)

    def _take_strides(self, target: int) -> bool:
        """Take strides chosen by a kernel until `target`, and keep the next one; return whether any was taken."""
        if self._stride is not None:
            return False
        # Estimate the number of strides ahead from that so far.
        ahead = self._ahead(target) * self._strides // self._reached if self._strides >= _ENOUGH else 1
        progress = self._progress(target - self._reached, self._most_strides(), ahead)
        if progress is None or progress.strides == 0:
            return False
        self._reached += progress.reached
        self._count(progress.strides)
        return True

    def _ahead(self, target: int) -> int:
        """Return the expected end of the advance, at least `target`."""
        return max(target, (self.expected_ns - self._start_ns) * self._control.denominator) - self._reached

    def _progress(self, room: int, count: int, ahead: int) -> Progress | None:
        control = self._control
        if self._kernel is None or not isinstance(control, _LEARNING):
            return None
        progress = self._advance.progress(self._kernel, control, self._phase, room, count, ahead)
        if progress is not None:
            self._phase, self._stride = progress.phase, progress.next_stride or None
            self._after = progress.after if self._stride is not None else None
            control.following = progress.following
            if progress.strides:
                control.learnt = progress.learnt
        return progress

    def _most_strides(self) -> int:
        """Return how many strides may be taken before the method has to be chosen again."""
        if self._choose_again is None:
            return LONGEST_STRETCH
        choice = max(_CHOOSE_AGAIN, 1 << self._strides.bit_length())
        return min(LONGEST_STRETCH, choice - self._strides)

    def steps_to(self, time_ns: int) -> int:
        """Return the number of steps up to `time_ns`, the last time requested."""
        return self._strides + ((time_ns - self._start_ns) * self._control.denominator > self._reached)

    def next_grid_ns(self) -> int:
        """Return the time of the next grid point, rounded up to nanoseconds."""
        if self._stride is None:
            self._progress(0, 1, 1)
        end = self._reached + self._next_stride()
        return self._start_ns - (-end // self._control.denominator)

    def ahead(self) -> PhaseState:
        """Return the phase at the next grid point, without going there.

        Raises:
            ConvergenceError: the step could not be solved.
        """
        stride = self._next_stride()
        if self._after is None:
            self._after = self._advance(self._phase, stride / (self._control.denominator * NANOSECONDS))
        return self._after

    def _next_stride(self) -> int:
        if self._stride is None:
            self._stride, self._after = self._control.stride(self._phase, self._advance)
        return self._stride

    def _take_stride(self) -> None:
        self._phase = self.ahead()
        self._reached += self._next_stride()
        self._stride = self._after = None
        self._count(1)

    def _count(self, taken: int) -> None:
        self._strides += taken
        strides = self._strides
        if self._choose_again is not None and strides >= _CHOOSE_AGAIN and strides & (strides - 1) == 0:
            self._stride = self._after = None
            method, control = self._choose_again(self._phase, self._stepper)
            self._use(method, control)
            self.methods.append(method.name)


class Stepper:
    """An `Advance`: a method, its body and load, and the kernel of the method."""

    def __init__(
        self,
        method: Method,
        inertia: Inertia,
        held: HeldWrench,
        load_from: LoadFrom | None,
        scales: LoadScales = _NO_SCALES,
    ) -> None:
        self._scales = scales
        self._method, self._inertia, self._held, self._load_from = method, inertia, held, load_from
        self._effects = () if load_from is None else scales.numbers
        self._plugins = plugin_kernels(self._effects)
        self._compiles = load_from is None or bool(scales.numbers and not scales.wheels)
        self._with_wheels: StatefulSteps | None = None
        if scales.wheels and (kernels := stateful_kernels(method)) is not None:
            self._with_wheels = StatefulSteps(kernels, inertia, held, scales.wheels, scales.numbers)
        self._gradual = bool(self._effects) and scales.settled < math.inf
        found = gradual_kernel(method) if self._gradual else kernel(method, effects=bool(self._effects))
        self._kernel = found if self._compiles else None

    def __call__(self, phase: PhaseState, h: float) -> PhaseState:
        """Return the phase after a step of h s."""
        if self._with_wheels is not None and (found := self._with_wheels.step(phase, h)) is not None:
            return found
        arguments = self._arguments(phase, h)
        after, load = phase.after(self._method.step(*arguments), h), arguments[-1]
        return load.after(phase, after) if isinstance(load, StagedLoad) else after

    @property
    def takes_arrays(self) -> bool:
        """Whether `from_many` is possible."""
        method = self._method
        return method.takes_arrays and method.compiles and self._compiles and not (self._plugins or self._gradual)

    @property
    def _takes_numbers(self) -> bool:
        """Whether there is a load that `EffectLoad` describes."""
        return bool(self._effects) and self._compiles and not self._gradual

    def from_many(self, phases: Numbers, h: Numbers, count: int) -> Numbers | None:
        """Return the phases, (`PHASE`, k), after `count` steps of h[i] s from phases[:, i] each; None if refused."""
        return steps_from(self._method, self._inertia, self._held, h, count, phases, self._effects)

    def stretch(self, phase: PhaseState, h: float, count: int, ahead: int, missed: int) -> PhaseState | None:
        """Return the phase after `count` steps of h s by a kernel; None if that is not possible."""
        if self._kernel is None or not are_ready(self._plugins, (self._kernel,), ahead, missed):
            return None
        return self._kernel.after(self._inertia, self._held, h, count, phase, ahead, missed, self._effects)

    def strides(self, control: StepControl) -> Strides | None:
        """Return the kernel for strides by `control`; None if there is none."""
        if not self._compiles:
            return None
        return strides_by(self._method, control, effects=bool(self._effects), gradual=self._gradual)

    def progress(
        self,
        strides: Strides,
        control: AccuracyControl | OwnControl,
        phase: PhaseState,
        room: int,
        count: int,
        ahead: int,
    ) -> Progress | None:
        """Return the result of a kernel for strides; None if there is none."""
        if not are_ready(self._plugins, (strides,), ahead, 1):
            return None
        acting = self._inertia, self._held
        return strides.after(acting, control.goal, control.learnt, phase, room, count, ahead, self._effects)

    def longest_stride(self, control: StepControl, phase: PhaseState, trials: int) -> float | None:
        """Return the longest stride (s) of so many trials by a kernel, and let `control` learn; None without a kernel.

        This alone is no reason to compile a kernel, because there may be no other stride.
        """
        strides = self.strides(control)
        if strides is None or not isinstance(control, _LEARNING) or not strides.at_hand(1):
            return None
        if not are_ready(self._plugins, (strides,), 1, 1):
            return None
        acting = self._inertia, self._held
        found = strides.longest(acting, control.goal, control.learnt, phase, trials, self._effects)
        if found is None:
            return None
        longest, control.learnt = found
        control.following = control.learnt
        return longest

    def pair(self, phase: PhaseState, h: float) -> tuple[PhaseState, PhaseState]:
        """Return the phase after a step of h s, and the embedded result of one order less."""
        if self._method.pair is None:
            raise TypeError(f"{self._method.name} is not an embedded pair")
        if self._with_wheels is not None and (both := self._with_wheels.pair(phase, h)) is not None:
            return both
        arguments = self._arguments(phase, h)
        step, comparison = self._method.pair(*arguments)
        after, other, load = phase.after(step, h), phase.after(comparison, h), arguments[-1]
        if isinstance(load, StagedLoad):
            return load.after(phase, after), load.compared(phase, other)
        return after, other

    def longest_step(self, phase: PhaseState, accuracy: float, horizon: float) -> float:
        """Return the longest step (s) that adds at most accuracy * step / horizon to the error at the end."""
        if self._method.longest_step is None:
            raise TypeError(f"{self._method.name} does not know its own error")
        return self._method.longest_step(
            self._inertia,
            self._held,
            self._velocity(phase),
            phase.orientation,
            phase.angular_velocity,
            accuracy,
            horizon,
        )

    def slowing(self, phase: PhaseState) -> float:
        """Return the rate (1/s) at which drag makes differences of speed decay in `phase`; 0 without drag."""
        return 0.0 if self._scales.slowing is None else self._scales.slowing(phase)

    def sight(self, phase: PhaseState) -> float:
        """Return for how long (s) the load in `phase` predicts the load ahead."""
        return math.inf if self._scales.sight is None else self._scales.sight(phase)

    @property
    def settled(self) -> float:
        """When (s of the run) the load stops changing gradually: until then steps may be short; inf for other loads."""
        return self._scales.settled

    def strength(self, phase: PhaseState) -> float:
        """Return the sum of the magnitudes (N) of the forces in `phase`, which may cancel."""
        held = norm(self._held.force_world) + norm(self._held.force_body)
        return held if self._scales.strength is None else held + self._scales.strength(phase)

    def steady(self, phase: PhaseState, longest: float) -> float:
        """Return for how long (s), at most `longest`, the load stays close to that in `phase`.

        This lasts until the load has changed by half of its maximum on the path of a coasting body, sampled after about
        1, 2, 4 ... ns. Without this limit, a first step whose stages all lie beyond a thin layer would miss it and be
        accepted.
        """
        if self._load_from is None:
            return longest
        return _steady(self._load_from, self._inertia, self._held, phase, longest)

    def fastest_rate(self, phase: PhaseState) -> float:
        """Return the largest rate (1/s) at which the load makes small differences of velocities decay, turn or grow."""
        if self._load_from is None:
            return 0.0
        if self._takes_numbers and are_ready(self._plugins, (RATES,), 1, 1):
            found = fastest_rate_by_kernel((self._inertia, self._held), phase, self._effects)
            if math.isfinite(found):
                return found
        return fastest_rate(self._load_from(phase), self._inertia, phase)

    def _arguments(
        self, phase: PhaseState, h: float
    ) -> tuple[Inertia, HeldWrench, float, Vector, Quaternion, Vector, Load | None]:
        load = None if self._load_from is None else self._load_from(phase)
        if load is not None and self._method.tableau is not None:
            load = staged(load, h, self._method.tableau)
        velocity, omega = self._velocity(phase), phase.angular_velocity
        return self._inertia, self._held, h, velocity, phase.orientation, omega, load

    def _velocity(self, phase: PhaseState) -> Vector:
        return scale(1.0 / self._inertia.mass, phase.linear_momentum_world)


# Cached, because each candidate of `auto` requests the same.
@lru_cache(maxsize=1)
def _steady(load_from: LoadFrom, inertia: Inertia, held: HeldWrench, phase: PhaseState, longest: float) -> float:
    """As `Stepper.steady`."""
    return steady_time(load_from(phase), inertia, held, phase, longest)
