"""The kernel for many bodies with reaction wheels: each goes to a time, and gets its commands, in one compiled call.

What happens to a body is what `simulation.py` and `arc.py` do, to the same bits: a command, or a wheel that switches
between free and held, begins an arc; its steps lie on a grid that begins with it, and any other time is reached by a
shorter step. The steps are those of the kernels in `stateful_kernel.py`. A body whose step is refused, or whose
accuracy cannot be kept, is left behind: it has to be simulated alone, which raises the error.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from rb_dynamics.loads.compiled_load import EffectLoad, has_effects, is_attraction_or_none, load_scales, strength
from rb_dynamics.loads.effect import Point
from rb_dynamics.loads.varying_load import evaluated
from rb_dynamics.loads.wheel_numbers import (
    bend_and_noise,
    command_wheel,
    excess,
    inner_torque,
    is_far,
    is_held,
    may_stay,
    move_on,
    settle,
    speed_of,
    spin_up_of,
    switch_wheels,
)
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.equations_of_motion import accelerations
from rb_dynamics.motion.fixed_step_kernel import OnDemand
from rb_dynamics.motion.kernel_layout import CONSTANTS, PHASE, TRUTHS, constants_at, phase_at, write_phase
from rb_dynamics.motion.load_time_scale import steady_time
from rb_dynamics.motion.method import Inertia
from rb_dynamics.motion.phase_state import MOMENTUM, POSITION, PhaseState, elapsed, is_finite, spun, total, two_sum
from rb_dynamics.motion.stateful_kernel import OF_EACH_STATE, OTHER, STAGE, WHEELS, CompiledWheelLoad, layout
from rb_dynamics.motion.step_control import Goal, Learnt, by_trial, first_guess, rounding
from rb_dynamics.numerics.compilation import compiled_apart, specialise
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import Quaternion, rotate_inverse
from rb_dynamics.numerics.sign_change import first_positive
from rb_dynamics.numerics.vector import ZERO, Vector, add, dot, norm, scale
from rb_dynamics.numerics.vector import multiply as times

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.numerics.array_types import Numbers

    Lanes = npt.NDArray[np.float64]
    Whole = npt.NDArray[np.int64]
    Take = Callable[[Numbers, float], None]
    # Room, see `_alone`, and the kernels of a step and of an embedded pair.
    _Trials = tuple[Numbers, Take, Take]

# Numbers of the arc of a body: goal, what was learnt when it began, what is learnt, and what will be after the next
# stride; length (s) of a stride from the grid point whose results are there already, as after the next stride (0 for
# none); then two phases with their states: at the grid point and after the next stride. The body's other numbers have
# that at the last time, in which it stands.
GOAL = 0
BEGAN = GOAL + len(Goal._fields)
LEARNT = BEGAN + len(Learnt._fields)
FOLLOWING = LEARNT + len(Learnt._fields)
TRIED = FOLLOWING + len(Learnt._fields)
GRID_POINT = TRIED + 1

# And its whole numbers: start of the arc (ns), length of the way to the grid point, strides that led there, length of
# the next one (0 if it has not been chosen), and of all strides (0 if each is chosen); end of the stride that was
# searched for a switch of a wheel, the time of the switch in it (-1 for none), and whether a wheel may switch at that
# end; the last time; whether the first arc has begun, and whether the body is left behind; lengths of the last arc, and
# of the next one if the last two were equally long (0 if not); whether a stride side by side has led to the next time;
# and whether the body stands at the grid point, whose phase is written only when it is needed.
START, REACHED, STRIDES, STRIDE, LENGTH = range(5)
SEARCHED, SWITCH, UNLIKE, TIME, BEGUN, LEFT_BEHIND = range(5, 11)
LAST, EXPECTED, ARRIVED, AT_GRID_POINT, WHOLE = range(11, 16)

LANES = 8
"""Bodies of a group, side by side: those of one vector register."""


def size_of(states: int) -> int:
    """Return how many numbers a phase with so many states has."""
    return PHASE + 2 * states


def advance_all(
    rows: Lanes,
    arcs: Lanes,
    whole: Whole,
    commands: Lanes,
    until_ns: Whole,
    first: int,
    last: int,
    step: Take,
    pair: Take,
    beside: Any,
    together: int,
    spare: Numbers,
    results: Lanes,
) -> None:
    """Give the bodies of some groups their commands, now, and let each go to its time.

    Args:
        rows: (groups, ..., `LANES`), of each body the numbers of `stateful_kernel.py`, without weights and rates.
        arcs: (groups, ..., `LANES`), of each body the numbers above.
        whole: (groups, `WHOLE`, `LANES`), likewise.
        commands: (groups, wheels + 1, `LANES`), NaN for none; the last is for a change of the load.
        until_ns: (groups, `LANES`), the times; negative for a body that stays, and gets no command.
        first: group.
        last: behind the last group.
        step: kernel of a step with wheels.
        pair: kernel of an embedded pair with wheels; any other where steps are fixed.
        beside: kernel that begins strides of the bodies of a group side by side; any other if there is none.
        together: whether there is one (0 or 1).
        spare: (groups, ...), the numbers of one body, with the weights of the tableau: room for `step` and `pair`.
        results: (groups, ..., `LANES`), room for `beside`; as of `spare`, that of the first group is used.
    """
    trials = (spare[first], step, pair)
    for g in range(first, last):
        if together != 0:
            if beside(rows[g], arcs[g], whole[g], commands[g], until_ns[g], trials[0], results[first]) == LANES:
                continue
        else:
            for i in range(LANES):
                begin(rows[g, :, i], arcs[g, :, i], whole[g, :, i], commands[g, :, i], until_ns[g, i])
        for i in range(LANES):
            c, f, w = rows[g, :, i], arcs[g, :, i], whole[g, :, i]
            goes = until_ns[g, i] >= 0 and w[ARRIVED] == 0 and w[LEFT_BEHIND] == 0
            if goes and not _advance(c, f, w, until_ns[g, i], trials):
                w[LEFT_BEHIND] = 1


@compiled_apart
def begin(c: Numbers, f: Numbers, w: Whole, commands: Numbers, until_ns: int) -> None:
    """Give a body its commands, which begin an arc."""
    w[ARRIVED] = 0
    if until_ns < 0 or w[LEFT_BEHIND] != 0:
        return
    begins = w[BEGUN] == 0
    w[BEGUN] = 1
    omega, (_, _, states) = phase_at(c, CONSTANTS).angular_velocity, layout(c)
    for k in range(len(commands)):
        if not math.isnan(commands[k]):
            if k < int(c[WHEELS]):
                command_wheel(c, WHEELS, k, commands[k], speed_of(c, WHEELS, states, k, omega))
            begins = True
    if begins:
        _begin_arc(c, f, w)


def tries(c: Numbers, f: Numbers, w: Whole, length: int) -> bool:
    """Return whether the stride tried next is the first of an arc, of `length` ns, and as long as the arc will be."""
    at_grid_point = w[LENGTH] == 0 and w[AT_GRID_POINT] != 0 and w[REACHED] == 0 and w[LEFT_BEHIND] == 0
    expected = w[EXPECTED] == length and f[LEARNT] == length / NANOSECONDS
    return at_grid_point and expected and is_attraction_or_none(c)


def keep_tried(c: Numbers, f: Numbers, r: Numbers, h: float) -> None:
    """Keep the results of a step that was taken side by side, for when it is chosen."""
    size = _size(c)
    for k in range(size):
        f[GRID_POINT + size + k] = r[k]
    for k in range(PHASE):
        c[OTHER + k] = r[size + k]
    f[TRIED] = h


@compiled_apart
def _alone(c: Numbers, row: Numbers, take: Take, h: float) -> None:
    """Take a step, or a pair, of one body; `row` has the weights of the tableau, and room for the numbers in `c`."""
    m, sums, states = layout(c)
    for k in range(STAGE):
        row[k] = c[k]
    for k in range(WHEELS, states + m):
        row[k] = c[k]
    for k in range(sums + OF_EACH_STATE * m, len(c)):
        row[k] = c[k]
    take(row, h)
    for k in range(CONSTANTS, STAGE):
        c[k] = row[k]
    for k in range(sums, states + m):
        c[k] = row[k]


def _advance(c: Numbers, f: Numbers, w: Whole, until_ns: int, trials: _Trials) -> bool:
    """Let a body go to a time, where it then stands; return whether it can."""
    good = True
    while good:
        if w[AT_GRID_POINT] != 0:
            _keep(c, f, GRID_POINT)
            w[AT_GRID_POINT] = 0
        good = _search(c, f, w, until_ns, trials)
        switch = 0 <= w[SWITCH] <= until_ns
        time_ns = w[SWITCH] if switch else until_ns
        good = good and _reach(c, f, w, time_ns, trials)
        good = good and _all_finite(c, phase_at(c, CONSTANTS), c, layout(c)[1])
        if time_ns > w[TIME]:
            move_on(c, WHEELS)
        w[TIME] = time_ns
        if not switch:
            break
        if good:
            _switch(c)
            _begin_arc(c, f, w)
    return good


@compiled_apart
def _begin_arc(c: Numbers, f: Numbers, w: Whole) -> None:
    """Begin an arc at the last time, where the body stands."""
    if w[TIME] > w[START]:
        length = w[TIME] - w[START]
        w[EXPECTED] = length if length == w[LAST] else 0
        w[LAST] = length
        _copy(f, LEARNT, BEGAN, 5)
    else:
        # See `Plan`.
        _copy(f, BEGAN, LEARNT, 5)
    w[START], w[SEARCHED], w[SWITCH] = w[TIME], -1, -1
    w[REACHED] = w[STRIDES] = w[STRIDE] = 0
    w[AT_GRID_POINT] = 1
    phase, (_, _, states) = phase_at(c, CONSTANTS), layout(c)
    outside = _outside(c, phase) if may_stay(c, WHEELS) else ZERO
    settle(c, WHEELS, states, (c[1], c[2], c[3]), outside, phase.angular_velocity)
    # As `AccuracyControl.start` does.
    f[LEARNT + 4] = 0.0
    if w[EXPECTED] > 0:
        f[LEARNT] = min(f[LEARNT], w[EXPECTED] / NANOSECONDS)


@compiled_apart
def _choose(c: Numbers, f: Numbers, w: Whole, trials: _Trials) -> bool:
    """Choose the next stride; return whether there is one."""
    stand(c, f, GRID_POINT)
    if w[LENGTH] > 0:
        _alone(c, trials[0], trials[1], w[LENGTH] / NANOSECONDS)
        _keep(c, f, GRID_POINT + _size(c))
        w[STRIDE] = w[LENGTH]
        return is_finite(phase_at(c, CONSTANTS))
    (inertia, held), phase = constants_at(c), phase_at(c, CONSTANTS)
    goal, sight = _goal_and_sight(c, f, phase)
    guess, k = f[LEARNT], LEARNT
    if guess == 0.0:
        load = CompiledWheelLoad(c, 0.0, phase.high[13], phase.low[13], total(phase, POSITION), inertia.moments, held)
        guess = _steady(load, inertia, held, phase, first_guess(goal, phase))
    learnt = Learnt(min(guess, max(sight, 1.0 / NANOSECONDS)), f[k + 1], f[k + 2], f[k + 3], f[k + 4])
    length, after, following, _, steady = _by_trial(goal, learnt, phase, (c, f, trials))
    f[TRIED] = 0.0
    if length == 0 or rounding(goal, phase, steady) > goal.accuracy:
        return False
    _keep(c, f, GRID_POINT + _size(c))
    f[FOLLOWING], f[FOLLOWING + 1], f[FOLLOWING + 2], f[FOLLOWING + 3], f[FOLLOWING + 4] = following
    w[STRIDE] = length
    return is_finite(after)


def _goal_and_sight(c: Numbers, f: Numbers, phase: PhaseState) -> tuple[Goal, float]:
    """Return the goal of a stride from `phase` on, and for how long (s) the load there predicts that ahead."""
    slowing, sight = load_scales(c, _point(c, phase))
    share, x, y, z = f[GOAL + 6], f[GOAL + 7], f[GOAL + 8], f[GOAL + 9]
    ends, order, errors = f[GOAL + 2] != 0.0, f[GOAL + 4], f[GOAL + 5]
    goal = Goal(f[GOAL], f[GOAL + 1], ends, f[GOAL + 3], order, errors, share, x, y, z, slowing, f[GOAL + 11])
    return goal, sight


def _search(c: Numbers, f: Numbers, w: Whole, until_ns: int, trials: _Trials) -> bool:
    """Find the first switch of a wheel up to a time, and take the strides that end by then; return whether they can be.

    As `Simulation` does, in whole strides.
    """
    while True:
        if w[STRIDE] == 0 and not _choose(c, f, w, trials):
            return False
        end_ns = w[START] + w[REACHED] + w[STRIDE]
        if end_ns != w[SEARCHED]:
            first = w[START] if w[SEARCHED] < 0 else w[SEARCHED] - 1
            w[SEARCHED], w[SWITCH] = end_ns, -1
            if not _search_stride(c, f, w, first, end_ns, trials):
                return False
        if w[SWITCH] >= 0 or end_ns > until_ns or (end_ns == until_ns and w[UNLIKE] == 0):
            return True
        _take(c, f, w)


def _search_stride(c: Numbers, f: Numbers, w: Whole, first: int, last: int, trials: _Trials) -> bool:
    """Note whether a wheel switches between two times within the next stride; return whether that can be told."""
    stand(c, f, GRID_POINT)
    start, (_, _, states) = phase_at(c, CONSTANTS), layout(c)
    below = min(_beyond(c, start), 0.0)
    stand(c, f, GRID_POINT + _size(c))
    above = _beyond(c, phase_at(c, CONSTANTS))
    w[UNLIKE] = 0
    if above > 0.0:
        w[UNLIKE] = 1
        last -= 1
        if last <= first:
            return True
        if not _reach(c, f, w, last, trials):
            return False
        above = _beyond(c, phase_at(c, CONSTANTS))
    there = phase_at(c, CONSTANTS)
    turning = start.angular_velocity, there.angular_velocity
    h = (last - first) / NANOSECONDS
    if is_far(c, WHEELS, max(below, above), h, turning, (start.orientation, there.orientation)):
        return True
    gained = _spin_up(c, there)
    stand(c, f, GRID_POINT)
    bend, noise = bend_and_noise(c, WHEELS, states, h, turning, (_spin_up(c, start), gained))
    found: int = _first_switch((c, f, w, trials), first, last, below, above, bend / NANOSECONDS**2, noise)
    if found > 0:
        w[SWITCH] = first + found
    return found >= 0


def _beyond_at(search: Any, time_ns: int) -> float:
    """Return how far the wheels are beyond at a time within the next stride; NaN if it cannot be reached."""
    c, f, w, trials = search
    return _beyond(c, phase_at(c, CONSTANTS)) if _reach(c, f, w, time_ns, trials) else math.nan


_first_switch = specialise(first_positive, "first_switch", _value=_beyond_at)


def _take(c: Numbers, f: Numbers, w: Whole) -> None:
    """Take the next stride."""
    _copy(f, FOLLOWING, LEARNT, 5)
    _copy(f, GRID_POINT + _size(c), GRID_POINT, _size(c))
    w[REACHED] += w[STRIDE]
    w[STRIDES] += 1
    w[STRIDE] = 0


@compiled_apart
def _reach(c: Numbers, f: Numbers, w: Whole, time_ns: int, trials: _Trials) -> bool:
    """Stand at a time within the next stride; return whether it can be reached."""
    rest = time_ns - w[START] - w[REACHED]
    if rest > 0 and rest == w[STRIDE]:
        _take(c, f, w)
        rest = 0
    stand(c, f, GRID_POINT)
    if rest > 0:
        _copy(f, FOLLOWING, LEARNT, 5)
        _alone(c, trials[0], trials[1], rest / NANOSECONDS)
        # A step leaves the states of a stage.
        _write_states(c, c, layout(c)[1])
    return is_finite(phase_at(c, CONSTANTS))


@compiled_apart
def _beyond(c: Numbers, phase: PhaseState) -> float:
    """Return how far the wheels are beyond where none switches, in a phase with the states in `c`."""
    (_, _, states), spin_up, found = layout(c), ZERO, -math.inf
    if is_held(c, WHEELS):
        spin_up = _spin_up(c, phase)
    for k in range(int(c[WHEELS])):
        found = max(found, excess(c, WHEELS, states, k, spin_up, phase.angular_velocity))
    return found


def _switch(c: Numbers) -> None:
    """Switch the wheels that no longer turn as they do, where the body stands."""
    phase, (m, sums, states), moments = phase_at(c, CONSTANTS), layout(c), (c[1], c[2], c[3])
    there = phase.orientation, phase.angular_velocity
    change = switch_wheels(c, WHEELS, states, moments, _outside(c, phase), *there)
    if change != ZERO:
        write_phase(c, CONSTANTS, spun(phase, moments, change))
        for k in range(m):
            c[sums + k], c[sums + m + k] = two_sum(c[sums + k], c[states + m + k], c[sums + m + k])
        _write_states(c, c, sums)


@compiled_apart
def _spin_up(c: Numbers, phase: PhaseState) -> Vector:
    """Return w' (principal axes) in a phase with the states in `c`."""
    _, _, states = layout(c)
    return spin_up_of(c, WHEELS, states, (c[1], c[2], c[3]), _outside(c, phase), phase.angular_velocity)


