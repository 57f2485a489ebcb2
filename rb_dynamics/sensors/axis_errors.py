"""`AxisErrors`: the errors of three sensitive axes, as gyros, accelerometers and magnetometers have them.

The terms are those of IEEE Std 952 (gyros): noise density N gives white noise of N sqrt(rate) in each sample, whose
Allan deviation is N / sqrt(tau); random walk K moves the bias by K / sqrt(rate) from sample to sample, whose Allan
deviation is K sqrt(tau / 3).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from rb_dynamics.errors import SceneError
from rb_dynamics.numerics.argument_checks import number, vector
from rb_dynamics.numerics.rotation import exp, rotate
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled
from rb_dynamics.sensors.random_numbers import Four, RandomNumbers
from rb_dynamics.sensors.sensor import diagonal

if TYPE_CHECKING:
    from rb_dynamics.loads.scene_entry import SceneEntry


@dataclass(frozen=True, slots=True)
class AxisErrors:
    """Measured = (1 + scale) R(misalignment) true + bias + its random walk + white noise, then range and resolution.

    Attributes:
        noise_density: N, unit / sqrt(Hz).
        random_walk: K, of the bias, unit / sqrt(s).
        bias: initial bias.
        scale: relative error of scale of each axis.
        misalignment: rotation vector, rad, by which a true vector is turned in the frame: the sensitive axes are turned
            the other way.
        range: the largest size of each component; infinite for no limit.
        resolution: step of the output: each component is a whole multiple of it; 0 for no steps.
    """

    noise_density: float = 0.0
    random_walk: float = 0.0
    bias: Vector = ZERO
    scale: Vector = ZERO
    misalignment: Vector = ZERO
    range: float = math.inf
    resolution: float = 0.0

    def __post_init__(self) -> None:
        """Check the arguments.

        Raises:
            TypeError: an argument is not of its type.
            SceneError: a number is out of range.
        """
        for name in ("noise_density", "random_walk", "resolution"):
            value = number(getattr(self, name), name, "a finite number of 0 or more", SceneError, least=0.0)
            object.__setattr__(self, name, value)
        for name in ("bias", "scale", "misalignment"):
            object.__setattr__(self, name, vector(getattr(self, name), name, "one number for each axis", SceneError))
        if self.range != math.inf:
            expected = "a number greater than 0, infinite for no limit"
            object.__setattr__(self, "range", number(self.range, "range", expected, SceneError, above=0.0))

    @classmethod
    def read(cls, entry: SceneEntry | None) -> AxisErrors:
        """Return the errors in an entry of a scene; no errors if there is no entry."""
        if entry is None:
            return cls()
        size, remedy = "a number of 0 or more", "write a size without a sign"
        sizes: Mapping[str, float] = {
            name: entry.number(name, size, lambda v: v >= 0.0, remedy, 0.0)
            for name in ("noise_density", "random_walk", "resolution")
        }
        limit = math.inf
        if entry.has("range"):
            limit = entry.number("range", "a number greater than 0", lambda v: v > 0.0, "leave it out for no limit")
        return cls(
            sizes["noise_density"],
            sizes["random_walk"],
            entry.per_axis("bias", "a finite number"),
            entry.per_axis("scale", "a relative error"),
            entry.vector("misalignment", "an angle (rad)", ZERO),
            limit,
            sizes["resolution"],
        )

    def measuring(self, random: RandomNumbers, lane: int, rate: float) -> Callable[[int, Vector], Vector]:
        """Return a function that adds the errors to true vectors, with noise of the lanes `lane` and `lane` + 1."""
        white, step = self.noise_density * math.sqrt(rate), self.random_walk / math.sqrt(rate)
        turn, gain, limit, unit = exp(self.misalignment), add((1.0, 1.0, 1.0), self.scale), self.range, self.resolution
        bias = self.bias

        def measure(sample: int, true: Vector) -> Vector:
            nonlocal bias
            x, y, z = rotate(turn, true)
            found = add((gain[0] * x, gain[1] * y, gain[2] * z), bias)
            if white > 0.0:
                found = add_scaled(found, white, _three(random.normal(sample, lane)))
            if step > 0.0:
                bias = add_scaled(bias, step, _three(random.normal(sample, lane + 1)))
            a, b, c = (min(limit, max(-limit, value)) for value in found)
            return (round(a / unit) * unit, round(b / unit) * unit, round(c / unit) * unit) if unit > 0.0 else (a, b, c)

        return measure

    def covariance(self, rate: float) -> tuple[float, ...]:
        """Return the covariance of a sample, row by row: white noise and rounding; a bias is not noise."""
        variance = self.noise_density * self.noise_density * rate + self.resolution * self.resolution / 12.0
        return diagonal((variance, variance, variance))


AXIS_KEYS = tuple(field.name for field in fields(AxisErrors))
"""Keys of the errors in a scene."""


def _three(numbers: Four) -> Vector:
    return numbers[:3]
