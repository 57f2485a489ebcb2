"""SO(3): quaternions, hat, exp and log, dexpinv, the Cayley map.

Pure functions on plain floats. Quaternions are (x, y, z, w) and need not be sign-normalised; a rotation turns body
axes into world axes. Half-angle forms are used where the textbook form cancels; a series takes over only where even
those lose digits, below a switch named at the function. Must not import numpy.

Sources: Iserles, Munthe-Kaas, Norsett & Zanna, Lie-group methods, Acta Numerica 9 (2000) 215, cited as IMNZ; Hairer,
Lubich & Wanner, Geometric Numerical Integration, 2nd ed. (2006), cited as HLW.
"""

from __future__ import annotations

import math

from rb_dynamics.numerics.vector import Vector, add_scaled, cross, dot, norm

Quaternion = tuple[float, float, float, float]
Matrix = tuple[Vector, Vector, Vector]

IDENTITY: Quaternion = (0.0, 0.0, 0.0, 1.0)

NORM_TOLERANCE = 1e-3
"""Largest deviation from 1 of the norm of a quaternion given by a user."""


def hat(v: Vector) -> Matrix:
    """Return the skew matrix with hat(v) u = v x u."""
    x, y, z = v
    return ((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))


def multiply(p: Quaternion, q: Quaternion) -> Quaternion:
    """Return the quaternion product p q: first the rotation q, then p."""
    px, py, pz, pw = p
    qx, qy, qz, qw = q
    return (
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
        pw * qw - px * qx - py * qy - pz * qz,
    )


def conjugate(q: Quaternion) -> Quaternion:
    """Return the inverse of a unit quaternion."""
    return (-q[0], -q[1], -q[2], q[3])


def rotate(q: Quaternion, v: Vector) -> Vector:
    """Return R(q) v for a unit quaternion q; exactly v for the identity."""
    x, y, z, w = q
    # v + w t + u x t with u the vector part and t = 2 u x v.
    tx = 2.0 * (y * v[2] - z * v[1])
    ty = 2.0 * (z * v[0] - x * v[2])
    tz = 2.0 * (x * v[1] - y * v[0])
    return (
        v[0] + w * tx + (y * tz - z * ty),
        v[1] + w * ty + (z * tx - x * tz),
        v[2] + w * tz + (x * ty - y * tx),
    )


def rotate_inverse(q: Quaternion, v: Vector) -> Vector:
    """Return R(q)^T v for a unit quaternion q."""
    return rotate((-q[0], -q[1], -q[2], q[3]), v)


def normalize(q: Quaternion) -> Quaternion:
    """Return q / |q|."""
    n = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return (q[0] / n, q[1] / n, q[2] / n, q[3] / n)


def renormalize(q: Quaternion) -> Quaternion:
    """Return q / |q| if |q| is off 1 by more than the last two bits, else q: for attitudes updated in every step.

    Dividing in every step would bias the rotation by a thousandth of a rounding error. That bias grows with the number
    of steps n, while the rounding errors themselves grow like sqrt(n).
    """
    n = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    # Dividing by 1 changes nothing, and a branch here would prevent vectorisation over bodies.
    n = n if abs(n - 1.0) > LAST_BITS else 1.0
    return (q[0] / n, q[1] / n, q[2] / n, q[3] / n)


def unit(q: Quaternion) -> Quaternion | None:
    """Return q / |q|, or q itself if |q| is 1 to round-off; None if |q| is not 1 within `NORM_TOLERANCE`.

    A recorded attitude keeps its digits, and the function is idempotent.
    """
    off = abs(math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]) - 1.0)
    if off <= _UNIT:
        return q
    return normalize(q) if off <= NORM_TOLERANCE else None


LAST_BITS = 2.0 * 2.0**-52
# Twice what `renormalize` leaves.
_UNIT = 2.0 * LAST_BITS


def matrix(q: Quaternion) -> Matrix:
    """Return the rotation matrix of a unit quaternion; its columns are the body axes in world axes."""
    x, y, z, w = q
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