@compiled_apart
def _outside(c: Numbers, phase: PhaseState) -> Vector:
    """Return the torque (principal axes) on body and wheels from outside."""
    (_, held), torque = constants_at(c), ZERO
    if has_effects(c):
        here = _point(c, phase)
        load: Any = EffectLoad(c, here.time, here.position)
        _, torque = evaluated(load, 0.0, ZERO, here.velocity, here.orientation, here.angular_velocity)
    return add(add(held.torque_body, rotate_inverse(phase.orientation, held.torque_world)), torque)


def _point(c: Numbers, phase: PhaseState) -> Point:
    velocity = scale(1.0 / c[0], total(phase, MOMENTUM))
    return Point(elapsed(phase), total(phase, POSITION), velocity, phase.orientation, phase.angular_velocity)


def find_accelerations(rows: Lanes, bodies: Numbers, truth: Numbers) -> None:
    """Write the accelerations of bodies where they stand, as in `Truth`, from number 10 on; arguments as `find_truths`.

    Behind their states, the rates of a stage are overwritten.
    """
    for i in range(len(truth)):
        group, at = divmod(i, LANES)
        c, b, t = rows[group, :, at], bodies, truth
        (inertia, held), phase, (_, _, states) = constants_at(c), phase_at(c, CONSTANTS), layout(c)
        q, omega, push, torque = phase.orientation, phase.angular_velocity, held.force_world, ZERO
        if has_effects(c):
            here = _point(c, phase)
            load: Any = EffectLoad(c, here.time, here.position)
            force, torque = evaluated(load, 0.0, ZERO, here.velocity, q, omega)
            push = add(push, force)
        twist = add(held.torque_body, rotate_inverse(q, held.torque_world))
        if c[WHEELS] > 0.0:
            torque = add(torque, inner_torque(c, WHEELS, states, inertia.moments, add(twist, torque), q, omega))
        center, axes = (b[0, i], b[1, i], b[2, i]), (b[3, i], b[4, i], b[5, i], b[6, i])
        forces, torque = (held.force_body, push), add(twist, torque)
        along, around = accelerations(inertia.mass, inertia.moments, center, axes, q, omega, forces, torque)
        t[i, 10], t[i, 11], t[i, 12] = along
        t[i, 13], t[i, 14], t[i, 15] = around


