"""Buoyancy of a submerged body: a constant force through a fixed point, which rights it if above the centre of mass.

The fluid is at rest and has no surface; its resistance is drag, and its added mass is not modelled.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import SceneError
from rb_dynamics.loads.effect import Effect, Point, Potential, Wrenching
from rb_dynamics.loads.number_ranges import Range, check_numbers, check_vector, read_numbers
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.numerics.rotation import rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, cross, dot, scale, subtract

if TYPE_CHECKING:
    from rb_dynamics.loads.scene_entry import SceneEntry


class Lift(NamedTuple):
    """A force (N, world axes) at the end of an arm from the centre of mass (m, principal axes)."""

    force: Vector
    arm: Vector


def lifted(lift: Lift, point: Point) -> tuple[Vector, Vector]:
    """Return the force, and its torque about the centre of mass."""
    return lift.force, cross(lift.arm, rotate_inverse(point.orientation, lift.force))


@dataclass(frozen=True)
class Buoyancy(Effect):
    """The weight of the displaced fluid, -rho V g (N, world axes), at the centre of buoyancy. Energy: U = rho V g . x.

    Attributes:
        volume: V, displaced, m^3.
        density: rho, of the fluid, kg/m^3.
        acceleration_world: g, of gravity, m/s^2; the weight of the body itself is uniform_gravity.
        center_body: the centre of buoyancy x, from the body origin, body axes, m.
    """

    kind: ClassVar[str] = "buoyancy"
    takes: ClassVar[LoadDependence] = LoadDependence.FIELD
    keys: ClassVar[tuple[str, ...]] = ("volume", "density", "acceleration_world", "center_body")
    takes_arrays: ClassVar[bool] = True
    ranges: ClassVar[Mapping[str, Range]] = {
        "volume": Range("a number greater than 0 (m^3)", "write what is displaced", above=0.0),
        "density": Range("a number greater than 0 (kg/m^3)", "for sea water 1025", above=0.0),
    }

    volume: float
    density: float
    acceleration_world: Vector
    center_body: Vector = ZERO

    @classmethod
    def read(cls, entry: SceneEntry) -> Buoyancy:
        """Return the effect of an entry."""
        return cls(
            acceleration_world=entry.vector("acceleration_world", "a finite number (m/s^2)"),
            center_body=entry.vector("center_body", "a finite number (m)", ZERO),
            **read_numbers(cls, entry),
        )

    def __post_init__(self) -> None:
        """Check the arguments.

        Raises:
            TypeError: an argument is not of its type.
            SceneError: a number is not finite, or volume or density not greater than 0.
        """
        check_numbers(self)
        check_vector(self, "acceleration_world", "an acceleration (m/s^2)")
        check_vector(self, "center_body", "a point (m)")

    def check(self, body: RigidBody) -> None:
        """Refuse to turn a particle.

        Raises:
            SceneError: the body is one, and the force does not go through its centre.
        """
        if body.is_particle and self.center_body != body.center_of_mass:
            raise SceneError(
                f"buoyancy: center_body is {self.center_body}, expected the centre of mass: a body without inertia is "
                "a particle and does not turn; remove it, or add body.inertia"
            )

    def wrenching(self, body: RigidBody, start: float) -> Wrenching:
        """Return the force, and its torque about the centre of mass."""
        return partial(lifted, self.lift(body))

    def lift(self, body: RigidBody) -> Lift:
        """Return what its load depends on."""
        arm = rotate_inverse(body.principal_orientation_xyzw, subtract(self.center_body, body.center_of_mass))
        return Lift(scale(-self.density * self.volume, self.acceleration_world), arm)

    def potential(self, body: RigidBody) -> Potential:
        """Return U = rho V g . x (J), zero at the origin."""
        force, arm = self.lift(body)

        def at(point: Point) -> float:
            return -dot(force, add(point.position, rotate(point.orientation, arm)))

        return at
