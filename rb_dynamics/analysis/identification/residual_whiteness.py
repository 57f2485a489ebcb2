"""What the residuals of a fit say about its errors: whether they are noise, white or coloured, or exceed noise.

Residuals that are not white are coloured noise or an error of the model; they do not show which. The standard errors of
a fit are first computed as for coloured noise. An error of the model, unlike noise, acts on all parameters alike for
the whole flight; the standard errors are then doubled (Maine & Iliff, NASA RP-1077 (1981), find 5 to 10 times those of
white noise).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rb_dynamics.analysis.track import Array

# Freedom of the residuals in one band of frequencies, at least.
_BAND = 12.0
# Residuals are not white if chance makes them look so in one of ten thousand recordings only.
_CHANCE = 1e-4
_LAGS = 10
# The noise of an axis differs from that of the others if it does by so many standard errors.
_UNEVEN = 5.0
# By how much an error of the model makes errors larger than coloured noise does: with it intervals hold 94 of 100
# values where a torque, a drag or an error of a sensor is not in the model (docs/identify.md).
DOUBT = 2.0
# rad that the body turns in the longest mean of samples in which noise is looked for: residuals of a wrong motion
# hardly change in it.
_SHORT_TURN = 0.25
_LEAST_MEANS = 16


class Band(NamedTuple):
    """A band of frequencies of the residuals of one sensor in one recording.

    Attributes:
        power: sum of the squares of the residuals over their noise.
        freedom: that the fit left of them.
        told: (p, p), what it tells: J^T J of their derivatives over noise.
    """

    power: float
    freedom: float
    told: Array


def bands_of(left: Array, weighted: Array, root: Array, samples: Sequence[int]) -> list[list[Band]]:
    """Return the bands of each stream, by coordinates in which the covariance of white noise is 1.

    Args:
        left: (n,), residuals over their noise: three of each sample, stream by stream.
        weighted: (n, p), their derivatives.
        root: (p, p), derivatives of the parameters by these coordinates.
        samples: of each stream.
    """
    from scipy.fft import dct

    found, row = [], 0
    for count in samples:
        rows = slice(row, row + 3 * count)
        row += 3 * count
        power = np.sum(dct(left[rows].reshape(count, 3), axis=0, norm="ortho") ** 2, axis=1)
        by = dct(weighted[rows].reshape(count, -1), axis=0, norm="ortho").reshape(3 * count, -1) @ root
        free = np.cumsum(3.0 - np.einsum("ij,ij->i", by, by).reshape(count, 3).sum(axis=1))
        begin = 0
        bands = []
        while begin < count:
            used = float(free[begin - 1]) if begin else 0.0
            end = max(2 * begin, 1 + int(np.searchsorted(free, used + _BAND)))
            # The rest is too little for a band of its own.
            end = end if end - begin <= count - end else count
            freedom = max(1.0, float(free[end - 1]) - used)
            part = by[3 * begin : 3 * end]
            bands.append(Band(float(power[begin:end].sum()), freedom, part.T @ part))
            begin = end
        found.append(bands)
    return found


def axes_of(left: Array, weighted: Array, root: Array, samples: Sequence[int]) -> list[list[Band]]:
    """Return the three axes of each stream like its bands, see `bands_of`."""
    found, row = [], 0
    for count in samples:
        rows = slice(row, row + 3 * count)
        row += 3 * count
        parts = zip(
            left[rows].reshape(count, 3).T, (weighted[rows] @ root).reshape(count, 3, -1).swapaxes(0, 1), strict=True
        )
        found.append([Band(float(of @ of), max(1.0, count - float(np.sum(by**2))), by.T @ by) for of, by in parts])
    return found


def uneven(root: Array, streams: Sequence[Sequence[Band]]) -> Array:
    """Return the covariance of a fit where the axes of a stream have noise of different sizes; R R^T if none has.

    The fit took the three for equal (White, Econometrica 48 (1980) 817, with one variance for each axis).
    """
    strength = np.eye(len(root))
    for axes in streams:
        level = sum(band.power for band in axes) / sum(band.freedom for band in axes)
        more = [band.power / (level * band.freedom) - 1.0 if level else 0.0 for band in axes]
        if max(abs(of) * np.sqrt(0.5 * band.freedom) for of, band in zip(more, axes, strict=True)) > _UNEVEN:
            strength += np.sum([of * band.told for of, band in zip(more, axes, strict=True)], axis=0)
    found: Array = root @ strength @ root.T
    return found


def root_of(covariance: Array) -> Array:
    """Return a matrix R with R R^T the covariance."""
    sizes, axes = np.linalg.eigh(0.5 * (covariance + covariance.T))
    found: Array = axes * np.sqrt(np.maximum(sizes, 1e-30))
    return found


def widened(root: Array, streams: Sequence[Sequence[Band]]) -> tuple[Array, float]:
    """Return the covariance of a fit with residuals that are not white, nowhere smaller than R R^T, and its freedom.

    Noise counts by its strength at the frequencies at which the parameters act (Morelli & Klein, J. Guid. Control Dyn.
    20 (1997) 74). That is taken from the residuals, band by band, over the freedom that the fit left there: of slow
    residuals a fit takes many. The freedom of the whole is that of Satterthwaite. The errors are then doubled.
    """
    gathered, freedom = _strength(streams)
    values, vectors = np.linalg.eigh(gathered)
    found: Array = DOUBT**2 * root @ ((vectors * np.maximum(values, 1.0)) @ vectors.T) @ root.T
    return found, freedom


def _strength(streams: Sequence[Sequence[Band]]) -> tuple[Array, float]:
    """Return the strength of noise where the parameters act, (p, p), 1 of white noise, and its freedom."""
    bands = [band for each in streams for band in each]
    parts = [(band.power / band.freedom * band.told, band.freedom) for band in bands]
    shares = [(float(np.trace(part)), freedom) for part, freedom in parts]
    mean, spread = sum(share for share, _ in shares), sum(share**2 / freedom for share, freedom in shares)
    gathered: Array = np.sum([part for part, _ in parts], axis=0)
    return gathered, mean**2 / spread if spread > 0.0 else 1.0


def gains_nothing(gain: float, count: int, streams: Sequence[Sequence[Band]]) -> bool:
    """Return whether noise alone explains by how much a fit leaves less of some streams than `count` numbers do.

    `gain` is that of the sum of squares over noise. By an F-test: noise counts by its strength at the frequencies at
    which the parameters act, as for `widened`.
    """
    from scipy.special import fdtrc

    taken = sum(float(np.trace(band.told)) for each in streams for band in each)
    gathered, freedom = _strength(streams)
    level, more = max(1.0, float(np.trace(gathered)) / taken), max(1.0, taken - count)
    return float(fdtrc(more, freedom, gain / (more * level))) > _CHANCE


def whiteness(parts: Sequence[Array], streams: Sequence[Sequence[Band]]) -> tuple[bool, float]:
    """Return whether residuals (n, 3) of some streams are white, and the correlation of neighbours.

    By the test of Ljung & Box, which sees what neighbours share, and by the power of each band, which sees slow changes
    far below the noise of a sample.
    """
    from scipy.special import chdtrc

    statistic, freedom, first, total = 0.0, 0, 0.0, 0.0
    for left in parts:
        n = len(left)
        if n <= 2 * _LAGS:
            continue
        square = np.sum(left**2, axis=0)
        used = square > 0.0
        for lag in range(1, _LAGS + 1):
            product = np.sum(left[lag:] * left[:-lag], axis=0)
            statistic += float(np.sum(n * (n + 2.0) / (n - lag) * (product[used] / square[used]) ** 2))
            if lag == 1:
                first, total = first + float(product.sum()), total + float(square.sum())
        freedom += _LAGS * int(used.sum())
    every = [band for bands in streams for band in bands]
    level = sum(band.power for band in every) / max(1e-300, sum(band.freedom for band in every))
    likely = [float(chdtrc(band.freedom, band.power / level)) for band in every] if level > 0.0 else []
    white = freedom == 0 or float(chdtrc(freedom, statistic)) > _CHANCE
    white = white and min(likely, default=1.0) * len(likely or [1.0]) > _CHANCE
    return white, first / total if total > 0.0 else 0.0


def typical(rows: Array) -> float:
    """Return the root mean square over the axes of rows (n, 3), each by its median: a few wild rows count little.

    The axes of a sensor may have noise of different sizes.
    """
    return 1.4826 * float(np.sqrt(np.mean(np.median(np.abs(rows), axis=0) ** 2)))


def noise_beneath(left: Array, turn: float, step: float) -> float:
    """Return the noise of a sample that residuals (n, 3) show: what changes faster than a motion does.

    It is the largest in third differences of single samples and of means of ever more, as noise may be filtered.
    Infinite for too few samples.

    Args:
        left: residuals.
        turn: rad that the body turns from one sample to the next.
        step: smallest change of what was measured, its resolution.
    """
    found, size = step / np.sqrt(12.0), 1
    if len(left) < _LEAST_MEANS:
        return np.inf
    while True:
        count = len(left) // size
        third = np.diff(left[: count * size].reshape(count, size, -1).mean(axis=1), n=3, axis=0)
        if third.size:
            found = max(found, typical(third) / np.sqrt(20.0))
        size *= 2
        if size * turn > _SHORT_TURN or len(left) < size * _LEAST_MEANS:
            return float(found)
