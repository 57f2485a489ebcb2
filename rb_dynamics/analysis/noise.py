"""Estimate the noise of a quantity that should be constant, and decide whether it changes by more than its noise.

Third differences show the noise and hardly any smooth change; the spread about the mean shows both. For pure noise
their ratio is 1 (von Neumann, Annals of Mathematical Statistics 12 (1941) 367, with higher differences). The ratio is
taken for means of ever longer blocks: longer blocks reveal smaller changes, shorter ones faster changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.track import Array

Labels = NDArray[np.int_]

# Sum of the squares of 1, -3, 3, -1.
_THIRD = 20.0
# Variance of the ratio of K means: 2/K (1 + 2 (0.75^2 + 0.3^2 + 0.05^2) - 1).
_SPREAD = 2.62
# A ratio counts as more than noise if it is this many standard deviations above 1: practically none of 10 000
# recordings of pure noise, also with fewer means than these, whose ratio is skewed.
_BEYOND = 10.0
_LEAST_MEANS = 16
# Neighbouring samples may repeat or filter one measurement: if there are enough, blocks have at least this many.
_NEIGHBOURS = 4


@dataclass(frozen=True)
class Noise:
    """Result of `judge`.

    Attributes:
        level: standard deviation of one sample, all components together; infinite if there are too few samples.
        beyond: whether the values change by more than noise.
        sizes: block sizes that were tested, in samples.
        wander: sum of squares, over all samples, that integrated noise explains.
    """

    level: float
    beyond: bool
    sizes: tuple[int, ...]
    wander: float = 0.0

    def seen(self) -> float:
        """Return the root of the sum of squares, over all samples, of a smooth change that is surely detected."""
        return 2.0 * float(np.sqrt(self.level**2 * _BEYOND * np.sqrt(_SPREAD * _LEAST_MEANS) + self.wander))


def judge(values: Array, stretch: Labels, steps: Array | None = None) -> Noise:
    """Return the noise of `values`, (n, c), and whether they are otherwise constant within each stretch.

    Args:
        values: should be constant within a stretch.
        stretch: number of the stretch of each row, ascending.
        steps: (n,) variance of the noise that each row adds to all after it; None for none.
    """
    wander = 0.0 if steps is None else _BEYOND * _wander(steps, stretch)
    size = _NEIGHBOURS if len(values) >= _NEIGHBOURS * 2 * _LEAST_MEANS else 1
    level, beyond = np.inf, False
    sizes: list[int] = []
    while True:
        mean, of = means(values, stretch, size)
        third = _thirds(mean, of)
        count = len(mean) - len(np.unique(of))
        if len(third) < _LEAST_MEANS - 3 or count < _LEAST_MEANS - 1:
            if size == 1 or sizes:
                return Noise(level, beyond, tuple(sizes), wander)
            size = 1
            continue
        noise = float(np.sum(third**2)) / len(third) / _THIRD
        spread = float(np.sum(centred(mean, of) ** 2)) / count
        level = level if sizes else float(np.sqrt(size * noise))
        accepted = (1.0 + _BEYOND * np.sqrt(_SPREAD / len(third))) * noise + wander / (size * count)
        beyond = beyond or bool(spread > accepted)
        sizes.append(size)
        size *= 2


def _wander(steps: Array, stretch: Labels) -> float:
    """Return the sum of squares about the means of the stretches that is expected of a random walk of these steps."""
    _, begins, number, count = np.unique(stretch, return_index=True, return_inverse=True, return_counts=True)
    before = np.arange(len(stretch)) - begins[number]
    return float(np.sum(steps * before * (1.0 - before / count[number])))


def typical(values: Array, stretch: Labels) -> float:
    """Return the median magnitude of the noise of a row, which short changes do not affect; 0 for too few."""
    third = _thirds(values, stretch)
    return float(np.median(np.linalg.norm(third, axis=1)) / np.sqrt(_THIRD)) if len(third) else 0.0


def _thirds(values: Array, stretch: Labels) -> Array:
    """Return the third differences within stretches."""
    third: Array = values[3:] - 3.0 * values[2:-1] + 3.0 * values[1:-2] - values[:-3]
    within: Array = third[stretch[3:] == stretch[:-3]]
    return within


def means(values: Array, stretch: Labels, size: int) -> tuple[Array, Labels]:
    """Return the mean of each block of `size` rows within a stretch, and its stretch; drops incomplete blocks."""
    begins = np.flatnonzero(np.diff(stretch, prepend=stretch[:1] - 1))
    lengths = np.diff(begins, append=len(stretch)) // size
    firsts = (
        np.repeat(begins - size * np.concatenate([[0], np.cumsum(lengths)[:-1]]), lengths) if len(begins) else begins
    )
    rows = (firsts + size * np.arange(len(firsts)))[:, None] + np.arange(size)
    mean: Array = values[rows].mean(axis=1)
    return mean, np.repeat(stretch[begins], lengths)


def centred(values: Array, stretch: Labels) -> Array:
    """Return `values` minus the mean of their stretch."""
    _, number, count = np.unique(stretch, return_inverse=True, return_counts=True)
    flat = values.reshape(len(values), -1)
    sums = np.stack([np.bincount(number, column, len(count)) for column in flat.T], axis=1)
    result: Array = (flat - (sums / count[:, None])[number]).reshape(values.shape)
    return result
