"""The explicit Runge-Kutta method of order 8 of Dormand and Prince: the general solver that most people reach for."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.method import Increment, Inertia, Load, Method, Takes
from rb_dynamics.motion.refusal import require_finite, require_quaternion
from rb_dynamics.motion.rkmk import Quadrature, Tableau, Terms, total
from rb_dynamics.rotation import Quaternion, normalize, rotate, rotate_inverse
from rb_dynamics.rotation import multiply as compose
from rb_dynamics.vector import Vector, add, add_scaled, cross, divide, dot, multiply, norm, scale, subtract

# q, omega, impulse and displacement.
_State = tuple[Quaternion, Vector, Vector, Vector]


# What a step starts from.
_Start = tuple[Inertia, HeldWrench, float, Vector, Quaternion, Vector]


@cache
def _scheme() -> Quadrature:
    """Return the scheme as scipy has it."""
    from scipy import integrate

    nodes, stages, weights = (getattr(integrate.DOP853, name).tolist() for name in "CAB")
    tableau = Tableau(tuple(nodes), tuple(map(tuple, stages)), tuple(weights))
    return tableau.quadrature(tableau.weights)


@cache
def _estimates() -> tuple[Terms, Terms]:
    """Return the weights of the two error estimates, of orders 5 and 3."""
    from scipy import integrate

    fifth, third = ([(j, w) for j, w in enumerate(getattr(integrate.DOP853, n).tolist()) if w] for n in ("E5", "E3"))
    return tuple(fifth), tuple(third)


def step(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,
) -> Increment:
    """Advance (q, omega, v, x) and the books by DOP853 and normalise q (Hairer, Norsett & Wanner I, section II.5).

    The equations are those of `rk4`, with q from the axes of R0 and v and x for an observer who moves with `velocity`:
    small numbers, to which rounding does little. Order 8, under any load too; keeps no invariant but what its accuracy
    keeps.

    Raises:
        ConvergenceError: the step turns the body so far that the end is no rotation any more, or diverges.
    """
    start = (inertia, held, h, velocity, orientation, angular_velocity)
    slopes, twists, powers = _slopes(start, load)
    return _end(start, _total(h, _scheme().first, slopes), twists, powers)


def pair(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,
) -> tuple[Increment, Increment]:
    """Return the step and a comparison that is off by the estimate of its error, which falls as that of order 7.

    The estimate combines those of orders 5 and 3, e5 |e5| / sqrt(|e5|^2 + |e3|^2 / 100) (HNW I, eq. II.10.17), for
    each of q, omega, impulse and displacement.

    Raises:
        ConvergenceError: as for `step`.
    """
    start = (inertia, held, h, velocity, orientation, angular_velocity)
    slopes, twists, powers = _slopes(start, load)
    ends = _total(h, _scheme().first, slopes)
    fifth, third = (_total(h, terms, slopes) for terms in _estimates())
    q, omega, pushed, moved = (_off(end, e5, e3) for end, e5, e3 in zip(ends, fifth, third, strict=True))
    other = ((q[0], q[1], q[2], q[3]), (omega[0], omega[1], omega[2]), (pushed[0], pushed[1], pushed[2]))
    comparison = _end(start, (*other, (moved[0], moved[1], moved[2])), twists, powers)
    return _end(start, ends, twists, powers), comparison


def _size(values: Sequence[float]) -> float:
    """Return the norm of three values or four."""
    first = norm((values[0], values[1], values[2]))
    return first if len(values) == 3 else norm((first, values[3], 0.0))


def _off(end: Sequence[float], fifth: Sequence[float], third: Sequence[float]) -> tuple[float, ...]:
    size = _size(fifth)
    whole = norm((size, 0.1 * _size(third), 0.0))
    factor = size / whole if whole > 0.0 else 0.0
    return tuple(value - factor * error for value, error in zip(end, fifth, strict=True))


def _slopes(start: _Start, load: Load | None) -> tuple[list[_State], list[Vector], list[float]]:
    """Return the slopes of the stages in the axes of R0, without the constant parts, and those of the books."""
    (mass, moments), held, h, velocity, orientation, angular_velocity = start
    force_0 = rotate_inverse(orientation, held.force_world)
    torque_0 = rotate_inverse(orientation, held.torque_world)
    slopes: list[_State] = []
    twists: list[Vector] = []
    powers: list[float] = []
    for node, terms in _scheme().stages:
        ahead = node * h
        (x, y, z, w), spin_up, pushed, moved = _total(h, terms, slopes)
        q, omega = (x, y, z, 1.0 + w), add(angular_velocity, spin_up)
        gain = scale(1.0 / mass, add_scaled(pushed, ahead, force_0))
        turn = normalize(q)
        push, torque = rotate(turn, held.force_body), held.torque_body
        if load is not None:
            place = add_scaled(rotate(orientation, moved), ahead, velocity)
            v = add(velocity, rotate(orientation, gain))
            force, more = load(ahead, place, v, compose(orientation, turn), omega)
            push, torque = add(push, rotate_inverse(orientation, force)), add(torque, more)
        all_torque = add(torque, rotate_inverse(turn, torque_0))
        omega_dot = divide(subtract(all_torque, cross(omega, multiply(moments, omega))), moments)
        slopes.append((compose(q, (*scale(0.5, omega), 0.0)), omega_dot, push, gain))
        twists.append(rotate(turn, torque))
        powers.append(dot(add(push, force_0), gain) + dot(all_torque, omega))
    return slopes, twists, powers


def _end(start: _Start, sums: _State, twists: list[Vector], powers: list[float]) -> Increment:
    """Return the increment with these `sums` of the slopes.

    Raises:
        ConvergenceError: the end is no rotation, or not finite.
    """
    _, held, h, velocity, orientation, angular_velocity = start
    weights = _scheme().first
    (x, y, z, w), spin_up, pushed, moved = sums
    require_quaternion("dop853", h, x * x + y * y + z * z + (1.0 + w) * (1.0 + w), norm(angular_velocity))
    impulse = add_scaled(rotate(orientation, pushed), h, held.force_world)
    work = dot(velocity, impulse)
    for j, weight in weights:
        work += weight * h * powers[j]
    end = Increment(
        add_scaled(rotate(orientation, moved), h, velocity),
        normalize(compose(orientation, normalize((x, y, z, 1.0 + w)))),
        add(angular_velocity, spin_up),
        impulse,
        add_scaled(rotate(orientation, scale(h, total(1.0, weights, twists))), h, held.torque_world),
        work,
    )
    return require_finite("dop853", h, end)


def _total(h: float, terms: Terms, slopes: list[_State]) -> _State:
    a = b = c = d = e = f = g = i = j = k = m = n = o = 0.0
    for stage, s in terms:
        (a1, b1, c1, d1), (e1, f1, g1), (i1, j1, k1), (m1, n1, o1) = slopes[stage]
        a, b, c, d = a + s * a1, b + s * b1, c + s * c1, d + s * d1
        e, f, g = e + s * e1, f + s * f1, g + s * g1
        i, j, k = i + s * i1, j + s * j1, k + s * k1
        m, n, o = m + s * m1, n + s * n1, o + s * o1
    return (h * a, h * b, h * c, h * d), (h * e, h * f, h * g), (h * i, h * j, h * k), (h * m, h * n, h * o)


DOP853 = Method("dop853", order=8, invariants=frozenset({"unit_quaternion"}), step=step, takes=Takes.ANY, pair=pair)