def _all_finite(c: Numbers, phase: PhaseState, a: Numbers, at: int) -> bool:
    """Return whether a phase, its states, which begin at `at` in `a`, and its energy are finite."""
    momentum, omega = total(phase, MOMENTUM), phase.angular_velocity
    found = dot(momentum, scale(1.0 / c[0], momentum)) + dot(omega, times((c[1], c[2], c[3]), omega))
    for k in range(2 * layout(c)[0]):
        found += a[at + k]
    return math.isfinite(found)


def _size(c: Numbers) -> int:
    return size_of(layout(c)[0])


def _copy(f: Numbers, source: int, target: int, count: int) -> None:
    for k in range(count):
        f[target + k] = f[source + k]


@compiled_apart
def stand(c: Numbers, f: Numbers, at: int) -> None:
    """Stand in one of the phases of `f`."""
    m, sums, states = layout(c)
    for k in range(PHASE):
        c[CONSTANTS + k] = f[at + k]
    for k in range(m):
        high, low = f[at + PHASE + k], f[at + PHASE + m + k]
        c[sums + k], c[sums + m + k], c[states + k] = high, low, high + low


def _write_states(c: Numbers, a: Numbers, at: int) -> None:
    """Write the states whose sums begin at `at` in `a`."""
    m, _, states = layout(c)
    for k in range(m):
        c[states + k] = a[at + k] + a[at + m + k]


