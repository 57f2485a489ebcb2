"""Uniform gravity: a constant force m g through the centre of mass, held like a wrench command in world axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.loads.effect import Effect, Field, Point, Potential
from rb_dynamics.loads.number_ranges import check_vector
from rb_dynamics.loads.wrench import WORLD, Wrench
from rb_dynamics.numerics.vector import Vector, dot, scale

if TYPE_CHECKING:
    from rb_dynamics.loads.scene_entry import SceneEntry


@dataclass(frozen=True)
class UniformGravity(Effect):
    """The same acceleration everywhere (m/s^2, world axes). Energy: U = -m g . x, x the centre of mass."""

    kind: ClassVar[str] = "uniform_gravity"
    keys: ClassVar[tuple[str, ...]] = ("acceleration_world",)
    takes_arrays: ClassVar[bool] = True

    acceleration_world: Vector

    def __post_init__(self) -> None:
        """Check the arguments.

        Raises:
            TypeError: it is not three numbers.
            SceneError: one of them is not finite.
        """
        check_vector(self, "acceleration_world", "an acceleration (m/s^2)")

    @classmethod
    def read(cls, entry: SceneEntry) -> UniformGravity:
        """Return the effect of an entry."""
        return cls(entry.vector("acceleration_world", "a finite number (m/s^2)"))

    def schedule(self, body: RigidBody) -> tuple[tuple[float, Wrench], ...]:
        """Return the weight, held from the start."""
        return ((0.0, Wrench(force=scale(body.mass, self.acceleration_world), frame_id=WORLD)),)

    def gravity(self) -> Field:
        """Return the acceleration, the same everywhere."""
        return lambda _: self.acceleration_world

    def potential(self, body: RigidBody) -> Potential:
        """Return U = -m g . x (J), zero at the origin."""
        weight = scale(body.mass, self.acceleration_world)

        def at(point: Point) -> float:
            return -dot(weight, point.position)

        return at
