"""The Taylor method: the motion under a held wrench as power series in time, by recurrences on its equations.

One expansion serves every time of a step (dense output), and its last terms tell how long the step may be.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.method import Increment, Inertia, Load, Method
from rb_dynamics.rotation import Quaternion, normalize, rotate, rotate_inverse
from rb_dynamics.rotation import multiply as compose
from rb_dynamics.vector import ZERO, Vector, add_scaled, norm, positive_zeros, scale

# Work for a given time goes with order^2 / step; it is flat from 12 to 20 for errors of 1e-11 to 1e-15, and short steps
# between commands want it low.
_ORDER = 12

# The last term against the first, per order: beyond it a step has no correct digit.
_LARGEST_RATIO = 0.85

_Series = list[float]
_EPSILON = 2.0**-52


class _Expansion(NamedTuple):
    """Coefficients of t^0, t^1, ...; vectors in the axes of the body at t = 0 unless they are in body axes.

    Attributes:
        turn: quaternion of the rotation since t = 0.
        omega: angular velocity, body axes.
        force: the body-fixed force; empty where there is none.
        torque: the body-fixed torque; empty where there is none.
        power: of everything that acts.
    """

    turn: tuple[_Series, _Series, _Series, _Series]
    omega: tuple[_Series, _Series, _Series]
    force: tuple[_Series, ...]
    torque: tuple[_Series, ...]
    power: _Series


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

    With R = R0 r: r' = r w / 2, I w' = I w x w + tau_body + y, y' = y x w with y = R^T tau_world, and the body-fixed
    force and torque as r f r*. Order 12; keeps no invariant but what its accuracy keeps.

    Raises:
        ConvergenceError: the last terms of the series are not small: the step is beyond its reach; or a load that
            changes inside the step acts, for which there are no recurrences.
    """
    if load is not None:
        raise ConvergenceError(
            "taylor: a load that changes inside the step acts, expected a held wrench alone; use midpoint6 or rk4, or "
            "strang6 if the load does not depend on the velocities"
        )
    unit = _clock(inertia, held, angular_velocity)
    held, h, velocity = _slowed(held, unit), h * unit, scale(1.0 / unit, velocity)
    series = _series(inertia, held, velocity, orientation, scale(1.0 / unit, angular_velocity))
    last = _size(series.turn, _ORDER) ** (1.0 / _ORDER)
    if not last * abs(h) < _LARGEST_RATIO:
        raise ConvergenceError(
            f"taylor: a step of {h / unit:g} s is beyond the reach of the series at {norm(angular_velocity):.3g} rad/s"
            f"; use a step below {0.5 / last / unit if last > 0.0 else 0.0:.3g} s, or accuracy instead of step"
        )
    x, y, z, w = (_value(c, h) for c in series.turn)
    omega = (_value(series.omega[0], h), _value(series.omega[1], h), _value(series.omega[2], h))
    force_impulse, force_moment, torque_impulse = ZERO, ZERO, ZERO
    if series.force:
        force_impulse = rotate(orientation, _vector(series.force, h, _integral))
        force_moment = rotate(orientation, _vector(series.force, h, _second_integral))
    if series.torque:
        torque_impulse = rotate(orientation, _vector(series.torque, h, _integral))
    uniform = add_scaled(scale(h, velocity), 0.5 * h * h / inertia.mass, held.force_world)
    return Increment(
        add_scaled(uniform, 1.0 / inertia.mass, force_moment),
        normalize(compose(orientation, normalize((x, y, z, w)))),
        scale(unit, omega),
        scale(unit, add_scaled(force_impulse, h, held.force_world)),
        scale(unit, add_scaled(torque_impulse, h, held.torque_world)),
        unit * unit * _integral(series.power, h),
    )


