"""The explicit Runge-Kutta method of order 8 of Dormand and Prince: the general solver that most people reach for."""

from __future__ import annotations

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


@cache
def _scheme() -> Quadrature:
    """Return the scheme as scipy has it, without its error estimates."""
    from scipy import integrate

    nodes, stages, weights = (getattr(integrate.DOP853, name).tolist() for name in "CAB")
    tableau = Tableau(tuple(nodes), tuple(map(tuple, stages)), tuple(weights))
    return tableau.quadrature(tableau.weights)


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
    mass, moments = inertia
    stages, weights, _ = _scheme()
    force_0 = rotate_inverse(orientation, held.force_world)
    torque_0 = rotate_inverse(orientation, held.torque_world)
    # The slopes of the stages, in the axes of R0; impulses without the parts that are constant there.
    slopes: list[_State] = []
    twists: list[Vector] = []
    powers: list[float] = []
    for node, terms in stages:
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

    (x, y, z, w), spin_up, pushed, moved = _total(h, weights, slopes)
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


DOP853 = Method("dop853", order=8, invariants=frozenset({"unit_quaternion"}), step=step, takes=Takes.ANY)
