"""Rotations of arrays of vectors by arrays of unit quaternions xyzw; `rotation.py` has single ones, on floats."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rotate_all(orientation_xyzw: Array, vectors: Array) -> Array:
    """Return R(q) v = v + w t + u x t with t = 2 u x v for quaternions (..., 4) and vectors (..., 3), broadcast."""
    axis, scalar = orientation_xyzw[..., :3], orientation_xyzw[..., 3:]
    twice = 2.0 * np.cross(axis, vectors)
    turned: Array = vectors + scalar * twice + np.cross(axis, twice)
    return turned


def rotate_all_inverse(orientation_xyzw: Array, vectors: Array) -> Array:
    """Return R(q)^T v for quaternions (..., 4) and vectors (..., 3), broadcast."""
    return rotate_all(orientation_xyzw * np.array([-1.0, -1.0, -1.0, 1.0]), vectors)


def rotation_vectors(orientation_xyzw: Array) -> Array:
    """Return the rotation (rad, at most pi, body axes) from each of (n, 4) quaternions to the next, (n - 1, 3)."""
    axis, scalar = orientation_xyzw[:, :3], orientation_xyzw[:, 3:]
    part = scalar[:-1] * axis[1:] - scalar[1:] * axis[:-1] - np.cross(axis[:-1], axis[1:])
    along = np.sum(orientation_xyzw[1:] * orientation_xyzw[:-1], axis=1, keepdims=True)
    size = np.linalg.norm(part, axis=1, keepdims=True)
    half = np.arctan2(size, np.abs(along))
    # q and -q are one attitude: take the shorter rotation. The ratio is 1 where nothing turns.
    ratio = np.divide(half, size, out=np.ones_like(size), where=size > 0.0)
    vectors: Array = 2.0 * np.where(along < 0.0, -1.0, 1.0) * ratio * part
    return vectors
