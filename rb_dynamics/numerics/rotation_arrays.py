"""Rotations of arrays of vectors by arrays of unit quaternions xyzw; `rotation.py` has those of single vectors."""

from __future__ import annotations

from functools import reduce

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def lengths(rows: Array) -> Array:
    """Return the length of each row: the bits of `np.linalg.norm`, in a seventh of the time for rows of a vector."""
    sizes: Array = np.sqrt(reduce(np.add, (rows * rows).T))
    return sizes


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
    return rotations_between(orientation_xyzw[:-1], orientation_xyzw[1:])


def rotations_between(first_xyzw: Array, second_xyzw: Array) -> Array:
    """Return the rotation (rad, at most pi, body axes) that turns each of `first_xyzw` (n, 4) into `second_xyzw`."""
    axis, scalar = first_xyzw[:, :3], first_xyzw[:, 3:]
    part = scalar * second_xyzw[:, :3] - second_xyzw[:, 3:] * axis - np.cross(axis, second_xyzw[:, :3])
    along = np.sum(second_xyzw * first_xyzw, axis=1, keepdims=True)
    size = lengths(part)[:, None]
    half = np.arctan2(size, np.abs(along))
    # q and -q are the same attitude: take the shorter rotation. The ratio is 1 if nothing turns.
    ratio = np.divide(half, size, out=np.ones_like(size), where=size > 0.0)
    vectors: Array = 2.0 * np.where(along < 0.0, -1.0, 1.0) * ratio * part
    return vectors


def exponentials(vectors: Array) -> Array:
    """Return the quaternions (n, 4) of the rotations `vectors` (n, 3), rad."""
    half = 0.5 * lengths(vectors)[:, None]
    # numpy's sinc(x) is sin(pi x) / (pi x), and 1 at 0.
    return np.concatenate([0.5 * np.sinc(half / np.pi) * vectors, np.cos(half)], axis=1)


def product(left_xyzw: Array, right_xyzw: Array) -> Array:
    """Return the quaternions of R(left) R(right), (..., 4), broadcast."""
    (u, a), (v, b) = ((q[..., :3], q[..., 3:]) for q in (left_xyzw, right_xyzw))
    result: Array = np.concatenate(
        [a * v + b * u + np.cross(u, v), a * b - np.sum(u * v, axis=-1, keepdims=True)], axis=-1
    )
    return result


def interpolated(time_ns: NDArray[np.int64], poses: Array, wanted_ns: NDArray[np.int64]) -> Array:
    """Interpolate poses at `wanted_ns`, within `time_ns`: positions linearly, attitudes along the shorter rotation.

    Args:
        time_ns: (n,), strictly increasing.
        poses: (n, 7) position and unit quaternion xyzw.
        wanted_ns: (m,).
    """
    if len(time_ns) == 1:
        return np.repeat(poses, len(wanted_ns), axis=0)
    row = np.clip(np.searchsorted(time_ns, wanted_ns, side="right") - 1, 0, len(time_ns) - 2)
    part = ((wanted_ns - time_ns[row]) / (time_ns[row + 1] - time_ns[row]))[:, None]
    turn = exponentials(part * rotation_vectors(poses[:, 3:])[row])
    moved = (1.0 - part) * poses[row, :3] + part * poses[row + 1, :3]
    return np.hstack([moved, product(poses[row, 3:], turn)])
