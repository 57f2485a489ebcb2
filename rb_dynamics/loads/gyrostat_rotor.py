"""A rotor: a wheel driven about an axis fixed in the body at a constant or scheduled rate (gyrostat)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import count, pairwise
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import SceneError
from rb_dynamics.loads.effect import Effect, Point, Stored, Storing, Wrenching
from rb_dynamics.loads.number_ranges import Range, check_numbers, check_vector, read_numbers
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.numerics.argument_checks import items, number, shown
from rb_dynamics.numerics.nanoseconds import on_nanosecond
from rb_dynamics.numerics.rotation import rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, cross, dot, norm, scale, subtract
from rb_dynamics.numerics.vector import multiply as times

if TYPE_CHECKING:
    from rb_dynamics.loads.scene_entry import SceneEntry

_RATE = "a finite number (rad/s)"


def _knot(k: int, pair: object) -> tuple[float, float]:
    """Return entry `k` of a spin rate, its time on a whole nanosecond."""
    name, expected = f"rotor: spin_rate[{k}]", "a pair of time (s) and rate (rad/s)"
    found = items(pair, name, expected)
    if len(found) != 2:
        raise TypeError(f"{name} is {shown(pair)}, expected {expected}; write (0.0, 100.0)")
    time, rate = (number(value, name, expected, SceneError) for value in found)
    return on_nanosecond(time), rate


class Spin(NamedTuple):
    """A rotor between two knots: axis (principal axes), inertia, and rate from `begin` (s) on."""

    axis: Vector
    inertia: float
    begin: float
    rate: float
    slope: float


def reaction(s: Spin, point: Point) -> tuple[Vector, Vector]:
    """Return the inner torque of the rotor on the body, -w x h - h', and no force."""
    h = scale(s.inertia * (s.rate + s.slope * (point.time - s.begin)), s.axis)
    return ZERO, subtract(scale(-s.inertia * s.slope, s.axis), cross(point.angular_velocity, h))


