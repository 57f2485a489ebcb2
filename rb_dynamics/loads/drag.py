"""Drag in a uniform medium, linear or quadratic in the speed, in translation and rotation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import SceneError
from rb_dynamics.loads.effect import Effect, Point, Slowing, Wrenching
from rb_dynamics.loads.load import LoadDependence
from rb_dynamics.numerics.argument_checks import vector
from rb_dynamics.numerics.rotation import conjugate, multiply, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, norm, scale, subtract
from rb_dynamics.numerics.vector import multiply as times

if TYPE_CHECKING:
    from rb_dynamics.scene.scene_entry import SceneEntry


@dataclass(frozen=True)
class _Drag(Effect):
    """Force -c |v - u|^power (v - u) and torque -k |w|^power w; it takes energy out at the rate of their powers.

    Attributes:
        power: of the speed that the resistance grows with, beyond the first: 0 or 1.
        translation: c along each body axis; acts through the centre of mass.
        rotation: k about each body axis.
        medium_velocity_world: u, m/s.
    """

    takes: ClassVar[LoadDependence] = LoadDependence.ANY
    keys: ClassVar[tuple[str, ...]] = ("translation", "rotation", "medium_velocity_world")
    power: ClassVar[int]

    translation: Vector = ZERO
    rotation: Vector = ZERO
    medium_velocity_world: Vector = ZERO

    @classmethod
    def read(cls, entry: SceneEntry) -> _Drag:
        """Return the effect of an entry."""
        rule = ("a number of 0 or more", lambda v: v >= 0.0, "drag takes energy out: write it without a sign")
        translation, rotation = (entry.per_axis(name, *rule) for name in ("translation", "rotation"))
        if not (entry.has("translation") or entry.has("rotation")):
            entry.reject("at least one of translation and rotation", "add translation: or rotation:")
        if rotation != ZERO and entry.is_particle:
            entry.reject("none, as a body without inertia is a particle and does not turn", "remove it", "rotation")
        return cls(translation, rotation, entry.vector("medium_velocity_world", "a finite number (m/s)", ZERO))

    def __post_init__(self) -> None:
        """Refuse coefficients that are none.

        Raises:
            TypeError: one is not three numbers.
            SceneError: one is negative, or not finite.
        """
        for name in ("translation", "rotation"):
            found = vector(getattr(self, name), f"{self.kind}: {name}", "a coefficient for each body axis", SceneError)
            if min(found) < 0.0:
                raise SceneError(
                    f"{self.kind}: {name} is {found}, expected coefficients of 0 or more: drag takes energy out, write "
                    "them without a sign"
                )
            object.__setattr__(self, name, found)
        wind = vector(self.medium_velocity_world, f"{self.kind}: medium_velocity_world", "a velocity (m/s)", SceneError)
        object.__setattr__(self, "medium_velocity_world", wind)

    def check(self, body: RigidBody) -> None:
        """Refuse to turn a particle.

        Raises:
            SceneError: the body is one and `rotation` is not zero.
        """
        if body.is_particle and self.rotation != ZERO:
            raise SceneError(
                f"{self.kind}: rotation is {self.rotation}, expected none: a body without inertia is a particle and "
                "does not turn; remove it, or add body.inertia"
            )

    def slowing(self, body: RigidBody) -> Slowing | None:
        """Return c/m, times the speed where drag goes with its square; then it is known where all axes are alike.

        Else the speed along the axis of most drag, which the others share, fades before it has slowed the rest.
        """
        least, medium = min(self.translation) / body.mass, self.medium_velocity_world
        if least == 0.0 or (self.power and min(self.translation) < max(self.translation)):
            return None
        return lambda point: least * (norm(subtract(point.velocity, medium)) if self.power else 1.0)

    def wrenching(self, body: RigidBody, start: float) -> Wrenching:
        """Return force and torque at a point."""
        axes = body.principal_orientation_xyzw
        translation, rotation, medium = self.translation, self.rotation, self.medium_velocity_world

        def size(velocity: Vector) -> float:
            return norm(velocity) if self.power else 1.0

        def resistance(point: Point) -> tuple[Vector, Vector]:
            wind = subtract(point.velocity, medium)
            to_world = multiply(point.orientation, conjugate(axes))
            force = rotate(to_world, scale(-size(wind), times(translation, rotate_inverse(to_world, wind))))
            omega = point.angular_velocity
            torque = rotate_inverse(axes, scale(-size(omega), times(rotation, rotate(axes, omega))))
            return force, torque

        return resistance


@dataclass(frozen=True)
class LinearDrag(_Drag):
    """Force -c (v - u) and torque -k w, as in slow flow: c in N s/m and k in N m s/rad, along the body axes."""

    kind: ClassVar[str] = "linear_drag"
    power: ClassVar[int] = 0


@dataclass(frozen=True)
class QuadraticDrag(_Drag):
    """Force -c |v - u| (v - u) and torque -k |w| w, as in fast flow: c in N s^2/m^2 and k in N m s^2/rad^2.

    c is half of the density, the area and the drag coefficient along a body axis.
    """

    kind: ClassVar[str] = "quadratic_drag"
    power: ClassVar[int] = 1
