"""`PhaseState`: the state inside a run, about the centre of mass and in principal axes, with work and impulses.

It is converted from and to `State` only at the ends of a run and at outputs, so that conversions add no rounding.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.loads.effect import Point
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.method import Increment, Inertia
from rb_dynamics.numerics.rotation import Quaternion, conjugate, multiply, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, cross, dot, norm, scale, subtract
from rb_dynamics.numerics.vector import multiply as times

SUMS = 14
"""Sums carried with compensation: position of the centre of mass, linear momentum, impulse, torque impulse (world axes,
three each), work, and the time since the start. Inner states, such as those of wheels, follow them."""
Sums = tuple[float, ...]
POSITION, MOMENTUM, IMPULSE, TORQUE_IMPULSE = 0, 3, 6, 9
"""Offset of each of these vectors among the sums."""


class PhaseState(NamedTuple):
    """A point of phase space, with the accumulated work and impulses.

    Attributes:
        orientation: principal to world axes.
        angular_velocity: principal axes, rad/s; used in place of the momentum so that the initial value keeps its
            digits.
        high: the compensated sums, see `SUMS`.
        low: their rounding errors; the value is high + low.
    """

    orientation: Quaternion
    angular_velocity: Vector
    high: Sums
    low: Sums

    @classmethod
    def of(cls, body: RigidBody, state: State, time: float = 0.0) -> PhaseState:
        """Return the phase of `body` in `state`, with work and impulses 0, `time` s after the start."""
        arm = rotate(state.orientation_xyzw, body.center_of_mass)
        omega = rotate_inverse(body.principal_orientation_xyzw, state.angular_velocity_body)
        spin = rotate(state.orientation_xyzw, cross(state.angular_velocity_body, body.center_of_mass))
        position = add(state.position_world, arm)
        momentum = scale(body.mass, add(state.linear_velocity_world, spin))
        return cls(
            multiply(state.orientation_xyzw, body.principal_orientation_xyzw),
            omega,
            (*position, *momentum, *ZERO, *ZERO, 0.0, time),
            (0.0,) * SUMS,
        )

    def after(self, step: Increment, h: float) -> PhaseState:
        """Return the phase after a step of h s; the sums are compensated, see `grown`."""
        high, low = grown(self.high, self.low, step, h)
        return PhaseState(step.orientation, step.angular_velocity, high, low)

    @property
    def inner(self) -> Sums:
        """Inner states, such as those of wheels."""
        return tuple([a + b for a, b in zip(self.high[SUMS:], self.low[SUMS:], strict=True)])

    def with_inner(self, states: Sums) -> PhaseState:
        """Return the same phase with these inner states."""
        return self._replace(high=(*self.high[:SUMS], *states), low=(*self.low[:SUMS], *(0.0,) * len(states)))

    @property
    def center_of_mass_world(self) -> Vector:
        """Position of the centre of mass, m."""
        return total(self, POSITION)

    @property
    def linear_momentum_world(self) -> Vector:
        """kg m/s."""
        return total(self, MOMENTUM)

    @property
    def impulse_world(self) -> Vector:
        """Integral of the force since the start, N s."""
        return total(self, IMPULSE)

    @property
    def torque_impulse_world(self) -> Vector:
        """Integral of the torque about the centre of mass since the start, N m s."""
        return total(self, TORQUE_IMPULSE)

    @property
    def work(self) -> float:
        """Work of all loads since the start, J."""
        return self.high[12] + self.low[12]

    @property
    def time(self) -> float:
        """Time since the start of the run, s."""
        return elapsed(self)

    def point(self, body: RigidBody) -> Point:
        """Return the variables that effects may depend on."""
        velocity = scale(1.0 / body.mass, self.linear_momentum_world)
        return Point(self.time, self.center_of_mass_world, velocity, self.orientation, self.angular_velocity)

    def angular_momentum_world(self, body: RigidBody) -> Vector:
        """Return L = I w about the centre of mass, kg m^2/s (lecture 24, page 22), without parts that move inside."""
        return rotate(self.orientation, times(body.principal_moments, self.angular_velocity))

    def state(self, body: RigidBody, time_ns: int) -> State:
        """Return the state of `body` in this phase: body origin and body axes again."""
        velocity = scale(1.0 / body.mass, self.linear_momentum_world)
        at, q, w = self.center_of_mass_world, self.orientation, self.angular_velocity
        return State(time_ns, *of_origin(body.center_of_mass, body.principal_orientation_xyzw, at, q, velocity, w))


class RoundingHistory(NamedTuple):
    """Quantities of a run, over all arcs, that bound the growth of rounding errors.

    Attributes:
        arcs: number of arcs.
        turned: total rotation, rad.
        travelled: path of the centre of mass, m.
        rates: sum of the angular rates at the starts of all arcs but the first, rad/s: at each start the rate is
            rounded.
        speeds: the same sum of the speeds, m/s.
    """

    arcs: int = 0
    turned: float = 0.0
    travelled: float = 0.0
    rates: float = 0.0
    speeds: float = 0.0

    def on(self, inertia: Inertia, start: PhaseState, end: PhaseState) -> RoundingHistory:
        """Return the history with another arc from `start` to `end`, see `with_arc`."""
        return with_arc(self, inertia, start, end)


def with_arc(before: RoundingHistory, inertia: Inertia, start: PhaseState, end: PhaseState) -> RoundingHistory:
    """Return `before` with another arc from `start` to `end`, assuming that the largest speeds are at its ends."""
    time = elapsed(end) - elapsed(start)
    rate, speed = norm(start.angular_velocity), norm(total(start, MOMENTUM)) / inertia.mass
    return RoundingHistory(
        before.arcs + 1,
        before.turned + max(rate, norm(end.angular_velocity)) * time,
        before.travelled + max(speed, norm(total(end, MOMENTUM)) / inertia.mass) * time,
        before.rates + (rate if before.arcs > 0 else 0.0),
        before.speeds + (speed if before.arcs > 0 else 0.0),
    )


def of_origin(
    center_of_mass: Vector,
    axes: Quaternion,
    position: Vector,
    orientation: Quaternion,
    velocity: Vector,
    angular_velocity: Vector,
) -> tuple[Vector, Quaternion, Vector, Vector]:
    """Return position, attitude, velocity and angular velocity of body origin and body axes.

    Args:
        center_of_mass: from the body origin, body axes, m.
        axes: principal to body axes.
        position: of the centre of mass, world axes, m.
        orientation: principal to world axes.
        velocity: of the centre of mass, world axes, m/s.
        angular_velocity: principal axes, rad/s.
    """
    orientation = multiply(orientation, conjugate(axes))
    omega = rotate(axes, angular_velocity)
    return (
        subtract(position, rotate(orientation, center_of_mass)),
        orientation,
        subtract(velocity, rotate(orientation, cross(omega, center_of_mass))),
        omega,
    )


def total(phase: PhaseState, first: int) -> Vector:
    """Return the vector at offset `first` of the sums of `phase`."""
    h, low, i = phase.high, phase.low, first
    return (h[i] + low[i], h[i + 1] + low[i + 1], h[i + 2] + low[i + 2])


def gain(before: PhaseState, after: PhaseState, first: int) -> Vector:
    """Return the change of the vector at offset `first` of the sums, without cancellation."""
    a, b, c, d, i = after.high, after.low, before.high, before.low, first
    return (
        (a[i] - c[i]) + (b[i] - d[i]),
        (a[i + 1] - c[i + 1]) + (b[i + 1] - d[i + 1]),
        (a[i + 2] - c[i + 2]) + (b[i + 2] - d[i + 2]),
    )


def elapsed(phase: PhaseState) -> float:
    """Return the time since the start of the run, s."""
    return phase.high[13] + phase.low[13]


def time_between(before: PhaseState, after: PhaseState) -> float:
    """Return the time from one phase of a run to another, s, without cancellation."""
    return (after.high[13] - before.high[13]) + (after.low[13] - before.low[13])


def is_finite(phase: PhaseState) -> bool:
    """Return whether attitude, rate and sums are finite, and so is their total.

    The rounding error of a finite sum is finite.
    """
    (a, b, c, d), (e, f, g), h = phase.orientation, phase.angular_velocity, phase.high
    rotation = a + b + c + d + e + f + g
    sums = h[0] + h[1] + h[2] + h[3] + h[4] + h[5] + h[6] + h[7] + h[8] + h[9] + h[10] + h[11] + h[12] + h[13]
    return math.isfinite(rotation + sums)


def grown(high: Sums, low: Sums, step: Increment, h: float) -> tuple[Sums, Sums]:
    """Return the sums after a step of h s, and their rounding errors.

    By two-sum (Knuth, TAOCP 2, 4.2.2 theorem B): the error of 1e9 additions stays at one rounding.
    """
    x, p, t = step.displacement, step.impulse, step.torque_impulse
    a0, b0 = two_sum(high[0], x[0], low[0])
    a1, b1 = two_sum(high[1], x[1], low[1])
    a2, b2 = two_sum(high[2], x[2], low[2])
    a3, b3 = two_sum(high[3], p[0], low[3])
    a4, b4 = two_sum(high[4], p[1], low[4])
    a5, b5 = two_sum(high[5], p[2], low[5])
    a6, b6 = two_sum(high[6], p[0], low[6])
    a7, b7 = two_sum(high[7], p[1], low[7])
    a8, b8 = two_sum(high[8], p[2], low[8])
    a9, b9 = two_sum(high[9], t[0], low[9])
    a10, b10 = two_sum(high[10], t[1], low[10])
    a11, b11 = two_sum(high[11], t[2], low[11])
    a12, b12 = two_sum(high[12], step.work, low[12])
    a13, b13 = two_sum(high[13], h, low[13])
    return (
        (a0, a1, a2, a3, a4, a5, a6, a7, a8, a9, a10, a11, a12, a13),
        (b0, b1, b2, b3, b4, b5, b6, b7, b8, b9, b10, b11, b12, b13),
    )


def spun(phase: PhaseState, moments: Vector, change: Vector) -> PhaseState:
    """Return `phase`, without inner states, after a change of its angular velocity by a torque that acts at once."""
    turn, omega = times(moments, change), phase.angular_velocity
    work, impulse = dot(turn, add_scaled(omega, 0.5, change)), rotate(phase.orientation, turn)
    step = Increment(ZERO, phase.orientation, add(omega, change), ZERO, impulse, work)
    high, low = grown(phase.high, phase.low, step, 0.0)
    return PhaseState(step.orientation, step.angular_velocity, high, low)


def two_sum(a: float, b: float, rest: float) -> tuple[float, float]:
    """Return a + b, and `rest` with its rounding error (Knuth, TAOCP 2, 4.2.2 theorem B)."""
    total = a + b
    part = total - a
    return total, rest + ((a - (total - part)) + (b - part))


def inertia_of(body: RigidBody) -> Inertia:
    """Return the mass properties of `body` for a step. A particle never rotates; its moments must only be non-zero."""
    return Inertia(body.mass, (1.0, 1.0, 1.0) if body.is_particle else body.principal_moments)


def in_principal_axes(body: RigidBody, held: HeldWrench) -> HeldWrench:
    """Return `held` with its body parts in principal axes."""
    axes = body.principal_orientation_xyzw
    return HeldWrench(
        rotate_inverse(axes, held.force_body),
        rotate_inverse(axes, held.torque_body),
        held.force_world,
        held.torque_world,
    )
