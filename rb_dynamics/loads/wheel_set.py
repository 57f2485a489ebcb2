"""`WheelSet`: the reaction wheels of one run: which of them turn freely, and their interaction with the body.

A wheel is free, or it is held at a constant speed relative to the body: at rest by friction, or at its largest or its
commanded speed by the drive. A wheel changes between the two only at certain times, between which the motion is smooth;
the engine finds these times (`switching`) and ends a step there.

The states of a run are one momentum about its axis for each wheel, H = J (W + a . w), then the work of the motors and
the heat of friction (J), and what the inner torque adds to the work (J) and the impulse (N m s, world axes). Behind
them comes the angle (rad) of each wheel that has an imbalance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.loads.effect import Stored
from rb_dynamics.loads.load import Load
from rb_dynamics.loads.reaction_wheel import ReactionWheel
from rb_dynamics.loads.wheel_imbalance import imbalances, shaking, time_to_turn
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.numerics.rotation import Matrix, Quaternion, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, cross, divide, dot, norm, scale, subtract
from rb_dynamics.numerics.vector import multiply as times

if TYPE_CHECKING:
    from rb_dynamics.numerics.array_types import Numbers

# Least volume that three unit axes must span; it is 1 if they are perpendicular.
_FLAT = 1e-6

_ACCUMULATED = 6
"""Number of states after the momenta: motor work, friction heat, work and impulse of the inner torque."""

# Numbers that `inner_torque` reads: number of wheels, and row by row the inverse of the inertia without the free ones;
# then for each wheel inertia and axis, viscous and Coulomb friction, state (one of the next three) and, while it is
# free, torque of the motor and constant part of the friction.
_BEFORE, _EACH = 10, 9
_FREE, _AT_SPEED, _AT_REST = 0.0, 1.0, 2.0


class _Wheel(NamedTuple):
    """The present state of motion of a wheel.

    Attributes:
        command: torque (N m) or speed (rad/s).
        point: the speed at which the wheel may be held: rest, its largest or its commanded speed; None at other speeds.
        held: whether it is held there.
        motor: torque of the motor while it is free, N m.
        coulomb: constant part of the friction's torque while it is free, N m.
        low: lower end of the range of speeds in which it stays free, rad/s.
        high: upper end of that range, rad/s.
        left: the point from which it was released at the present time; None otherwise.
    """

    command: float
    point: float | None = None
    held: bool = False
    motor: float = 0.0
    coulomb: float = 0.0
    low: float = -math.inf
    high: float = math.inf
    left: float | None = None

    @property
    def where(self) -> float | None:
        """The point at which the wheel is, held or not; None at other speeds."""
        return self.left if self.point is None else self.point


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
        self._numbers: tuple[float, ...] | None = None
        self._now = [_Wheel(wheel.speed if wheel.command == "speed" else 0.0) for wheel in wheels]
        for k, wheel in enumerate(wheels):
            self._place(k, wheel.speed)
        self._invert()

    @property
    def now(self) -> list[_Wheel]:
        """Present state of motion of each wheel, for `restore`."""
        return list(self._now)

    def restore(self, now: Sequence[_Wheel]) -> None:
        """Return to an earlier state of motion."""
        self._now = list(now)
        self._invert()

    @property
    def numbers(self) -> tuple[float, ...]:
        """Numbers of the present state of motion, for kernels; see `_BEFORE`."""
        if self._numbers is None:
            found = [float(len(self.wheels)), *(each for row in self._inverse for each in row)]
            for wheel, axis, now in zip(self.wheels, self._axes, self._now, strict=True):
                held = _FREE if not now.held else _AT_REST if now.point == 0.0 else _AT_SPEED
                found += (wheel.inertia, *axis, wheel.viscous, wheel.coulomb, held, now.motor, now.coulomb)
            self._numbers = tuple(found)
        return self._numbers

    def begin(self, omega: Vector) -> tuple[float, ...]:
        """Return the states at the start, while the body turns with `omega` (principal axes)."""
        momenta = [w.inertia * (w.speed + dot(a, omega)) for w, a in zip(self.wheels, self._axes, strict=True)]
        return (*momenta, *(0.0,) * _ACCUMULATED, *(self.wheels[each.wheel].phase for each in self.imbalances))

    def command(self, k: int, value: float, speed: float) -> None:
        """Apply the command of wheel k, which turns with `speed`; `settle` then decides whether it is held."""
        point = self._now[k].where
        self._set(k, command=value, point=point)
        # It may still be held at rest or at its largest speed, but not at a speed that was commanded before.
        if point is None or point not in self._points(k):
            self._place(k, speed)

    def move_on(self) -> None:
        """Record that time advances: released wheels have left their points."""
        if any(wheel.left is not None for wheel in self._now):
            self._now = [wheel._replace(left=None) for wheel in self._now]

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
        motor, heat, work, x, y, z = states[count : count + _ACCUMULATED]
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
        """Decide which wheels are held, under an external torque (principal axes).

        First, all wheels at a point are held; then those that cannot be held are released, until all others can.
        Earlier decisions at the same time do not matter, so that commands of one time may come one by one.
        """
        speeds = self.speeds(omega, states)
        self._now = [wheel._replace(point=wheel.where, held=wheel.where is not None) for wheel in self._now]
        while True:
            self._invert()
            if not any(wheel.held for wheel in self._now):
                return
            spin_up = self._spin_up(torque(), omega, states)
            going = [(k, way) for k in range(len(speeds)) if (way := self._way_out(k, spin_up, speeds[k]))]
            if not going:
                return
            self._let_go(*going[0], speeds[going[0][0]])

    def switching(self, torque: Callable[[], Vector], omega: Vector, states: Sequence[float]) -> list[int]:
        """Return the wheels whose state of motion has to change; `torque` as for `settle`."""
        speeds = self.speeds(omega, states)
        spin_up = self._spin_up(torque(), omega, states) if any(wheel.held for wheel in self._now) else ZERO
        return [
            k
            for k, (wheel, speed) in enumerate(zip(self._now, speeds, strict=True))
            if (self._way_out(k, spin_up, speed) if wheel.held else not wheel.low <= speed <= wheel.high)
        ]

    def switch(self, wheels: Sequence[int], omega: Vector, states: Sequence[float]) -> None:
        """Set free wheels from `switching` to the point that they have just passed."""
        speeds = self.speeds(omega, states)
        for k in wheels:
            wheel = self._now[k]
            if not wheel.held:
                passed = wheel.low if speeds[k] < wheel.low else wheel.high
                points = self._points(k)
                self._set(k, point=min(points, key=lambda point: abs(point - passed)))

    def stage(
        self, torque: Vector, orientation: Quaternion, omega: Vector, states: Sequence[float]
    ) -> tuple[Vector, tuple[float, ...]]:
        """Return the inner torque on the body (principal axes), and the rates of the states, under `torque`."""
        numbers, count = self.numbers, len(self.wheels) + _ACCUMULATED
        c: Any = [*numbers, *states[:count], *states[:count]]
        inner = inner_torque(c, 0, len(numbers), self._moments, torque, orientation, omega)
        turning = () if not self.imbalances else self.speeds(omega, states)
        return inner, (*c[-count:], *(turning[each.wheel] for each in self.imbalances))

    def turned(self, states: Sequence[float], start: Sequence[float]) -> Vector:
        """Return the change of angular velocity (principal axes) that corresponds to a change of the states.

        With another direction of the imbalance, the body has another mean rate.
        """
        numbers = self.numbers
        c: Any = [*numbers, *states]
        off = momentum_in(c, 0, len(numbers))
        for each, angle in zip(self.imbalances, self._angles(states), strict=True):
            speed = start[each.wheel] / self.wheels[each.wheel].inertia
            off = add_scaled(off, speed * angle, each.torques[0])
        return divide(off, self._moments)

    def shaking(self, omega: Vector, states: Sequence[float]) -> tuple[Vector, Vector]:
        """Return force (N) and torque about the centre of mass (N m) of the imbalances, principal axes."""
        return shaking(self.imbalances, self.speeds(omega, states), self._angles(states))

    def sight(self, omega: Vector, states: Sequence[float]) -> float:
        """Return for how long (s) the present loads of the imbalances predict those ahead."""
        speeds, times = self.speeds(omega, states), [math.inf]
        for k, *_ in self.imbalances:
            wheel, now = self.wheels[k], self._now[k]
            torque = 0.0 if now.held else abs(now.motor) + wheel.coulomb + wheel.viscous * abs(speeds[k])
            times.append(time_to_turn(speeds[k], torque / wheel.inertia))
        return min(times)

    def _angles(self, states: Sequence[float]) -> Sequence[float]:
        """Return the angles (rad) of the wheels that have an imbalance."""
        return states[len(self.wheels) + _ACCUMULATED :]

    def _points(self, k: int) -> tuple[float, ...]:
        """Return the speeds at which a wheel may be held."""
        wheel = self.wheels[k]
        points = [-wheel.max_speed, wheel.max_speed] if wheel.max_speed < math.inf else []
        points += [0.0] if wheel.coulomb > 0.0 else []
        return (*points, *([self._now[k].command] if wheel.command == "speed" else []))

    def _place(self, k: int, speed: float) -> None:
        """Set the state of motion of a wheel from its speed alone."""
        points = self._points(k)
        if speed in points:
            self._set(k, point=speed, left=None)
            return
        low = max((point for point in points if point < speed), default=-math.inf)
        high = min((point for point in points if point > speed), default=math.inf)
        self._free(k, low, high, math.copysign(1.0, speed))

    def _let_go(self, k: int, way: float, speed: float) -> None:
        """Release a wheel from its point, up (1) or down (-1)."""
        point, points = self._now[k].point, self._points(k)
        assert point is not None
        # It was set to its point within a nanosecond of passing it, and is beyond it by that much.
        if way > 0.0:
            high = min((other for other in points if other > point), default=math.inf)
            self._free(k, min(point, speed), high, math.copysign(1.0, point) if point else way)
        else:
            low = max((other for other in points if other < point), default=-math.inf)
            self._free(k, low, max(point, speed), math.copysign(1.0, point) if point else way)
        self._set(k, left=point)

    def _free(self, k: int, low: float, high: float, sign: float) -> None:
        """Let a wheel turn freely between two speeds; `sign` is that of its speed."""
        wheel, now = self.wheels[k], self._now[k]
        motor = now.command
        if wheel.command == "speed":
            motor = -wheel.max_torque if low + high > 2.0 * now.command else wheel.max_torque
        self._set(k, point=None, held=False, motor=motor, coulomb=-sign * wheel.coulomb, low=low, high=high, left=None)

    def _set(self, k: int, **how: Any) -> None:
        """Change the state of motion of a wheel."""
        self._now[k] = self._now[k]._replace(**how)
        self._numbers = None

    def _sliding(self, k: int, speed: float) -> float:
        wheel = self.wheels[k]
        return -math.copysign(wheel.coulomb, speed) - wheel.viscous * speed

    def _way_out(self, k: int, spin_up: Vector, speed: float) -> float:
        """Return in which direction a held wheel is released, if nothing can hold it: up (1), down (-1) or none (0)."""
        wheel, now = self.wheels[k], self._now[k]
        if not now.held or now.point is None:
            return 0.0
        needed = wheel.inertia * dot(self._axes[k], spin_up)
        least = most = now.command
        if wheel.command == "speed":
            least = most = math.copysign(wheel.max_torque, now.command - now.point)
            if now.point == now.command:
                least, most = -wheel.max_torque, wheel.max_torque
        if now.point == 0.0:
            least, most = least - wheel.coulomb, most + wheel.coulomb
        else:
            friction = self._sliding(k, speed)
            least, most = least + friction, most + friction
        if now.point == wheel.max_speed:
            least = -math.inf
        elif now.point == -wheel.max_speed:
            most = math.inf
        return -1.0 if needed > most else 1.0 if needed < least else 0.0

    def _spin_up(self, torque: Vector, omega: Vector, states: Sequence[float]) -> Vector:
        """Return w' (principal axes) under an external torque, in the present state of motion of the wheels."""
        numbers = self.numbers
        c: Any = [*numbers, *states]
        return spin_up_of(c, 0, len(numbers), self._moments, torque, omega)

    def _invert(self) -> None:
        self._inverse, self._numbers = self._inverted(), None

    def _inverted(self) -> Matrix:
        """Return the inverse of the inertia without the free wheels: I - sum of J a a^T, symmetric."""
        (a, b, c), d, e, f = self._moments, 0.0, 0.0, 0.0
        for wheel, (x, y, z), now in zip(self.wheels, self._axes, self._now, strict=True):
            j = 0.0 if now.held else wheel.inertia
            a, b, c, d, e, f = a - j * x * x, b - j * y * y, c - j * z * z, d - j * x * y, e - j * x * z, f - j * y * z
        one, two, three = b * c - f * f, e * f - d * c, d * f - e * b
        s = 1.0 / (a * one + d * two + e * three)
        four, five, six = s * (a * c - e * e), s * (d * e - a * f), s * (a * b - d * d)
        one, two, three = s * one, s * two, s * three
        return ((one, two, three), (two, four, five), (three, five, six))


