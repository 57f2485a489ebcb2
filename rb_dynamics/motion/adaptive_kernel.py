"""Kernels for steps by accuracy: many steps, with their lengths chosen by step control, in one compiled call.

The lengths are chosen by the code of `step_control.py`, with the same bits compiled and in plain Python. A kernel stops
before a step that plain Python would refuse; plain Python then takes that step and raises the error.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from struct import Struct
from typing import TYPE_CHECKING, Any, NamedTuple

from rb_dynamics.loads.compiled_load import load_scales, sight_of_transients, strength
from rb_dynamics.loads.effect import Point
from rb_dynamics.loads.varying_load import evaluated
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.fixed_step_kernel import OnDemand, compiles, load_of, load_of_effects, no_load
from rb_dynamics.motion.kernel_layout import (
    CONSTANTS,
    PHASE,
    Constants,
    constant_numbers,
    constants_at,
    phase_at,
    phase_numbers,
    phase_of,
    write_phase,
)
from rb_dynamics.motion.load_time_scale import are_finite, largest_rate, steady_time, write_rates
from rb_dynamics.motion.method import Increment, Inertia, Method
from rb_dynamics.motion.phase_state import MOMENTUM, POSITION, PhaseState, elapsed, grown, is_finite, total
from rb_dynamics.motion.step_control import (
    AccuracyControl,
    Goal,
    Learnt,
    OwnControl,
    StepControl,
    Stride,
    by_method,
    by_trial,
    first_guess,
    rounding,
    taught,
)
from rb_dynamics.numerics.compilation import compiled_apart, specialise
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.vector import Vector, norm, scale

if TYPE_CHECKING:
    from rb_dynamics.numerics.array_types import Numbers

_SIGNATURE = "UniTuple(int64, 3)(float64[::1], int64, int64)"

# Layout of the array that a kernel works on: body and wrench, goal, phase, learnt state; then room for the phase and
# the learnt state after the next stride. The kernel overwrites the last four.
_GOAL_AT = CONSTANTS
_PHASE_AT = _GOAL_AT + len(Goal._fields)
_STATE_SIZE = PHASE + len(Learnt._fields)
_AFTER_AT = _PHASE_AT + _STATE_SIZE
_INPUT, _OUTPUT = Struct(f"{_AFTER_AT}d"), Struct(f"{2 * _STATE_SIZE}d")

# Longer than any run, but so far below 2^63 that sums of two do not overflow.
FOREVER = 2**62


class Progress(NamedTuple):
    """Result of a kernel.

    Attributes:
        strides: number of strides taken.
        reached: ns after the start of the first stride.
        phase: the phase there.
        learnt: the learnt state there.
        next_stride: the next stride, which would have ended too late, ns; 0 if it has not been chosen.
        after: the phase at the end of the next stride.
        following: the learnt state after the next stride.
    """

    strides: int
    reached: int
    phase: PhaseState
    learnt: Learnt
    next_stride: int
    after: PhaseState
    following: Learnt


# Body and held wrench, and the numbers that `_load` reads.
_Acting = tuple[Inertia, HeldWrench, "Numbers"]


def run(constants: _Acting, goal: Goal, learnt: Learnt, phase: PhaseState, room: int, count: int) -> Progress:
    """Take at most `count` strides from `phase` on that end within `room` ns.

    Stops, with `next_stride` 0, where a stride ends exactly there, and before one that cannot be taken or whose
    accuracy cannot be reached.
    """
    strides = reached = 0
    while strides < count:
        chosen = _choose(goal, learnt, phase, constants)
        if chosen.length == 0 or rounding(goal, phase, chosen.steady) > goal.accuracy or not is_finite(chosen.after):
            break
        if chosen.length > room - reached:
            return Progress(strides, reached, phase, learnt, chosen.length, chosen.after, chosen.learnt)
        phase, learnt = chosen.after, chosen.learnt
        strides, reached = strides + 1, reached + chosen.length
        if reached == room:
            break
    return Progress(strides, reached, phase, learnt, 0, phase, learnt)


def _choose(goal: Goal, learnt: Learnt, phase: PhaseState, constants: _Acting) -> Stride:
    """Placeholder for `by_trial` or the next function."""
    raise NotImplementedError


def _by_trial_in_sight(goal: Goal, learnt: Learnt, phase: PhaseState, constants: _Acting) -> Stride:
    """As `AccuracyControl.stride`, under the load of effects."""
    inertia, held, effects = constants
    step, load = learnt.step, _load(effects, phase.high, phase.low)
    if not step > 0.0:
        step = _STEADY(load, inertia, held, phase, first_guess(goal, phase))
    slowing, sight = load_scales(effects, _here(inertia, phase))
    sight = min(sight, sight_of_transients(effects, phase.high[13], phase.low[13]))
    if not sight > 0.0:
        return Stride(0, phase, learnt, 0.0, 0.0)
    g, known = goal, learnt
    goal = Goal(g.accuracy, g.horizon, g.ends, g.mass, g.order, g.errors, g.share, g.x, g.y, g.z, slowing, g.noise)
    step = min(step, max(sight, 1.0 / NANOSECONDS))
    return by_trial(
        goal, Learnt(step, known.farthest, known.resolved_stride, known.resolved_error, known.until), phase, constants
    )


def _by_method(goal: Goal, learnt: Learnt, phase: PhaseState, constants: _Acting) -> Stride:
    """Return a stride chosen by the method itself, and take it."""
    chosen = by_method(goal, learnt, phase, constants)
    return Stride(chosen.length, _stepped(constants, phase, chosen.steady), learnt, 0.0, chosen.steady)


def _halves_and_whole(constants: _Acting, phase: PhaseState, h: float) -> tuple[PhaseState, PhaseState]:
    """Return the phase after two steps of h/2 s and after one of h s."""
    kept = other = phase
    # A loop, so that only one step is compiled.
    for part in range(3):
        whole = part == 2
        end = _stepped(constants, phase if whole else kept, h if whole else 0.5 * h)
        kept, other = (kept, end) if whole else (end, other)
    return kept, other


def _pair_of_steps(constants: _Acting, phase: PhaseState, h: float) -> tuple[PhaseState, PhaseState]:
    """Return the phase after a step of h s, and the embedded result of one order less."""
    inertia, held, effects = constants
    velocity, load = _velocity(inertia, phase), _load(effects, phase.high, phase.low)
    step, comparison = _pair(inertia, held, h, velocity, phase.orientation, phase.angular_velocity, load)
    return _grown(phase, step, h), _grown(phase, comparison, h)


def _held_strength(constants: _Acting, _: PhaseState) -> float:
    """Return the sum of the magnitudes (N) of the forces."""
    held = constants[1]
    return norm(held.force_world) + norm(held.force_body)


def _whole_strength(constants: _Acting, phase: PhaseState) -> float:
    """Return the sum of the magnitudes (N) of the forces, those of effects included."""
    inertia, held, effects = constants
    return norm(held.force_world) + norm(held.force_body) + strength(effects, _here(inertia, phase))


def _here(inertia: Inertia, phase: PhaseState) -> Point:
    velocity, place = _velocity(inertia, phase), total(phase, POSITION)
    return Point(elapsed(phase), place, velocity, phase.orientation, phase.angular_velocity)


def _longest(constants: _Acting, phase: PhaseState, accuracy: float, horizon: float) -> float:
    inertia, held, _ = constants
    velocity = _velocity(inertia, phase)
    return _longest_step(inertia, held, velocity, phase.orientation, phase.angular_velocity, accuracy, horizon)


def _stepped(constants: _Acting, phase: PhaseState, h: float) -> PhaseState:
    inertia, held, effects = constants
    velocity, load = _velocity(inertia, phase), _load(effects, phase.high, phase.low)
    return _grown(phase, _step(inertia, held, h, velocity, phase.orientation, phase.angular_velocity, load), h)


def _velocity(inertia: Inertia, phase: PhaseState) -> Vector:
    return scale(1.0 / inertia.mass, total(phase, MOMENTUM))


def _grown(phase: PhaseState, step: Increment, h: float) -> PhaseState:
    high, low = grown(phase.high, phase.low, step, h)
    return PhaseState(step.orientation, step.angular_velocity, high, low)


_load = no_load


def _step(*arguments: Any) -> Increment:
    """Placeholder for the step of a method."""
    raise NotImplementedError


def _pair(*arguments: Any) -> tuple[Increment, Increment]:
    """Placeholder for the pair of a method."""
    raise NotImplementedError


def _longest_step(*arguments: Any) -> float:
    """Placeholder for the longest step of a method."""
    raise NotImplementedError


def _run_on_numbers(numbers: Numbers, room: int, count: int) -> tuple[int, int, int]:
    """Like `run`, on an array."""
    c, g, i, k = numbers, _GOAL_AT, _PHASE_AT, _AFTER_AT
    share, x, y, z = c[g + 6], c[g + 7], c[g + 8], c[g + 9]
    goal = Goal(c[g], c[g + 1], c[g + 2] != 0.0, c[g + 3], c[g + 4], c[g + 5], share, x, y, z, c[g + 10], c[g + 11])
    learnt = Learnt(c[i + PHASE], c[i + PHASE + 1], c[i + PHASE + 2], c[i + PHASE + 3], c[i + PHASE + 4])
    inertia, held = constants_at(c)
    progress = run((inertia, held, c), goal, learnt, phase_at(c, i), room, count)
    write_phase(c, i, progress.phase)
    c[i + PHASE], c[i + PHASE + 1], c[i + PHASE + 2], c[i + PHASE + 3], c[i + PHASE + 4] = progress.learnt
    write_phase(c, k, progress.after)
    c[k + PHASE], c[k + PHASE + 1], c[k + PHASE + 2], c[k + PHASE + 3], c[k + PHASE + 4] = progress.following
    return progress.strides, progress.reached, progress.next_stride


def _seen(
    load: Any, t: float, displacement: Vector, velocity: Vector, orientation: Quaternion, omega: Vector
) -> tuple[bool, Vector, Vector]:
    """As in `load_time_scale.py`."""
    push, twist = evaluated(load, t, displacement, velocity, orientation, omega)
    return are_finite(push, twist), push, twist


_STEADY = compiled_apart(specialise(steady_time, "steady_time_of_numbers", _seen=_seen))
_STRENGTH = specialise(_held_strength, "strength_of_held")
_WHOLE_STRENGTH = specialise(_whole_strength, "strength_of_all")

# Cost of a stride in plain Python, its choice included, in steps.
_STEPS_IN_A_STRIDE = {"doubling": 3.0, "pair": 1.5, "own": 1.5}


class Strides(OnDemand):
    """Kernel for strides of one method with one kind of control."""

    def __init__(self, method: Method, kind: str, *, effects: bool = False, gradual: bool = False) -> None:
        """Prepare, without compiling. `kind` is "doubling", "pair" or "own"; the rest as for `Kernel`."""
        suffix, load = load_of(effects=effects, gradual=gradual)
        name = f"strides_by_{kind}_{method.name}{suffix}"
        step = specialise(_stepped, f"{name}_step", _step=method.step, _load=load)
        if kind == "own":
            longest = specialise(_longest, f"{name}_longest", _longest_step=method.longest_step)
            known = specialise(by_method, f"{name}_known", _longest_step=longest)
            choose = specialise(_by_method, f"{name}_choice", by_method=known, _stepped=step)
        else:
            if kind == "pair":
                attempt = specialise(_pair_of_steps, f"{name}_trial", _pair=method.pair, _load=load)
            else:
                attempt = specialise(_halves_and_whole, f"{name}_trial", _stepped=step)
            if effects:
                # What is inlined is compiled again at each level of calls; under effects a call is cheap beside a step.
                attempt = compiled_apart(attempt)
            longer = compiled_apart(specialise(taught, f"{name}_taught", _attempt=attempt))
            whole = _WHOLE_STRENGTH if effects else _STRENGTH
            choose = specialise(by_trial, f"{name}_choice", _attempt=attempt, taught=longer, _strength=whole)
            if effects:
                choose = compiled_apart(choose)
                choose = specialise(_by_trial_in_sight, f"{name}_choice_in_sight", by_trial=choose, _load=load)
        on_numbers = specialise(_run_on_numbers, name, run=specialise(run, f"{name}_run", _choose=choose))
        super().__init__(method.name, on_numbers, _SIGNATURE, _STEPS_IN_A_STRIDE[kind])

    def after(
        self,
        constants: Constants,
        goal: Goal,
        learnt: Learnt,
        phase: PhaseState,
        room: int,
        count: int,
        ahead: int,
        effects: tuple[float, ...] = (),
    ) -> Progress | None:
        """Return the result of `run` if about `ahead` strides are expected; None if there is no kernel."""
        compiled = self.get(ahead, 1)
        if compiled is None:
            return None
        numbers = _packed(constants, goal, learnt, phase, effects)
        strides, reached, next_stride = compiled(numbers, min(room, FOREVER), count)
        s = _OUTPUT.unpack_from(numbers.data, 8 * _PHASE_AT)
        (end, learnt), (after, following) = _known(s[:_STATE_SIZE]), _known(s[_STATE_SIZE:])
        return Progress(strides, reached, end, learnt, next_stride, after, following)

    def longest(
        self,
        constants: Constants,
        goal: Goal,
        learnt: Learnt,
        phase: PhaseState,
        trials: int,
        effects: tuple[float, ...] = (),
    ) -> tuple[float, Learnt] | None:
        """Return the longest stride (s) of so many trials and what they teach; None if one fails or without kernels."""
        compiled, search = self.get(1, 1), LONGEST.get(1, 1)
        if compiled is None or search is None:
            return None
        numbers = _packed(constants, goal, learnt, phase, effects)
        found = search(numbers, trials, compiled)
        learnt = Learnt(*numbers[_PHASE_AT + PHASE : _AFTER_AT].tolist())
        return (found / NANOSECONDS, learnt) if found > 0 else None


def _packed(constants: Constants, goal: Goal, learnt: Learnt, phase: PhaseState, effects: tuple[float, ...]) -> Numbers:
    import numpy as np

    numbers = np.empty(_AFTER_AT + _STATE_SIZE + len(effects))
    numbers[_AFTER_AT + _STATE_SIZE :] = effects
    _INPUT.pack_into(numbers.data, 0, *constant_numbers(*constants), *goal, *phase_numbers(phase), *learnt)
    return numbers


def _longest_of(numbers: Numbers, trials: int, strides: Callable[[Numbers, int, int], tuple[int, int, int]]) -> int:
    """Return the longest stride (ns), as `longest_stride` of `auto_method.py` does; 0 if one fails."""
    longest = 0
    for _ in range(trials):
        _, _, stride = strides(numbers, 0, 1)
        if stride == 0:
            return 0
        for k in range(PHASE, _STATE_SIZE):
            numbers[_PHASE_AT + k] = numbers[_AFTER_AT + k]
        if stride / NANOSECONDS < LONGER * (longest / NANOSECONDS):
            break
        longest = stride
    return longest


LONGER = 1.2
"""A trial has found no longer stride than the one before if its stride is less than this times as long."""


def _rates_on_numbers(numbers: Numbers) -> None:
    (inertia, _), phase = constants_at(numbers), phase_at(numbers, CONSTANTS)
    load: Any = load_of_effects(numbers, phase.high, phase.low)
    write_rates(load, inertia, phase, numbers[CONSTANTS + PHASE :])


def fastest_rate_by_kernel(constants: Constants, phase: PhaseState, effects: tuple[float, ...]) -> float:
    """Return `fastest_rate` under effects; inf if it is not finite or there is no kernel."""
    compiled = RATES.get(1, 1)
    if compiled is None:
        return math.inf
    import numpy as np

    numbers = np.array((*constant_numbers(*constants), *phase_numbers(phase), *(0.0,) * 36, *effects))
    compiled(numbers)
    return largest_rate(numbers[CONSTANTS + PHASE : CONSTANTS + PHASE + 36])


RATES = OnDemand("auto", _rates_on_numbers, "void(float64[::1])")
LONGEST = OnDemand("auto", _longest_of, f"int64(float64[::1], int64, FunctionType({_SIGNATURE}))")


def _known(numbers: tuple[float, ...]) -> tuple[PhaseState, Learnt]:
    return phase_of(numbers[:PHASE]), Learnt(*numbers[PHASE:])


def strides_of(method: Method, *, effects: bool = False, gradual: bool = False) -> Strides | None:
    """Return the kernel for `method` with the control that suits it, None if there is none."""
    if method.order is None:
        return None
    kind = "own" if method.longest_step else "pair" if method.pair else "doubling"
    return _strides(method, kind, effects=effects, gradual=gradual)


def strides_by(method: Method, control: StepControl, *, effects: bool = False, gradual: bool = False) -> Strides | None:
    """Return the kernel for `method` with `control`, as for `Kernel`; None if there is none."""
    if isinstance(control, OwnControl):
        return _strides(method, "own", effects=effects, gradual=gradual)
    if isinstance(control, AccuracyControl):
        return _strides(method, "pair" if control.embedded else "doubling", effects=effects, gradual=gradual)
    return None


@cache
def _strides(method: Method, kind: str, *, effects: bool, gradual: bool) -> Strides | None:
    able = compiles(method, effects=effects) and not (effects and kind == "own")
    return Strides(method, kind, effects=effects, gradual=gradual) if able else None
