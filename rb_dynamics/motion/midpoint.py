"""The implicit midpoint rule with the Cayley attitude update: conserves energy and angular momentum to round-off.

Supports any load, evaluated at the midpoint of the step, without derivatives.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.method import Increment, Inertia, Load, LoadDependence, Method
from rb_dynamics.motion.step_checks import LARGEST_TURN, NO_INCREMENT, NOWHERE, turns_too_far
from rb_dynamics.numerics.compilation import compiled_as
from rb_dynamics.numerics.rotation import Quaternion, cayley, multiply, normalize, renormalize, rotate, rotate_inverse
from rb_dynamics.numerics.vector import Vector, add, add_scaled, cross, divide, dot, norm, scale, subtract
from rb_dynamics.numerics.vector import multiply as times

_ITERATIONS = 50
# The iteration over a load converges linearly; if its factor is above 1/2, the step does not resolve the motion.
_LOAD_ITERATIONS = 60
_UNKNOWN: Vector = (math.inf, math.inf, math.inf)
# Newton has converged when the angular velocity changes by only a few units in the last place.
_CONVERGED = 4.0 * 2.0**-52
# Below the normal range, a unit in the last place is no longer relative.
_SMALLEST = 2.0**-1071


def step(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,
) -> Increment:
    """Advance by the implicit midpoint rule with attitude R1 = R0 cay(h w) (HLW IV.8.3 and VII.5.3).

    w is the angular velocity of the mean momentum, I w = (m0 + m1)/2, and m1 = cay(h w)^T (m0 + lambda), lambda the
    torque impulse in the axes of R0. For constant torque in body axes lambda = (1 - hat(h w)/2)^-1 h tau, in world
    axes lambda = h R0^T tau. The energy then changes by w . lambda exactly and the world-frame angular momentum by
    lambda exactly; these are added to the totals of work and impulse. A load acts like a wrench in world axes, with the
    value that it has at the midpoint: at h/2, half the displacement and half the turn, with the mean velocities. Order
    2, symmetric.

    Raises:
        ConvergenceError: there is no solution w for this step, or the iteration over the load does not converge.
    """
    if load is None:
        return _step(_iterated, inertia, held, h, velocity, orientation, angular_velocity)
    return _under_load(inertia, held, h, velocity, orientation, angular_velocity, load)


def lane_step(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,  # noqa: ARG001
) -> Increment:
    """Take the same step if Newton's method converges fast, as for rotations below 0.2 rad; else return NaN.

    Without a loop, for many bodies at once (`batch_kernel.py`).
    """
    return _step(_written_out, inertia, held, h, velocity, orientation, angular_velocity)


@compiled_as(NO_INCREMENT)
def _under_load(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load,
) -> Increment:
    mass, moments = inertia
    momentum = norm(times(moments, angular_velocity))
    both, force_0, torque_0, size = held, _UNKNOWN, _UNKNOWN, math.inf
    for _ in range(_LOAD_ITERATIONS):
        try:
            found = _step(_iterated, inertia, both, h, velocity, orientation, angular_velocity)
        except ConvergenceError as error:
            if both is held:
                raise
            raise _disagreement(h, size) from error
        mean_velocity = add_scaled(velocity, 0.5 / mass, found.impulse)
        w = scale(0.5, add(angular_velocity, found.angular_velocity))
        attitude = normalize(multiply(orientation, _half(cayley(scale(h, w)))))
        force, torque = load(0.5 * h, scale(0.5 * h, mean_velocity), mean_velocity, attitude, w)
        if not math.isfinite(norm(force) + norm(torque)):
            raise ConvergenceError(
                f"midpoint: in the middle of a step of {h:g} s the load is {force} N and {torque} N m, expected finite "
                "numbers; check the load, or use a shorter step"
            )
        torque = rotate(attitude, torque)
        # Change of the momenta in the last iteration, relative to their contributions.
        push, twist = abs(h) * norm(subtract(force, force_0)), abs(h) * norm(subtract(torque, torque_0))
        before = size
        size = push / (abs(h) * norm(force) + mass * norm(mean_velocity) + _SMALLEST)
        size += twist / (abs(h) * norm(torque) + momentum + _SMALLEST)
        # Converged, or at the round-off level, where changes no longer shrink.
        if size <= _CONVERGED or 0.5 * before <= size <= 1e-12:
            return found
        both, force_0, torque_0 = held + HeldWrench(force_world=force, torque_world=torque), force, torque
    raise _disagreement(h, size)


def _disagreement(h: float, size: float) -> ConvergenceError:
    return ConvergenceError(
        f"midpoint: the iteration over load and motion does not converge in a step of {h:g} s (its last "
        f"change of the momenta is {size:.3g} of them, expected less than 1e-12); use a step below "
        f"{0.25 * abs(h):.3g} s"
    )


# solve(moments, m0, half_world, target, h): the mean angular velocity, see `_iterated`.
_Solve = Callable[[Vector, Vector, Vector, Vector, float], Vector]


def _step(
    solve: _Solve,
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
) -> Increment:
    mass, moments = inertia
    momentum = times(moments, angular_velocity)
    torque_impulse_world = scale(h, rotate_inverse(orientation, held.torque_world))
    half_world = scale(0.5, torque_impulse_world)
    target = add_scaled(add(momentum, half_world), 0.5 * h, held.torque_body)
    w = solve(moments, momentum, half_world, target, h)
    rate = norm(w)
    if not rate * abs(h) < LARGEST_TURN:
        return turns_too_far("midpoint", h, rate)
    half_turn = scale(0.5 * h, w)
    torque_impulse_body = _half_cayley(half_turn, scale(h, held.torque_body))
    force_impulse_body = _half_cayley(half_turn, scale(h, held.force_body))

    torque_impulse = add(torque_impulse_body, torque_impulse_world)
    turn = cayley(scale(h, w))
    impulse = add_scaled(rotate(orientation, force_impulse_body), h, held.force_world)
    mean_velocity = add_scaled(velocity, 0.5 / mass, impulse)
    return Increment(
        scale(h, mean_velocity),
        renormalize(multiply(orientation, turn)),
        divide(rotate_inverse(turn, add(momentum, torque_impulse)), moments),
        impulse,
        add_scaled(rotate(orientation, torque_impulse_body), h, held.torque_world),
        dot(mean_velocity, impulse) + dot(w, torque_impulse),
    )


def _half(turn: Quaternion) -> Quaternion:
    """Return the rotation by half the angle, for rotations below pi."""
    x, y, z, w = turn
    return normalize((x, y, z, 1.0 + w))


def _half_cayley(a: Vector, u: Vector) -> Vector:
    """Return (1 - hat(a))^-1 u: body-fixed u, averaged over the rotation cay(2 a)."""
    return scale(1.0 / (1.0 + dot(a, a)), add(add(u, cross(a, u)), scale(dot(a, u), a)))


def _iterated(moments: Vector, m0: Vector, half_world: Vector, target: Vector, h: float) -> Vector:
    """Solve I w + (h/2) w x (I w + half_world) = target for w by Newton's method.

    The step's equations with m1 eliminated: half_world = h R0^T tau_world / 2, target = m0 + half_world + h tau_body/2.
    """
    w, size = divide(target, moments), math.inf
    for _ in range(_ITERATIONS):
        w, size, done = _improved(moments, half_world, target, h, w, size)
        if done:
            return w
    return _not_converged(h, norm(w), norm(divide(m0, moments)), size)


def _written_out(moments: Vector, _m0: Vector, half_world: Vector, target: Vector, h: float) -> Vector:
    """Solve the same with at most four iterations, written out; return NaN if they are not enough."""
    w, size, done = _improved(moments, half_world, target, h, divide(target, moments), math.inf)
    w, size, done = _improved_unless(done, moments, half_world, target, h, w, size)
    w, size, done = _improved_unless(done, moments, half_world, target, h, w, size)
    w, size, done = _improved_unless(done, moments, half_world, target, h, w, size)
    return w if done else NOWHERE


def _improved_unless(
    done: bool, moments: Vector, half_world: Vector, target: Vector, h: float, w: Vector, size: float
) -> tuple[Vector, float, bool]:
    better, smaller, now = _improved(moments, half_world, target, h, w, size)
    # Select number by number: selecting between tuples would be a branch.
    kept = (w[0] if done else better[0], w[1] if done else better[1], w[2] if done else better[2])
    return kept, smaller, done or now


def _improved(
    moments: Vector, half_world: Vector, target: Vector, h: float, w: Vector, previous: float
) -> tuple[Vector, float, bool]:
    """Return w after an iteration, its change, and whether it was the last; `previous` is the change before."""
    momentum = times(moments, w)
    lever = add(momentum, half_world)
    residual = subtract(add_scaled(momentum, 0.5 * h, cross(w, lever)), target)
    correction = _solve_jacobian(moments, w, lever, 0.5 * h, residual)
    w = subtract(w, correction)
    size, length = _largest(correction), _largest(w)
    least = _SMALLEST + _SMALLEST / min(moments[0], moments[1], moments[2])
    # Converged, or at the round-off level, where corrections no longer shrink.
    done = size <= _CONVERGED * length + least or (size >= 0.5 * previous and size <= 1e-12 * length)
    return w, size, done


@compiled_as(NOWHERE)
def _not_converged(h: float, rate: float, before: float, last: float) -> Vector:
    raise ConvergenceError(
        f"midpoint: Newton's method did not converge for a step of {h:g} s (last correction {last:.3g} rad/s at "
        f"{rate:.3g} rad/s); use a step below {0.5 / max(before, 1e-300):.3g} s"
    )


def _largest(v: Vector) -> float:
    """Return the largest component: as good as the norm here, without square roots."""
    x, y, z = abs(v[0]), abs(v[1]), abs(v[2])
    larger = x if x > y else y
    return larger if larger > z else z


def _solve_jacobian(moments: Vector, w: Vector, lever: Vector, half: float, b: Vector) -> Vector:
    """Return J^-1 b, J = diag(moments) + half (hat(w) diag(moments) - hat(lever)), by Cramer's rule."""
    # In units of the largest moment, so that the determinant neither underflows nor overflows.
    unit = 1.0 / max(moments[0], moments[1], moments[2])
    i1, i2, i3 = scale(unit, moments)
    x, y, z = w
    p, q, r = scale(unit, lever)
    d = scale(unit, b)
    c1 = (i1, half * (z * i1 - r), half * (q - y * i1))
    c2 = (half * (r - z * i2), i2, half * (x * i2 - p))
    c3 = (half * (y * i3 - q), half * (p - x * i3), i3)
    c23, c31, c12 = cross(c2, c3), cross(c3, c1), cross(c1, c2)
    determinant = dot(c1, c23)
    # Singular: there is no valid correction.
    inverse = 1.0 / determinant if determinant != 0.0 else math.inf
    return scale(inverse, (dot(d, c23), dot(d, c31), dot(d, c12)))


MIDPOINT = Method(
    "midpoint",
    order=2,
    invariants=frozenset({"energy", "angular_momentum", "unit_quaternion"}),
    step=step,
    takes=LoadDependence.ANY,
    compiles=True,
    compiles_loads=False,
)
