"""Control laws: from the measurements of many bodies to the commanded torques, arrays in and arrays out.

A law is created once from its parameters for a block of bodies and then called at each sample; it may keep state. It
works element by element, so that a body gets the same bits alone and in a block. `control.py` adds delay, noise and
saturation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rb_dynamics.numerics.arrays import Numbers

Parameters = Mapping[str, "Numbers"]
"""By name: (N,) for a number, (N, k) for a list of k."""


@dataclass(frozen=True)
class Measurement:
    """Input of a law for N bodies.

    Attributes:
        time_s: of the sample, s.
        orientation_xyzw: (N, 4), body to world.
        angular_velocity_body: (N, 3), rad/s.
    """

    time_s: float
    orientation_xyzw: Numbers
    angular_velocity_body: Numbers


Law = Callable[[Measurement], "Numbers"]
"""Returns the torque about the centre of mass, (N, 3), body axes, N m."""


def rate_damping(parameters: Parameters) -> Law:
    """Return tau = -gain w; `gain` in N m s."""
    gain = parameters["gain"][:, None]
    return lambda measured: -gain * measured.angular_velocity_body


def b_dot(parameters: Parameters) -> Law:
    """Return tau = -gain (w - (w . b) b): damping across a field b, none along it, as magnetic torquers have.

    The field turns in the plane of world x and z, once in `field_period` s, as along a polar orbit. `gain` in N m s.
    Stickler and Alfriend, Elementary magnetic attitude control system, J. Spacecraft 13 (1976) 282.
    """
    import numpy as np

    gain, period = parameters["gain"], parameters["field_period"].tolist()

    def law(measured: Measurement) -> Numbers:
        angles = [2.0 * math.pi * measured.time_s / each for each in period]
        across, along = np.array([math.cos(a) for a in angles]), np.array([math.sin(a) for a in angles])
        x, y, z, w = measured.orientation_xyzw.T
        # Rows of the matrix from body to world axes, x and z.
        rows = (
            (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
            (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
        )
        field = [across * first + along * third for first, third in zip(*rows, strict=True)]
        spin = measured.angular_velocity_body.T
        along_field = spin[0] * field[0] + spin[1] * field[1] + spin[2] * field[2]
        return np.stack([-gain * (s - along_field * b) for s, b in zip(spin, field, strict=True)], axis=-1)

    return law


def attitude_pd(parameters: Parameters) -> Law:
    """Return tau = -2 proportional sign(e4) e - derivative w, with e the error from `target` as a quaternion.

    `proportional` in N m/rad, `derivative` in N m s, `target` (x, y, z, w) body to world, by default the identity.

    Wie, Weiss and Arapostathis, Quaternion feedback regulator, J. Guidance 12 (1989) 375, eq. 11.
    """
    import numpy as np

    proportional, derivative = 2.0 * parameters["proportional"], parameters["derivative"]
    identity = np.array([[0.0, 0.0, 0.0, 1.0]])
    a, b, c, d = _conjugate(parameters.get("target", identity))

    def law(measured: Measurement) -> Numbers:
        x, y, z, w = measured.orientation_xyzw.T
        error = (
            d * x + a * w + b * z - c * y,
            d * y - a * z + b * w + c * x,
            d * z + a * y - b * x + c * w,
        )
        scalar = d * w - a * x - b * y - c * z
        stiff = np.where(scalar < 0.0, -proportional, proportional)
        spin = measured.angular_velocity_body.T
        return np.stack([-stiff * e - derivative * s for e, s in zip(error, spin, strict=True)], axis=-1)

    return law


def _conjugate(quaternion: Numbers) -> tuple[Numbers, Numbers, Numbers, Numbers]:
    x, y, z, w = quaternion.T
    return -x, -y, -z, w


LAWS: Mapping[str, Callable[[Parameters], Law]] = {
    "rate_damping": rate_damping,
    "b_dot": b_dot,
    "attitude_pd": attitude_pd,
}

REQUIRED: Mapping[str, tuple[str, ...]] = {
    "rate_damping": ("gain",),
    "b_dot": ("gain", "field_period"),
    "attitude_pd": ("proportional", "derivative"),
}
"""Required parameters of a law."""

OPTIONAL: Mapping[str, tuple[str, ...]] = {"attitude_pd": ("target",)}
