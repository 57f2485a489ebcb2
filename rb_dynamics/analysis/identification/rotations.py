"""Rotation vectors as arrays, and how they change: exponential, logarithm and the Jacobians of SO(3).

Iserles, Munthe-Kaas, Norsett & Zanna, Acta Numerica 9 (2000) 215, section B.2.
"""

from __future__ import annotations

import numpy as np

from rb_dynamics.analysis.track import Array


def matrices(orientation_xyzw: Array) -> Array:
    """Return R(q), (..., 3, 3), of unit quaternions (..., 4)."""
    x, y, z, w = (orientation_xyzw[..., k] for k in range(4))
    return _of_rows(
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    )


def hats(vectors: Array) -> Array:
    """Return the matrices (..., 3, 3) with hat(a) b = a x b."""
    x, y, z = (vectors[..., k] for k in range(3))
    o = np.zeros_like(x)
    return _of_rows([o, -z, y], [z, o, -x], [-y, x, o])


def _of_rows(*rows: list[Array]) -> Array:
    found = np.empty((*rows[0][0].shape, 3, 3))
    for i, row in enumerate(rows):
        for j, each in enumerate(row):
            found[..., i, j] = each
    return found


def quaternions(vectors: Array) -> Array:
    """Return exp of rotation vectors (..., 3) as quaternions xyzw."""
    half = 0.5 * np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.concatenate([0.5 * np.sinc(half / np.pi) * vectors, np.cos(half)], axis=-1)


def products(p: Array, q: Array) -> Array:
    """Return p q of quaternions (..., 4)."""
    px, py, pz, pw = (p[..., k] for k in range(4))
    qx, qy, qz, qw = (q[..., k] for k in range(4))
    return np.stack(
        [
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
            pw * qw - px * qx - py * qy - pz * qz,
        ],
        axis=-1,
    )


def conjugates(q: Array) -> Array:
    """Return the quaternions of the inverse rotations."""
    found: Array = q * np.array([-1.0, -1.0, -1.0, 1.0])
    return found


def between(p: Array, q: Array) -> Array:
    """Return the rotation vectors (..., 3), body axes, that turn attitudes p into q."""
    return logarithms(products(conjugates(p), q))


def logarithms(q: Array) -> Array:
    """Return the rotation vectors (..., 3), of at most pi, of unit quaternions."""
    vector, scalar = q[..., :3], q[..., 3:]
    sine = np.linalg.norm(vector, axis=-1, keepdims=True)
    half = np.arctan2(sine, np.abs(scalar))
    ratio = np.divide(half, sine, out=np.ones_like(sine), where=sine > 0.0)
    found: Array = 2.0 * np.where(scalar < 0.0, -1.0, 1.0) * ratio * vector
    return found


def right_jacobians(vectors: Array) -> Array:
    """Return J with exp(v + d) = exp(v) exp(J d) to first order, (..., 3, 3)."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    hat = hats(vectors)
    half = np.sinc(0.5 * angle / np.pi)
    third = np.where(
        angle < 1e-2, (1.0 - angle**2 / 20.0) / 6.0, (angle - np.sin(angle)) / np.maximum(angle, 1e-9) ** 3
    )
    found: Array = np.eye(3) - 0.5 * half**2 * hat + third * (hat @ hat)
    return found
