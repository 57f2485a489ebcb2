"""The Taylor method: the motion under a held wrench as power series in time, by recurrences on its equations.

One expansion serves every time within a step (dense output), and its last terms limit the length of the step.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.method import DenseStep, Increment, Inertia, Load, Method
from rb_dynamics.motion.result_cache import cached_results
from rb_dynamics.motion.step_checks import NO_INCREMENT, require_finite
from rb_dynamics.numerics.compilation import compiled_as, workspace
from rb_dynamics.numerics.rotation import Quaternion, multiply, normalize, renormalize, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, dot, norm, positive_zeros, scale

# Work per time is proportional to order^2 / step; it is flat from 12 to 20 for errors of 1e-11 to 1e-15, and short
# steps between commands favour a low order.
_ORDER = 12
_TERMS = _ORDER + 1

# A lower order gains nothing.
_LOWEST_ORDER = 6

# Largest ratio of the last term to the first, per order: beyond it a step has no correct digit.
_LARGEST_RATIO = 0.85

_Series = list[float]
_EPSILON = 2.0**-52


class _Start(NamedTuple):
    """Start of an expansion, in units of time in which the rates are about 1.

    Attributes:
        moments: kg m^2.
        force: body-fixed.
        torque: body-fixed.
        torque_world: fixed in the world, in the axes of the body at t = 0.
        omega: angular velocity, body axes.
    """

    moments: Vector
    force: Vector
    torque: Vector
    torque_world: Vector
    omega: Vector


class _Expansion(NamedTuple):
    """Coefficients of t^0, t^1, ...

    The memory belongs to the caller and does not affect the result, so all expansions are equal as cache keys.

    Attributes:
        turn: quaternion of the rotation since t = 0.
        omega: angular velocity, body axes.
        force: the body-fixed force, in the axes at t = 0; zero if there is none.
        torque: the body-fixed torque, likewise.
        power: of the torques.
    """

    turn: tuple[_Series, _Series, _Series, _Series]
    omega: tuple[_Series, _Series, _Series]
    force: tuple[_Series, _Series, _Series]
    torque: tuple[_Series, _Series, _Series]
    power: _Series

    def __eq__(self, _: object) -> bool:
        return True

    def __hash__(self) -> int:
        return 0


def step(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,
) -> Increment:
    """Advance by the Taylor series (Jorba & Zou, Exp. Math. 14 (2005) 99; Hairer, Norsett & Wanner I, section I.8).

    With R = R0 r: r' = r w / 2, I w' = I w x w + tau_body + R^T tau_world, force and torque by the integral of R. Order
    12; a short step leaves out terms below rounding. Has no invariants beyond its accuracy.

    Raises:
        ConvergenceError: the last terms of the series are not small: the step is too long; or a load changes inside the
            step, for which there are no recurrences.
    """
    if load is not None:
        return _no_recurrences()
    rate = _rate(inertia, held, angular_velocity)
    unit, order = _clock(rate), _order(rate * abs(h))
    # Allocated here and in `longest_step`, because a kernel frees it at the end of the function.
    memory = _Expansion(
        (workspace(_TERMS), workspace(_TERMS), workspace(_TERMS), workspace(_TERMS)),
        (workspace(_TERMS), workspace(_TERMS), workspace(_TERMS)),
        (workspace(_TERMS), workspace(_TERMS), workspace(_TERMS)),
        (workspace(_TERMS), workspace(_TERMS), workspace(_TERMS)),
        workspace(_TERMS),
    )
    start = _start(inertia, held, orientation, angular_velocity, unit)
    series = _expand(memory, start, order)
    return _reached(inertia, held, h, velocity, orientation, angular_velocity, series, unit, order)


def step_from_memory(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    memory: Any,
) -> Increment:
    """Return the result of `step`, to the same bits, by the expansion that `memory` holds if it is from the same start.

    Otherwise expand to the full order there: a coefficient does not depend on the order.
    """
    rate = _rate(inertia, held, angular_velocity)
    unit, order = _clock(rate), _order(rate * abs(h))
    start = _start(inertia, held, orientation, angular_velocity, unit)
    m, n = memory, _TERMS
    series = _Expansion(
        (m[:n], m[n : 2 * n], m[2 * n : 3 * n], m[3 * n : 4 * n]),
        (m[4 * n : 5 * n], m[5 * n : 6 * n], m[6 * n : 7 * n]),
        (m[7 * n : 8 * n], m[8 * n : 9 * n], m[9 * n : 10 * n]),
        (m[10 * n : 11 * n], m[11 * n : 12 * n], m[12 * n : 13 * n]),
        m[13 * n : 14 * n],
    )
    # Last the start, by which an expansion is known.
    known, size, key = True, 14 * n, (*start.moments, *start.force, *start.torque, *start.torque_world, *start.omega)
    for k in range(15):
        known = known and m[size + k] == key[k]
        m[size + k] = key[k]
    if not known:
        for k in range(size):
            m[k] = 0.0
        _write(series, start, _ORDER)
    return _reached(inertia, held, h, velocity, orientation, angular_velocity, series, unit, order)


def _reached(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    series: _Expansion,
    unit: float,
    order: int,
) -> Increment:
    """Return the increment after h s by the terms up to `order`."""
    t = h * unit
    # The full order allows a longer step.
    if order == _ORDER:
        last = (0.5 * _size(series, _ORDER, 0.0)) ** (1.0 / _ORDER)
        if not last * abs(t) < _LARGEST_RATIO:
            return _beyond_reach(h, last * unit, angular_velocity)
    x, y, z, w = series.turn
    a, b, c = series.omega
    impulse, moment = scale(h, held.force_world), scale(0.5 * h * h, held.force_world)
    if held.force_body != ZERO:
        once, twice = _integrals(series.force, t, order)
        impulse = add_scaled(impulse, unit, rotate(orientation, once))
        moment = add(moment, rotate(orientation, twice))
    torque_impulse = scale(h, held.torque_world)
    if held.torque_body != ZERO:
        once, _ = _integrals(series.torque, t, order)
        torque_impulse = add_scaled(torque_impulse, unit, rotate(orientation, once))
    # The work of the force is its impulse times the mean velocity, whatever the force.
    work = dot(impulse, add_scaled(velocity, 0.5 / inertia.mass, impulse))
    turn = normalize((_value(x, t, order), _value(y, t, order), _value(z, t, order), _value(w, t, order)))
    end = Increment(
        add_scaled(scale(h, velocity), 1.0 / inertia.mass, moment),
        renormalize(multiply(orientation, turn)),
        scale(unit, (_value(a, t, order), _value(b, t, order), _value(c, t, order))),
        impulse,
        torque_impulse,
        work + unit * unit * _integral(series.power, t, order),
    )
    return require_finite("taylor", h, end)


@compiled_as(NO_INCREMENT)
def _no_recurrences() -> Increment:
    raise ConvergenceError(
        "taylor: a load that changes inside the step acts, expected a held wrench alone; use midpoint6 or rk4, or "
        "strang6 if the load does not depend on the velocities"
    )


@compiled_as(NO_INCREMENT)
def _beyond_reach(h: float, last: float, angular_velocity: Vector) -> Increment:
    raise ConvergenceError(
        f"taylor: a step of {h:g} s is beyond the reach of the series at {norm(angular_velocity):.3g} rad/s; use a "
        f"step below {0.5 / last if last > 0.0 else 0.0:.3g} s, or accuracy instead of step"
    )


def longest_step(
    inertia: Inertia,
    held: HeldWrench,
    _velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    accuracy: float,
    horizon: float,
) -> float:
    """Return the longest step (s) that adds at most accuracy * step / horizon to the error at the end.

    That is the error of the attitude, plus that of the position relative to the distance travelled. The last two terms
    of attitude, rate and velocity give the first one left out; an error of the rate grows for the whole horizon.
    Rounding is not a reason for shorter steps.
    """
    unit = _clock(_rate(inertia, held, angular_velocity))
    memory = _Expansion(
        (workspace(_TERMS), workspace(_TERMS), workspace(_TERMS), workspace(_TERMS)),
        (workspace(_TERMS), workspace(_TERMS), workspace(_TERMS)),
        (workspace(_TERMS), workspace(_TERMS), workspace(_TERMS)),
        (workspace(_TERMS), workspace(_TERMS), workspace(_TERMS)),
        workspace(_TERMS),
    )
    series = _expand(memory, _start(inertia, held, orientation, angular_velocity, unit), _ORDER)
    horizon = horizon * unit
    first, last_but_one = _size(series, 0, horizon), _size(series, _ORDER - 1, horizon)
    last = _size(series, _ORDER, horizon)
    if last_but_one == last == 0.0:
        return math.inf
    if not math.isfinite(first + last_but_one + last):
        return 0.0
    # Estimate the radius of convergence from the last terms (Jorba & Zou, eq. 11), and from it the first term left out.
    radius = math.inf
    if last_but_one > 0.0:
        radius = math.pow(first / last_but_one, 1.0 / (_ORDER - 1))
    if last > 0.0:
        radius = min(radius, math.pow(first / last, 1.0 / _ORDER))
    first_left_out = max(last_but_one / radius / radius, last / radius)
    if first_left_out == 0.0:
        return 0.5 * radius / unit
    floor = _EPSILON * (1.0 + norm(angular_velocity) / unit * horizon)
    by_accuracy = math.pow(accuracy / horizon / first_left_out, 1.0 / _ORDER)
    by_rounding = math.pow(floor / first_left_out, 1.0 / (_ORDER + 1))
    return min(0.5 * radius, 0.9 * max(by_accuracy, by_rounding)) / unit


def _rate(inertia: Inertia, held: HeldWrench, angular_velocity: Vector) -> float:
    """Return a rate (1/s) such that no coefficient k of the series is much larger than rate^k."""
    i1, i2, i3 = inertia.moments
    torque = norm(held.torque_body) + norm(held.torque_world)
    return max(norm(angular_velocity), math.sqrt(torque / min(i1, i2, i3)))


def _clock(rate: float) -> float:
    """Return a power of two near `rate`: in its units the powers of the rate stay within range."""
    return math.ldexp(1.0, min(max(math.frexp(rate)[1], -480), 480)) if 0.0 < rate < math.inf else 1.0


def _order(turn: float) -> int:
    """Return the order beyond which all terms together are below rounding, at most the full one.

    `turn` is rate * step. No term is larger than that of W' = W^2 / sqrt(3) + Y, Y' = Y W, from W = Y = 1, whose radius
    of convergence is 1. Orders are even, as from rest every other term is zero.
    """
    order, square = _LOWEST_ORDER, turn * turn
    term = square * square * square
    while order < _ORDER and not term <= 0.5 * _EPSILON:
        order, term = order + 2, term * square
    return order


def _start(
    inertia: Inertia, held: HeldWrench, orientation: Quaternion, angular_velocity: Vector, unit: float
) -> _Start:
    s = 1.0 / unit
    return _Start(
        inertia.moments,
        positive_zeros(scale(s * s, held.force_body)),
        positive_zeros(scale(s * s, held.torque_body)),
        positive_zeros(rotate_inverse(orientation, scale(s * s, held.torque_world))),
        positive_zeros(scale(s, angular_velocity)),
    )


# Cached, because an arc uses one expansion many times: to choose the step, to take it, and for each output within.
@cached_results(4)
def _expand(memory: _Expansion, start: _Start, order: int) -> _Expansion:
    return _write(memory, start, order)


def _write(memory: _Expansion, start: _Start, order: int) -> _Expansion:
    """Write the coefficients up to `order` into `memory`, all zeros before, and return it."""
    i1, i2, i3 = start.moments
    (f1, f2, f3), (t1, t2, t3), (u1, u2, u3) = start.force, start.torque, start.torque_world
    has_world = start.torque_world != ZERO
    has_axes = has_world or start.force != ZERO or start.torque != ZERO
    (x, y, z, w), (p, q, r), power = memory.turn, memory.omega, memory.power
    (force_1, force_2, force_3), (torque_1, torque_2, torque_3) = memory.force, memory.torque
    v1, v2, v3 = workspace(_TERMS), workspace(_TERMS), workspace(_TERMS)
    w[0] = 1.0
    p[0], q[0], r[0] = start.omega
    for k in range(order + 1):
        if has_axes:
            xx = yy = zz = xy = yz = zx = wx = wy = wz = 0.0
            for j in range(k + 1):
                a, b, c, d = x[j], y[j], z[j], w[j]
                e, f, g = x[k - j], y[k - j], z[k - j]
                xx, yy, zz = xx + a * e, yy + b * f, zz + c * g
                xy, yz, zx = xy + a * f, yz + b * g, zx + c * e
                wx, wy, wz = wx + d * e, wy + d * f, wz + d * g
            # The rotation matrix: the identity for the constant term, and twice the products of the quaternion.
            one = 1.0 if k == 0 else 0.0
            m11, m12, m13 = one - 2.0 * (yy + zz), 2.0 * (xy - wz), 2.0 * (zx + wy)
            m21, m22, m23 = 2.0 * (xy + wz), one - 2.0 * (zz + xx), 2.0 * (yz - wx)
            m31, m32, m33 = 2.0 * (zx - wy), 2.0 * (yz + wx), one - 2.0 * (xx + yy)
            force_1[k] = m11 * f1 + m12 * f2 + m13 * f3
            force_2[k] = m21 * f1 + m22 * f2 + m23 * f3
            force_3[k] = m31 * f1 + m32 * f2 + m33 * f3
            torque_1[k] = m11 * t1 + m12 * t2 + m13 * t3
            torque_2[k] = m21 * t1 + m22 * t2 + m23 * t3
            torque_3[k] = m31 * t1 + m32 * t2 + m33 * t3
            v1[k] = m11 * u1 + m21 * u2 + m31 * u3
            v2[k] = m12 * u1 + m22 * u2 + m32 * u3
            v3[k] = m13 * u1 + m23 * u2 + m33 * u3
        done = t1 * p[k] + t2 * q[k] + t3 * r[k]
        if has_world:
            for j in range(k + 1):
                done += v1[j] * p[k - j] + v2[j] * q[k - j] + v3[j] * r[k - j]
        power[k] = done
        if k == order:
            break
        q1 = q2 = q3 = q4 = e1 = e2 = e3 = 0.0
        for j in range(k + 1):
            a, b, c, d = x[j], y[j], z[j], w[j]
            e, f, g = p[k - j], q[k - j], r[k - j]
            q1 += d * e + b * g - c * f
            q2 += d * f + c * e - a * g
            q3 += d * g + a * f - b * e
            q4 += a * e + b * f + c * g
            e1 += q[j] * g
            e2 += r[j] * e
            e3 += p[j] * f
        e1, e2, e3 = (i2 - i3) * e1 + v1[k], (i3 - i1) * e2 + v2[k], (i1 - i2) * e3 + v3[k]
        if k == 0:
            e1, e2, e3 = e1 + t1, e2 + t2, e3 + t3
        n = 1.0 / (k + 1)
        p[k + 1], q[k + 1], r[k + 1] = n * e1 / i1, n * e2 / i2, n * e3 / i3
        n *= 0.5
        x[k + 1], y[k + 1], z[k + 1], w[k + 1] = n * q1, n * q2, n * q3, -n * q4
    return memory


def _value(series: _Series, t: float, order: int) -> float:
    total = 0.0
    for k in range(order, -1, -1):
        total = total * t + series[k]
    return total


def _integral(series: _Series, t: float, order: int) -> float:
    total = 0.0
    for k in range(order, -1, -1):
        total = total * t + series[k] / (k + 1)
    return total * t


def _integrals(series: tuple[_Series, _Series, _Series], t: float, order: int) -> tuple[Vector, Vector]:
    """Return the integral of a vector, and the integral of that integral."""
    a, b, c = series
    a1 = b1 = c1 = a2 = b2 = c2 = 0.0
    for k in range(order, -1, -1):
        m = 1.0 / (k + 1)
        n = m / (k + 2)
        a1, b1, c1 = a1 * t + m * a[k], b1 * t + m * b[k], c1 * t + m * c[k]
        a2, b2, c2 = a2 * t + n * a[k], b2 * t + n * b[k], c2 * t + n * c[k]
    return scale(t, (a1, b1, c1)), scale(t * t, (a2, b2, c2))


def _size(series: _Expansion, k: int, horizon: float) -> float:
    """Return the contribution of coefficient k to attitude and position at the end.

    The velocity is compared with what the body-fixed force gives in a unit of time: once the body has turned away, it
    is on average at least as fast. An error of the velocity counts half, as it lasts for half of the run on average.
    """
    (x, y, z, w), (p, q, r), (a, b, c) = series.turn, series.omega, series.force
    size = 2.0 * norm((norm((x[k], y[k], z[k])), w[k], 0.0)) + horizon * norm((p[k], q[k], r[k]))
    force = norm((a[0], b[0], c[0]))
    if k > 0 and force > 0.0:
        size += 0.5 * norm((a[k - 1], b[k - 1], c[k - 1])) / force / k
    return size


TAYLOR = Method(
    "taylor",
    order=_ORDER,
    invariants=frozenset({"unit_quaternion"}),
    step=step,
    longest_step=longest_step,
    compiles=True,
    dense=DenseStep(step_from_memory, 14 * _TERMS + 15),
)
