"""`CombinedEffects`: the effects of a scene on its body, added up.

A part that no effect has is None, so that no code runs for it.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from numbers import Integral
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import ConvergenceError, SceneError
from rb_dynamics.loads.actuator import Actuator
from rb_dynamics.loads.compiled_load import Underway, effect_numbers, functions_in
from rb_dynamics.loads.effect import Effect, Field, Point, Sight, Slowing, Stored, Wrenching
from rb_dynamics.loads.reaction_wheel import require_contained
from rb_dynamics.loads.varying_load import Load, LoadDependence
from rb_dynamics.loads.wrench import WORLD, HeldWrench, Wrench, WrenchFrames, largest_wrench
from rb_dynamics.numerics.argument_checks import shown
from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.vector import ZERO, Vector, add, norm, scale

if TYPE_CHECKING:
    from typing import TypeGuard

    import numpy as np
    import numpy.typing as npt

_T = TypeVar("_T")


class Lasting(NamedTuple):
    """Effects that act unchanged throughout a run.

    Attributes:
        force_world: held, N, world axes, through the centre of mass.
        numbers: of the load inside the steps, for kernels; empty if there is none.
    """

    force_world: Vector
    numbers: tuple[float, ...]


@dataclass(frozen=True)
class CombinedEffects:
    """The sum of the `effects` of a scene on `body`, in the order of the scene; `frames` give the name of its world."""

    body: RigidBody
    effects: tuple[Effect, ...] = ()
    frames: WrenchFrames = WrenchFrames()

    def __post_init__(self) -> None:
        """Let each effect check the body.

        Raises:
            SceneError: an effect cannot act on it, or has a load inside the step that it does not declare.
        """
        for effect in self.effects:
            if not isinstance(effect.kind, str):
                raise _not(effect, "kind", effect.kind, "the name of the effect, a string")
            if not isinstance(effect.takes, LoadDependence):
                raise _not(effect, "takes", effect.takes, "a LoadDependence")
            effect.check(self.body)
            _inside_the_step(effect, self.body, 0.0)
        require_contained(self.effects, self.body)

    @property
    def takes(self) -> LoadDependence:
        """The dependence of the load that a method must support."""
        return max((effect.takes for effect in self.effects), default=LoadDependence.HELD)

    @property
    def varying(self) -> tuple[str, ...]:
        """Kinds of the effects whose load varies within a step."""
        return tuple(dict.fromkeys(effect.kind for effect in self.effects if effect.takes > LoadDependence.HELD))

    def schedules(self) -> list[tuple[str, tuple[tuple[float, Wrench], ...]]]:
        """Return a channel name and the wrenches of each effect that holds wrenches."""
        found: dict[str, tuple[tuple[float, Wrench], ...]] = {}
        for effect in self.effects:
            if schedule := _schedule(effect, effect.schedule(self.body)):
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
        return [_refusing(effect, what, _function(effect, what, p), first) for effect, p in found if p is not None]

    def _named(self, wrench: Wrench) -> Wrench:
        return replace(wrench, frame_id=self.frames.world_frame) if wrench.frame_id == WORLD else wrench

    def knots(self) -> list[float]:
        """Return the times (s) at which steps have to end, in order."""
        return sorted({time for effect in self.effects for time in _knots(effect)})

    def require_smooth(self, point: Point, knot: float) -> None:
        """Check that no load jumps with the time of the point at a knot (s), of which stages of steps see both sides.

        Raises:
            SceneError: the load from the knot before, or that from this one, does.
        """
        for effect in self.effects:
            knots = _knots(effect)
            if knot not in knots:
                continue
            for start in (max((time for time in knots if time < knot), default=0.0), knot):
                part = _inside_the_step(effect, self.body, start)
                if part is not None and _jumps(part, point, knot):
                    raise SceneError(
                        f"{effect.kind}: its load jumps with the time of the point at its knot {knot!r} s, where steps "
                        "end and begin, and see both sides of it; let wrenching(body, start) choose the load by start"
                    )

    def load_from(self, start: float, driven: Wrenching | None = None) -> Callable[[Point], Load] | None:
        """Return the function that gives the load of a step from its start, valid from `start` (s) to the next knot.

        `driven` is the load of actuators, which is added.

        Raises:
            SceneError: an effect has a load inside the step that it does not declare; or, at the first evaluation, its
                load is not two vectors.
        """
        parts = self._parts("load", lambda effect: _inside_the_step(effect, self.body, start), _require_load)
        if driven is not None:
            parts.append(driven)
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

    def numbers(
        self, start: float, dipole: Vector = ZERO, *, plugins: bool = False, underway: Sequence[Underway] = ()
    ) -> tuple[float, ...] | None:
        """Return the same load for kernels; None if there is none, or an effect has no numbers.

        Of actuators only the `dipole` (A m^2, principal axes) of magnetorquers counts; for `plugins` and transients
        `underway` see `effect_numbers`.
        """
        if self.takes == LoadDependence.HELD:
            return None
        effects = [effect for effect in self.effects if not isinstance(effect, Actuator)]
        return effect_numbers(effects, self.body, start, dipole, plugins=plugins, underway=underway)

    @property
    def compile(self) -> bool:
        """Whether kernels support the load."""
        if any(isinstance(effect, Actuator) for effect in self.effects):
            return False
        return self.takes == LoadDependence.HELD or self.numbers(0.0, plugins=True) is not None

    def lasting(self) -> Lasting | None:
        """Return the effects if all of them act unchanged throughout a run; None otherwise, or without numbers.

        They do not if the load has knots, a wrench begins later or turns, or something moves inside the body.
        """
        numbers, force = self.numbers(0.0, plugins=True), ZERO
        if not self.compile or self.knots() or self.storing() is not None:
            return None
        # A plug-in may give each arc of a run a load of its own; one that does not compile gains nothing side by side.
        functions = functions_in(numbers or ())
        if functions and (any(each.fault for each in functions) or numbers != self.numbers(1.0, plugins=True)):
            return None
        for _, entries in self.schedules():
            if len(entries) > 1 or entries[0][0] != 0.0:
                return None
            held = self.frames.hold(entries[0][1])
            if held != HeldWrench(force_world=held.force_world):
                return None
            force = add(force, held.force_world)
        possible = max(map(abs, force)) <= largest_wrench(self.body)[0]
        return Lasting(force, numbers or ()) if possible else None

    def potential(self) -> Callable[[Point], float] | None:
        """Return the potential energy (J) of all effects; None if none has one."""
        parts = self._parts("potential", lambda effect: _real(effect, "potential", "J", effect.potential(self.body)))
        if not parts:
            return None

        def energy(point: Point) -> float:
            total = parts[0](point)
            for part in parts[1:]:
                total += part(point)
            return total

        return energy

    def potentials(self, points: Point) -> npt.NDArray[np.float64] | None:
        """Return the potential energy at a point of arrays; None if they must be computed one by one."""
        import numpy as np

        total: Any = None
        with np.errstate(all="ignore"):
            for effect in self.effects:
                if (part := effect.potential(self.body)) is not None:
                    if not effect.takes_arrays:
                        return None
                    total = part(points) if total is None else total + part(points)
        return total if np.isfinite(total).all() else None

    def gravity(self) -> Field:
        """Return the gravitational acceleration (m/s^2) of all effects."""
        return _added([_field(effect, "gravity", effect.gravity()) for effect in self.effects])

    def magnetic_field(self, time: float = 0.0) -> Field:
        """Return the magnetic flux density (T) of all effects at a time (s of the run)."""
        return _added([_field(effect, "magnetic_field", effect.magnetic_field_at(time)) for effect in self.effects])

    @property
    def magnetic(self) -> bool:
        """Whether one of them has a magnetic field."""
        return any(effect.magnetic_field() is not None for effect in self.effects)

    def slowing(self) -> Slowing | None:
        """Return the rate (1/s) at which differences of velocity decay; None if they need not."""
        parts = self._parts("slowing", lambda effect: _real(effect, "slowing", "1/s", effect.slowing(self.body), 0.0))
        return (lambda point: _total(part(point) for part in parts)) if parts else None

    def sight(self) -> Sight | None:
        """Return for how long (s) the load at a point predicts the load ahead; None if it always does."""
        parts = self._parts("sight", lambda effect: _ahead(effect, effect.sight(self.body)))
        return (lambda point: min(part(point) for part in parts)) if parts else None

    def strength(self) -> Callable[[Point], float] | None:
        """Return the sum of the magnitudes (N) of the forces that vary within a step; None if none does."""
        changing = [effect for effect in self.effects if _inside_the_step(effect, self.body, 0.0) is not None]

        def strength(point: Point) -> float:
            parts = ((effect, _inside_the_step(effect, self.body, point.time)) for effect in changing)
            loads = (_refusing(effect, "load", part, _require_load) for effect, part in parts if part is not None)
            return _total(norm(load(point)[0]) for load in loads)

        return strength if changing else None

    def storing(self) -> Callable[[Point], Stored] | None:
        """Return momentum and energy of what moves inside the body, for all effects; None if nothing does."""
        parts = self._parts("storing", lambda effect: effect.storing(self.body), _require_stored)
        if not parts:
            return None

        def stored(point: Point) -> Stored:
            momentum, energy = ZERO, 0.0
            for part in parts:
                more = part(point)
                momentum, energy = add(momentum, more.momentum), energy + more.energy
            return Stored(momentum, energy)

        return stored

    def stored_at(self, points: Point) -> Stored | None:
        """Return momentum and energy at a point of arrays; None if they must be computed one by one."""
        momentum, energy = ZERO, 0.0
        for effect in self.effects:
            if (part := effect.storing(self.body)) is not None:
                if not effect.takes_arrays:
                    return None
                more = part(points)
                momentum, energy = add(momentum, more.momentum), energy + more.energy
        return Stored(momentum, energy)


def _total(values: Iterable[float]) -> float:
    """Return the sum of `values` in their order, as in kernels; `sum` rounds differently in some versions of Python."""
    return reduce(operator.add, values, 0.0)


def _added(fields: Sequence[Field | None]) -> Field:
    """Return the sum of fields, in their order; zero if there is none."""
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
    """Return a function of `effect` that refuses points at which it fails, because a trial step may lead anywhere.

    `first` checks only the first value, for speed.
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
        if what == "load" and not all(map(math.isfinite, (*found[0], *found[1]))):  # type: ignore[index]
            raise ConvergenceError(
                f"{effect.kind}: its load is {shown(found)} at simulation time {point.time:.9g} s and position "
                f"{list(point.position)} m, expected finite numbers; correct the effect, or end the run before"
            )
        return found

    return at


