"""Drag in a uniform medium, linear or quadratic in the speed, in translation and rotation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import SceneError
from rb_dynamics.loads.effect import Effect, Point, Slowing, Wrenching
from rb_dynamics.loads.number_ranges import check_vector
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.numerics.rotation import Quaternion, conjugate, multiply, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, norm, scale, subtract
from rb_dynamics.numerics.vector import multiply as times

if TYPE_CHECKING:
    from rb_dynamics.loads.scene_entry import SceneEntry


class Resistance(NamedTuple):
    """Parameters of the drag of one body.

    Attributes:
        power: of the speed, in addition to the first power: 0 or 1.
        translation, rotation: coefficients along and about the body axes.
        medium: its velocity, world axes, m/s.
        axes: principal to body axes.
        slowing: rate at which all differences of velocity decay, divided by |v - u|^power; 0 if they need not.
    """

    power: float
    translation: Vector
    rotation: Vector
    medium: Vector
    axes: Quaternion
    slowing: float


def resisted(r: Resistance, point: Point) -> tuple[Vector, Vector]:
    """Return force and torque at a point."""
    wind, omega = subtract(point.velocity, r.medium), point.angular_velocity
    to_world = multiply(point.orientation, conjugate(r.axes))
    force = rotate(to_world, scale(-_size(r, wind), times(r.translation, rotate_inverse(to_world, wind))))
    torque = rotate_inverse(r.axes, scale(-_size(r, omega), times(r.rotation, rotate(r.axes, omega))))
    return force, torque


def slowed(r: Resistance, point: Point) -> float:
    """Return the rate (1/s) at which all differences of velocity decay; 0 if they need not."""
    return r.slowing * _size(r, subtract(point.velocity, r.medium)) if r.slowing > 0.0 else 0.0


def _size(r: Resistance, velocity: Vector) -> float:
    return norm(velocity) if r.power != 0.0 else 1.0


@dataclass(frozen=True)
class _Drag(Effect):
    """Force -c |v - u|^power (v - u) and torque -k |w|^power w, which dissipate energy.

    Attributes:
        power: of the speed, in addition to the first power: 0 or 1.
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
        """Check the coefficients.

        Raises:
            TypeError: one is not three numbers.
            SceneError: one is negative, or not finite.
        """
        for name in ("translation", "rotation"):
            check_vector(self, name, "a coefficient for each body axis")
            if min(found := getattr(self, name)) < 0.0:
                raise SceneError(
                    f"{self.kind}: {name} is {found}, expected coefficients of 0 or more: drag takes energy out, write "
                    "them without a sign"
                )
        check_vector(self, "medium_velocity_world", "a velocity (m/s)")

    def check(self, body: RigidBody) -> None:
        """Check that there is no rotational drag on a particle.

        Raises:
            SceneError: the body is a particle and `rotation` is not zero.
        """
        if body.is_particle and self.rotation != ZERO:
            raise SceneError(
                f"{self.kind}: rotation is {self.rotation}, expected none: a body without inertia is a particle and "
                "does not turn; remove it, or add body.inertia"
            )

    def slowing(self, body: RigidBody) -> Slowing | None:
        """Return the slowest rate: the least c / m for linear drag, c |v - u| / m for quadratic drag alike on all axes.

        None for other quadratic drag, which depends on the speed |v - u| common to all axes: it may vanish before the
        velocity along axes with less drag has decayed.
        """
        resistance = self.resistance(body)
        return partial(slowed, resistance) if resistance.slowing > 0.0 else None

    def resistance(self, body: RigidBody) -> Resistance:
        """Return what its load depends on."""
        axes, least = body.principal_orientation_xyzw, min(self.translation)
        slowing = 0.0 if self.power and least < max(self.translation) else least / body.mass
        return Resistance(self.power, self.translation, self.rotation, self.medium_velocity_world, axes, slowing)

    def wrenching(self, body: RigidBody, start: float) -> Wrenching:
        """Return force and torque at a point."""
        return partial(resisted, self.resistance(body))


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
