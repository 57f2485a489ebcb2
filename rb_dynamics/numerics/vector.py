"""Vectors in R^3 as tuples of floats: the few operations that a step needs, without numpy or arrays."""

from __future__ import annotations

import math
from typing import Any, cast

Vector = tuple[float, float, float]

ZERO: Vector = (0.0, 0.0, 0.0)


def add(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def subtract(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scale(s: float, a: Vector) -> Vector:
    """Return s a."""
    return (s * a[0], s * a[1], s * a[2])


def add_scaled(a: Vector, s: float, b: Vector) -> Vector:
    """Return a + s b."""
    return (a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2])


def dot(a: Vector, b: Vector) -> float:
    """Return a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """Return a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def norm(a: Vector) -> float:
    """Return |a| without overflow or underflow, to 2 units in the last place.

    Uses square roots alone, whose bits are the same everywhere; those of `math.hypot` depend on the Python version.
    """
    square, scale_back = a[0] * a[0] + a[1] * a[1] + a[2] * a[2], 1.0
    if square >= 1e280:
        square, scale_back = _square(2.0**-600, a), 2.0**600
    elif square <= 1e-280:
        square, scale_back = _square(2.0**600, a), 2.0**-600
    # One root for all: of vectors side by side, the compiler computes every branch.
    return math.sqrt(square) * scale_back


def norm_of_arrays(a: Vector) -> Any:
    """Return `norm` for vectors whose components are arrays."""
    import numpy as np

    parts = cast("tuple[Any, ...]", a)
    square = parts[0] * parts[0] + parts[1] * parts[1] + parts[2] * parts[2]
    if ((square > 1e-280) & (square < 1e280)).all():
        return np.sqrt(square)
    return np.array([norm(each) for each in zip(*(part.tolist() for part in parts), strict=True)])


def _square(s: float, a: Vector) -> float:
    """Return |s a|^2."""
    x, y, z = s * a[0], s * a[1], s * a[2]
    return x * x + y * y + z * z


def multiply(a: Vector, b: Vector) -> Vector:
    """Return (a1 b1, a2 b2, a3 b3): a diagonal matrix times a vector."""
    return (a[0] * b[0], a[1] * b[1], a[2] * b[2])


def divide(a: Vector, b: Vector) -> Vector:
    """Return (a1 / b1, a2 / b2, a3 / b3): the inverse of a diagonal matrix times a vector."""
    return (a[0] / b[0], a[1] / b[1], a[2] / b[2])


def resized(a: Vector) -> Vector:
    """Return `a`, or a multiple of it if the inverse of its length is beyond the range of double precision."""
    largest = max(map(abs, a))
    if largest == 0.0 or 1e-300 < largest < 1e300:
        return a
    _, power = math.frexp(largest)
    return (math.ldexp(a[0], -power), math.ldexp(a[1], -power), math.ldexp(a[2], -power))


def positive_zeros(a: Vector) -> Vector:
    """Return a with 0 for -0, so that equal vectors have equal bits, as caches that compare with == require."""
    return (a[0] + 0.0, a[1] + 0.0, a[2] + 0.0)
