"""Residuals and derivatives of all streams as rows of one matrix, and what is decomposed of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rb_dynamics.analysis.identification.measurement_model import Predicted
from rb_dynamics.analysis.track import Array

RUNAWAY = 1e12
"""Times the noise: a residual that large is not that of a moving body."""

_SENSITIVE = 1e14
"""Times the noise: below such a derivative the rounding of a state (1e-16) moves the motion by less than the noise."""

# Of a matrix that are decomposed at a time: no large one is copied.
_ROWS = 1 << 14


def stacked(predicted: Sequence[Predicted], noise: dict[tuple[str, str, int], float]) -> tuple[Array, Array]:
    """Return residuals (n,) and derivatives (n, p) of all streams over noise, one below the other."""
    left = [each.left.ravel() / noise[each.key] for each in predicted]
    by = [each.by.reshape(each.left.size, each.by.shape[2]) / noise[each.key] for each in predicted]
    return np.concatenate(left), np.vstack(by)


def tame(left: Array, by: Array) -> tuple[Array, Array]:
    """Return residuals and derivatives with finite numbers: if the motion diverges, their squares have none."""
    if sane(left, by):
        return left, by
    ends = (left, RUNAWAY, RUNAWAY), (by, _SENSITIVE, 0.0)
    left, by = (np.nan_to_num(np.clip(part, -end, end), nan=of) for part, end, of in ends)
    return left, by


def sane(*parts: Array, unit: float = 1.0) -> bool:
    """Return whether residuals, and derivatives if given, in units of the noise, are finite and have not diverged."""
    largest = (max(float(each.max(initial=0.0)), -float(each.min(initial=0.0))) for each in parts)
    return all(each < limit * unit for each, limit in zip(largest, (RUNAWAY, _SENSITIVE), strict=False))


def triangle(matrix: Array) -> Array:
    """Return R of the QR decomposition, block by block: with small matrices LAPACK does not wait for threads."""
    count, columns = matrix.shape
    if count > _ROWS > columns:
        return triangle(np.vstack([triangle(matrix[row : row + _ROWS]) for row in range(0, count, _ROWS)]))
    block = 4 * columns
    while len(matrix) > 2 * block:
        padded = np.vstack([matrix, np.zeros((-len(matrix) % block, columns))])
        matrix = np.asarray(np.linalg.qr(padded.reshape(-1, block, columns), mode="r")).reshape(-1, columns)
    return np.asarray(np.linalg.qr(matrix, mode="r"), dtype=np.float64)


def information(by: Array) -> Array:
    """Return J^T J of derivatives over noise."""
    root = triangle(by)
    found: Array = root.T @ root
    return found


def covariance_of(by: Array) -> Array:
    """Return (J^T J + 1)^-1 of derivatives over noise, which are not squared before they are inverted."""
    _, sizes, turned = np.linalg.svd(np.vstack([triangle(by), np.eye(by.shape[1])]), full_matrices=False)
    root = turned.T / sizes
    found: Array = root @ root.T
    return found
