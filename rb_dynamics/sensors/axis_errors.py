"""`AxisErrors`: the errors of three sensitive axes, as gyros, accelerometers and magnetometers have them.

The terms are those of IEEE Std 952 (gyros): noise density N gives white noise of N sqrt(rate) in each sample, whose
Allan deviation is N / sqrt(tau); random walk K moves the bias by K / sqrt(rate) from sample to sample, whose Allan
deviation is K sqrt(tau / 3).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from fractions import Fraction
from typing import TYPE_CHECKING, NamedTuple

from rb_dynamics.errors import SceneError
from rb_dynamics.numerics.argument_checks import number, vector
from rb_dynamics.numerics.rotation import Quaternion, exp, rotate
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled
from rb_dynamics.sensors.random_numbers import Key, RandomNumbers, normal_numbers
from rb_dynamics.sensors.sensor import diagonal

if TYPE_CHECKING:
    from rb_dynamics.loads.scene_entry import SceneEntry


# From here on all doubles are whole numbers; adding and subtracting the other rounds smaller ones.
_WHOLE, _ROUND = 2.0**51, 1.5 * 2.0**52


class AxisNumbers(NamedTuple):
    """What `measured` takes.

    Attributes:
        turn: rotation by the misalignment.
        gain: of each axis.
        white: standard deviation of the white noise in a sample.
        step: of the random walk of the bias, from sample to sample.
        limit: the largest size of the output: within the range, and a whole multiple of the resolution.
        unit: the resolution.
    """

    turn: Quaternion
    gain: Vector
    white: float
    step: float
    limit: float
    unit: float


@dataclass(frozen=True, slots=True)
class AxisErrors:
    """Measured = (1 + scale) R(misalignment) true + bias + its random walk + white noise, then resolution and range.

    Attributes:
        noise_density: N, unit / sqrt(Hz).
        random_walk: K, of the bias, unit / sqrt(s).
        bias: initial bias.
        scale: relative error of scale of each axis.
        misalignment: rotation vector, rad, by which a true vector is turned in the frame: the sensitive axes are turned
            the other way.
        range: the largest size of each component; infinite for no limit. At least the resolution.
        resolution: step of the output: each component is a whole multiple of it, and saturates at the last within the
            range, as that of a converter does; 0 for no steps.
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
            unit = self.resolution
            value = number(self.range, "range", _reaching(unit), SceneError, least=unit, above=0.0)
            object.__setattr__(self, "range", value)

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
            unit, remedy = sizes["resolution"], "leave it out for no limit"
            limit = entry.number("range", _reaching(unit), lambda v: v > 0.0 and v >= unit, remedy)
        return cls(
            sizes["noise_density"],
            sizes["random_walk"],
            entry.per_axis("bias", "a finite number"),
            entry.per_axis("scale", "a relative error"),
            entry.vector("misalignment", "an angle (rad)", ZERO),
            limit,
            sizes["resolution"],
        )

    def numbers(self, rate: float) -> AxisNumbers:
        """Return the numbers of `measured` at so many samples a second."""
        white, step = self.noise_density * math.sqrt(rate), self.random_walk / math.sqrt(rate)
        gain = add((1.0, 1.0, 1.0), self.scale)
        return AxisNumbers(exp(self.misalignment), gain, white, step, self._saturation, self.resolution)

    @property
    def _saturation(self) -> float:
        """The last step of the output within the range, both taken as the decimal numbers that were written."""
        if math.isinf(self.range) or not self.resolution > 0.0:
            return self.range
        steps = Fraction(repr(self.range)) // Fraction(repr(self.resolution))
        return min(self.range, steps * self.resolution) if steps < _WHOLE else self.range

    def measuring(self, random: RandomNumbers, lane: int, rate: float) -> Callable[[int, Vector], Vector]:
        """Return a function that adds the errors to true vectors, with noise of the lanes `lane` and `lane` + 1."""
        numbers, key, bias = self.numbers(rate), random.key, self.bias

        def measure(sample: int, true: Vector) -> Vector:
            nonlocal bias
            found, bias = measured(numbers, bias, key, lane, sample, true)
            return found

        return measure

    def covariance(self, rate: float) -> tuple[float, ...]:
        """Return the covariance of a sample, row by row: white noise and rounding; a bias is not noise."""
        variance = self.noise_density * self.noise_density * rate + self.resolution * self.resolution / 12.0
        return diagonal((variance, variance, variance))


def measured(n: AxisNumbers, bias: Vector, key: Key, lane: int, sample: int, true: Vector) -> tuple[Vector, Vector]:
    """Return what the axes measure, and their bias at the next sample; noise is that of `lane` and the one after it."""
    x, y, z = rotate(n.turn, true)
    found, following = add((n.gain[0] * x, n.gain[1] * y, n.gain[2] * z), bias), bias
    if n.white > 0.0:
        found = add_scaled(found, n.white, normal_numbers(key, sample, lane))
    if n.step > 0.0:
        following = add_scaled(bias, n.step, normal_numbers(key, sample, lane + 1))
    return (_shown(n, found[0]), _shown(n, found[1]), _shown(n, found[2])), following


def _shown(n: AxisNumbers, value: float) -> float:
    """Return a value at the resolution and within the range."""
    if n.unit > 0.0:
        steps = value / n.unit
        if abs(steps) < _WHOLE:
            # To the nearest whole number, as `round` does, and 0 for -0.
            value = ((steps + _ROUND) - _ROUND + 0.0) * n.unit
    return min(n.limit, max(-n.limit, value))


def _reaching(unit: float) -> str:
    """Return what a range must be, for an error message."""
    return f"a number of at least the resolution, {unit:g}" if unit > 0.0 else "a number greater than 0"


AXIS_KEYS = tuple(field.name for field in fields(AxisErrors))
"""Keys of the errors in a scene."""
