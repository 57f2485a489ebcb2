"""`Effect`: something that acts on the body without being commanded, such as gravity or drag.

An effect holds data from the scene. For a given body, it is asked once for each of its possible parts (load, potential,
stored momentum); a part that it does not have costs nothing afterwards.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import SceneError
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.vector import Vector

if TYPE_CHECKING:
    from rb_dynamics.loads.scene_entry import SceneEntry


class Point(NamedTuple):
    """The variables on which an effect may depend.

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
    """Angular momentum (kg m^2/s, principal axes) and energy (J) of a part that moves inside the body."""

    momentum: Vector
    energy: float


Wrenching = Callable[[Point], tuple[Vector, Vector]]
"""Force (N, world axes) and torque about the centre of mass (N m, principal axes) at a point."""

Potential = Callable[[Point], float]
"""Potential energy (J) at a point."""

Storing = Callable[[Point], Stored]
"""Momentum and energy of what moves inside the body at a point."""


Slowing = Callable[[Point], float]
"""Rate (1/s) at which differences of velocity decay at a point."""


Field = Callable[[Vector], Vector]
"""A vector (world axes) at a place (m, world axes)."""


Sight = Callable[[Point], float]
"""For how long (s) the load at a point predicts the load ahead."""


class Effect:
    """A load that acts without commands; each kind overrides the parts that it has.

    Attributes:
        kind: `type` in the scene's list of effects.
        takes: what its load depends on.
        keys: the other keys of its entry in the scene.
        takes_arrays: whether `potential` and `storing` also take a point of arrays, with the same bits in arrays.
    """

    kind: ClassVar[str]
    takes: ClassVar[LoadDependence] = LoadDependence.HELD
    keys: ClassVar[tuple[str, ...]] = ()
    takes_arrays: ClassVar[bool] = False

    @classmethod
    def read(cls, entry: SceneEntry) -> Effect:
        """Return the effect of an entry of a scene; problems with its values are recorded in the entry.

        Raises:
            SceneError: it cannot be made from these values.
        """
        raise SceneError(f"{cls.kind}: cannot be read from a scene; add it in Python: replace(scene, effects=...)")

    def check(self, body: RigidBody) -> None:
        """Check that the effect can act on the body.

        Raises:
            SceneError: it cannot; the message says why, and what to do.
        """

    def schedule(self, body: RigidBody) -> tuple[tuple[float, Wrench], ...]:
        """Return the held wrenches of the effect, each with its start time (s); `WORLD` for world axes."""
        return ()

    def knots(self) -> tuple[float, ...]:
        """Return the times (s) at which the load is not smooth: steps end there, and `wrenching` is asked again."""
        return ()

    def wrenching(self, body: RigidBody, start: float) -> Wrenching | None:
        """Return the load for the time from `start` (s) to the next knot; None if the effect has no varying load."""
        return None

    def potential(self, body: RigidBody) -> Potential | None:
        """Return the potential energy; None if the effect has none."""
        return None

    def slowing(self, body: RigidBody) -> Slowing | None:
        """Return the rate at which all differences of velocity decay; None if they need not.

        Along the motion it may fall as 1/t while the body comes to rest, but no faster: drag in a medium that thins out
        has no such rate.
        """
        return None

    def sight(self, body: RigidBody) -> Sight | None:
        """Return for how long (s) the load at a point predicts the load ahead; None if it always does.

        With `accuracy`, steps are no longer than that, so that none skips a region in which the load is strong. Greater
        than 0; infinite where nothing is near.
        """
        return None

    def gravity(self) -> Field | None:
        """Return the gravitational acceleration (m/s^2), which no accelerometer measures; None if it is not gravity."""
        return None

    def magnetic_field(self) -> Field | None:
        """Return the magnetic flux density (T), at time 0 if it varies; None if the effect has none."""
        return None

    def magnetic_field_at(self, time: float) -> Field | None:
        """Return the magnetic flux density (T) at a time (s of the run); None if the effect has none."""
        return self.magnetic_field()

    def storing(self, body: RigidBody) -> Storing | None:
        """Return momentum and energy of what moves inside the body; None if nothing does."""
        return None