def longest_step(
    inertia: Inertia,
    held: HeldWrench,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    accuracy: float,
    horizon: float,
) -> float:
    """Return the longest step (s) that adds at most accuracy * step / horizon to the attitude error at the end.

    The last two terms of attitude and rate tell the first that is left out; an error of the rate grows for the whole
    horizon. Rounding alone is no reason to step shorter.
    """
    unit = _clock(inertia, held, angular_velocity)
    held, horizon, velocity = _slowed(held, unit), horizon * unit, scale(1.0 / unit, velocity)
    angular_velocity = scale(1.0 / unit, angular_velocity)
    series = _series(inertia, held, velocity, orientation, angular_velocity)
    floor = _EPSILON * (1.0 + norm(angular_velocity) * horizon)
    terms = [2.0 * _size(series.turn, k) + horizon * _size(series.omega, k) for k in (0, _ORDER - 1, _ORDER)]
    if terms[1] == terms[2] == 0.0:
        return math.inf
    if not all(map(math.isfinite, terms)):
        return 0.0
    # The radius of convergence as the last terms show it (Jorba & Zou, eq. 11), and with it the first term left out.
    radius = min(
        math.pow(terms[0] / term, 1.0 / k) for k, term in ((_ORDER - 1, terms[1]), (_ORDER, terms[2])) if term > 0.0
    )
    first_left_out = max(terms[1] / radius / radius, terms[2] / radius)
    if first_left_out == 0.0:
        return 0.5 * radius / unit
    by_accuracy = math.pow(accuracy / horizon / first_left_out, 1.0 / _ORDER)
    by_rounding = math.pow(floor / first_left_out, 1.0 / (_ORDER + 1))
    return min(0.5 * radius, 0.9 * max(by_accuracy, by_rounding)) / unit


def _clock(inertia: Inertia, held: HeldWrench, angular_velocity: Vector) -> float:
    """Return a power of two near the rate (1/s) of the motion: in its units the powers of the rate are numbers."""
    torque = max(norm(held.torque_body), norm(held.torque_world))
    rate = max(norm(angular_velocity), math.sqrt(torque / min(inertia.moments)))
    return math.ldexp(1.0, min(max(math.frexp(rate)[1], -480), 480)) if 0.0 < rate < math.inf else 1.0


def _slowed(held: HeldWrench, unit: float) -> HeldWrench:
    s = 1.0 / unit / unit
    return HeldWrench(
        scale(s, held.force_body), scale(s, held.torque_body), scale(s, held.force_world), scale(s, held.torque_world)
    )


def _series(
    inertia: Inertia, held: HeldWrench, velocity: Vector, orientation: Quaternion, angular_velocity: Vector
) -> _Expansion:
    return _expand(
        inertia,
        held,
        positive_zeros(rotate_inverse(orientation, held.force_world)),
        positive_zeros(rotate_inverse(orientation, held.torque_world)),
        positive_zeros(rotate_inverse(orientation, velocity)),
        positive_zeros(angular_velocity),
    )


# The arc looks at one step many times: to choose it, to take it, and for each output inside it.
@lru_cache(maxsize=4)
def _expand(
    inertia: Inertia, held: HeldWrench, force_0: Vector, torque_0: Vector, velocity_0: Vector, angular_velocity: Vector
) -> _Expansion:
    i1, i2, i3 = inertia.moments
    t1, t2, t3 = held.torque_body
    r1, r2, r3, r4 = [0.0], [0.0], [0.0], [1.0]
    w1, w2, w3 = ([c] for c in angular_velocity)
    y1, y2, y3 = ([c] for c in torque_0)
    # The world-frame torque costs its recurrence only where there is one.
    has_torque = torque_0 != ZERO
    for k in range(_ORDER):
        n = 1.0 / (k + 1)
        e1 = (i2 - i3) * _product(w2, w3) + y1[k]
        e2 = (i3 - i1) * _product(w3, w1) + y2[k]
        e3 = (i1 - i2) * _product(w1, w2) + y3[k]
        if k == 0:
            e1, e2, e3 = e1 + t1, e2 + t2, e3 + t3
        q1 = _product(r4, w1) + _product(r2, w3) - _product(r3, w2)
        q2 = _product(r4, w2) + _product(r3, w1) - _product(r1, w3)
        q3 = _product(r4, w3) + _product(r1, w2) - _product(r2, w1)
        q4 = -_product(r1, w1) - _product(r2, w2) - _product(r3, w3)
        if has_torque:
            d1 = _product(y2, w3) - _product(y3, w2)
            d2 = _product(y3, w1) - _product(y1, w3)
            d3 = _product(y1, w2) - _product(y2, w1)
        else:
            d1 = d2 = d3 = 0.0
        w1.append(n * e1 / i1)
        w2.append(n * e2 / i2)
        w3.append(n * e3 / i3)
        r1.append(0.5 * n * q1)
        r2.append(0.5 * n * q2)
        r3.append(0.5 * n * q3)
        r4.append(0.5 * n * q4)
        y1.append(n * d1)
        y2.append(n * d2)
        y3.append(n * d3)
    turn, omega = (r1, r2, r3, r4), (w1, w2, w3)
    force = _turned(turn, held.force_body) if held.force_body != ZERO else ()
    torque = _turned(turn, held.torque_body) if held.torque_body != ZERO else ()
    power = [t1 * a + t2 * b + t3 * c for a, b, c in zip(w1, w2, w3, strict=True)]
    if has_torque:
        power = _sum(power, _dot((y1, y2, y3), omega))
    if force or force_0 != ZERO:
        power = _sum(power, _force_power(inertia.mass, force, force_0, velocity_0))
    return _Expansion(turn, omega, force, torque, power)


