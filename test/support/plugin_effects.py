"""Effects as a plug-in may have them: numbers and functions of this module."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.loads.central_gravity import CentralGravity
from rb_dynamics.loads.effect import Effect, Point, Sight, Slowing, Wrenching
from rb_dynamics.loads.scene_entry import SceneEntry
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.numerics import vector
from rb_dynamics.numerics.rotation import rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, dot, norm, scale, subtract

OFFSET = 1.5


class Rope(NamedTuple):
    stiffness: float
    anchor: Vector
    arm: Vector


def pulled(rope: Rope, point: Point) -> tuple[Vector, Vector]:
    arm = rotate(point.orientation, rope.arm)
    stretch = subtract(vector.add(point.position, arm), rope.anchor)
    stiffness = rope.stiffness * (math.sin(3.0 * point.time) * math.exp(-point.time) + OFFSET)
    force = scale(-stiffness / math.sqrt(1.0 + dot(stretch, stretch)), subtract(stretch, scale(0.01, point.velocity)))
    return force, rotate_inverse(point.orientation, vector.cross(arm, force))


def seen(rope: Rope, point: Point) -> float:
    return 0.02 + 0.01 * norm(subtract(point.position, rope.anchor))


def slowed(rate: float, point: Point) -> float:
    return rate / (1.0 + point.time)


@dataclass(frozen=True)
class Roped(Effect):
    """A rope to a point of the body, with a load, a sight and a slowing."""

    kind = "rope"
    takes = LoadDependence.ANY
    stiffness: float = 8.0
    see: Callable[..., float] = seen

    @classmethod
    def read(cls, entry: SceneEntry) -> Roped:
        return cls()

    def wrenching(self, body: RigidBody, start: float) -> Wrenching:
        return partial(pulled, self._rope)

    def sight(self, body: RigidBody) -> Sight:
        return partial(self.see, self._rope)

    def slowing(self, body: RigidBody) -> Slowing:
        return partial(slowed, 0.25)

    @property
    def _rope(self) -> Rope:
        return Rope(self.stiffness, (0.0, 0.5, 1.0), (0.1, -0.2, 0.3))


@dataclass(frozen=True)
class OtherPull(CentralGravity):
    """Derived from an effect of the package, with its load and sight."""


@dataclass(frozen=True)
class Given(Effect):
    """The load that it is given."""

    load: Any
    kind = "given"
    takes = LoadDependence.ANY

    def wrenching(self, body: RigidBody, start: float) -> Wrenching:
        loaded: Wrenching = self.load
        return loaded


def inverse(strength: float, point: Point) -> tuple[Vector, Vector]:
    """Fails when the time is 1/2 s, and is held down elsewhere."""
    return (min(1.0, strength / abs(point.time - 0.5)), 0.0, 0.0), ZERO


def blind(rope: Rope, point: Point) -> float:
    return 0.3 - point.time


def squared(strength: float, point: Point) -> tuple[Vector, Vector]:
    return (strength * point.position[0] ** 3, 0.0, 0.0), ZERO


def counted(strength: float, point: Point) -> tuple[Vector, Vector]:
    large = 1
    for _ in range(60):
        large = large * 3
    return (1e-25 * strength * large, 0.0, 0.0), ZERO


def whole(strength: float, point: Point) -> tuple[Any, Vector]:
    """Numba refuses its whole numbers, which have no -0."""
    return (strength, 0, 0), ZERO


def doubled(strength: float, point: Point) -> tuple[Vector, Vector]:
    return (2.0 * strength * point.time, 0.0, 0.0), ZERO


def tripled(strength: float, point: Point) -> tuple[Vector, Vector]:
    return (3.0 * strength * point.time, 0.0, 0.0), ZERO
