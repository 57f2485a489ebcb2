"""`Effect`: something that acts on the body without being commanded, such as gravity or drag.

An effect is data from the scene. It is asked once, for a given body, for each part that it may have (load, potential,
stored momentum); a part that it does not have costs nothing afterwards.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import SceneError
from rb_dynamics.loads.load import LoadDependence
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.vector import Vector

if TYPE_CHECKING:
    from rb_dynamics.loads.scene_entry import SceneEntry


class Point(NamedTuple):
    """What an effect may depend on.

    Attributes:
        time: s since the start of the run.
        position: of the centre of mass, world axes, m.
        velocity: of the centre of mass, world axes, m/s.
        orientation: principal to world axes.
        angular_velocity: principal axes, rad/s.
    """

    time: float
    position: Vector
    velocity: Vector
    orientation: Quaternion
    angular_velocity: Vector


class Stored(NamedTuple):
    """What a part that moves inside the body has: angular momentum (kg m^2/s, principal axes) and energy (J)."""

    momentum: Vector
    energy: float


Wrenching = Callable[[Point], tuple[Vector, Vector]]
"""Force (N, world axes) and torque about the centre of mass (N m, principal axes) at a point."""

Potential = Callable[[Point], float]
"""Potential energy (J) at a point."""

Storing = Callable[[Point], Stored]
"""What moves inside the body at a point."""


Slowing = Callable[[Point], float]
"""Rate (1/s) at which differences of velocity decay at a point."""


Field = Callable[[Vector], Vector]
"""A vector (world axes) at a place (m, world axes)."""


Sight = Callable[[Point], float]
"""For how long (s) from a point on the load there tells what comes."""


class Effect:
    """A load that acts without commands; each kind overrides the parts that it has.

    Attributes:
        kind: `type` in the scene's list of effects.
        takes: what its load depends on.
        keys: of its entry in the scene, beside `type`.
    """

    kind: ClassVar[str]
    takes: ClassVar[LoadDependence] = LoadDependence.HELD
    keys: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def read(cls, entry: SceneEntry) -> Effect:
        """Return the effect that an entry of a scene asks for; problems with its values are recorded there.

        Raises:
            SceneError: it cannot be made from these values.
        """
        raise SceneError(f"{cls.kind}: cannot be read from a scene; add it in Python: replace(scene, effects=...)")

    def check(self, body: RigidBody) -> None:
        """Refuse a body on which it cannot act.

        Raises:
            SceneError: the message says why, and what to do.
        """

    def schedule(self, body: RigidBody) -> tuple[tuple[float, Wrench], ...]:
        """Return the wrenches that it holds, each with the time (s) at which it begins; `WORLD` for world axes."""
        return ()

    def knots(self) -> tuple[float, ...]:
        """Return the times (s) at which its load has a kink: steps end there."""
        return ()

    def wrenching(self, body: RigidBody, start: float) -> Wrenching | None:
        """Return its load for the time from `start` (s) to the next knot; None where it has none that varies."""
        return None

    def potential(self, body: RigidBody) -> Potential | None:
        """Return its potential energy; None where it has none."""
        return None

    def slowing(self, body: RigidBody) -> Slowing | None:
        """Return the rate at which it makes all differences of velocity decay; None where they need not.

        Along the motion it may fall like 1/t, as the body comes to rest, and no faster: drag that thins out has no such
        rate.
        """
        return None

    def sight(self, body: RigidBody) -> Sight | None:
        """Return for how long (s) the load at a point predicts the load ahead; None where it always does.

        Steps by accuracy are no longer, so that none passes over a place where the load is strong without meeting it.
        Greater than 0; infinite where nothing is near.
        """
        return None

    def gravity(self) -> Field | None:
        """Return its gravitational acceleration (m/s^2), which no accelerometer feels; None where it is not gravity."""
        return None

    def magnetic_field(self) -> Field | None:
        """Return its magnetic flux density (T), at time 0 where it changes; None where it has none."""
        return None

    def magnetic_field_at(self, time: float) -> Field | None:
        """Return its magnetic flux density (T) at a time (s of the run); None where it has none."""
        return self.magnetic_field()

    def storing(self, body: RigidBody) -> Storing | None:
        """Return what moves inside the body by it; None where nothing does."""
        return None
