"""A spring from a point fixed in the world to the centre of mass."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import SceneError
from rb_dynamics.loads.effect import Effect, Point, Potential, Wrenching
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.numerics.argument_checks import number, vector
from rb_dynamics.numerics.vector import ZERO, Vector, dot, scale, subtract

if TYPE_CHECKING:
    from rb_dynamics.loads.scene_entry import SceneEntry


class Stretched(NamedTuple):
    """Numbers of the load."""

    stiffness: float
    anchor: Vector


def pulled(s: Stretched, point: Point) -> tuple[Vector, Vector]:
    """Return the force (N, world axes) and no torque."""
    return scale(-s.stiffness, subtract(point.position, s.anchor)), ZERO


@dataclass(frozen=True)
class Spring(Effect):
    """Force -k (x - a), k in N/m, a in m; energy k |x - a|^2 / 2."""

    kind: ClassVar[str] = "spring"
    takes: ClassVar[LoadDependence] = LoadDependence.FIELD
    keys: ClassVar[tuple[str, ...]] = ("stiffness", "anchor_world")

    stiffness: float
    anchor_world: Vector = ZERO

    def __post_init__(self) -> None:
        """Refuse what is not a spring.

        Raises:
            TypeError: an argument is not of its type.
            SceneError: a number is not finite, or the stiffness not greater than 0.
        """
        expected = "a number greater than 0 (N/m)"
        stiffness = number(self.stiffness, "spring: stiffness", expected, SceneError, above=0.0)
        object.__setattr__(self, "stiffness", stiffness)
        anchor = vector(self.anchor_world, "spring: anchor_world", "a point (m)", SceneError)
        object.__setattr__(self, "anchor_world", anchor)

    @classmethod
    def read(cls, entry: SceneEntry) -> Spring:
        """Return the effect of an entry of a scene."""
        remedy = "write the stiffness of the spring, such as 8.0"
        return cls(
            entry.number("stiffness", "a number greater than 0 (N/m)", lambda k: k > 0.0, remedy),
            entry.vector("anchor_world", "a finite number (m)", ZERO),
        )

    def wrenching(self, body: RigidBody, start: float) -> Wrenching:
        """Return the load as a function of a module and its numbers, so that it can be compiled."""
        return partial(pulled, Stretched(self.stiffness, self.anchor_world))

    def potential(self, body: RigidBody) -> Potential:
        """Return the energy of the spring (J)."""

        def at(point: Point) -> float:
            stretch = subtract(point.position, self.anchor_world)
            return 0.5 * self.stiffness * dot(stretch, stretch)

        return at
