"""Reaction wheels as numbers: how each turns now, what wheels and body do to each other, and when that changes.

A wheel is free, or it is held at a constant speed relative to the body: at rest by friction, or at its largest or its
commanded speed by the drive. The functions run in plain Python and in kernels, with the same bits. In `c` they find the
numbers of the wheels from i on, and their states from s on: one momentum about its axis for each, H = J (W + a . w).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rb_dynamics.numerics.compilation import compiled_apart
from rb_dynamics.numerics.rotation import Quaternion, rotate
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, cross, dot, norm, scale, subtract
from rb_dynamics.numerics.vector import multiply as times

if TYPE_CHECKING:
    from rb_dynamics.numerics.array_types import Numbers

    Cells = Numbers | list[float]

BOOKS = 6
"""States behind the momenta: motor work, friction heat (J), and what the inner torque adds to those of the body: work
(J) and impulse (N m s, world axes)."""

BEFORE, EACH = 10, 19
"""Numbers of all: how many wheels there are, and row by row the inverse of the inertia without the free ones; and of
each, see below."""

INERTIA, AXIS, VISCOUS, COULOMB, HELD, MOTOR, FRICTION, COMMAND = 0, 1, 4, 5, 6, 7, 8, 9
"""Of each: its inertia and axis, viscous and Coulomb friction, how it is held, and while it is free the torque (N m) of
the motor and the constant part of the friction; its command, N m or rad/s."""

POINT, LOW, HIGH, LEFT, MOST_TORQUE, MOST_SPEED, BY_SPEED, LATE, TORQUE = 10, 11, 12, 13, 14, 15, 16, 17, 18
"""The speed (rad/s) at which it may stay, where it is at one; the speeds below and above which it is no longer as free
as it is; the point that it was released from at this very time; its limits; and whether a speed is commanded. NaN for
no speed. How long ago (s) it passed the point that it is put to now, and the torque on it since then."""

_NANOSECOND = 1e-9

# A step resolves a motion whose derivatives are at most this per step, in units of the one before.
_RESOLVED = 6.0

# Rounding errors of a speed.
_ROUNDING = 2.0**-46

FREE, AT_SPEED, AT_REST = 0.0, 1.0, 2.0
"""How a wheel is held."""


def begin_wheel(c: Cells, i: int, k: int, speed: float) -> None:
    """Let wheel k turn with `speed`, without a torque; where a speed is commanded, that of the start."""
    a = _at(i, k)
    c[a + HELD], c[a + COMMAND] = FREE, speed if c[a + BY_SPEED] != 0.0 else 0.0
    c[a + POINT] = c[a + LEFT] = math.nan
    _place(c, a, speed)


def command_wheel(c: Cells, i: int, k: int, value: float, speed: float) -> None:
    """Apply the command of wheel k, which turns with `speed`; `settle` then decides whether it is held."""
    a = _at(i, k)
    c[a + COMMAND], c[a + POINT] = value, _where(c, a)
    # It is still at rest or at its largest speed; it does not stay at a speed that was commanded before.
    if math.isnan(c[a + POINT]) or not _is_point(c, a, c[a + POINT]):
        _place(c, a, speed)


def turns_freely(c: Cells, i: int, k: int, speed: float) -> bool:
    """Return whether wheel k is free, under a commanded torque, and where it may not stay: then commands only turn it.

    See `command_freely`.
    """
    a = _at(i, k)
    free = c[a + HELD] == FREE and c[a + BY_SPEED] == 0.0 and math.isnan(_where(c, a))
    return free and not _is_point(c, a, speed)


def command_freely(c: Cells, i: int, k: int, value: float, speed: float) -> None:
    """As `command_wheel` and `settle`, for a wheel that `turns_freely`."""
    a = _at(i, k)
    low, high, _ = _around(c, a, speed)
    c[a + COMMAND] = value
    _free(c, a, low, high, math.copysign(1.0, speed))


def move_on(c: Cells, i: int) -> None:
    """Let time go on: wheels that were released have left their points."""
    for k in range(int(c[i])):
        c[_at(i, k) + LEFT] = math.nan


def may_stay(c: Cells, i: int) -> bool:
    """Return whether a wheel is where it may stay."""
    found = False
    for k in range(int(c[i])):
        found = found or not math.isnan(_where(c, _at(i, k)))
    return found


@compiled_apart
def settle(c: Cells, i: int, s: int, moments: Vector, torque: Vector, omega: Vector) -> None:
    """Decide which wheels are held, under a torque from outside (principal axes).

    First all wheels at a speed where they may stay are held; those that cannot be are released, until all others can.
    What was decided before at this very time counts for nothing, so that commands of one time may come one by one.
    """
    for k in range(int(c[i])):
        a = _at(i, k)
        c[a + POINT] = _where(c, a)
        c[a + HELD] = FREE if math.isnan(c[a + POINT]) else AT_REST if c[a + POINT] == 0.0 else AT_SPEED
    released = True
    while released:
        invert_inertia(c, i, moments)
        released = False
        spin_up = spin_up_of(c, i, s, moments, torque, omega) if is_held(c, i) else ZERO
        for k in range(int(c[i])):
            if c[_at(i, k) + HELD] == FREE:
                continue
            speed = speed_of(c, i, s, k, omega)
            way = _way_out(c, _at(i, k), spin_up, speed)
            if way != 0.0:
                _let_go(c, _at(i, k), way, speed)
                released = True
                break


def is_held(c: Cells, i: int) -> bool:
    """Return whether a wheel is held."""
    found = False
    for k in range(int(c[i])):
        found = found or c[_at(i, k) + HELD] != FREE
    return found


def excess(c: Cells, i: int, s: int, k: int, spin_up: Vector, omega: Vector) -> float:
    """Return how far wheel k is beyond where it turns as it does now: rad/s if it is free, rad/s^2 if it is held.

    The two are of one size, as a search for a switch looks at the largest of all wheels. `spin_up` is w' if a wheel is
    held (`spin_up_of`). The wheel switches where the value is positive.
    """
    a, speed = _at(i, k), speed_of(c, i, s, k, omega)
    below, above = c[a + LOW] - speed, speed - c[a + HIGH]
    if c[a + HELD] != FREE:
        needed, least, most = _holding(c, a, spin_up, speed)
        below, above = (least - needed) / c[a + INERTIA], (needed - most) / c[a + INERTIA]
    return below if below > above else above


def is_far(
    c: Cells, i: int, excess: float, h: float, turning: tuple[Vector, Vector], attitudes: tuple[Quaternion, Quaternion]
) -> bool:
    """Return whether no wheel can switch within a step of h s, by the `excess`, w and the attitude at its ends alone.

    The speed of a free wheel deviates from a monotonic function by what the turning of the body adds to it. The angle
    counts too: a body may swing from rest to rest.
    """
    (x, y, z, w), (a, b, d, e) = attitudes
    chord = math.sqrt(max(0.0, 2.0 - 2.0 * abs(x * a + y * b + z * d + w * e)))
    return not is_held(c, i) and excess + 8.0 * (norm(turning[0]) + norm(turning[1]) + 2.0 * chord / h) <= 0.0


def bend_and_noise(
    c: Cells, i: int, s: int, h: float, turning: tuple[Vector, Vector], gaining: tuple[Vector, Vector]
) -> tuple[float, float]:
    """Return bounds on the second derivative of `excess` within a step of h s, and on its rounding errors.

    `turning` and `gaining` are w and w' at its ends. J (W' + a . w') = u + f, so W'' = -v W' / J - a . w''; and a held
    wheel needs J a . w'. Of w' and w'' it takes twice the largest that w has as a cubic.
    """
    mean, (first, last) = scale(1.0 / h, subtract(turning[1], turning[0])), gaining
    faster, change = 2.0 * max(norm(first), norm(last), norm(mean)), subtract(last, first)
    early = add_scaled(scale(6.0, subtract(mean, first)), -2.0, change)
    late = add_scaled(scale(6.0, subtract(last, mean)), -2.0, change)
    sharper = 2.0 / h * max(norm(early), norm(late), norm(change))
    bend = size = 0.0
    for k in range(int(c[i])):
        a = _at(i, k)
        if c[a + HELD] == FREE:
            j, speed = c[a + INERTIA], speed_of(c, i, s, k, turning[0])
            rate = abs(c[a + MOTOR] + c[a + FRICTION] - c[a + VISCOUS] * speed) / j
            bend = max(bend, c[a + VISCOUS] / j * (rate + faster) + sharper)
            size = max(size, abs(speed) + abs(c[s + k]) / j)
        else:
            bend, size = max(bend, _RESOLVED / h * sharper), max(size, faster)
    return bend, _ROUNDING * size


def switches(c: Cells, i: int, s: int, k: int, spin_up: Vector, omega: Vector) -> bool:
    """Return whether wheel k no longer turns as it does now; see `excess`."""
    return excess(c, i, s, k, spin_up, omega) > 0.0


@compiled_apart
def switch_wheels(
    c: Cells, i: int, s: int, moments: Vector, torque: Vector, orientation: Quaternion, omega: Vector
) -> Vector:
    """Put free wheels that have just passed a point to it, and return by how much that changes w (principal axes).

    They passed it between two whole nanoseconds. What wheels and body did to each other since then is taken back, and
    what they do from the point on put in its place, to first order in that time. The changes of the states come behind
    them.
    """
    spin_up, n = spin_up_of(c, i, s, moments, torque, omega), count_of(c, i)
    inner_torque(c, i, s, moments, torque, orientation, omega)
    r, passed = s + n + BOOKS, False
    for k in range(n):
        a, speed = _at(i, k), speed_of(c, i, s, k, omega)
        c[a + LATE] = 0.0
        if c[a + HELD] == FREE and switches(c, i, s, k, spin_up, omega):
            bound = c[a + LOW] if speed < c[a + LOW] else c[a + HIGH]
            rate = c[r + k] / c[a + INERTIA] - dot(_axis_of(c, i, k), spin_up)
            beyond = speed - bound
            # Where the speed hardly changes, the time is not known.
            c[a + LATE] = min(beyond / rate, _NANOSECOND) if beyond * rate > 0.0 else 0.0
            c[a + TORQUE], c[a + POINT], passed = c[r + k], _nearest(c, a, bound), True
    if not passed:
        return ZERO
    settle(c, i, s, moments, torque, omega)
    inner_torque(c, i, s, moments, torque, orientation, omega)
    push = ZERO
    for k in range(n):
        a = _at(i, k)
        if c[a + LATE] > 0.0:
            gain = (c[r + k] - c[a + TORQUE]) * c[a + LATE]
            if c[a + HELD] != FREE:
                gain = c[a + INERTIA] * (c[a + POINT] - speed_of(c, i, s, k, omega))
            push = add_scaled(push, -gain, _axis_of(c, i, k))
    change, motor, heat = _by_inverse(c, i, push), 0.0, 0.0
    for k in range(n):
        a, axis, speed = _at(i, k), _axis_of(c, i, k), speed_of(c, i, s, k, omega)
        held, late = c[a + HELD] != FREE, c[a + LATE] > 0.0
        faster = c[a + POINT] - speed if held and late else 0.0
        gain = c[a + INERTIA] * (faster + dot(axis, change)) if held else 0.0
        if late and not held:
            gain = (c[r + k] - c[a + TORQUE]) * c[a + LATE]
            faster = gain / c[a + INERTIA] - dot(axis, change)
        c[r + k] = gain
        # At rest friction has done it, elsewhere the drive.
        if c[a + LEFT] == 0.0 or c[a + POINT] == 0.0:
            heat -= gain * (speed + 0.5 * faster)
        else:
            motor += gain * (speed + 0.5 * faster)
    impulse = times(moments, change)
    c[r + n], c[r + n + 1] = motor, heat
    c[r + n + 2] = motor - heat - dot(impulse, add_scaled(omega, 0.5, change))
    c[r + n + 3], c[r + n + 4], c[r + n + 5] = rotate(orientation, impulse)
    return change


def _at(i: int, k: int) -> int:
    return i + BEFORE + k * EACH


def _where(c: Cells, a: int) -> float:
    """Return the point at which a wheel is, held or not; NaN elsewhere."""
    return c[a + LEFT] if math.isnan(c[a + POINT]) else c[a + POINT]


def _place(c: Cells, a: int, speed: float) -> None:
    """Put a wheel where it is by its speed alone."""
    low, high, there = _around(c, a, speed)
    if there:
        c[a + POINT], c[a + LEFT] = speed, math.nan
        return
    _free(c, a, low, high, math.copysign(1.0, speed))


def _let_go(c: Cells, a: int, way: float, speed: float) -> None:
    """Release a wheel from its point, up (1) or down (-1)."""
    point = c[a + POINT]
    sign = way if point == 0.0 else math.copysign(1.0, point)
    # It was caught within a nanosecond, and is past its point by that much.
    if way > 0.0:
        _free(c, a, min(point, speed), _around(c, a, point)[1], sign)
    else:
        _free(c, a, _around(c, a, point)[0], max(point, speed), sign)
    c[a + LEFT] = point


def _free(c: Cells, a: int, low: float, high: float, sign: float) -> None:
    """Let a wheel turn freely between two speeds, with speeds of this sign."""
    motor = c[a + COMMAND]
    if c[a + BY_SPEED] != 0.0:
        motor = -c[a + MOST_TORQUE] if low + high > 2.0 * c[a + COMMAND] else c[a + MOST_TORQUE]
    # Where the body drives it beyond its largest speed, the motor slows it down.
    if max(c[a + MOST_SPEED], c[a + MOST_TORQUE]) < math.inf and max(-low, high) == math.inf:
        motor = -sign * c[a + MOST_TORQUE]
    c[a + HELD], c[a + MOTOR], c[a + FRICTION] = FREE, motor, -sign * c[a + COULOMB]
    c[a + LOW], c[a + HIGH] = low, high
    c[a + POINT] = c[a + LEFT] = math.nan


# The speeds at which a wheel may stay: either limit, rest if friction can hold it, and the commanded speed.
def _point(c: Cells, a: int, number: int) -> float:
    if number == 0 and c[a + MOST_SPEED] < math.inf:
        return -c[a + MOST_SPEED]
    if number == 1 and c[a + MOST_SPEED] < math.inf:
        return c[a + MOST_SPEED]
    if number == 2 and c[a + COULOMB] > 0.0:
        return 0.0
    return c[a + COMMAND] if number == 3 and c[a + BY_SPEED] != 0.0 else math.nan


def _is_point(c: Cells, a: int, speed: float) -> bool:
    return _around(c, a, speed)[2]


def _around(c: Cells, a: int, speed: float) -> tuple[float, float, bool]:
    """Return the nearest points below and above a speed, infinite if there is none, and whether it is one itself."""
    low, high, there = -math.inf, math.inf, False
    for number in range(4):
        point = _point(c, a, number)
        low = point if low < point < speed else low
        high = point if speed < point < high else high
        there = there or point == speed
    return low, high, there


def _nearest(c: Cells, a: int, speed: float) -> float:
    nearest = math.nan
    for number in range(4):
        point = _point(c, a, number)
        if math.isnan(nearest) or abs(point - speed) < abs(nearest - speed):
            nearest = point
    return nearest


def _way_out(c: Cells, a: int, spin_up: Vector, speed: float) -> float:
    """Return which way a held wheel is released, if nothing can hold it: up (1), down (-1) or not at all (0)."""
    needed, least, most = _holding(c, a, spin_up, speed)
    return -1.0 if needed > most else 1.0 if needed < least else 0.0


def _holding(c: Cells, a: int, spin_up: Vector, speed: float) -> Vector:
    """Return the torque that a held wheel needs, and the least and the largest torque that there can be."""
    needed = c[a + INERTIA] * dot((c[a + AXIS], c[a + AXIS + 1], c[a + AXIS + 2]), spin_up)
    point, command = c[a + POINT], c[a + COMMAND]
    least = most = command
    if c[a + BY_SPEED] != 0.0:
        least = most = math.copysign(c[a + MOST_TORQUE], command - point)
        if point == command:
            least, most = -c[a + MOST_TORQUE], c[a + MOST_TORQUE]
    if point == c[a + MOST_SPEED]:
        least = -c[a + MOST_TORQUE]
    elif point == -c[a + MOST_SPEED]:
        most = c[a + MOST_TORQUE]
    if point == 0.0:
        least, most = least - c[a + COULOMB], most + c[a + COULOMB]
    else:
        friction = -math.copysign(c[a + COULOMB], speed) - c[a + VISCOUS] * speed
        least, most = least + friction, most + friction
    return needed, least, most


def invert_inertia(c: Cells, i: int, moments: Vector) -> None:
    """Write the inverse of the inertia without the free wheels: I - sum of J a a^T, symmetric."""
    (a, b, c0), d, e, f = moments, 0.0, 0.0, 0.0
    for k in range(int(c[i])):
        j = c[_at(i, k) + INERTIA] if c[_at(i, k) + HELD] == FREE else 0.0
        x, y, z = _axis_of(c, i, k)
        a, b, c0, d, e, f = a - j * x * x, b - j * y * y, c0 - j * z * z, d - j * x * y, e - j * x * z, f - j * y * z
    one, two, three = b * c0 - f * f, e * f - d * c0, d * f - e * b
    s = 1.0 / (a * one + d * two + e * three)
    four, five, six = s * (a * c0 - e * e), s * (d * e - a * f), s * (a * b - d * d)
    one, two, three = s * one, s * two, s * three
    c[i + 1], c[i + 2], c[i + 3] = one, two, three
    c[i + 4], c[i + 5], c[i + 6] = two, four, five
    c[i + 7], c[i + 8], c[i + 9] = three, five, six


def count_of(c: Cells, i: int) -> int:
    """Return how many wheels there are. Kernels for a constant number have their own version."""
    return int(c[i])


def length_of(c: Cells, i: int) -> int:
    """Return how many numbers there are of the wheels whose numbers begin at i."""
    return BEFORE + EACH * int(c[i])


def states_of(c: Cells | Sequence[float], i: int) -> int:
    """Return how many states the wheels have whose numbers begin at i."""
    return int(c[i]) + BOOKS


def inner_torque(
    c: Cells, i: int, s: int, moments: Vector, torque: Vector, orientation: Quaternion, omega: Vector
) -> Vector:
    """Return the inner torque on the body (principal axes) under `torque` from outside, and write rates of the states.

    The rates come behind the states in `c`.
    """
    spin_up, carried, n = spin_up_of(c, i, s, moments, torque, omega), ZERO, count_of(c, i)
    for k in range(n):
        j, axis = c[_at(i, k) + INERTIA], _axis_of(c, i, k)
        carried = add_scaled(carried, j * speed_of(c, i, s, k, omega), axis)
    inner, r = cross(carried, omega), s + n + BOOKS
    motor = heat = power = 0.0
    for k in range(n):
        a, axis, speed = _at(i, k), _axis_of(c, i, k), speed_of(c, i, s, k, omega)
        taken, held = c[a + INERTIA] * dot(axis, spin_up), c[a + HELD]
        if held == FREE:
            friction = c[a + FRICTION] - c[a + VISCOUS] * speed
            on_wheel = c[a + MOTOR] + friction
            inner = add_scaled(inner, taken - on_wheel, axis)
        else:
            on_wheel, friction = taken, 0.0
            if held == AT_SPEED:
                friction = -math.copysign(c[a + COULOMB], speed) - c[a + VISCOUS] * speed
        c[r + k] = on_wheel
        motor, heat = motor + (on_wheel - friction) * speed, heat - friction * speed
        power += on_wheel * speed
    c[r + n], c[r + n + 1], c[r + n + 2] = motor, heat, power - dot(inner, omega)
    c[r + n + 3], c[r + n + 4], c[r + n + 5] = rotate(orientation, inner)
    return inner


def spin_up_of(c: Cells, i: int, s: int, moments: Vector, torque: Vector, omega: Vector) -> Vector:
    """Return w' (principal axes) under `torque` from outside; see `inner_torque`."""
    momentum, push = times(moments, omega), torque
    for k in range(count_of(c, i)):
        a, axis, speed = _at(i, k), _axis_of(c, i, k), speed_of(c, i, s, k, omega)
        momentum = add_scaled(momentum, c[a + INERTIA] * speed, axis)
        if c[a + HELD] == FREE:
            push = add_scaled(push, -(c[a + MOTOR] + c[a + FRICTION] - c[a + VISCOUS] * speed), axis)
    return _by_inverse(c, i, add(push, cross(momentum, omega)))


def _by_inverse(c: Cells, i: int, vector: Vector) -> Vector:
    """Return the product of the inverse of the inertia without the free wheels and a vector."""
    x, y, z = vector
    one, two = (c[i + 1], c[i + 2], c[i + 3]), (c[i + 4], c[i + 5], c[i + 6])
    return add(add(scale(x, one), scale(y, two)), scale(z, (c[i + 7], c[i + 8], c[i + 9])))


def momentum_in(c: Cells, i: int, s: int) -> Vector:
    """Return the sum of the momenta at s along their axes; see `inner_torque`."""
    total = ZERO
    for k in range(count_of(c, i)):
        total = add_scaled(total, c[s + k], _axis_of(c, i, k))
    return total


def speed_of(c: Cells, i: int, s: int, k: int, omega: Vector) -> float:
    """Return the speed (rad/s) of wheel k relative to the body."""
    speed: float = c[s + k] / c[_at(i, k) + INERTIA] - dot(_axis_of(c, i, k), omega)
    return speed


def _axis_of(c: Cells, i: int, k: int) -> Vector:
    a = _at(i, k) + AXIS
    return (c[a], c[a + 1], c[a + 2])
