"""`WheelSet`: the reaction wheels of one run: which of them turn freely, and their interaction with the body.

A wheel is free, or it is held at a constant speed relative to the body: at rest by friction, or at its largest or its
commanded speed by the drive. A wheel changes between the two only at certain times, between which the motion is smooth;
the engine finds these times (`excess`) and ends a step there.

The states of a run are one momentum about its axis for each wheel, H = J (W + a . w), then the work of the motors and
the heat of friction (J), and what the inner torque adds to the work (J) and the impulse (N m s, world axes). Behind
them comes the angle (rad) of each wheel that has an imbalance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.loads.effect import Stored
from rb_dynamics.loads.reaction_wheel import ReactionWheel
from rb_dynamics.loads.varying_load import Load
from rb_dynamics.loads.wheel_imbalance import imbalances, shaking, time_to_turn
from rb_dynamics.loads.wheel_numbers import (
    BEFORE,
    BOOKS,
    EACH,
    FREE,
    HELD,
    MOTOR,
    POINT,
    begin_wheel,
    bend_and_noise,
    command_wheel,
    excess,
    inner_torque,
    invert_inertia,
    is_far,
    is_held,
    may_stay,
    momentum_in,
    move_on,
    settle,
    spin_up_of,
    switch_wheels,
)
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.numerics.rotation import Quaternion, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, cross, divide, dot, norm, scale, subtract

# Least volume that three unit axes must span; it is 1 if they are perpendicular.
_FLAT = 1e-6


class WheelSet:
    """The wheels of one run, in the order of the scene.

    Attributes:
        imbalances: imbalances of the wheels that have one.
    """

    def __init__(self, wheels: Sequence[ReactionWheel], body: RigidBody) -> None:
        """Start at the speeds of the scene, without torques; a wheel with commanded speed holds its initial speed."""
        self.wheels = tuple(wheels)
        self._moments = body.principal_moments
        self._axes = tuple(wheel.axis_in(body) for wheel in wheels)
        self.imbalances = imbalances(wheels, body)
        # See `wheel_numbers.py`.
        self._now = [float(len(self.wheels)), *(0.0,) * (BEFORE - 1)]
        for wheel, axis in zip(self.wheels, self._axes, strict=True):
            limits = wheel.max_torque, wheel.max_speed, float(wheel.command == "speed"), 0.0, 0.0
            how = FREE, 0.0, 0.0, 0.0, math.nan, -math.inf, math.inf, math.nan
            self._now += (wheel.inertia, *axis, wheel.viscous, wheel.coulomb, *how, *limits)
        for k, wheel in enumerate(self.wheels):
            begin_wheel(self._now, 0, k, wheel.speed)
        invert_inertia(self._now, 0, self._moments)

    @property
    def now(self) -> tuple[float, ...]:
        """How they turn now, for kernels and for `restore`."""
        return tuple(self._now)

    def restore(self, now: Sequence[float]) -> None:
        """Turn as then."""
        self._now = list(now)

    def begin(self, omega: Vector) -> tuple[float, ...]:
        """Return the states at the start, while the body turns with `omega` (principal axes)."""
        momenta = [w.inertia * (w.speed + dot(a, omega)) for w, a in zip(self.wheels, self._axes, strict=True)]
        return (*momenta, *(0.0,) * BOOKS, *(self.wheels[each.wheel].phase for each in self.imbalances))

    def command(self, k: int, value: float, speed: float) -> None:
        """Apply the command of wheel k, which turns with `speed`; `settle` then decides whether it is held."""
        command_wheel(self._now, 0, k, value, speed)

    def move_on(self) -> None:
        """Let time go on: wheels that were released have left their points."""
        move_on(self._now, 0)

    def speeds(self, omega: Vector, states: Sequence[float]) -> tuple[float, ...]:
        """Return the speeds relative to the body, rad/s."""
        parts = zip(states, self.wheels, self._axes, strict=False)
        return tuple([momentum / wheel.inertia - dot(axis, omega) for momentum, wheel, axis in parts])

    def stored(self, omega: Vector, states: Sequence[float]) -> Stored:
        """Return what the wheels add to L = I w (principal axes) and to T = w . I w / 2."""
        momentum, energy = ZERO, 0.0
        for wheel, axis, speed in zip(self.wheels, self._axes, self.speeds(omega, states), strict=True):
            momentum = add_scaled(momentum, wheel.inertia * speed, axis)
            energy += wheel.inertia * speed * (dot(axis, omega) + 0.5 * speed)
        return Stored(momentum, energy)

    def booked(self, states: Sequence[float]) -> tuple[float, float, float, Vector]:
        """Return work of the motors, heat of friction, and work and impulse of the inner torque."""
        count = len(self.wheels)
        motor, heat, work, x, y, z = states[count : count + BOOKS]
        return motor, heat, work, (x, y, z)

    def moved(
        self, before: tuple[Quaternion, Vector], after: tuple[Quaternion, Vector], states: Sequence[float]
    ) -> tuple[float, ...]:
        """Return the states after the body has been moved to attitude and rate `after`; wheels keep their speeds."""
        speeds = zip(self.wheels, self._axes, self.speeds(before[1], states), strict=True)
        momenta = [wheel.inertia * (speed + dot(axis, after[1])) for wheel, axis, speed in speeds]
        was, became = self.stored(before[1], states), self.stored(after[1], momenta)
        turned = subtract(rotate(after[0], became.momentum), rotate(before[0], was.momentum))
        motor, heat, work, impulse = self.booked(states)
        work += became.energy - was.energy
        return (*momenta, motor, heat, work, *subtract(impulse, turned), *self._angles(states))

    def settle(self, torque: Callable[[], Vector], omega: Vector, states: Sequence[float]) -> None:
        """Decide which wheels are held, under a torque from outside (principal axes): asked only where one may be."""
        outside = torque() if may_stay(self._now, 0) else ZERO
        c, n = [*self._now, *states], len(self._now)
        settle(c, 0, n, self._moments, outside, omega)
        self._now = c[:n]

    def excess(
        self, torque: Callable[[], Vector], omega: Vector, states: Sequence[float]
    ) -> tuple[float, Vector | None]:
        """Return how far the wheels are beyond where none switches, positive if one does, and w' if that needs it.

        `torque` as for `settle`.
        """
        c, n, held = [*self._now, *states], len(self._now), is_held(self._now, 0)
        spin_up = spin_up_of(c, 0, n, self._moments, torque(), omega) if held else None
        return max(excess(c, 0, n, k, spin_up or ZERO, omega) for k in range(len(self.wheels))), spin_up

    def is_far(
        self, excess: float, h: float, turning: tuple[Vector, Vector], attitudes: tuple[Quaternion, Quaternion]
    ) -> bool:
        """Return whether no wheel can switch within a step; see `wheel_numbers.is_far`."""
        return is_far(self._now, 0, excess, h, turning, attitudes)

    def spin_up(self, torque: Vector, omega: Vector, states: Sequence[float]) -> Vector:
        """Return w' (principal axes) under `torque` from outside."""
        return spin_up_of([*self._now, *states], 0, len(self._now), self._moments, torque, omega)

    def bend_and_noise(
        self, states: Sequence[float], h: float, turning: tuple[Vector, Vector], gaining: tuple[Vector, Vector]
    ) -> tuple[float, float]:
        """Return bounds on the second derivative of `excess` within a step, and on its rounding errors."""
        return bend_and_noise([*self._now, *states], 0, len(self._now), h, turning, gaining)

    def switch(
        self, torque: Vector, orientation: Quaternion, omega: Vector, states: Sequence[float]
    ) -> tuple[Vector, tuple[float, ...]]:
        """Put free wheels to the point that they have just passed; see `switch_wheels`.

        Return by how much that changes the angular velocity (principal axes) and the states.
        """
        n, count = len(self._now), len(self.wheels) + BOOKS
        c = [*self._now, *states[:count], *states[:count]]
        change = switch_wheels(c, 0, n, self._moments, torque, orientation, omega)
        self._now = c[:n]
        return change, (*c[-count:], *(0.0,) * len(self.imbalances))

    def stage(
        self, torque: Vector, orientation: Quaternion, omega: Vector, states: Sequence[float]
    ) -> tuple[Vector, tuple[float, ...]]:
        """Return the inner torque on the body (principal axes), and the rates of the states, under `torque`."""
        numbers, count = self._now, len(self.wheels) + BOOKS
        c = [*numbers, *states[:count], *states[:count]]
        inner = inner_torque(c, 0, len(numbers), self._moments, torque, orientation, omega)
        turning = () if not self.imbalances else self.speeds(omega, states)
        return inner, (*c[-count:], *(turning[each.wheel] for each in self.imbalances))

    def turned(self, states: Sequence[float], start: Sequence[float]) -> Vector:
        """Return the change of angular velocity (principal axes) that corresponds to a change of the states.

        With another direction of the imbalance, the body has another mean rate.
        """
        off = momentum_in([*self._now, *states], 0, len(self._now))
        for each, angle in zip(self.imbalances, self._angles(states), strict=True):
            speed = start[each.wheel] / self.wheels[each.wheel].inertia
            off = add_scaled(off, speed * angle, each.torques[0])
        return divide(off, self._moments)

    def shaking(self, omega: Vector, states: Sequence[float]) -> tuple[Vector, Vector]:
        """Return force (N) and torque about the centre of mass (N m) of the imbalances, principal axes."""
        speeds = list(self.speeds(omega, states))
        for k, *_ in self.imbalances:
            a = BEFORE + k * EACH
            # The speed of a wheel held at rest is rounded. As the only force on a body, its square would be an error as
            # large as the distance that the body covers, in a step of any length.
            if self._now[a + HELD] != FREE and self._now[a + POINT] == 0.0:
                speeds[k] = 0.0
        return shaking(self.imbalances, speeds, self._angles(states))

    def sight(self, omega: Vector, states: Sequence[float]) -> float:
        """Return for how long (s) the present loads of the imbalances predict those ahead."""
        speeds, times = self.speeds(omega, states), [math.inf]
        for k, *_ in self.imbalances:
            wheel, a = self.wheels[k], BEFORE + k * EACH
            torque = abs(self._now[a + MOTOR]) + wheel.coulomb + wheel.viscous * abs(speeds[k])
            torque = torque if self._now[a + HELD] == FREE else 0.0
            times.append(time_to_turn(speeds[k], torque / wheel.inertia))
        return min(times)

    def _angles(self, states: Sequence[float]) -> Sequence[float]:
        """Return the angles (rad) of the wheels that have an imbalance."""
        return states[len(self.wheels) + BOOKS :]


