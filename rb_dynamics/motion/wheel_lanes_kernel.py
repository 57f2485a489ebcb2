"""An embedded pair for several bodies with reaction wheels, side by side: the compiler vectorises over them.

The bits are those of `stateful_kernel.py`, body by body: the same functions are called, stage by stage, with the
numbers of the bodies in columns on the stack. For bodies with as many wheels, under central gravity or no effect.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

from rb_dynamics.loads.central_gravity import Attraction, attracted
from rb_dynamics.loads.compiled_load import WIDTH
from rb_dynamics.loads.effect import Point
from rb_dynamics.loads.wheel_numbers import BEFORE, BOOKS, EACH, inner_torque, momentum_in, spin_up_of
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.explicit_runge_kutta import Carried, Slope, StepConstants, Turn, slope, step_constants
from rb_dynamics.motion.fixed_step_kernel import OnDemand
from rb_dynamics.motion.inner_states import difference
from rb_dynamics.motion.kernel_layout import CONSTANTS, PHASE, constants_in, phase_in, write_phase_in
from rb_dynamics.motion.method import Increment, Method
from rb_dynamics.motion.phase_state import grown, two_sum
from rb_dynamics.motion.stateful_kernel import MOST_STAGES, ROWS, WHEELS
from rb_dynamics.numerics.compilation import block, flat, lane, specialise
from rb_dynamics.numerics.rotation import Quaternion, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, divide, scale

if TYPE_CHECKING:
    from rb_dynamics.numerics.array_types import Numbers

LANES = 8
"""Bodies side by side: those of one vector register."""

COUNTS = (3, 4)
"""How many wheels there are kernels for."""

# Numbers of the effect; and where in a slope push and gain begin, behind the turn, then the rates of the states; twist
# and power follow them.
_EFFECT, _TURN, _MOVED = 10, 7, 13
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


def pairs_on_numbers(rows: Numbers, row: Numbers, results: Numbers, h: float) -> None:
    """Take the pair of a step of h s for the bodies of a group.

    Args:
        rows: (..., `LANES`), of each body the numbers of `stateful_kernel.py`.
        row: the weights, as in the numbers of a body.
        results: (..., `LANES`), for the phase at the end with its states, then the second result.
        h: length of the step, s.
    """
    # Body and wrench, phase, second result, wheels with their states, and the effect.
    c, s, other = block(CONSTANTS, LANES), block(PHASE, LANES), block(PHASE, LANES)
    w, e = block(_COLUMN, LANES), block(_EFFECT, LANES)
    # Slopes and sums of them.
    k, t = flat(block(_SLOPES, LANES)), flat(block(_SUMS, LANES))
    _read(c, 0, CONSTANTS, rows, 0)
    _read(s, 0, PHASE, rows, CONSTANTS)
    _read(w, 0, _HIGH + 2 * _M, rows, WHEELS)
    _read(e, 0, _EFFECT, rows, len(rows) - 1 - WIDTH)
    acts = rows[len(rows) - 1, 0] != 0.0
    for stage in range(_STAGES):
        _add_up(k, t, row, h, stage, stage, 0)
        _move_states(w, t)
        ahead, to = _NODES[stage], lane(stage * _PER_SLOPE * LANES)
        for i in range(LANES):
            o = lane(i)
            f, place, time = _constants(c, s, o, h)
            moments = (c[1, o], c[2, o], c[3, o])
            load = _LaneLoad(w[:, o], time, place, moments, f.held, acts, _attraction(e, o))
            _write_slope(k, to + o, w, o, _slope(f, ahead, _turn_of(t, 0, o), _carried_of(t, 0, o), load))
    for result in range(_RESULTS):
        _add_up(k, t, row, h, MOST_STAGES + result, _STAGES, result * _PER_SUM)
    _add_books(k, t, row, h)
    _end_states(w, t)
    for i in range(LANES):
        o = lane(i)
        f, _, _ = _constants(c, s, o, h)
        _, _, high, low = phase_in(s, o)
        turns = _turn_of(t, 0, o), _turn_of(t, _PER_SUM, o), _turn_of(t, 2 * _PER_SUM, o)
        moves = _carried_of(t, 0, o), _carried_of(t, _PER_SUM, o), _carried_of(t, 2 * _PER_SUM, o)
        books = _vector_of(t, _RESULTS * _PER_SUM, o), _number_of(t, _RESULTS * _PER_SUM + 3, o)
        step, second = _compared(f, turns, moves, books, f)
        off = divide(_momentum_in(w[:, o], 0, _STATES), (c[1, o], c[2, o], c[3, o]))
        new_high, new_low = grown(high, low, second, h)
        write_phase_in(other, o, second.orientation, add_scaled(second.angular_velocity, 1.0, off), new_high, new_low)
        new_high, new_low = grown(high, low, step, h)
        write_phase_in(s, o, step.orientation, step.angular_velocity, new_high, new_low)
    _read(results, 0, PHASE, s, 0)
    _read(results, PHASE, 2 * _M, w, _HIGH)
    _read(results, PHASE + 2 * _M, PHASE, other, 0)


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


def _constants(c: Numbers, s: Numbers, i: int, h: float) -> tuple[StepConstants, Vector, float]:
    """Return the constants of the step of a body, its place and its time at the start."""
    inertia, held = constants_in(c, i)
    q, omega, high, low = phase_in(s, i)
    velocity = scale(1.0 / inertia.mass, (high[3] + low[3], high[4] + low[4], high[5] + low[5]))
    place = (high[0] + low[0], high[1] + low[1], high[2] + low[2])
    return step_constants(inertia, held, h, velocity, q, omega), place, high[13] + low[13]


def _add_up(k: Numbers, t: Numbers, weights: Numbers, h: float, row: int, stages: int, to: int) -> None:
    """Write h times the sums of the slopes at the first stages, with the weights of a row, from `to` on."""
    begin, turns = lane(to * LANES), lane((to + _TURN) * LANES)
    if stages == 0:
        for x in range(_PER_SUM * LANES):
            t[begin + lane(x)] = 0.0
        return
    first = weights[ROWS + row * MOST_STAGES]
    for x in range(_PER_SUM * LANES):
        t[begin + lane(x)] = first * k[lane(x)]
    # Other sums than `total` begin with 0: -0 becomes 0.
    for x in range((_PER_SUM - _TURN) * LANES):
        t[turns + lane(x)] = 0.0 + t[turns + lane(x)]
    for stage in range(1, stages):
        weight, at = weights[ROWS + row * MOST_STAGES + stage], lane(stage * _PER_SLOPE * LANES)
        if weight != 0.0:
            for x in range(_PER_SUM * LANES):
                t[begin + lane(x)] = t[begin + lane(x)] + weight * k[at + lane(x)]
    for x in range(_PER_SUM * LANES):
        t[begin + lane(x)] = h * t[begin + lane(x)]


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


# Of a method and a number of wheels, see `pairs_of`.
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


@cache
def pairs_of(method: Method, wheels: int) -> OnDemand | None:
    """Return the kernel for bodies with so many wheels; None if there is none."""
    tableau = method.tableau
    if tableau is None or wheels not in COUNTS:
        return None
    m, high = wheels + BOOKS, BEFORE + EACH * wheels
    sizes = {
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

    count = made(_count, _WHEELS=wheels)
    inner = made(inner_torque, count_of=count, spin_up_of=made(spin_up_of, count_of=count))
    parts = (_move_states, _add_books, _end_states, _add_up, _write_slope)
    found = made(
        pairs_on_numbers,
        _slope=made(slope, evaluated=made(_evaluated, _inner_torque=inner)),
        _compared=tableau.compared,
        _momentum_in=made(momentum_in, count_of=count),
        **{part.__name__: made(part) for part in parts},
    )
    return OnDemand(method.name, found, SIGNATURE, steps=2.0 * LANES)


SIGNATURE = "void(float64[:, ::1], float64[::1], float64[:, ::1], float64)"
