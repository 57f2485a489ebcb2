"""Control laws: from the measurements of many bodies to commands, arrays in and arrays out.

A law is created once from its parameters for a block of bodies and then called at each sample; it may keep state. It
works element by element, so that a body gets the same bits alone and in a block. `control.py` adds delay, noise and
saturation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

from rb_dynamics.study.campaign.control_inputs import OnboardValues

if TYPE_CHECKING:
    import numpy as np

    from rb_dynamics.numerics.array_types import Numbers

Parameters = Mapping[str, "Numbers"]
"""By name: (N,) for a number, (N, k) for a list of k."""


class RandomStreams:
    """A stream of random numbers for each of N runs, which depends on the seed of the campaign and the run alone."""

    def __init__(self, make: Callable[[], Sequence[np.random.Generator]]) -> None:
        """Draw from the generators that `make` returns, one for each run."""
        self._make = make

    def normal(self, count: int) -> Numbers:
        """Return the next `count` numbers of each run, of the standard normal distribution, (N, `count`)."""
        import numpy as np

        return np.stack([each.standard_normal(count) for each in self._streams])

    def uniform(self, count: int) -> Numbers:
        """Return the next `count` numbers of each run, evenly distributed from 0 to 1, (N, `count`)."""
        import numpy as np

        return np.stack([each.random(count) for each in self._streams])

    @cached_property
    def _streams(self) -> Sequence[np.random.Generator]:
        return self._make()


class LawInput:
    """Input of a law for N bodies.

    Attributes:
        time_s: of the sample, s.
        sensors: newest message of each sensor of the scene, by its name: `time_s` (N,) when it was taken, and what it
            measures: `angular_velocity`, `specific_force`, `magnetic_field`, `direction` (N, 3) in the axes of the
            sensor, `orientation_xyzw` (N, 4) sensor to world, `position_world` (N, 3). NaN before the first message.
        wheel_speeds: of each reaction wheel, relative to the body, rad/s, (N,), by its name.
        random: streams of random numbers.
    """

    def __init__(
        self,
        time_s: float,
        orientation_xyzw: Numbers | None,
        angular_velocity_body: Numbers | None,
        random: RandomStreams,
        onboard: OnboardValues,
    ) -> None:
        """Make the input of a law; None for what no sensor measures."""
        self.time_s, self.random = time_s, random
        self.sensors, self.wheel_speeds = onboard.sensors, onboard.wheel_speeds
        self._field = onboard.field_world
        self._orientation, self._rate = orientation_xyzw, angular_velocity_body

    @cached_property
    def magnetic_field_world(self) -> Numbers | None:
        """Flux density of the scene's field at the body origin, T, (N, 3); None without a field."""
        return None if self._field is None else self._field()

    @property
    def orientation_xyzw(self) -> Numbers:
        """(N, 4), body to world: the true one with noise, or as the first sensor that measures it says.

        Raises:
            LookupError: the scene has sensors, of which none measures it.
        """
        return _known(self._orientation, "attitude", "a star_tracker or a pose")

    @property
    def angular_velocity_body(self) -> Numbers:
        """(N, 3), rad/s: the true one with noise, or as the first sensor that measures it says.

        Raises:
            LookupError: the scene has sensors, of which none measures it.
        """
        return _known(self._rate, "angular velocity", "an imu")


def _known(values: Numbers | None, what: str, sensor: str) -> Numbers:
    if values is None:
        raise LookupError(f"no sensor of the scene measures the {what}; add {sensor} to sensors")
    return values


Law = Callable[[LawInput], "Numbers | Mapping[str, Numbers]"]
"""Returns the torque about the centre of mass, (N, 3), body axes, N m; or commands by name.

These are `torque` and `force` (N, through the centre of mass, body axes), (N, 3), and actuators of the scene, (N,), in
their units. What is left out stays as it was.
"""


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

    def law(measured: LawInput) -> Numbers:
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
        return np.stack([-gain * (s - along_field * b) for s, b in zip(spin, field, strict=True)]).T

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

    def law(measured: LawInput) -> Numbers:
        x, y, z, w = measured.orientation_xyzw.T
        error = (
            d * x + a * w + b * z - c * y,
            d * y - a * z + b * w + c * x,
            d * z + a * y - b * x + c * w,
        )
        scalar = d * w - a * x - b * y - c * z
        stiff = np.where(scalar < 0.0, -proportional, proportional)
        spin = measured.angular_velocity_body.T
        return np.stack([-stiff * e - derivative * s for e, s in zip(error, spin, strict=True)]).T

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

HEARS: Mapping[str, Mapping[str, str]] = {
    "rate_damping": {"angular_velocity": "an imu"},
    "b_dot": {"angular_velocity": "an imu", "orientation_xyzw": "a star_tracker or a pose"},
    "attitude_pd": {"angular_velocity": "an imu", "orientation_xyzw": "a star_tracker or a pose"},
}
"""What a sensor must measure for a law, and what does."""