def length_of(c: Numbers, i: int) -> int:
    """Return the size of the numbers of wheels that begin at i."""
    return _BEFORE + _EACH * int(c[i])


def states_of(c: Numbers | Sequence[float], i: int) -> int:
    """Return the number of states of the wheels whose numbers begin at i."""
    return int(c[i]) + _ACCUMULATED


def inner_torque(
    c: Numbers, i: int, s: int, moments: Vector, torque: Vector, orientation: Quaternion, omega: Vector
) -> Vector:
    """Return the inner torque on the body (principal axes) under the external `torque`; write the rates of the states.

    In `c`, `WheelSet.numbers` begin at i and the states at s, followed by their rates.
    """
    spin_up, carried, n = spin_up_of(c, i, s, moments, torque, omega), ZERO, int(c[i])
    for k in range(n):
        j, axis = c[i + _BEFORE + k * _EACH], _axis_of(c, i, k)
        carried = add_scaled(carried, j * _speed_of(c, i, s, k, omega), axis)
    inner, r = cross(carried, omega), s + n + _ACCUMULATED
    motor = heat = power = 0.0
    for k in range(n):
        a, axis, speed = i + _BEFORE + k * _EACH, _axis_of(c, i, k), _speed_of(c, i, s, k, omega)
        taken, held = c[a] * dot(axis, spin_up), c[a + 6]
        if held == _FREE:
            friction = c[a + 8] - c[a + 4] * speed
            on_wheel = c[a + 7] + friction
            inner = add_scaled(inner, taken - on_wheel, axis)
        else:
            on_wheel, friction = taken, 0.0
            if held == _AT_SPEED:
                friction = -math.copysign(c[a + 5], speed) - c[a + 4] * speed
        c[r + k] = on_wheel
        motor, heat = motor + (on_wheel - friction) * speed, heat - friction * speed
        power += on_wheel * speed
    c[r + n], c[r + n + 1], c[r + n + 2] = motor, heat, power - dot(inner, omega)
    c[r + n + 3], c[r + n + 4], c[r + n + 5] = rotate(orientation, inner)
    return inner


