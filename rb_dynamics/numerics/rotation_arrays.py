"""Rotations of many vectors at once: arrays of unit quaternions xyzw. One at a time, on floats: `rotation.py`."""

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
