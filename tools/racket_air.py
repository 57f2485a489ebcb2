"""The air on a tennis racket, as an effect of one's own that `identify` fits: cylinders in cross-flow.

Frame, throat, handle and strings are cylinders. Air presses on each piece of one along its velocity across its axis,
with c rho / 2 times speed squared times length times diameter (cross-flow principle: Hoerner, Fluid-Dynamic Drag
(1965), chapter 3). So the torque also depends on how fast the racket flies, which a gyro does not measure.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, NamedTuple

from rb_dynamics import Effect, RigidBody, SceneError
from rb_dynamics.loads.effect import Point, Wrenching
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.numerics.rotation import Quaternion, conjugate, multiply, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, cross, norm, scale

DENSITY = 1.2
# Of a racket of 27 inches, m: half axes of the head, its centre and the butt from the centre of mass along the handle.
WIDE, LONG, HEAD, BUTT = 0.125, 0.165, 0.1, -0.413


def pieces() -> tuple[tuple[float, float, float, float, float], ...]:
    """Return place x, y, length times diameter, and direction x, y of each piece; all lie in one plane."""
    found = [(0.0, BUTT + 0.076 * (k + 0.5), 0.076 * 0.033, 0.0, 1.0) for k in range(3)]
    found += [(side * 0.032, -0.12, 0.14 * 0.02, -side * 0.26, 0.966) for side in (-1.0, 1.0)]
    for k in range(8):
        c, s = math.cos(math.tau * (k + 0.5) / 8), math.sin(math.tau * (k + 0.5) / 8)
        size = math.hypot(WIDE * s, LONG * c)
        found.append((WIDE * c, HEAD + LONG * s, size * math.tau / 8 * 0.022, -WIDE * s / size, LONG * c / size))
    # 16 strings along the handle and 18 across it, of 1.3 mm; a quarter of each in each quadrant.
    for x, y in ((0.5, 0.5), (0.5, -0.5), (-0.5, 0.5), (-0.5, -0.5)):
        for count, width, along in ((16, 2.0 * WIDE, (0.0, 1.0)), (18, 2.0 * LONG, (1.0, 0.0))):
            area = count / width * math.pi * WIDE * LONG / 4 * 0.0013
            found.append((WIDE * x, HEAD + LONG * y, area, *along))
    return tuple(found)


PIECES = pieces()


class Pressure(NamedTuple):
    """Numbers of the load: c rho / 2, and principal to body axes."""

    factor: float
    axes: Quaternion


def pushed(air: Pressure, point: Point) -> tuple[Vector, Vector]:
    """Return force (world axes) and torque (principal axes)."""
    to_world = multiply(point.orientation, conjugate(air.axes))
    rate, speed = rotate(air.axes, point.angular_velocity), rotate_inverse(to_world, point.velocity)
    force, torque = ZERO, ZERO
    for x, y, area, tx, ty in PIECES:
        u = add(speed, cross(rate, (x, y, 0.0)))
        along = u[0] * tx + u[1] * ty
        across = (u[0] - along * tx, u[1] - along * ty, u[2])
        push = scale(-air.factor * area * norm(across), across)
        force, torque = add(force, push), add(torque, cross((x, y, 0.0), push))
    return rotate(to_world, force), rotate_inverse(air.axes, torque)


@dataclass(frozen=True)
class CrossFlow(Effect):
    """Drag of the cylinders, with one coefficient: about 1.1 for each."""

    kind: ClassVar[str] = "cross_flow"
    takes: ClassVar[LoadDependence] = LoadDependence.ANY
    coefficient: float = 1.1

    def __post_init__(self) -> None:
        """Refuse what is no drag; `identify` then stays on this side."""
        if not self.coefficient >= 0.0:
            raise SceneError(f"cross_flow: coefficient is {self.coefficient}, expected 0 or more")

    def wrenching(self, body: RigidBody, start: float) -> Wrenching:
        """Return the load as a function of a module and its numbers, so that it is compiled."""
        return partial(pushed, Pressure(0.5 * DENSITY * self.coefficient, body.principal_orientation_xyzw))
