"""Strides of several bodies with reaction wheels, side by side: the compiler vectorises over them.

The bits are those of `wheel_arcs_kernel.py` and `stateful_kernel.py`, body by body: the same functions are called, with
the numbers of the bodies in columns on the stack. For bodies with as many wheels, under central gravity or no effect.
Commands and checks of a stride go side by side for a body whose wheels are free and stay so, and whose arc is as long
as the one before; other bodies get them one by one, as does what is not vectorised: powers and arc tangents.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

from rb_dynamics.loads.central_gravity import Attraction, attracted, time_to_fall
from rb_dynamics.loads.compiled_load import ATTRACTION, WIDTH
from rb_dynamics.loads.effect import Point
from rb_dynamics.loads.wheel_numbers import (
    BEFORE,
    BOOKS,
    EACH,
    command_freely,
    excess,
    inner_torque,
    is_far,
    momentum_in,
    speed_of,
    spin_up_of,
    turns_freely,
)
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.explicit_runge_kutta import Carried, Slope, StepConstants, Turn, slope, step_constants
from rb_dynamics.motion.fixed_step_kernel import OnDemand
from rb_dynamics.motion.inner_states import difference
from rb_dynamics.motion.kernel_layout import CONSTANTS, PHASE, constants_in, phase_in, write_phase_in
from rb_dynamics.motion.method import Increment, Method
from rb_dynamics.motion.phase_state import MOMENTUM, POSITION, PhaseState, elapsed, grown, is_finite, total, two_sum
from rb_dynamics.motion.stateful_kernel import MOST_STAGES, ROWS, WHEELS
from rb_dynamics.motion.step_control import (
    MOST_GROWTH,
    Discrepancy,
    Goal,
    discrepancy,
    errors_of,
    following_step,
    rounding,
    steady_length,
)
from rb_dynamics.motion.wheel_arcs_kernel import (
    ARRIVED,
    AT_GRID_POINT,
    BEGAN,
    BEGUN,
    BESIDE,
    EXPECTED,
    GOAL,
    GRID_POINT,
    LANES,
    LAST,
    LEARNT,
    LEFT_BEHIND,
    LENGTH,
    REACHED,
    SEARCHED,
    START,
    STRIDE,
    STRIDES,
    SWITCH,
    TIME,
    UNLIKE,
    begin,
    keep_tried,
    stand,
    tries,
)
from rb_dynamics.numerics.compilation import block, flat, lane, specialise, workspace
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import Quaternion, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, divide, dot, scale
from rb_dynamics.numerics.vector import multiply as times

if TYPE_CHECKING:
    from rb_dynamics.motion.wheel_arcs_kernel import Whole
    from rb_dynamics.numerics.array_types import Numbers

COUNTS = (3, 4)
"""How many wheels there are kernels for."""

# Numbers of the effect; and where in a slope push and gain begin, behind the turn, then the rates of the states; twist
# and power follow them.
_EFFECT, _TURN, _MOVED = 10, 7, 13

# Bodies for which going side by side pays.
_FEWEST = 2

# Of a stride side by side: whether a body takes it with wheels that are free, or is tried otherwise; how far the wheels
# are beyond at its start; from here on a `Discrepancy`; the error that the stride may add, and what it adds; the length
# of the following one; and whether it is accepted. See `_compare`.
_FREE, _TRIED, _BELOW, _APART = range(4)
_ALLOWED, _ERROR, _FOLLOWING, _ACCEPTED, _MARKS = range(_APART + 6, _APART + 11)
# Numbers of `_keep_constants`.
_KEPT = 20

# The sums: of the result, and of the two estimates of its error.
_RESULTS = 3


class _LaneLoad(NamedTuple):
    """The load on one of the bodies: its wheels, whose numbers and states `column` has, and the only effect."""

    column: Numbers
    time: float
    position: Vector
    moments: Vector
    held: HeldWrench
    acts: bool
    attraction: Attraction


def _evaluated(
    load: _LaneLoad,
    t: float,
    displacement: Vector,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
) -> tuple[Vector, Vector]:
    """As `evaluated_with_wheels`."""
    here = Point(load.time + t, add(load.position, displacement), velocity, orientation, angular_velocity)
    force, torque = ZERO, ZERO
    if load.acts:
        force, torque = attracted(load.attraction, here)
    held = add(load.held.torque_body, rotate_inverse(orientation, load.held.torque_world))
    inner = _inner_torque(load.column, 0, _STATES, load.moments, add(held, torque), orientation, angular_velocity)
    return force, add(torque, inner)


def strides_on_numbers(
    rows: Numbers, arcs: Numbers, whole: Whole, commands: Numbers, until_ns: Whole, row: Numbers, results: Numbers
) -> int:
    """Give the bodies of a group their commands, and let those go to their times that one stride leads there.

    Args:
        rows: (..., `LANES`), of each body the numbers of `stateful_kernel.py`.
        arcs: (..., `LANES`), those of its arc, see `wheel_arcs_kernel.py`.
        whole: (`WHOLE`, `LANES`), likewise.
        commands: (wheels + 1, `LANES`), see `advance_all`.
        until_ns: (`LANES`,), likewise.
        row: the weights, as in the numbers of a body.
        results: (..., `LANES`), room for the phase at the end with its states, then the second result.

    Returns:
        How many bodies are where they should be.
    """
    # Body and wrench; phase at the start, at the end, and second result; wheels with their states, effect and arc.
    c, s, r, other = block(CONSTANTS, LANES), block(PHASE, LANES), block(PHASE, LANES), block(PHASE, LANES)
    w, e, f, m = block(_COLUMN, LANES), block(_EFFECT, LANES), block(GRID_POINT, LANES), block(_MARKS, LANES)
    _read(c, 0, CONSTANTS, rows, 0)
    _read(s, 0, PHASE, rows, CONSTANTS)
    _read(w, 0, _HIGH + 2 * _M, rows, WHEELS)
    _read(e, 0, _EFFECT, rows, len(rows) - 1 - WIDTH)
    _read(f, 0, GRID_POINT, arcs, 0)
    effects, length = rows[len(rows) - 1, 0], 0
    for i in range(LANES):
        if until_ns[i] >= 0:
            length = max(length, until_ns[i] - whole[TIME, i])
    h = length / NANOSECONDS
    _mark_free(m, s, w, e, f, effects, whole, commands, until_ns, length, h)
    free = _begin_free(m, s, w, f, whole, commands, h)
    if free > 0:
        _read(rows, WHEELS, _HIGH, w, 0)
        _read(arcs, BEGAN, LEARNT + 5 - BEGAN, f, BEGAN)
    if free < LANES:
        tried, length = _begin_others(m, rows, arcs, whole, commands, until_ns, free, length)
        if tried < _FEWEST:
            return 0
        h = length / NANOSECONDS
        _read(w, 0, _HIGH, rows, WHEELS)
    _take_pairs(c, s, r, other, w, e, effects != 0.0, row, h)
    if free > 0:
        _compare(m, s, r, other, f, h)
        _choose_following(m, f, h)
        _accept(m, c, s, r, w, e, f, effects != 0.0, h)
    arrived = 0
    for i in range(LANES):
        m[_FREE, i] *= m[_ACCEPTED, i] if free > 0 else 0.0
        arrived += int(m[_FREE, i])
    if arrived == LANES:
        _read(rows, CONSTANTS, PHASE, r, 0)
        _read(rows, WHEELS + _HIGH, 3 * _M, w, _HIGH)
    else:
        _read(results, 0, PHASE, r, 0)
        _read(results, PHASE, 2 * _M, w, _HIGH)
        _read(results, PHASE + 2 * _M, PHASE, other, 0)
        _end_one_by_one(m, rows, arcs, results, h)
    for i in range(LANES):
        if m[_FREE, i] != 0.0:
            arcs[LEARNT, i], arcs[LEARNT + 1, i] = m[_FOLLOWING, i], m[_APART + 5, i]
            whole[REACHED, i], whole[STRIDES, i], whole[UNLIKE, i], whole[ARRIVED, i] = length, 1, 0, 1
            whole[TIME, i] = whole[SEARCHED, i] = until_ns[i]
    return arrived


def _begin_others(
    m: Numbers,
    rows: Numbers,
    arcs: Numbers,
    whole: Whole,
    commands: Numbers,
    until_ns: Whole,
    free: int,
    length: int,
) -> tuple[int, int]:
    """Give the other bodies their commands; return how many then try a stride of which length (ns)."""
    tried = free
    for i in range(LANES):
        if m[_FREE, i] == 0.0:
            begin(rows[:, i], arcs[:, i], whole[:, i], commands[:, i], until_ns[i])
            if tried == 0:
                length = whole[EXPECTED, i]
            if length > 0 and until_ns[i] >= 0 and tries(rows[:, i], arcs[:, i], whole[:, i], length):
                m[_TRIED, i], tried = 1.0, tried + 1
    return tried, length


def _end_one_by_one(m: Numbers, rows: Numbers, arcs: Numbers, results: Numbers, h: float) -> None:
    """Let bodies stand where a stride of h s led them, and keep the results of the others that have tried it."""
    for i in range(LANES):
        if m[_FREE, i] != 0.0:
            stand(rows[:, i], results[:, i], 0)
        elif m[_TRIED, i] != 0.0:
            keep_tried(rows[:, i], arcs[:, i], results[:, i], h)


def _mark_free(
    m: Numbers,
    s: Numbers,
    w: Numbers,
    e: Numbers,
    f: Numbers,
    effects: float,
    whole: Whole,
    commands: Numbers,
    until_ns: Whole,
    length: int,
    h: float,
) -> None:
    """Mark the bodies that get commands, for which a stride of h s is tried then, and whose wheels remain free."""
    told, whole_numbers = flat(commands), flat(whole)
    for i in range(LANES):
        o = lane(i)
        start, time, last = _whole(whole_numbers, START, o), _whole(whole_numbers, TIME, o), until_ns[o]
        before, fixed = _whole(whole_numbers, LAST, o), _whole(whole_numbers, LENGTH, o)
        begun, left = _whole(whole_numbers, BEGUN, o), _whole(whole_numbers, LEFT_BEHIND, o)
        free = (time - start == length) & (before == length) & (last - time == length) & (last >= 0) & (length > 0)
        free = free & (fixed == 0) & (begun != 0) & (left == 0) & (f[LEARNT, o] >= h)
        free = free & ((effects == 0.0) | ((effects == 1.0) & (e[0, o] == ATTRACTION)))
        commanded, omega = False, (s[4, o], s[5, o], s[6, o])
        for k in range(_WHEELS):
            w[_STATES + k, o] = w[_HIGH + k, o] + w[_LOW + k, o]
            commanded = commanded | (not math.isnan(told[lane(k * LANES) + o]))
            free = free & turns_freely(w[:, o], 0, k, speed_of(w[:, o], 0, _STATES, k, omega))
        m[_FREE, o] = 1.0 if free & commanded else 0.0
        m[_TRIED, o] = m[_FREE, o]


def _begin_free(m: Numbers, s: Numbers, w: Numbers, f: Numbers, whole: Whole, commands: Numbers, h: float) -> int:
    """Give commands to those bodies, as `begin` does; return how many they are."""
    told, free = flat(commands), 0
    for k in range(_WHEELS):
        for i in range(LANES):
            o = lane(i)
            value, speed = told[lane(k * LANES) + o], speed_of(w[:, o], 0, _STATES, k, (s[4, o], s[5, o], s[6, o]))
            if m[_FREE, o] != 0.0 and not math.isnan(value):
                command_freely(w[:, o], 0, k, value, speed)
    for i in range(LANES):
        o, below = lane(i), -math.inf
        goes, omega = m[_FREE, o] != 0.0, (s[4, o], s[5, o], s[6, o])
        for k in range(_WHEELS):
            below = max(below, excess(w[:, o], 0, _STATES, k, ZERO, omega))
        m[_BELOW, o] = min(below, 0.0)
        for k in range(5):
            f[BEGAN + k, o] = f[LEARNT + k, o] if goes else f[BEGAN + k, o]
        f[LEARNT, o], f[LEARNT + 4, o] = h if goes else f[LEARNT, o], 0.0 if goes else f[LEARNT + 4, o]
    for i in range(LANES):
        if m[_FREE, i] != 0.0:
            free += 1
            whole[START, i], whole[EXPECTED, i] = whole[TIME, i], whole[LAST, i]
            whole[SEARCHED, i] = whole[SWITCH, i] = -1
            whole[REACHED, i] = whole[STRIDES, i] = whole[STRIDE, i] = whole[ARRIVED, i] = 0
            whole[AT_GRID_POINT, i] = 1
    return free


def _whole(numbers: Whole, r: int, i: int) -> int:
    number: int = numbers[lane(r * LANES) + i]
    return number


def _compare(m: Numbers, s: Numbers, r: Numbers, other: Numbers, f: Numbers, h: float) -> None:
    """Write the discrepancies of the results."""
    for i in range(LANES):
        o = lane(i)
        goal, start, end = _goal(f, o), PhaseState(*phase_in(s, o)), PhaseState(*phase_in(r, o))
        second = PhaseState(*phase_in(other, o))
        found = discrepancy(goal, f[LEARNT + 1, o], start, end, second, h, 0.0)
        m[_APART, o], m[_APART + 1, o], m[_APART + 2, o] = found.sine, found.cosine, found.turned
        m[_APART + 3, o], m[_APART + 4, o], m[_APART + 5, o] = found.rounded, found.position, found.farthest
        allowed = goal.share * goal.accuracy * h / goal.horizon
        # A bound, as the angle is not above its tangent; negative errors count as 0.
        most = max(2.0 * found.sine / found.cosine + found.turned, found.position)
        small = (most * _SMALL <= allowed) & (goal.noise == 0.0)
        good = is_finite(end) & is_finite(second) & math.isfinite(most)
        m[_ALLOWED, o], m[_ERROR, o], m[_FOLLOWING, o] = allowed, 0.0 if small else math.inf, MOST_GROWTH * h
        m[_ACCEPTED, o] = 1.0 if good else 0.0


def _choose_following(m: Numbers, f: Numbers, h: float) -> None:
    """Choose the strides after those whose error is not so small that it does not matter."""
    for i in range(LANES):
        if m[_FREE, i] != 0.0 and m[_ERROR, i] != 0.0:
            goal, allowed = _goal(f, i), m[_ALLOWED, i]
            apart = Discrepancy(
                *(m[_APART, i], m[_APART + 1, i], m[_APART + 2, i]),
                *(m[_APART + 3, i], m[_APART + 4, i], m[_APART + 5, i]),
            )
            attitude, position, _, noise = errors_of(goal, 0.0, apart)
            error = max(attitude, position)
            m[_FOLLOWING, i] = following_step(goal, allowed, error, h)
            if not (error <= allowed and noise <= allowed):
                m[_ACCEPTED, i] = 0.0


def _accept(
    m: Numbers,
    c: Numbers,
    s: Numbers,
    r: Numbers,
    w: Numbers,
    e: Numbers,
    f: Numbers,
    acts: bool,
    h: float,
) -> None:
    """Accept the strides for which rounding, load and wheels allow it, and whose end is finite."""
    for i in range(LANES):
        o = lane(i)
        start, end = PhaseState(*phase_in(s, o)), PhaseState(*phase_in(r, o))
        moments, momentum, inverse = (c[1, o], c[2, o], c[3, o]), total(end, MOMENTUM), 1.0 / c[0, o]
        velocity, sight = scale(inverse, total(start, MOMENTUM)), math.inf
        if acts:
            here = Point(elapsed(start), total(start, POSITION), velocity, start.orientation, start.angular_velocity)
            sight = time_to_fall(_attraction(e, o), here)
        goal, omega = _goal(f, o), end.angular_velocity
        lost = rounding(goal, start, steady_length(h, m[_FOLLOWING, o], True))
        above, sums = -math.inf, dot(momentum, scale(inverse, momentum)) + dot(omega, times(moments, omega))
        for k in range(_M):
            w[_STATES + k, o] = w[_HIGH + k, o] + w[_LOW + k, o]
            sums += w[_STATES + k, o]
        for k in range(_WHEELS):
            above = max(above, excess(w[:, o], 0, _STATES, k, ZERO, omega))
        turning, attitudes = (start.angular_velocity, omega), (start.orientation, end.orientation)
        far = is_far(w[:, o], 0, max(m[_BELOW, o], above), h, turning, attitudes)
        good = (sight >= h) & (lost <= goal.accuracy) & (above <= 0.0) & far & math.isfinite(sums)
        m[_ACCEPTED, o] = m[_ACCEPTED, o] if good else 0.0


def _goal(f: Numbers, i: int) -> Goal:
    """Return the goal of a body under attraction, which slows nothing."""
    share, x, y, z = f[GOAL + 6, i], f[GOAL + 7, i], f[GOAL + 8, i], f[GOAL + 9, i]
    ends, order, errors = f[GOAL + 2, i] != 0.0, f[GOAL + 4, i], f[GOAL + 5, i]
    return Goal(f[GOAL, i], f[GOAL + 1, i], ends, f[GOAL + 3, i], order, errors, share, x, y, z, 0.0, f[GOAL + 11, i])


def _take_pairs(
    c: Numbers,
    s: Numbers,
    r: Numbers,
    other: Numbers,
    w: Numbers,
    e: Numbers,
    acts: bool,
    row: Numbers,
    h: float,
) -> None:
    """Take the pair of a step of h s: write the phase at the end, with its states, and the second result."""
    # Slopes and sums of them.
    k, t, d = flat(block(_SLOPES, LANES)), flat(block(_SUMS, LANES)), flat(block(_KEPT, LANES))
    for i in range(LANES):
        _keep_constants(d, c, s, lane(i), h)
    for stage in range(_STAGES):
        _add_up(k, t, row, h, stage, stage, 0)
        _move_states(w, t)
        ahead, to = _NODES[stage], lane(stage * _PER_SLOPE * LANES)
        for i in range(LANES):
            o = lane(i)
            f, place, time = _constants(d, c, s, o, h)
            moments = (c[1, o], c[2, o], c[3, o])
            load = _LaneLoad(w[:, o], time, place, moments, f.held, acts, _attraction(e, o))
            _write_slope(k, to + o, w, o, _slope(f, ahead, _turn_of(t, 0, o), _carried_of(t, 0, o), load))
    for result in range(_RESULTS):
        _add_up(k, t, row, h, MOST_STAGES + result, _STAGES, result * _PER_SUM)
    _add_books(k, t, row, h)
    _end_states(w, t)
    for i in range(LANES):
        o = lane(i)
        f, _, _ = _constants(d, c, s, o, h)
        _, _, high, low = phase_in(s, o)
        turns = _turn_of(t, 0, o), _turn_of(t, _PER_SUM, o), _turn_of(t, 2 * _PER_SUM, o)
        moves = _carried_of(t, 0, o), _carried_of(t, _PER_SUM, o), _carried_of(t, 2 * _PER_SUM, o)
        books = _vector_of(t, _RESULTS * _PER_SUM, o), _number_of(t, _RESULTS * _PER_SUM + 3, o)
        step, second = _compared(f, turns, moves, books, f)
        off = divide(_momentum_in(w[:, o], 0, _STATES), (c[1, o], c[2, o], c[3, o]))
        new_high, new_low = grown(high, low, second, h)
        write_phase_in(other, o, second.orientation, add_scaled(second.angular_velocity, 1.0, off), new_high, new_low)
        new_high, new_low = grown(high, low, step, h)
        write_phase_in(r, o, step.orientation, step.angular_velocity, new_high, new_low)


# Loops go over rows and bodies at once: the compiler would unroll one over bodies alone, and not vectorise it.
def _read(a: Numbers, to: int, count: int, source: Numbers, at: int) -> None:
    """Copy rows."""
    target, given, first, begin = flat(a), flat(source), lane(to * LANES), lane(at * LANES)
    for x in range(count * LANES):
        target[first + lane(x)] = given[begin + lane(x)]


def _move_states(w: Numbers, t: Numbers) -> None:
    """Write the states at a stage."""
    rows = flat(w)
    for x in range(_M * LANES):
        sums = rows[lane(_HIGH * LANES) + lane(x)] + rows[lane(_LOW * LANES) + lane(x)]
        rows[lane(_STATES * LANES) + lane(x)] = sums + t[lane(_MOVED * LANES) + lane(x)]


def _add_books(k: Numbers, t: Numbers, weights: Numbers, h: float) -> None:
    """Write h times the sums of twist and power, behind the other sums; see `booked`."""
    books = lane(_RESULTS * _PER_SUM * LANES)
    for x in range(4 * LANES):
        t[books + lane(x)] = 0.0
    for stage in range(_STAGES):
        weight = weights[ROWS + MOST_STAGES * MOST_STAGES + stage] * h
        if weight != 0.0:
            at = lane((stage * _PER_SLOPE + _PER_SUM) * LANES)
            for x in range(4 * LANES):
                t[books + lane(x)] = t[books + lane(x)] + weight * k[at + lane(x)]


def _end_states(w: Numbers, t: Numbers) -> None:
    """Write the errors of the states to where the states at a stage were, and add to their sums."""
    rows, fifth, third = flat(w), lane((_PER_SUM + _MOVED) * LANES), lane((2 * _PER_SUM + _MOVED) * LANES)
    high, low = lane(_HIGH * LANES), lane(_LOW * LANES)
    for x in range(_M * LANES):
        rows[lane(_STATES * LANES) + lane(x)] = difference(t[fifth + lane(x)], t[third + lane(x)])
    for x in range(_M * LANES):
        a, b = rows[high + lane(x)], rows[low + lane(x)]
        rows[high + lane(x)], rows[low + lane(x)] = two_sum(a, t[lane(_MOVED * LANES) + lane(x)], b)


def _attraction(e: Numbers, i: int) -> Attraction:
    return Attraction(e[1, i], (e[2, i], e[3, i], e[4, i]), e[5, i], (e[6, i], e[7, i], e[8, i]), e[9, i])


def _keep_constants(d: Numbers, c: Numbers, s: Numbers, i: int, h: float) -> None:
    """Write what every stage of the step of a body would compute anew."""
    inertia, held = constants_in(c, i)
    q, omega, high, low = phase_in(s, i)
    velocity = scale(1.0 / inertia.mass, (high[3] + low[3], high[4] + low[4], high[5] + low[5]))
    f = step_constants(inertia, held, h, velocity, q, omega)
    _write_vector(d, i, 0, f.differences)
    _write_vector(d, i, 3, f.inverse)
    _write_vector(d, i, 6, f.velocity)
    _write_vector(d, i, 9, f.force_0)
    _write_vector(d, i, 12, f.torque_0)
    _write_vector(d, i, 15, (high[0] + low[0], high[1] + low[1], high[2] + low[2]))
    d[i + lane(18 * LANES)], d[i + lane(19 * LANES)] = f.inverse_mass, high[13] + low[13]


def _constants(d: Numbers, c: Numbers, s: Numbers, i: int, h: float) -> tuple[StepConstants, Vector, float]:
    """Return the constants of the step of a body, its place and its time at the start."""
    _, held = constants_in(c, i)
    q, omega, _, _ = phase_in(s, i)
    differences, inverse, velocity = _vector_of(d, 0, i), _vector_of(d, 3, i), _vector_of(d, 6, i)
    force, torque, mass = _vector_of(d, 9, i), _vector_of(d, 12, i), _number_of(d, 18, i)
    f = StepConstants(differences, inverse, mass, held, h, velocity, q, omega, force, torque)
    return f, _vector_of(d, 15, i), _number_of(d, 19, i)


def _add_up(k: Numbers, t: Numbers, weights: Numbers, h: float, row: int, stages: int, to: int) -> None:
    """Write h times the sums of the slopes at the first stages, with the weights of a row, from `to` on."""
    begin, turns = lane(to * LANES), lane((to + _TURN) * LANES)
    # Other sums than `total` begin with 0: -0 becomes 0.
    for x in range(_TURN * LANES):
        t[begin + lane(x)] = -0.0
    for x in range((_PER_SUM - _TURN) * LANES):
        t[turns + lane(x)] = 0.0
    count, which = 0, workspace(MOST_STAGES)
    for stage in range(stages):
        if weights[ROWS + row * MOST_STAGES + stage] != 0.0:
            which[count], count = stage, count + 1
    # Two at once, as what takes time is reading and writing; the last are multiplied by h.
    for k_th in range(0, count, 2):
        one, two, factor = int(which[k_th]), int(which[min(k_th + 1, count - 1)]), h if k_th + 2 >= count else 1.0
        a, first = lane(one * _PER_SLOPE * LANES), weights[ROWS + row * MOST_STAGES + one]
        b, second = lane(two * _PER_SLOPE * LANES), weights[ROWS + row * MOST_STAGES + two]
        if one == two:
            for x in range(_PER_SUM * LANES):
                t[begin + lane(x)] = factor * (t[begin + lane(x)] + first * k[a + lane(x)])
        else:
            for x in range(_PER_SUM * LANES):
                t[begin + lane(x)] = factor * (t[begin + lane(x)] + first * k[a + lane(x)] + second * k[b + lane(x)])


def _number_of(t: Numbers, r: int, i: int) -> float:
    number: float = t[lane(r * LANES) + i]
    return number


def _vector_of(t: Numbers, r: int, i: int) -> Vector:
    return _number_of(t, r, i), _number_of(t, r + 1, i), _number_of(t, r + 2, i)


def _turn_of(t: Numbers, r: int, i: int) -> Turn:
    x, y, z = _vector_of(t, r, i)
    return (x, y, z, _number_of(t, r + 3, i)), _vector_of(t, r + 4, i)


def _carried_of(t: Numbers, r: int, i: int) -> Carried:
    return _vector_of(t, r + 7, i), _vector_of(t, r + 10, i)


def _write_slope(k: Numbers, at: int, w: Numbers, i: int, found: Slope) -> None:
    (a, b, c, d), turn = found.turn
    _write_vector(k, at, 0, (a, b, c))
    k[at + lane(3 * LANES)] = d
    _write_vector(k, at, 4, turn)
    _write_vector(k, at, 7, found.push)
    _write_vector(k, at, 10, found.gain)
    for r in range(_M):
        k[at + lane((_MOVED + r) * LANES)] = w[_RATES + r, i]
    _write_vector(k, at, _PER_SUM, found.twist)
    k[at + lane((_PER_SUM + 3) * LANES)] = found.power


def _write_vector(k: Numbers, at: int, r: int, a: Vector) -> None:
    k[at + lane(r * LANES)], k[at + lane((r + 1) * LANES)], k[at + lane((r + 2) * LANES)] = a


# Of a method and a number of wheels, see `strides_beside`.
_NODES = (0.0,)
_STAGES = _M = _COLUMN = _HIGH = _LOW = _STATES = _RATES = _PER_SLOPE = _PER_SUM = _SLOPES = _SUMS = 0


def _inner_torque(*_: Any) -> Vector:
    """Placeholder for `inner_torque` of a constant number of wheels."""
    raise NotImplementedError


def _momentum_in(*_: Any) -> Vector:
    """Placeholder likewise."""
    raise NotImplementedError


def _slope(*_: Any) -> Slope:
    """Placeholder for `slope` under the load of these wheels."""
    raise NotImplementedError


def _compared(*_: Any) -> tuple[Increment, Increment]:
    """Placeholder for the results of the pair of a method."""
    raise NotImplementedError


def _count(c: Numbers, i: int) -> int:  # noqa: ARG001
    return _WHEELS


_WHEELS = 0

# Errors that are smaller than the accuracy allows by this factor let the following stride be five times as long, see
# `following_step`; with room for rounding.
_SMALL = math.inf


def _is_never_held(c: Numbers, i: int) -> bool:  # noqa: ARG001
    return False


@cache
def strides_beside(method: Method, wheels: int) -> OnDemand | None:
    """Return the kernel for bodies with so many wheels; None if there is none."""
    tableau = method.tableau
    if tableau is None or wheels not in COUNTS:
        return None
    m, high = wheels + BOOKS, BEFORE + EACH * wheels
    sizes = {
        "_WHEELS": wheels,
        "_SMALL": 1.01 * (5.0 / 0.9) ** ((method.order or 0) - 1),
        "_STAGES": len(tableau.rows),
        "_NODES": tableau.nodes,
        "_M": m,
        "_HIGH": high,
        "_LOW": high + m,
        "_STATES": high + 2 * m,
        "_RATES": high + 3 * m,
        "_COLUMN": high + 4 * m,
        "_PER_SLOPE": _MOVED + m + 4,
        "_PER_SUM": _MOVED + m,
        "_SLOPES": len(tableau.rows) * (_MOVED + m + 4),
        "_SUMS": _RESULTS * (_MOVED + m) + 4,
    }

    def made(function: Callable[..., Any], **names: object) -> Callable[..., Any]:
        return specialise(function, f"{function.__name__}_of_{wheels}_by_{method.name}", **sizes, **names)

    count = made(_count)
    names = {"count_of": count, "is_held": _is_never_held}
    inner = made(inner_torque, count_of=count, spin_up_of=made(spin_up_of, count_of=count))
    pairs = made(
        _take_pairs,
        _slope=made(slope, evaluated=made(_evaluated, _inner_torque=inner)),
        _compared=tableau.compared,
        _momentum_in=made(momentum_in, count_of=count),
        **{part.__name__: made(part) for part in (_move_states, _add_books, _end_states, _add_up, _write_slope)},
    )
    parts = (_mark_free, _begin_free, _compare)
    found = made(
        strides_on_numbers,
        _take_pairs=pairs,
        _accept=made(_accept, is_far=made(is_far, **names)),
        **{part.__name__: made(part) for part in parts},
    )
    return OnDemand(method.name, found, BESIDE, steps=2.0 * LANES)