def _jumps(load: Wrenching, point: Point, time: float) -> bool:
    """Return whether a load jumps with the time at `time` (s): over 1 ns it changes like over 1 us."""
    try:
        sides = [[load(point._replace(time=time + t)) for t in (-h, h)] for h in (1e-9, 1e-6)]
    except (ArithmeticError, ValueError):
        # It need not exist beyond the knot.
        return False
    near, far = (norm(add(b[0], scale(-1.0, a[0]))) + norm(add(b[1], scale(-1.0, a[1]))) for a, b in sides)
    size = max(norm(force) + norm(torque) for force, torque in sides[0])
    return near > max(0.1 * far, 1e-9 * size)


def _not(effect: Effect, what: str, value: object, expected: str) -> SceneError:
    return SceneError(f"{effect.kind}: its {what} is {shown(value)}, expected {expected}; correct the effect")


def _function(effect: Effect, what: str, part: Callable[[Point], _T]) -> Callable[[Point], _T]:
    if not callable(part):
        raise _not(effect, what, part, "a function of the point, or None for none")
    return part


def _knots(effect: Effect) -> list[float]:
    times: object = effect.knots()
    if isinstance(times, str) or not isinstance(times, Iterable):
        raise _not(effect, "knots", times, "times (s), such as (1.0, 2.5), or () for none")
    found = list(times)
    for time in found:
        if not _is_finite(time):
            raise _not(effect, "knots", found, f"finite times (s), found {shown(time)} among them")
    return found


