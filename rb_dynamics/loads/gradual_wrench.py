"""`Transient`: the transition from one held wrench to the next: the lag of a channel, the rise and fall of a thruster.

The wrench in between is known in closed form: a weighted mean of the two, with a weight that changes exponentially or
linearly. So it needs no state, and depends neither on steps nor on outputs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.loads.varying_load import Load
from rb_dynamics.loads.wrench import HeldWrench, combined
from rb_dynamics.numerics.nanoseconds import NANOSECONDS, nanoseconds
from rb_dynamics.numerics.rotation import IDENTITY, Quaternion, conjugate, multiply, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add

# Time constants after which an exponential change counts as complete: exp(-40) = 4e-18 of it is below round-off.
_OVER = 40.0


class Transient(NamedTuple):
    """A wrench that changes gradually from `since_ns` on.

    Attributes:
        before: the wrench at `since_ns`.
        after: the wrench at the end.
        since_ns: start time.
        length: time constant of an exponential change, or duration of a linear one, s.
        is_linear: whether the change is linear.
    """

    before: HeldWrench
    after: HeldWrench
    since_ns: int
    length: float
    is_linear: bool = False

    @property
    def end_ns(self) -> int:
        """End time."""
        return self.since_ns + _lasting_ns(self.length if self.is_linear else _OVER * self.length)

    def aged(self, age: float) -> HeldWrench:
        """Return the wrench `age` s after the start."""
        return aged(self.before, self.after, self.length, self.is_linear, age)

    def at(self, time_ns: int) -> HeldWrench:
        """Return the wrench at a time."""
        return self.aged((time_ns - self.since_ns) / NANOSECONDS)

    def sight(self, age: float) -> float:
        """Return for how long (s) it can be predicted `age` s after the start."""
        return sight(self.length, self.is_linear, age)


# Asked several times at each edge, where exact rounding takes longer than a compiled step.
@lru_cache(maxsize=64)
def _lasting_ns(length: float) -> int:
    return max(1, nanoseconds(length))


def aged(before: HeldWrench, after: HeldWrench, length: float, is_linear: bool, age: float) -> HeldWrench:
    """Return the wrench of a `Transient` `age` s after its start.

    With two weights the result is exact to a few roundings of itself, also where it begins or ends at zero.
    """
    if is_linear:
        # It ends within a nanosecond of its length. A step that is tried beyond, in a search for switches of wheels,
        # must not see it grow without bound.
        part = min(age, length + 1e-9) / length
        return combined(1.0 - part, before, part, after)
    part = age / length
    return combined(math.exp(-part), before, -math.expm1(-part), after)


def sight(length: float, is_linear: bool, age: float) -> float:
    """Return for how long (s) a `Transient` can be predicted: a step over many time constants would skip it."""
    return math.inf if is_linear else length * math.exp(min(age / length, _OVER))


def with_acting(acting: HeldWrench, force: Vector, torque: Vector, orientation: Quaternion) -> tuple[Vector, Vector]:
    """Return force (world axes) and torque (principal axes) with those of a wrench, body parts in principal axes."""
    force = add(force, add(acting.force_world, rotate(orientation, acting.force_body)))
    return force, add(torque, add(acting.torque_body, rotate_inverse(orientation, acting.torque_world)))


def seen_in_one_frame(held: HeldWrench, orientation: Quaternion, body: RigidBody | None) -> tuple[bool, Vector, Vector]:
    """Return whether the wrench is in world axes, and its force and torque; in body axes if it has parts in both.

    `orientation` is from principal to world axes.
    """
    if (held.force_body, held.torque_body) == (ZERO, ZERO) != (held.force_world, held.torque_world):
        return True, held.force_world, held.torque_world
    if (held.force_world, held.torque_world) == (ZERO, ZERO):
        return False, held.force_body, held.torque_body
    axes = IDENTITY if body is None else body.principal_orientation_xyzw
    attitude = multiply(orientation, conjugate(axes))
    force, torque = (rotate_inverse(attitude, part) for part in (held.force_world, held.torque_world))
    return False, add(held.force_body, force), add(held.torque_body, torque)


class TransientLoad:
    """The load of one step with transients: their wrenches, and another load."""

    def __init__(self, transients: Sequence[Transient], ages: Sequence[float], load: Load | None) -> None:
        """Begin a step at the given ages (s) of the transients, whose body parts are in principal axes."""
        self._transients, self._ages, self._load = transients, ages, load

    def __call__(
        self, t: float, displacement: Vector, velocity: Vector, orientation: Quaternion, angular_velocity: Vector
    ) -> tuple[Vector, Vector]:
        """Return force (N, world axes) and torque (N m, principal axes), as a `Load` does."""
        force, torque = ZERO, ZERO
        if self._load is not None:
            force, torque = self._load(t, displacement, velocity, orientation, angular_velocity)
        acting = HeldWrench()
        for transient, age in zip(self._transients, self._ages, strict=True):
            acting = acting + transient.aged(age + t)
        return with_acting(acting, force, torque, orientation)