@compiled_apart
def _keep(c: Numbers, f: Numbers, at: int) -> None:
    """Keep the phase in which the body stands."""
    m, sums, _ = layout(c)
    for k in range(PHASE):
        f[at + k] = c[CONSTANTS + k]
    for k in range(2 * m):
        f[at + PHASE + k] = c[sums + k]


def _attempted(trials: Any, phase: PhaseState, h: float) -> tuple[PhaseState, PhaseState]:  # noqa: ARG001
    """Return the results of an embedded pair after a step of h s from the grid point."""
    c, f, (row, _, pair) = trials
    if h == f[TRIED]:
        stand(c, f, GRID_POINT + _size(c))
    else:
        stand(c, f, GRID_POINT)
        _alone(c, row, pair, h)
    f[TRIED] = 0.0
    return phase_at(c, CONSTANTS), phase_at(c, OTHER)


def _whole_strength(trials: Any, phase: PhaseState) -> float:
    """Return the sum of the magnitudes (N) of the forces."""
    c, _, _ = trials
    _, held = constants_at(c)
    return norm(held.force_world) + norm(held.force_body) + strength(c, _point(c, phase))


def _as_told(goal: Goal, learnt: Learnt, phase: PhaseState, trials: Any, h: float, noise: float) -> Learnt:  # noqa: ARG001
    """Return what is learnt: rounding does not hide the error of a pair."""
    return learnt


