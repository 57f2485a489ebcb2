"""Splitting into kicks and preprocessed discrete Moser-Veselov motion: nearly the exact flow at a fraction of its cost.

The discrete body conserves energy and angular momentum exactly; slightly modified moments of inertia raise its order to
10. Steps that rotate the body by more than about a radian between two kicks are refused.
"""

from __future__ import annotations

import math

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.motion.result_cache import cached_results
from rb_dynamics.motion.splitting import ABA82_STAGES, ABA104_STAGES, ABA864_STAGES, method
from rb_dynamics.motion.step_checks import NO_ATTITUDE, NOWHERE
from rb_dynamics.numerics.compilation import compiled_as
from rb_dynamics.numerics.rotation import Quaternion, multiply
from rb_dynamics.numerics.vector import Vector, norm

# Coefficients of C^k, C^(k-1) H, ..., H^k.
_Row = tuple[float, ...]
_Rows = tuple[tuple[_Row, _Row], tuple[_Row, _Row], tuple[_Row, _Row], tuple[_Row, _Row]]

# Newton converges quadratically: after a correction of 1e-8 nothing is left.
_LAST_CORRECTION = 1e-8
_SMALLEST = 1e-300
_ITERATIONS = 12
# Beyond a right angle the discrete body has no such rotation, or another one; the series ends before that.
_LARGEST_TURN = 1.2
# For a body more slender than this the coefficients cancel.
_SMALLEST_RATIO = 1e-3

# Denominators of s_k and d_k.
_DENOMINATORS = (6.0, 60.0, 2520.0, 45360.0)

_NO_ROWS: _Rows = (
    ((math.nan,) * 2, (math.nan,) * 2),
    ((math.nan,) * 3, (math.nan,) * 3),
    ((math.nan,) * 4, (math.nan,) * 4),
    ((math.nan,) * 5, (math.nan,) * 5),
)


def flow(moments: Vector, orientation: Quaternion, angular_velocity: Vector, t: float) -> tuple[Quaternion, Vector]:
    """Return attitude and angular velocity after t s of free motion, to order 10; energy and momentum are conserved.

    With m = I w the turn by 2 atan |r| about r solves J r + r x J r = (t/2) (1 + |r|^2) m (Moser & Veselov, Commun.
    Math. Phys. 139 (1991) 217, in half-angle form); m is fixed in the world. The moments J with
    1/J_j = (1 + t^2 s_1 + ... + t^8 s_4)/I_j + t^2 d_1 + ... + t^8 d_4 make that the motion of the body with I (Hairer
    & Vilmart, J. Phys. A 39 (2006) 13225).

    Raises:
        ConvergenceError: the body rotates too far in t s, or is too slender.
    """
    i1, i2, i3 = moments
    w1, w2, w3 = angular_velocity
    turn = abs(t) * norm(angular_velocity)
    if not turn < _LARGEST_TURN:
        return _out_of_reach(t, turn)
    m1, m2, m3 = i1 * w1, i2 * w2, i3 * w3
    half = 0.5 * t
    energy, square = half * t * (m1 * w1 + m2 * w2 + m3 * w3), half * t * (m1 * m1 + m2 * m2 + m3 * m3)
    (s1, d1), (s2, d2), (s3, d3), (s4, d4) = _preprocessing(moments)
    n1, n2, n3, n4 = _DENOMINATORS
    stretch = _form(s1, square, energy) / n1 + _form(s2, square, energy) / n2
    stretch += 1.0 + (_form(s3, square, energy) / n3 + _form(s4, square, energy) / n4)
    shift = _form(d1, square, energy) / n1 + _form(d2, square, energy) / n2
    shift += _form(d3, square, energy) / n3 + _form(d4, square, energy) / n4
    j1, j2, j3 = i1 / (stretch + shift * i1), i2 / (stretch + shift * i2), i3 / (stretch + shift * i3)

    a, b, c = half * m1, half * m2, half * m3
    k1, k2, k3 = j3 - j2, j1 - j3, j2 - j1
    x, y, z = a / j1, b / j2, c / j3
    for _ in range(_ITERATIONS):
        f = 1.0 + x * x + y * y + z * z
        r1, r2, r3 = j1 * x + k1 * y * z - a * f, j2 * y + k2 * z * x - b * f, j3 * z + k3 * x * y - c * f
        u, v, w = 2.0 * x, 2.0 * y, 2.0 * z
        p11, p12, p13 = j1 - a * u, k1 * z - a * v, k1 * y - a * w
        p21, p22, p23 = k2 * z - b * u, j2 - b * v, k2 * x - b * w
        p31, p32, p33 = k3 * y - c * u, k3 * x - c * v, j3 - c * w
        c1, c2, c3 = p22 * p33 - p23 * p32, p23 * p31 - p21 * p33, p21 * p32 - p22 * p31
        determinant = p11 * c1 + p12 * c2 + p13 * c3
        inverse = 1.0 / determinant if determinant != 0.0 else math.inf
        dx = inverse * (c1 * r1 + (p13 * p32 - p12 * p33) * r2 + (p12 * p23 - p13 * p22) * r3)
        dy = inverse * (c2 * r1 + (p11 * p33 - p13 * p31) * r2 + (p13 * p21 - p11 * p23) * r3)
        dz = inverse * (c3 * r1 + (p12 * p31 - p11 * p32) * r2 + (p11 * p22 - p12 * p21) * r3)
        x, y, z = x - dx, y - dy, z - dz
        if abs(dx) + abs(dy) + abs(dz) <= _LAST_CORRECTION * (abs(x) + abs(y) + abs(z)) + _SMALLEST:
            break
    else:
        return _out_of_reach(t, turn)
    n = 1.0 / math.sqrt(1.0 + x * x + y * y + z * z)
    x, y, z = n * x, n * y, n * z
    # The inverse rotation of m, as in `rotate_inverse`.
    t1, t2, t3 = 2.0 * (y * m3 - z * m2), 2.0 * (z * m1 - x * m3), 2.0 * (x * m2 - y * m1)
    return multiply(orientation, (x, y, z, n)), (
        (m1 - n * t1 + (y * t3 - z * t2)) / i1,
        (m2 - n * t2 + (z * t1 - x * t3)) / i2,
        (m3 - n * t3 + (x * t2 - y * t1)) / i3,
    )


