"""Central gravity: Newton's attraction by a distant centre and, on request, its gradient over the body."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.effect import Effect, Field, Point, Potential, Sight, Wrenching
from rb_dynamics.loads.number_ranges import Range, check_numbers, check_vector, read_numbers
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.numerics.argument_checks import truth
from rb_dynamics.numerics.compilation import compiled_as
from rb_dynamics.numerics.rotation import rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, cross, dot, norm, norm_of_arrays, scale, subtract
from rb_dynamics.numerics.vector import multiply as times

if TYPE_CHECKING:
    from rb_dynamics.loads.scene_entry import SceneEntry


class Attraction(NamedTuple):
    """Parameters of the load: mu, centre, mass and moments of the body, and whether with gradient."""

    parameter: float
    center: Vector
    mass: float
    moments: Vector
    gradient: float


def attracted(a: Attraction, point: Point) -> tuple[Vector, Vector]:
    """Return force and torque at a point.

    Raises:
        ConvergenceError: the body reaches the centre.
    """
    distance, direction = to_center(a.center, point.position)
    pull = scale(-a.parameter * a.mass / distance / distance, direction)
    if a.gradient == 0.0:
        return pull, ZERO
    trace = a.moments[0] + a.moments[1] + a.moments[2]
    n = rotate_inverse(point.orientation, direction)
    i_n = times(a.moments, n)
    cubed = a.parameter / distance / distance / distance
    tide = add_scaled(scale(trace - 5.0 * dot(n, i_n), n), 2.0, i_n)
    force = rotate(point.orientation, scale(-1.5 * cubed / distance, tide))
    return add(pull, force), scale(3.0 * cubed, cross(n, i_n))


def falling(parameter: float, center: Vector, place: Vector) -> Vector:
    """Return the gravitational acceleration -mu n / r^2 (m/s^2) at a place."""
    distance, direction = to_center(center, place)
    return scale(-parameter / distance / distance, direction)


def time_to_fall(a: Attraction, point: Point) -> float:
    """Return half of the shortest time (s) to the centre for an approaching body; infinite for others."""
    distance, direction = to_center(a.center, point.position)
    coming = dot(point.velocity, direction) < 0.0
    return 0.5 * distance / norm(point.velocity) if coming else math.inf


def to_center(center: Vector, place: Vector) -> tuple[float, Vector]:
    """Return the distance from `center` to `place` and the direction; refuse the centre itself."""
    away = subtract(place, center)
    distance = norm(away)
    if distance == 0.0:
        return _arrived(center)
    return distance, scale(1.0 / distance, away)


def to_center_of_each(center: Vector, places: Vector) -> tuple[float, Vector]:
    """As `to_center`, for arrays; at the centre the direction is not a number."""
    away = subtract(places, center)
    distance = norm_of_arrays(away)
    return distance, scale(1.0 / distance, away)


@compiled_as((math.nan, (math.nan, math.nan, math.nan)))
def _arrived(center: Vector) -> tuple[float, Vector]:
    raise ConvergenceError(
        f"central_gravity: the body has reached the centre at {list(center)}, where the attraction is infinite; start "
        "it further away, with more angular momentum about the centre, or end the run before"
    )


@dataclass(frozen=True)
class CentralGravity(Effect):
    """Attraction by a centre with gravitational parameter mu (m^3/s^2) at `center_world` (m).

    Without `gravity_gradient` F = -mu m n / r^2 through the centre of mass, U = -mu m / r, with r n from the centre to
    the centre of mass. With it the next term of MacCullagh's expansion, U2 = -mu (tr I - 3 n . I n) / (2 r^3): the
    torque 3 mu / r^3 n x I n and the corresponding force, so that energy and the angular momentum about the centre are
    conserved (Hughes, Spacecraft Attitude Dynamics, section 8.1; Wertz, eq. 17-31).
    """

    kind: ClassVar[str] = "central_gravity"
    takes: ClassVar[LoadDependence] = LoadDependence.FIELD
    keys: ClassVar[tuple[str, ...]] = ("gravitational_parameter", "center_world", "gravity_gradient")
    takes_arrays: ClassVar[bool] = True
    ranges: ClassVar[Mapping[str, Range]] = {
        "gravitational_parameter": Range(
            "a number greater than 0 (m^3/s^2)", "write mu = G M, for the Earth 3.986004418e14", above=0.0
        )
    }

    gravitational_parameter: float
    center_world: Vector = ZERO
    gravity_gradient: bool = False

    @classmethod
    def read(cls, entry: SceneEntry) -> CentralGravity:
        """Return the effect of an entry."""
        center = entry.vector("center_world", "a finite number (m)", ZERO)
        return cls(**read_numbers(cls, entry), center_world=center, gravity_gradient=entry.flag("gravity_gradient"))

    def __post_init__(self) -> None:
        """Check the arguments.

        Raises:
            TypeError: an argument is not of its type.
            SceneError: a number is not finite, or the gravitational parameter not greater than 0.
        """
        check_numbers(self)
        check_vector(self, "center_world", "a point (m)")
        gradient = truth(self.gravity_gradient, "central_gravity: gravity_gradient")
        object.__setattr__(self, "gravity_gradient", gradient)

    def attraction(self, body: RigidBody) -> Attraction:
        """Return what its load depends on."""
        gradient = 1.0 if self.gravity_gradient else 0.0
        return Attraction(self.gravitational_parameter, self.center_world, body.mass, body.principal_moments, gradient)

    def wrenching(self, body: RigidBody, start: float) -> Wrenching:
        """Return force and torque at a point.

        Raises:
            ConvergenceError: the body reaches the centre.
        """
        return partial(attracted, self.attraction(body))

    def gravity(self) -> Field:
        """Return -mu n / r^2 at a place."""
        return partial(falling, self.gravitational_parameter, self.center_world)

    def potential(self, body: RigidBody) -> Potential:
        """Return U (J), zero at infinity."""
        mu, mass, moments = self.gravitational_parameter, body.mass, body.principal_moments
        trace = moments[0] + moments[1] + moments[2]

        def at(point: Point) -> float:
            to = to_center_of_each if hasattr(point.time, "shape") else to_center
            distance, direction = to(self.center_world, point.position)
            energy = -mu * mass / distance
            if not self.gravity_gradient:
                return energy
            n = rotate_inverse(point.orientation, direction)
            return energy - 0.5 * mu * (trace - 3.0 * dot(n, times(moments, n))) / distance / distance / distance

        return at

    def sight(self, body: RigidBody) -> Sight:
        """Return half of the time in which the body could reach the centre, while it comes nearer."""
        return partial(time_to_fall, self.attraction(body))
