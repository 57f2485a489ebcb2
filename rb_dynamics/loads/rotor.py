"""A rotor: a wheel that its motor turns about an axis fixed in the body, at a constant or scheduled rate (gyrostat)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.loads.effect import Effect, Point, Stored, Storing, Wrenching
from rb_dynamics.loads.load import Takes
from rb_dynamics.rotation import rotate_inverse
from rb_dynamics.vector import ZERO, Vector, cross, dot, norm, scale, subtract


@dataclass(frozen=True)
class Rotor(Effect):
    """A wheel of axial inertia J (kg m^2) about the unit axis a, at the rate s(t) (rad/s) relative to the body.

    With h = J s a the whole has the angular momentum L = I w + h, where I is the inertia of body and rotor with the
    rotor locked, and I w' = N - w x (I w + h) - h' (Hughes, Spacecraft Attitude Dynamics, section 3.4). The energy is
    w . I w / 2 + J s a . w + J s^2 / 2; the motor does the work that keeps the rate and changes it.

    Attributes:
        axis_body: direction of the axis, body axes; its length does not count.
        axial_inertia: J, already counted in the inertia of the body.
        spin_rate: (time in s, rate in rad/s) pairs in order of time; linear between, constant before and after.
    """

    kind: ClassVar[str] = "rotor"
    takes: ClassVar[Takes] = Takes.ANY

    axis_body: Vector
    axial_inertia: float
    spin_rate: tuple[tuple[float, float], ...]

    def knots(self) -> tuple[float, ...]:
        """Return where the acceleration of the rotor changes."""
        return tuple(time for time, _ in self.spin_rate) if len(self.spin_rate) > 1 else ()

    def wrenching(self, body: RigidBody, start: float) -> Wrenching:
        """Return what the rotor does to the body, -w x h - h': an inner torque, no force."""
        axis = self._axis(body)
        begin, rate, slope = self._piece(start)
        reaction = scale(-self.axial_inertia * slope, axis)

        def torque(point: Point) -> tuple[Vector, Vector]:
            h = scale(self.axial_inertia * (rate + slope * (point.time - begin)), axis)
            return ZERO, subtract(reaction, cross(point.angular_velocity, h))

        return torque

    def storing(self, body: RigidBody) -> Storing:
        """Return h and J s a . w + J s^2 / 2 at a point."""
        axis, inertia = self._axis(body), self.axial_inertia

        def stored(point: Point) -> Stored:
            begin, rate, slope = self._piece(point.time)
            spin = rate + slope * (point.time - begin)
            energy = inertia * spin * (dot(axis, point.angular_velocity) + 0.5 * spin)
            return Stored(scale(inertia * spin, axis), energy)

        return stored

    def _axis(self, body: RigidBody) -> Vector:
        axis = rotate_inverse(body.principal_orientation_xyzw, self.axis_body)
        return scale(1.0 / norm(axis), axis)

    def _piece(self, time: float) -> tuple[float, float, float]:
        """Return start, rate at the start and slope of the piece that begins at or before `time` and holds after it."""
        before = (self.spin_rate[0][0], self.spin_rate[0][1])
        for knot in self.spin_rate:
            if knot[0] > time:
                slope = (knot[1] - before[1]) / (knot[0] - before[0]) if knot[0] > before[0] else 0.0
                return before[0], before[1], slope
            before = knot
        return before[0], before[1], 0.0