def _schedule(effect: Effect, entries: Any) -> tuple[tuple[float, Wrench], ...]:
    expected = "pairs of a time (s) and a Wrench, or () for none"
    if isinstance(entries, str) or not isinstance(entries, Collection):
        raise _not(effect, "schedule", entries, expected)
    for entry in entries:
        time, wrench = entry if isinstance(entry, (tuple, list)) and len(entry) == 2 else (None, None)
        if not _is_finite(time) or not isinstance(wrench, Wrench):
            raise _not(effect, "schedule", entries, f"{expected}; found {shown(entry)} among them")
    return tuple((time, wrench) for time, wrench in entries)


def _field(effect: Effect, what: str, field: Field | None) -> Field | None:
    """Return a field that is checked to be three finite numbers at every point."""
    if field is None:
        return None
    if not callable(field):
        raise _not(effect, what, field, "a function of the place, or None for none")

    def at(place: Vector) -> Vector:
        found = field(place)
        vector: object = found
        if not isinstance(vector, Collection) or len(vector) != 3 or not all(map(_is_finite, vector)):
            raise _not(effect, what, found, f"three finite floats (world axes), at {list(place)} m")
        return found

    return at


def _require_load(effect: Effect, load: object) -> None:
    """Check that `load` is a force and a torque in double precision: other types would lose digits of the motion."""
    vectors = [list(part) if isinstance(part, Collection) else [] for part in load] if _is_pair(load) else []
    if not vectors or any(len(vector) != 3 or not all(map(_is_double, vector)) for vector in vectors):
        expected = "a force (N, world axes) and a torque (N m, principal axes), three floats each"
        raise _not(effect, "load", load, f"{expected}, such as ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)) for none")