@dataclass(frozen=True)
class Rotor(Effect):
    """A wheel of axial inertia J (kg m^2) about the unit axis a, at the rate s(t) (rad/s) relative to the body.

    With h = J s a, body and rotor together have the angular momentum L = I w + h, where I is the inertia of body and
    rotor with the rotor locked, and I w' = N - w x (I w + h) - h' (Hughes, Spacecraft Attitude Dynamics, section 3.4).
    The energy is w . I w / 2 + J s a . w + J s^2 / 2; the motor does the work that maintains and changes the rate.

    Attributes:
        axis_body: direction of the axis, body axes; its length does not matter.
        axial_inertia: J, already counted in the inertia of the body.
        spin_rate: (time in s, rate in rad/s) pairs in order of time; linear between, constant before and after.
    """

    kind: ClassVar[str] = "rotor"
    takes: ClassVar[LoadDependence] = LoadDependence.ANY
    keys: ClassVar[tuple[str, ...]] = ("axis_body", "axial_inertia", "spin_rate")
    takes_arrays: ClassVar[bool] = True
    ranges: ClassVar[Mapping[str, Range]] = {
        "axial_inertia": Range(
            "a number greater than 0 (kg m^2)", "write the rotor's inertia about its own axis", above=0.0
        )
    }

    axis_body: Vector
    axial_inertia: float
    spin_rate: tuple[tuple[float, float], ...]

    @classmethod
    def read(cls, entry: SceneEntry) -> Rotor:
        """Return the effect of an entry."""
        if entry.is_particle:
            entry.reject("no rotor, as a body without inertia is a particle", "add body.inertia or remove it")
        axis = entry.direction("axis_body", "write the rotor's axis, such as [0, 0, 1]")
        inertia = read_numbers(cls, entry)["axial_inertia"]
        if entry.is_list("spin_rate"):
            knots = entry.timeline("spin_rate", ("rate",), "a list", "write {time:, rate:} entries")
            return cls(axis, inertia, tuple((time, at.number("rate", _RATE)) for time, at in knots))
        return cls(axis, inertia, ((0.0, entry.number("spin_rate", f"{_RATE} or a list of {{time:, rate:}}")),))

    def __post_init__(self) -> None:
        """Check the arguments, and round the knots to whole nanoseconds, where steps can end.

        Raises:
            TypeError: an argument is not of its type.
            SceneError: a value is not possible for a rotor.
        """
        check_vector(self, "axis_body", "the direction of its axis", direction=True)
        check_numbers(self)
        knots = tuple(map(_knot, count(), items(self.spin_rate, "rotor: spin_rate", "(time, rate) pairs")))
        times = [time for time, _ in knots]
        if not knots or times[0] < 0.0 or any(later <= earlier for earlier, later in pairwise(times)):
            raise SceneError(
                f"rotor: spin_rate has the times {times} s, expected at least one, not negative, each later than the "
                "one before by a nanosecond or more; sort them"
            )
        object.__setattr__(self, "spin_rate", knots)

    def check(self, body: RigidBody) -> None:
        """Check that the rotor can be a part of `body`.

        Raises:
            SceneError: the body is a particle, or its inertia about the axis is smaller than the rotor's.
        """
        axis = self._axis(body)
        whole = dot(axis, times(body.principal_moments, axis))
        if self.axial_inertia > whole * (1.0 + 1e-9):
            raise SceneError(
                f"rotor: axial_inertia is {self.axial_inertia!r}, expected at most {whole:.6g} kg m^2, the inertia of "
                "the body about that axis, in which the rotor is counted; add the rotor to body.inertia"
            )

    @property
    def momentum_body(self) -> Vector:
        """h = J s a at the first knot (N m s), body axes."""
        return scale(self.axial_inertia * self.spin_rate[0][1] / norm(self.axis_body), self.axis_body)

    def with_momentum(self, momentum_body: Vector) -> Rotor:
        """Return the same of constant momentum (N m s), body axes: its axis and rate follow."""
        size = norm(momentum_body)
        axis = scale(1.0 / size, momentum_body) if size else self.axis_body
        return replace(self, axis_body=axis, spin_rate=((0.0, size / self.axial_inertia),))

    def knots(self) -> tuple[float, ...]:
        """Return where the acceleration of the rotor changes."""
        return tuple(time for time, _ in self.spin_rate) if len(self.spin_rate) > 1 else ()

    def wrenching(self, body: RigidBody, start: float) -> Wrenching:
        """Return the inner torque of the rotor on the body, -w x h - h', and no force."""
        return partial(reaction, self.spin(body, start))

    def spin(self, body: RigidBody, start: float) -> Spin:
        """Return what its load depends on from `start` (s) to the next knot."""
        return Spin(self._axis(body), self.axial_inertia, *self._piece(start))

    def storing(self, body: RigidBody) -> Storing:
        """Return h and J s a . w + J s^2 / 2 at a point."""
        axis, inertia = self._axis(body), self.axial_inertia

        def stored(point: Point) -> Stored:
            time: Any = point.time
            begin, rate, slope = self._piece(time) if isinstance(time, float) else self._pieces(time)
            spin = rate + slope * (time - begin)
            energy = inertia * spin * (dot(axis, point.angular_velocity) + 0.5 * spin)
            return Stored(scale(inertia * spin, axis), energy)

        return stored

    def _axis(self, body: RigidBody) -> Vector:
        axis = rotate_inverse(body.principal_orientation_xyzw, self.axis_body)
        return scale(1.0 / norm(axis), axis)

    def _pieces(self, times: Any) -> Any:
        """Return the same as `_piece` for an array of times."""
        import numpy as np

        begins = [begin for begin, _ in self.spin_rate]
        pieces = np.array([self._piece(begin) for begin in (-1.0, *begins)])
        return pieces[np.searchsorted(begins, times, side="right")].T

    def _piece(self, time: float) -> tuple[float, float, float]:
        """Return start, rate at the start and slope of the piece that begins at or before `time` and holds after it."""
        before = (self.spin_rate[0][0], self.spin_rate[0][1])
        for knot in self.spin_rate:
            if knot[0] > time:
                slope = (knot[1] - before[1]) / (knot[0] - before[0]) if knot[0] > before[0] else 0.0
                return before[0], before[1], slope
            before = knot
        return before[0], before[1], 0.0
