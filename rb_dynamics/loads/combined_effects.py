"""`CombinedEffects`: the effects of a scene on its body, added up.

A part that no effect has is None, so that no code runs for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from numbers import Integral
from typing import TYPE_CHECKING, TypeVar

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import ConvergenceError, SceneError
from rb_dynamics.loads.effect import Effect, Field, Point, Sight, Slowing, Stored, Wrenching
from rb_dynamics.loads.load import Load, LoadDependence
from rb_dynamics.loads.wrench import WORLD, Wrench, WrenchFrames
from rb_dynamics.numerics.argument_checks import shown
from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.vector import ZERO, Vector, add

if TYPE_CHECKING:
    from typing import TypeGuard

_T = TypeVar("_T")


@dataclass(frozen=True)
class CombinedEffects:
    """What the `effects` of a scene do to `body`, in the order of the scene; `frames` say what its world is called."""

    body: RigidBody
    effects: tuple[Effect, ...] = ()
    frames: WrenchFrames = WrenchFrames()

    def __post_init__(self) -> None:
        """Let each effect look at the body.

        Raises:
            SceneError: an effect cannot act on it, or has a load inside the step and does not say so.
        """
        for effect in self.effects:
            effect.check(self.body)
            _inside_the_step(effect, self.body, 0.0)

    @property
    def takes(self) -> LoadDependence:
        """What a method has to take."""
        return max((effect.takes for effect in self.effects), default=LoadDependence.HELD)

    @property
    def varying(self) -> tuple[str, ...]:
        """Kinds of the effects whose load changes inside a step."""
        return tuple(effect.kind for effect in self.effects if effect.takes > LoadDependence.HELD)

    def schedules(self) -> list[tuple[str, tuple[tuple[float, Wrench], ...]]]:
        """Return a channel name and the wrenches of each effect that holds some."""
        found: dict[str, tuple[tuple[float, Wrench], ...]] = {}
        for effect in self.effects:
            if schedule := effect.schedule(self.body):
                name = first = f"effects/{effect.kind}"
                number = 1
                while name in found:
                    number += 1
                    name = f"{first}_{number}"
                found[name] = tuple((time, self._named(wrench)) for time, wrench in schedule)
        return list(found.items())

    def _parts(
        self,
        what: str,
        of: Callable[[Effect], Callable[[Point], _T] | None],
        first: Callable[[Effect, _T], None] | None = None,
    ) -> list[Callable[[Point], _T]]:
        found = ((effect, of(effect)) for effect in self.effects)
        return [_refusing(effect, what, part, first) for effect, part in found if part is not None]

    def _named(self, wrench: Wrench) -> Wrench:
        return replace(wrench, frame_id=self.frames.world_frame) if wrench.frame_id == WORLD else wrench

    def knots(self) -> list[float]:
        """Return the times (s) at which steps have to end, in order."""
        return sorted({time for effect in self.effects for time in effect.knots()})

    def load_from(self, start: float) -> Callable[[Point], Load] | None:
        """Return what gives the load of a step from its first point, from `start` (s) to the next knot.

        Raises:
            SceneError: an effect has a load inside the step and does not say so.
            TypeError: when it is evaluated first, the load of an effect is not two vectors.
        """
        parts = self._parts("load", lambda effect: _inside_the_step(effect, self.body, start), _require_load)
        if not parts:
            return None

        def at(point: Point) -> Load:
            def load(
                t: float,
                displacement: Vector,
                velocity: Vector,
                orientation: Quaternion,
                angular_velocity: Vector,
            ) -> tuple[Vector, Vector]:
                here = Point(point.time + t, add(point.position, displacement), velocity, orientation, angular_velocity)
                force, torque = parts[0](here)
                for part in parts[1:]:
                    more_force, more_torque = part(here)
                    force, torque = add(force, more_force), add(torque, more_torque)
                return force, torque

            return load

        return at

    def potential(self) -> Callable[[Point], float] | None:
        """Return the potential energy (J) of all; None where none has one."""
        parts = self._parts("potential", lambda effect: effect.potential(self.body))
        if not parts:
            return None

        def energy(point: Point) -> float:
            total = parts[0](point)
            for part in parts[1:]:
                total += part(point)
            return total

        return energy

    def gravity(self) -> Field:
        """Return the gravitational acceleration (m/s^2) of all."""
        return _added([effect.gravity() for effect in self.effects])

    def magnetic_field(self) -> Field:
        """Return the magnetic flux density (T) of all."""
        return _added([effect.magnetic_field() for effect in self.effects])

    @property
    def magnetic(self) -> bool:
        """Whether one of them has a magnetic field."""
        return any(effect.magnetic_field() is not None for effect in self.effects)

    def slowing(self) -> Slowing | None:
        """Return the rate (1/s) at which differences of velocity die down; None where they need not."""
        parts = self._parts("slowing", lambda effect: effect.slowing(self.body))
        return (lambda point: math.fsum(part(point) for part in parts)) if parts else None

    def sight(self) -> Sight | None:
        """Return for how long (s) the load at a point tells what comes; None where it always does."""
        parts = self._parts("sight", lambda effect: _ahead(effect, effect.sight(self.body)))
        return (lambda point: min(part(point) for part in parts)) if parts else None

    def storing(self) -> Callable[[Point], Stored] | None:
        """Return what moves inside the body, of all; None where nothing does."""
        parts = self._parts("stored momentum", lambda effect: effect.storing(self.body))
        if not parts:
            return None

        def stored(point: Point) -> Stored:
            momentum, energy = ZERO, 0.0
            for part in parts:
                more = part(point)
                momentum, energy = add(momentum, more.momentum), energy + more.energy
            return Stored(momentum, energy)

        return stored


def _added(fields: Sequence[Field | None]) -> Field:
    """Return the sum of fields, in their order; zero where there is none."""
    parts = [field for field in fields if field is not None]

    def at(place: Vector) -> Vector:
        total = ZERO
        for part in parts:
            total = add(total, part(place))
        return total

    return at


def _refusing(
    effect: Effect,
    what: str,
    part: Callable[[Point], _T],
    first: Callable[[Effect, _T], None] | None = None,
) -> Callable[[Point], _T]:
    """Return a part of `effect` that refuses the points where it fails: a step on trial may lead anywhere.

    `first` looks at the first value alone, as values are many.
    """

    def at(point: Point) -> _T:
        nonlocal first
        try:
            found = part(point)
        except (ArithmeticError, ValueError) as failed:
            raise ConvergenceError(
                f"{effect.kind}: its {what} fails with {type(failed).__name__}: {failed}, at simulation time "
                f"{point.time:.9g} s, position {list(point.position)} m, velocity {list(point.velocity)} m/s and rate "
                f"{list(point.angular_velocity)} rad/s in principal axes; correct the effect, or end the run before"
            ) from failed
        if first is not None:
            first(effect, found)
            first = None
        return found

    return at


def _require_load(effect: Effect, load: object) -> None:
    """Refuse what is not a force and a torque of double precision: with others, the sums of the motion lose digits."""
    vectors = [list(part) if isinstance(part, Collection) else [] for part in load] if _is_pair(load) else []
    if not vectors or any(len(vector) != 3 or not all(map(_is_double, vector)) for vector in vectors):
        raise TypeError(
            f"{effect.kind}: its load is {shown(load)}, expected a force (N, world axes) and a torque (N m, principal "
            "axes), three floats each; return ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)) for none"
        )


def _is_pair(load: object) -> TypeGuard[Collection[object]]:
    return isinstance(load, Collection) and len(load) == 2


def _is_double(value: object) -> bool:
    return isinstance(value, (float, Integral))


def _ahead(effect: Effect, sight: Sight | None) -> Sight | None:
    """Return a sight that is a time greater than 0 everywhere: without one, a run would never get anywhere."""
    if sight is None:
        return None

    def at(point: Point) -> float:
        seconds = sight(point)
        if not _is_double(seconds):
            raise TypeError(f"{effect.kind}: its sight is {shown(seconds)}, expected a time (s); return a float")
        if not seconds > 0.0:
            raise ValueError(f"{seconds!r} s, expected a time greater than 0; return math.inf where nothing is near")
        return seconds

    return at


def _inside_the_step(effect: Effect, body: RigidBody, start: float) -> Wrenching | None:
    """Return the load of an effect; no method is asked whether it can take one that is not declared."""
    part = effect.wrenching(body, start)
    if part is not None and effect.takes == LoadDependence.HELD:
        raise SceneError(
            f"{effect.kind}: has a load inside the step but takes is HELD, expected what the load depends on; declare "
            "takes = LoadDependence.FIELD (time, place, attitude) or LoadDependence.ANY (velocities too) in the effect"
        )
    return part
