"""`widened`: what residuals that are not white make of the covariance of a fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rb_dynamics.analysis.track import Array

# Freedom of the residuals in one band of frequencies, at least.
_BAND = 12.0


def widened(covariance: Array, left: Array, weighted: Array, samples: Sequence[int]) -> tuple[Array, float]:
    """Return the covariance of a fit with residuals that are not white, nowhere smaller than given, and its freedom.

    Noise counts by its strength at the frequencies at which the parameters act (Morelli & Klein, J. Guid. Control Dyn.
    20 (1997) 74). That is taken from the residuals, band by band, over the freedom that the fit left there: of slow
    residuals a fit takes many. The freedom of the whole is that of Satterthwaite.

    Args:
        covariance: (p, p), for white noise of strength 1.
        left: (n,), residuals over their noise: three of each sample, recording by recording.
        weighted: (n, p), their derivatives.
        samples: of each recording.
    """
    from scipy.fft import dct

    sizes, axes = np.linalg.eigh(0.5 * (covariance + covariance.T))
    root = axes * np.sqrt(np.maximum(sizes, 1e-30))
    gathered = np.zeros_like(covariance)
    mean, spread, row = 0.0, 0.0, 0
    for count in samples:
        rows = slice(row, row + 3 * count)
        row += 3 * count
        power = np.sum(dct(left[rows].reshape(count, 3), axis=0, norm="ortho") ** 2, axis=1)
        by = dct((weighted[rows] @ root).reshape(count, 3, -1), axis=0, norm="ortho")
        free = np.cumsum(3.0 - np.sum(by**2, axis=(1, 2)))
        begin = 0
        while begin < count:
            used = float(free[begin - 1]) if begin else 0.0
            end = max(2 * begin, 1 + int(np.searchsorted(free, used + _BAND)))
            # What is left over is too little for a band of its own.
            end = end if end - begin <= count - end else count
            freedom = max(1.0, float(free[end - 1]) - used)
            level = float(power[begin:end].sum()) / freedom
            part = by[begin:end].reshape(-1, by.shape[2])
            gathered += level * (part.T @ part)
            share = level * float(np.sum(part**2))
            mean, spread, begin = mean + share, spread + share**2 / freedom, end
    values, vectors = np.linalg.eigh(gathered)
    found: Array = root @ ((vectors * np.maximum(values, 1.0)) @ vectors.T) @ root.T
    return found, mean**2 / spread if spread > 0.0 else 1.0