def from_matrix(m: Matrix) -> Quaternion:
    """Return the unit quaternion of a rotation matrix (Shepperd, J. Guidance Control 1 (1978) 223).

    The largest of the four components is computed first, so that no digit is lost near half turns.
    """
    (a, b, c), (d, e, f), (g, h, i) = m
    trace = a + e + i
    if trace >= max(a, e, i):
        return normalize((h - f, c - g, d - b, 1.0 + trace))
    if a >= max(e, i):
        return normalize((1.0 + a - e - i, b + d, c + g, h - f))
    if e >= i:
        return normalize((b + d, 1.0 + e - a - i, f + h, c - g))
    return normalize((c + g, f + h, 1.0 + i - a - e, d - b))


def exp(v: Vector) -> Quaternion:
    """Return the rotation by |v| rad about v as a quaternion: exp(hat(v)) (IMNZ eq. B.10)."""
    angle = norm(v)
    # sin(a/2)/a does not cancel; only 0/0 has to be avoided.
    s = math.sin(0.5 * angle) / angle if angle > 0.0 else 0.5
    return (s * v[0], s * v[1], s * v[2], math.cos(0.5 * angle))


def log(q: Quaternion) -> Vector:
    """Return the rotation vector v, |v| <= pi, with R(exp(v)) = R(q); accurate at 0 and at half turns alike."""
    x, y, z, w = q
    sine = norm((x, y, z))
    if sine == 0.0:
        return (0.0, 0.0, 0.0)
    s = 2.0 * (math.atan2(sine, w) if w >= 0.0 else -math.atan2(sine, -w)) / sine
    return (s * x, s * y, s * z)


def angle_between(p: Quaternion, q: Quaternion) -> float:
    """Return the angle (rad) of the rotation from attitude p to attitude q, 0 to pi."""
    x, y, z, w = multiply(conjugate(p), q)
    return angle_of(norm((x, y, z)), abs(w))


def angle_of(sine: float, cosine: float) -> float:
    """Return the angle (rad), 0 to pi, with multiples of this sine and cosine of its half, which are not negative."""
    return 2.0 * math.atan2(sine, cosine)


def dexpinv(v: Vector, u: Vector) -> Vector:
    """Return dexp_v^-1(u) = u - v x u / 2 + (1 - (a/2) cot(a/2))/a^2 v x (v x u), a = |v| < 2 pi (IMNZ eq. B.11).

    d/dt exp(hat(v)) = hat(dexp_v(v')) exp(hat(v)).
    """
    first = cross(v, u)
    return add_scaled(add_scaled(u, -0.5, first), _cotangent(dot(v, v)), cross(v, first))


def cayley(v: Vector) -> Quaternion:
    """Return cay(hat(v)) = (1 - hat(v)/2)^-1 (1 + hat(v)/2) as a quaternion: a turn by 2 atan(|v|/2) (HLW IV.8.3)."""
    x, y, z = 0.5 * v[0], 0.5 * v[1], 0.5 * v[2]
    square = x * x + y * y + z * z
    n = math.sqrt(1.0 + square) if square < 1e280 else norm((x, y, z))
    return (x / n, y / n, z / n, 1.0 / n)


# B_2k / (2k)! in absolute value: the series of (1 - (a/2) cot(a/2))/a^2 in a^2.
_COTANGENT = (
    1.0 / 12.0,
    1.0 / 720.0,
    1.0 / 30240.0,
    1.0 / 1209600.0,
    1.0 / 47900160.0,
    691.0 / 1307674368000.0,
    1.0 / 74724249600.0,
    3617.0 / 10670622842880000.0,
)


def _cotangent(square: float) -> float:
    """Return (1 - (a/2) cot(a/2))/a^2; below a = 1/2 by its series, each term of which is 1/160 of the last."""
    if square >= 0.25:
        half = 0.5 * math.sqrt(square)
        return (1.0 - half * math.cos(half) / math.sin(half)) / square
    s = square
    c = _COTANGENT
    return c[0] + s * (c[1] + s * (c[2] + s * (c[3] + s * (c[4] + s * (c[5] + s * (c[6] + s * c[7]))))))