def shares(axes: Sequence[Vector]) -> list[Vector] | None:
    """Return a row for each axis, whose product with a vector is the component along that axis.

    The components add up to the vector, and the sum of their squares is least. For unit vectors a, x = a . (sum of
    a a^T)^-1 v. None if the axes lie in one plane.
    """
    axes = [scale(1.0 / norm(axis), axis) for axis in axes]
    xx, xy, xz, yy, yz, zz = (math.fsum(axis[i] * axis[k] for axis in axes) for i in range(3) for k in range(i, 3))
    one, two, three = (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)
    across = cross(two, three), cross(three, one), cross(one, two)
    volume = dot(one, across[0])
    if volume < _FLAT:
        return None
    # The matrix is symmetric, and so is its inverse.
    x, y, z = (scale(1.0 / volume, each) for each in across)
    return [(dot(axis, x), dot(axis, y), dot(axis, z)) for axis in axes]


class WheelLoad:
    """The load of one step with wheels: other loads, and the wheels' torque on the body.

    Attributes:
        states: at the start of the step.
    """

    def __init__(self, wheels: WheelSet, held: HeldWrench, load: Load | None, states: tuple[float, ...]) -> None:
        """Begin a step under a held wrench (principal axes) and another load."""
        self._wheels, self._held, self._load, self.states = wheels, held, load, states

    def __call__(
        self, t: float, displacement: Vector, velocity: Vector, orientation: Quaternion, angular_velocity: Vector
    ) -> tuple[Vector, Vector]:
        """Return force and torque with the wheels as they are at the start of the step."""
        force, torque, _ = self.stage(t, displacement, velocity, orientation, angular_velocity, self.states)
        return force, torque

    def outside(
        self,
        t: float,
        displacement: Vector,
        velocity: Vector,
        orientation: Quaternion,
        angular_velocity: Vector,
        states: tuple[float, ...],
    ) -> tuple[Vector, Vector, Vector]:
        """Return force and torque of the other load and of imbalances, and the sum of all external torques."""
        force, torque = ZERO, ZERO
        if self._load is not None:
            force, torque = self._load(t, displacement, velocity, orientation, angular_velocity)
        if self._wheels.imbalances:
            push, twist = self._wheels.shaking(angular_velocity, states)
            force, torque = add(force, rotate(orientation, push)), add(torque, twist)
        held = add(self._held.torque_body, rotate_inverse(orientation, self._held.torque_world))
        return force, torque, add(held, torque)

    def stage(
        self,
        t: float,
        displacement: Vector,
        velocity: Vector,
        orientation: Quaternion,
        angular_velocity: Vector,
        states: tuple[float, ...],
    ) -> tuple[Vector, Vector, tuple[float, ...]]:
        """Return force and torque, the inner one included, and the rates of the states."""
        force, torque, outside = self.outside(t, displacement, velocity, orientation, angular_velocity, states)
        inner, rates = self._wheels.stage(outside, orientation, angular_velocity, states)
        return force, add(torque, inner), rates

    def turned(self, states: tuple[float, ...]) -> Vector:
        """As `WheelSet.turned`, from the states at the start of the step."""
        return self._wheels.turned(states, self.states)