def _form(row: _Row, c: float, h: float) -> float:
    """Return row[0] c^k + row[1] c^(k-1) h + ... + row[k] h^k."""
    total, power = 0.0, 1.0
    for a in row:
        total, power = total * c + a * power, power * h
    return total


@compiled_as((NO_ATTITUDE, NOWHERE))
def _out_of_reach(t: float, turn: float) -> tuple[Quaternion, Vector]:
    raise ConvergenceError(
        f"dmv: {t:.3g} s between two kicks turn the body by {turn:.3g} rad, expected less than {_LARGEST_TURN:g} rad; "
        f"use a step shorter by a factor of {2.0 * turn:.3g}, or method strang6, whose flow is exact"
    )


@cached_results(8)
def _preprocessing(moments: Vector) -> _Rows:
    """Return the coefficients of s_k and d_k for k = 1 to 4, times their denominators.

    s_k and d_k are homogeneous polynomials of degree k in H = m . I^-1 m / 2 and C = m . m / 2 whose coefficients are
    polynomials in the elementary symmetric functions of 1/I_j. Found by expansion of both motions in t with rational
    arithmetic.

    Raises:
        ConvergenceError: the body is too slender.
    """
    i1, i2, i3 = moments
    if not min(i1, i2, i3) >= _SMALLEST_RATIO * max(i1, i2, i3):
        return _too_slender(moments)
    x, y, z = 1.0 / i1, 1.0 / i2, 1.0 / i3
    p, q, r = x + y + z, x * y + y * z + z * x, x * y * z
    pp, qq, rr = p * p, q * q, r * r
    return (
        ((q, -2.0 * p), (-2.0 * r, q)),
        (
            (2.0 * qq - 6.0 * p * r, 8.0 * r - 2.0 * p * q, 2.0 * pp - q),
            (-q * r, 8.0 * p * r - qq, -p * q - 6.0 * r),
        ),
        (
            (
                17.0 * q * qq - 66.0 * p * q * r + 100.0 * rr,
                -36.0 * p * qq + 132.0 * pp * r - 30.0 * q * r,
                6.0 * pp * q + 41.0 * qq - 212.0 * p * r,
                -4.0 * p * pp + 4.0 * p * q + 72.0 * r,
            ),
            (
                -19.0 * qq * r + 72.0 * p * rr,
                2.0 * q * qq - 2.0 * p * q * r - 176.0 * rr,
                13.0 * p * qq - 64.0 * pp * r + 110.0 * q * r,
                2.0 * pp * q - 26.0 * qq + 60.0 * p * r,
            ),
        ),
        (
            (
                62.0 * qq * qq - 342.0 * p * qq * r + 378.0 * pp * rr + 291.0 * q * rr,
                -154.0 * p * q * qq + 612.0 * pp * q * r + 282.0 * qq * r - 2256.0 * p * rr,
                156.0 * pp * qq + 18.0 * q * qq - 612.0 * p * pp * r + 180.0 * p * q * r + 1908.0 * rr,
                -4.0 * p * pp * q - 264.0 * p * qq + 1104.0 * pp * r - 828.0 * q * r,
                2.0 * pp * pp - 3.0 * pp * q + 153.0 * qq - 486.0 * p * r,
            ),
            (
                -61.0 * q * qq * r + 243.0 * p * q * rr - 610.0 * r * rr,
                -qq * qq + 222.0 * p * qq * r - 864.0 * pp * rr + 684.0 * q * rr,
                -30.0 * p * q * qq + 114.0 * pp * q * r - 798.0 * qq * r + 2136.0 * p * rr,
                -30.0 * pp * qq + 194.0 * q * qq + 128.0 * p * pp * r - 552.0 * p * q * r - 1296.0 * rr,
                -p * pp * q - 6.0 * p * qq - 126.0 * pp * r + 459.0 * q * r,
            ),
        ),
    )


@compiled_as(_NO_ROWS)
def _too_slender(moments: Vector) -> _Rows:
    raise ConvergenceError(
        f"dmv: the smallest moment of inertia is {min(moments) / max(moments):.3g} of the largest, expected at "
        f"least {_SMALLEST_RATIO:g}; use method strang6, whose flow is exact for any body"
    )


_SOURCE = (
    "preprocessed discrete Moser-Veselov motion of order 10 (Hairer & Vilmart, J. Phys. A 39 (2006) 13225; McLachlan & "
    "Zanna, Found. Comput. Math. 5 (2005) 87)"
)

_SMALL = "for a torque of size eps the error is O("

DMV82 = method("dmv82", 2, ABA82_STAGES, _SMALL + "eps h^8 + eps^2 h^2)", flow, _SOURCE)
DMV864 = method("dmv864", 4, ABA864_STAGES, _SMALL + "eps h^8 + eps^2 h^6 + eps^3 h^4)", flow, _SOURCE)
DMV104 = method("dmv104", 4, ABA104_STAGES, _SMALL + "eps h^10 + eps^2 h^4)", flow, _SOURCE)