def spin_up_of(c: Numbers, i: int, s: int, moments: Vector, torque: Vector, omega: Vector) -> Vector:
    """Return w' (principal axes) under the external `torque`; see `inner_torque`."""
    momentum, push = times(moments, omega), torque
    for k in range(int(c[i])):
        a, axis, speed = i + _BEFORE + k * _EACH, _axis_of(c, i, k), _speed_of(c, i, s, k, omega)
        momentum = add_scaled(momentum, c[a] * speed, axis)
        if c[a + 6] == _FREE:
            push = add_scaled(push, -(c[a + 7] + c[a + 8] - c[a + 4] * speed), axis)
    x, y, z = add(push, cross(momentum, omega))
    one, two = (c[i + 1], c[i + 2], c[i + 3]), (c[i + 4], c[i + 5], c[i + 6])
    return add(add(scale(x, one), scale(y, two)), scale(z, (c[i + 7], c[i + 8], c[i + 9])))


def momentum_in(c: Numbers, i: int, s: int) -> Vector:
    """Return the sum of the momenta at s along their axes; see `inner_torque`."""
    total = ZERO
    for k in range(int(c[i])):
        total = add_scaled(total, c[s + k], _axis_of(c, i, k))
    return total


def _speed_of(c: Numbers, i: int, s: int, k: int, omega: Vector) -> float:
    speed: float = c[s + k] / c[i + _BEFORE + k * _EACH] - dot(_axis_of(c, i, k), omega)
    return speed


def _axis_of(c: Numbers, i: int, k: int) -> Vector:
    a = i + _BEFORE + k * _EACH
    return (c[a + 1], c[a + 2], c[a + 3])


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
