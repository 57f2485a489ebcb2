"""Distributions of one number, each as a function from a probability to a value.

In this form, every sampling (random, Latin hypercube, Sobol) and every correlation works with every distribution. The
bits of a value depend only on its own probability, not on how many are computed at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from rb_dynamics.numerics.array_types import Numbers


class Distribution(Protocol):
    """A distribution, given by its quantile function."""

    def quantile(self, probability: Numbers) -> Numbers:
        """Return the values (n,) that are not exceeded with `probability` (n,), strictly between 0 and 1."""


@dataclass(frozen=True)
class Normal:
    """The normal distribution, truncated to `low` … `high`."""

    mean: float
    deviation: float
    low: float = -math.inf
    high: float = math.inf

    def quantile(self, probability: Numbers) -> Numbers:
        """Return the quantiles; see `Distribution`."""
        from scipy.special import ndtri

        if self.deviation == 0.0:
            return 0.0 * probability + self.mean
        if self.low > self.mean:
            return -self._mirrored.quantile(1.0 - probability)
        below, above = self._chances
        values: Numbers = self.mean + self.deviation * ndtri(below + (above - below) * probability)
        # Rounding may exceed a bound.
        return values.clip(self.low, self.high)

    @property
    def possible(self) -> bool:
        """Whether double precision has a chance of a value between the bounds."""
        if self.deviation == 0.0:
            return self.low <= self.mean <= self.high
        if self.low > self.mean:
            return self._mirrored.possible
        below, above = self._chances
        return above > below

    @property
    def _mirrored(self) -> Normal:
        """The distribution of the negative: chances above about 8 deviations round to 1, those below do not to 0."""
        return Normal(-self.mean, self.deviation, -self.high, -self.low)

    @property
    def _chances(self) -> tuple[float, float]:
        """The chances of values below both bounds."""
        from scipy.special import ndtr

        below, above = (float(ndtr((edge - self.mean) / self.deviation)) for edge in (self.low, self.high))
        return below, above


@dataclass(frozen=True)
class Uniform:
    """Uniform between `low` and `high`."""

    low: float
    high: float

    def quantile(self, probability: Numbers) -> Numbers:
        """Return the quantiles; see `Distribution`."""
        return (self.low + (self.high - self.low) * probability).clip(self.low, self.high)


@dataclass(frozen=True)
class LogUniform:
    """Uniform in the logarithm between `low` and `high`, both greater than 0."""

    low: float
    high: float

    def quantile(self, probability: Numbers) -> Numbers:
        """Return the quantiles; see `Distribution`."""
        return exponentials(math.log(self.low) + math.log(self.high / self.low) * probability).clip(self.low, self.high)


@dataclass(frozen=True)
class LogNormal:
    """A factor whose logarithm is normally distributed, with median 1."""

    deviation: float

    def quantile(self, probability: Numbers) -> Numbers:
        """Return the quantiles; see `Distribution`."""
        from scipy.special import ndtri

        return exponentials(self.deviation * ndtri(probability))


@dataclass(frozen=True)
class Choice:
    """One of `values`, with probabilities `weights` that add up to 1."""

    values: tuple[float, ...]
    weights: tuple[float, ...]

    def quantile(self, probability: Numbers) -> Numbers:
        """Return the quantiles, in the order of `values`; see `Distribution`."""
        import numpy as np

        ends = np.cumsum(self.weights)[:-1]
        return np.array(self.values)[np.searchsorted(ends, probability, side="right")]


@dataclass(frozen=True)
class Stepped:
    """Another distribution, rounded to whole multiples of `step`; of a uniform one all are as likely."""

    distribution: Normal | Uniform | LogUniform
    step: float

    def quantile(self, probability: Numbers) -> Numbers:
        """Return the quantiles; see `Distribution`."""
        import numpy as np

        found, half = self.distribution, 0.5 * self.step
        wide = Uniform(found.low - half, found.high + half) if isinstance(found, Uniform) else found
        rounded: Numbers = np.rint(wide.quantile(probability).clip(found.low, found.high) / self.step) * self.step
        return rounded


def exponentials(exponents: Numbers) -> Numbers:
    """Return e to the power of each of (n,), one by one with libm: vector units differ in the last bits."""
    import numpy as np

    return np.array([math.exp(exponent) for exponent in exponents.tolist()])