def _seen(
    load: Any, t: float, displacement: Vector, velocity: Vector, orientation: Quaternion, omega: Vector
) -> tuple[bool, Vector, Vector]:
    """Return True, force and torque with the wheels as they are at the start of the step."""
    load.numbers[STAGE] = 0.0
    force, torque = evaluated(load, t, displacement, velocity, orientation, omega)
    return True, force, torque


_steady: Callable[[CompiledWheelLoad, Inertia, HeldWrench, PhaseState, float], float] = specialise(
    steady_time, "steady_time_with_wheels", _seen=_seen
)
_by_trial = specialise(
    by_trial, "by_trial_with_wheels", _attempt=_attempted, taught=_as_told, _strength=_whole_strength
)

_TAKE = "FunctionType(void(float64[::1], float64))"
_GROUP = "float64[:, ::1], float64[:, ::1], int64[:, ::1], float64[:, ::1], int64[::1], float64[::1], float64[:, ::1]"
BESIDE = f"int64({_GROUP})"
"""Types of the kernel for the bodies of a group, as numba writes them."""
_ARRAYS = "float64[:, :, ::1], float64[:, :, ::1], int64[:, :, ::1], float64[:, :, ::1], int64[:, ::1]"
_KERNELS = f"{_TAKE}, {_TAKE}, FunctionType({BESIDE}), int64"
_SIGNATURE = f"void({_ARRAYS}, int64, int64, {_KERNELS}, float64[:, ::1], float64[:, :, ::1])"
ADVANCE_ALL = OnDemand("dop853", advance_all, _SIGNATURE, steps=4.0)
FIND_ACCELERATIONS = OnDemand("dop853", find_accelerations, TRUTHS, steps=1.0)
"""The kernel that finds the accelerations of many bodies."""