def _turned(turn: tuple[_Series, _Series, _Series, _Series], a: Vector) -> tuple[_Series, _Series, _Series]:
    """Return the series of r a r* for a vector a fixed in the body."""
    x, y, z, w = turn
    a1, a2, a3 = a
    px = [wk * a1 + yk * a3 - zk * a2 for yk, zk, wk in zip(y, z, w, strict=True)]
    py = [wk * a2 + zk * a1 - xk * a3 for xk, zk, wk in zip(x, z, w, strict=True)]
    pz = [wk * a3 + xk * a2 - yk * a1 for xk, yk, wk in zip(x, y, w, strict=True)]
    pw = [-xk * a1 - yk * a2 - zk * a3 for xk, yk, zk in zip(x, y, z, strict=True)]
    out: tuple[_Series, _Series, _Series] = ([], [], [])
    for k in range(1, len(x) + 1):
        xk, yk, zk, wk = x[:k], y[:k], z[:k], w[:k]
        ax, ay, az, aw = px[:k], py[:k], pz[:k], pw[:k]
        out[0].append(_product(ax, wk) - _product(aw, xk) - _product(ay, zk) + _product(az, yk))
        out[1].append(_product(ay, wk) - _product(aw, yk) - _product(az, xk) + _product(ax, zk))
        out[2].append(_product(az, wk) - _product(aw, zk) - _product(ax, yk) + _product(ay, xk))
    return out


def _force_power(mass: float, force: Sequence[_Series], force_0: Vector, velocity_0: Vector) -> _Series:
    """Return the series of F . v, all in the axes at t = 0."""
    total = [list(component) for component in force] or [[0.0] * (_ORDER + 1) for _ in range(3)]
    for component, uniform in zip(total, force_0, strict=True):
        component[0] += uniform
    speed = []
    for component, start in zip(total, velocity_0, strict=True):
        speed.append([start, *(c / (mass * (k + 1)) for k, c in enumerate(component[:-1]))])
    return _dot(total, speed)


def _product(a: _Series, b: _Series) -> float:
    """Return the newest coefficient of the product of two series of equal length (Cauchy)."""
    total = 0.0
    for p, q in zip(a, reversed(b), strict=True):
        total += p * q
    return total


def _dot(a: Sequence[_Series], b: Sequence[_Series]) -> _Series:
    (a1, a2, a3), (b1, b2, b3) = a, b
    return [
        _product(a1[:k], b1[:k]) + _product(a2[:k], b2[:k]) + _product(a3[:k], b3[:k]) for k in range(1, _ORDER + 2)
    ]


def _sum(a: _Series, b: _Series) -> _Series:
    return [p + q for p, q in zip(a, b, strict=True)]


def _size(components: Sequence[_Series], k: int) -> float:
    """Return the norm of coefficient k of three series or four."""
    first = norm((components[0][k], components[1][k], components[2][k]))
    return first if len(components) == 3 else norm((first, components[3][k], 0.0))


def _value(series: _Series, h: float) -> float:
    total = 0.0
    for c in reversed(series):
        total = total * h + c
    return total


def _integral(series: _Series, h: float) -> float:
    total = 0.0
    for k in range(len(series) - 1, -1, -1):
        total = total * h + series[k] / (k + 1)
    return total * h


def _second_integral(series: _Series, h: float) -> float:
    total = 0.0
    for k in range(len(series) - 1, -1, -1):
        total = total * h + series[k] / ((k + 1) * (k + 2))
    return total * h * h


def _vector(series: Sequence[_Series], h: float, of: Callable[[_Series, float], float]) -> Vector:
    return (of(series[0], h), of(series[1], h), of(series[2], h))


TAYLOR = Method("taylor", order=_ORDER, invariants=frozenset({"unit_quaternion"}), step=step, longest_step=longest_step)