def _require_stored(effect: Effect, stored: object) -> None:
    momentum, energy = stored if isinstance(stored, Stored) else ((), 0.0)
    if len(momentum) != 3 or not all(map(_is_finite, (*momentum, energy))):
        expected = "Stored(momentum, energy), three finite floats (kg m^2/s, principal axes) and one (J)"
        raise _not(effect, "storing", stored, expected)


def _is_finite(value: object) -> bool:
    return isinstance(value, (float, Integral)) and math.isfinite(value)


def _real(
    effect: Effect, what: str, unit: str, part: Callable[[Point], float] | None, least: float = -math.inf
) -> Callable[[Point], float] | None:
    """Return a function that is checked to be a finite number, and at least `least`, at every point."""
    if part is None:
        return None
    value = _function(effect, what, part)

    def at(point: Point) -> float:
        found = value(point)
        if not _is_finite(found) or found < least:
            bound = f" of {least:g} or more" if math.isfinite(least) else ""
            where = f"at simulation time {point.time:.9g} s and position {list(point.position)} m"
            raise _not(effect, what, found, f"a finite float{bound} ({unit}) {where}")
        return found

    return at


def _is_pair(load: object) -> TypeGuard[Collection[object]]:
    return isinstance(load, Collection) and len(load) == 2


def _is_double(value: object) -> bool:
    return isinstance(value, (float, Integral))


def _ahead(effect: Effect, sight: Sight | None) -> Sight | None:
    """Return a sight that is checked to be greater than 0: otherwise a run could not advance."""
    if sight is None:
        return None
    ahead = _function(effect, "sight", sight)

    def at(point: Point) -> float:
        seconds = ahead(point)
        if not _is_double(seconds) or not seconds > 0.0:
            where = f"at simulation time {point.time:.9g} s; math.inf where nothing is near"
            raise _not(effect, "sight", seconds, f"a time (s) greater than 0 {where}")
        return seconds

    return at


def _inside_the_step(effect: Effect, body: RigidBody, start: float) -> Wrenching | None:
    """Return the load of an effect, which must be declared: methods are checked only for declared loads."""
    part = effect.wrenching(body, start)
    if part is not None:
        _function(effect, "load", part)
    if part is not None and effect.takes == LoadDependence.HELD:
        raise SceneError(
            f"{effect.kind}: has a load inside the step but takes is HELD, expected what the load depends on; declare "
            "takes = LoadDependence.FIELD (time, place, attitude) or LoadDependence.ANY (velocities too) in the effect"
        )
    return part
