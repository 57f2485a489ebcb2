"""Estimate the noise of a quantity that should be constant, and decide whether it changes by more than its noise.

Third differences show the noise and hardly any smooth change; the spread about the mean shows both. For pure noise
their ratio is 1 (von Neumann, Annals of Mathematical Statistics 12 (1941) 367, with higher differences). The ratio is
taken for means of ever longer blocks: longer blocks reveal smaller changes, shorter ones faster changes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.track import Array, Times, in_blocks, parts
from rb_dynamics.numerics.growing_array import give_back, stored

Labels = NDArray[np.int_]

# Sum of the squares of 1, -3, 3, -1.
_THIRD = 20.0
# Variance of the ratio of K means: 2/K (1 + 2 (0.75^2 + 0.3^2 + 0.05^2) - 1).
_SPREAD = 2.62
# A ratio counts as more than noise if it is this many standard deviations above 1: practically none of 10 000
# recordings of pure noise, also with fewer means than these, whose ratio is skewed.
_BEYOND = 10.0
_LEAST_MEANS = 16
# Blocks so many times longer show whether the noise of neighbours is correlated; no noise is by more than this factor.
_LONGER, _MOST_COLOUR = (2, 4, 8), 100.0
# Neighbouring samples may repeat or filter one measurement: if there are enough, blocks have at least this many.
_NEIGHBOURS = 4
# So many rows tell how they are filtered.
_ENOUGH = 100_000


@dataclass(frozen=True)
class Noise:
    """Result of `judge`.

    Attributes:
        level: standard deviation of one sample, all components together; infinite if there are too few samples.
        beyond: whether the values change by more than noise.
        sizes: block sizes that were tested, in samples.
        wander: sum of squares, over all samples, that integrated noise explains.
        coloured: whether they change by more than noise of which each sample is independent, but by no more than noise
            that is correlated over some samples.
    """

    level: float
    beyond: bool
    sizes: tuple[int, ...]
    wander: float = 0.0
    coloured: bool = False

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
    size = _NEIGHBOURS if len(values) >= _NEIGHBOURS * 2 * _LEAST_MEANS else 1
    whole = 0.0 if steps is None else _BEYOND * _wander(steps, stretch)
    level, beyond, sure = np.inf, False, False
    sizes: list[int] = []
    while True:
        ratio = _ratio(values, stretch, size, steps)
        if ratio is None:
            if size == 1 or sizes:
                return Noise(level, beyond, tuple(sizes), whole, beyond and not sure)
            size = 1
            continue
        if not sizes:
            level = float(np.sqrt(size * ratio.noise))
            beyond = sure = size > 1 and _short_beyond(values, stretch, size, steps, ratio)
        exceeds = ratio.beyond()
        coloured = exceeds and not ratio.beyond(*_colour(values, stretch, size))
        beyond, sure = beyond or exceeds, sure or (exceeds and not coloured)
        sizes.append(size)
        size *= 2


class _Ratio(NamedTuple):
    """The spread about the means of stretches beside the noise, both of means of blocks.

    Attributes:
        noise: variance by third differences.
        spread: variance about the means.
        variance: of `spread` over `noise`, for pure noise.
        wander: how much of `spread` integrated noise explains.
        of: stretches of the means that count.
    """

    noise: float
    spread: float
    variance: float
    wander: float
    of: Labels

    def beyond(self, colour: float = 1.0, variance: float = 0.0) -> bool:
        """Return whether the spread is more than that of noise this many times as large, itself known to `variance`."""
        factor = 1.0 + _BEYOND * float(np.sqrt(self.variance + variance))
        return self.spread > factor * colour * self.noise + self.wander


def _ratio(values: Array, stretch: Labels, size: int, steps: Array | None) -> _Ratio | None:
    """Return the ratio for means of `size` rows; None of too few."""
    mean, of, lengths = _in_long(*means(values, stretch, size))
    third = _thirds(mean, of)
    if len(third) < _LEAST_MEANS - 3:
        return None
    # The noise may differ from stretch to stretch, so each has the same weight in both.
    weights = np.repeat((lengths - 1.0) / (lengths - 3.0), lengths - 3)
    count = float(np.sum(lengths - 1))
    noise = float(weights @ np.sum(third**2, axis=1)) / count / _THIRD
    spread = float(np.sum(centred(mean, of) ** 2)) / count
    here = np.isin(stretch, of)
    wander = 0.0 if steps is None else _BEYOND * _wander(steps[here], stretch[here])
    return _Ratio(noise, spread, _SPREAD * float(np.sum(weights**2)) / count**2, wander / (size * count), of)


def _short_beyond(values: Array, stretch: Labels, size: int, steps: Array | None, ratio: _Ratio) -> bool:
    """Return whether stretches too short for means of `size` rows change by more than noise, row by row.

    Rows may be filtered: the noise that they show is then as much too small as in the long stretches.
    """
    short = ~np.isin(stretch, ratio.of)
    rows = np.flatnonzero(~short)[:_ENOUGH]
    long = _ratio(values[rows], stretch[rows], 1, None)
    found = _ratio(values[short], stretch[short], 1, None if steps is None else steps[short])
    if long is None or found is None:
        return False
    colour = size * ratio.noise / long.noise if long.noise else 1.0
    return found.beyond(max(colour, 1.0), ratio.variance)


def _colour(values: Array, stretch: Labels, size: int) -> tuple[float, float]:
    """Return by what factor means of `size` rows may be noisier than their neighbours show, and to what variance.

    Noise that is correlated over more rows is in means of longer blocks, too: these are less quiet than those of white
    noise. Medians are compared, as a step that stays is no noise.
    """
    here, colour, variance = _median_of_thirds(*means(values, stretch, size)), 1.0, 0.0
    for times in _LONGER:
        mean, of = means(values, stretch, times * size)
        if len(mean) < _LEAST_MEANS // 2 or not here:
            break
        found, unsure = times * (_median_of_thirds(mean, of) / here) ** 2, 2.0 * _SPREAD / len(mean)
        # White noise has 1, up to chance.
        if found > max(colour, 1.0 + 2.0 * float(np.sqrt(unsure))):
            colour, variance = found, unsure
    return min(colour, _MOST_COLOUR), variance


def _median_of_thirds(mean: Array, of: Labels) -> float:
    third = np.linalg.norm(_thirds(mean, of), axis=1)
    return float(np.median(third)) if len(third) else 0.0


def _in_long(mean: Array, of: Labels) -> tuple[Array, Labels, NDArray[np.intp]]:
    """Return the rows of stretches long enough for a third difference, their stretches, and how many each has."""
    lengths = np.diff(_begins(of), append=len(of))
    long = lengths > 3
    if long.all():
        return mean, of, lengths
    rows = np.repeat(long, lengths)
    return mean[rows], of[rows], lengths[long]


def _wander(steps: Array, stretch: Labels) -> float:
    """Return the sum of squares about the means of the stretches that is expected of a random walk of these steps."""
    begins = _begins(stretch)
    count = np.diff(begins, append=len(stretch))
    before = np.arange(len(stretch)) - np.repeat(begins, count)
    return float(np.sum(steps * before * (1.0 - before / np.repeat(count, count))))


def _begins(stretch: Labels) -> NDArray[np.intp]:
    """Return the first row of each stretch."""
    return np.flatnonzero(np.diff(stretch, prepend=stretch[:1] - 1))


def typical(values: Array, stretch: Labels) -> float:
    """Return the median magnitude of the noise of a row, which short changes do not affect; 0 for too few."""
    blocks = zip(in_blocks(values, 3), in_blocks(stretch, 3), strict=True)
    return _typical([np.linalg.norm(_thirds(rows, labels), axis=1) for rows, labels in blocks])


def typical_at(values: Array, time_ns: Times) -> float:
    """Return the same of rows at these times, ascending, in one stretch."""
    blocks = zip(in_blocks(values, 3), in_blocks(time_ns, 3), strict=True)
    return _typical([np.linalg.norm(third_differences(rows, times), axis=1) for rows, times in blocks])


def noise_of_path(steps: Iterable[Array], begin: Array, time_ns: Times) -> float:
    """Return the same of the sums of the steps, (k, 3) in each block, from `begin` on, (0, 3) or (1, 3)."""
    before, last, first = np.empty((0, 3)), begin, 0
    sizes: list[Array] = []
    for block in steps:
        path = np.concatenate([before, np.cumsum(np.concatenate([last, block]), axis=0)])
        sizes.append(np.linalg.norm(third_differences(path, time_ns[first : first + len(path)]), axis=1))
        first += len(path[:-3])
        before, last = path[-3:-1], path[-1:]
    return _typical(sizes)


def _typical(sizes: Sequence[Array]) -> float:
    """Return the median of sizes of third differences, of one value; 0 for none."""
    whole = np.concatenate([np.empty(0), *sizes])
    return float(np.median(whole, overwrite_input=True) / np.sqrt(_THIRD)) if len(whole) else 0.0


def _thirds(values: Array, stretch: Labels | None = None) -> Array:
    """Return the third differences within stretches."""
    third: Array = values[3:] - 3.0 * values[2:-1] + 3.0 * values[1:-2] - values[:-3]
    within: Array = third if stretch is None else third[stretch[3:] == stretch[:-3]]
    return within


def third_differences(values: Array, time_ns: Times) -> Array:
    """Return third differences (n - 3, c) of rows at uneven times, of which a parabola leaves nothing.

    They have the noise of those at even times, and are these there.
    """
    first, second, third = (np.maximum(np.diff(time_ns)[k : len(time_ns) - 3 + k], 1) * 1e-9 for k in range(3))
    both, last, whole = first + second, second + third, first + second + third
    # Divided differences, times second: samples of one stamp then count alone.
    weights = np.stack(
        [-second / (first * both * whole), 1.0 / (first * last), -1.0 / (both * third), second / (whole * last * third)]
    )
    weights *= np.sqrt(_THIRD / np.sum(weights**2, axis=0))
    result: Array = weights[0, :, None] * values[:-3]
    for k in (1, 2, 3):
        result += weights[k, :, None] * values[k : len(values) - 3 + k]
    return result


def means(values: Array, stretch: Labels, size: int) -> tuple[Array, Labels]:
    """Return the mean of each block of `size` rows within a stretch, and its stretch; drops incomplete blocks."""
    begins = _begins(stretch)
    lengths = np.diff(begins, append=len(stretch)) // size
    firsts = (
        np.repeat(begins - size * np.concatenate([[0], np.cumsum(lengths)[:-1]]), lengths) if len(begins) else begins
    )
    firsts += size * np.arange(len(firsts))

    def blocks() -> Iterator[Array]:
        for part in parts(len(firsts) * size, size):
            rows = firsts[part.start // size : part.stop // size, None] + np.arange(size)
            yield values[rows].mean(axis=1)
            give_back(values)

    return stored(blocks(), values.shape[1] if values.ndim > 1 else 0), np.repeat(stretch[begins], lengths)


def centred(values: Array, stretch: Labels) -> Array:
    """Return `values`, (n, c), minus the mean of their stretch."""
    begins = _begins(stretch)
    count = np.diff(begins, append=len(stretch))
    number = np.repeat(np.arange(len(begins)), count)
    sums = np.zeros((len(begins), values.shape[1]))
    for labels, rows in zip(in_blocks(number), in_blocks(values), strict=True):
        # Those of the block before come first, as if all were added up at once.
        here = slice(int(labels[0]), int(labels[-1]) + 1)
        within = np.append(0, labels - labels[0])
        for total, column in zip(sums.T, rows.T, strict=True):
            total[here] = np.bincount(within, np.append(total[here.start], column))
    mean = sums / count[:, None]
    blocks = zip(in_blocks(number), in_blocks(values), strict=True)
    return stored((rows - mean[labels] for labels, rows in blocks), values.shape[1])
