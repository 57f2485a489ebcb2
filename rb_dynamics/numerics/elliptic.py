"""Elliptic functions and integrals on plain floats, accurate to round-off, as needed for the motion of a free body.

Parameters are given by both m = k^2 and its complement m1 = 1 - m, each to full relative accuracy: near the separatrix
m is 1 to the last digit and all information is in m1.

Sources: R. Bulirsch, Numer. Math. 7 (1965) 78 for sn, cn, dn; B. C. Carlson, Numer. Algorithms 10 (1995) 13 for R_F and
R_J; DLMF chapters 19 and 22.
"""

from __future__ import annotations

import math

from rb_dynamics.numerics.compilation import workspace
from rb_dynamics.numerics.vector import norm

# Convergence is quadratic: after a relative difference below this, the next step is exact to round-off.
_CLOSE = 1e-8
# Truncation of the series is of sixth order in the relative spread; at this spread it is below round-off.
_SPREAD = 1.5e-3
# Each mean doubles the digits; the smallest positive number takes 13.
_MEANS = 24
# The loop conditions are written so that a NaN ends the loops.


def agm(a: float, b: float) -> float:
    """Return the arithmetic-geometric mean of a, b > 0 (DLMF 19.8.1)."""
    while abs(a - b) > _CLOSE * a:
        a, b = 0.5 * (a + b), math.sqrt(a * b)
    return 0.5 * (a + b)


def complete_k(m1: float) -> float:
    """Return K, the quarter period, for the complementary parameter m1; infinite for 0 (DLMF 19.8.5)."""
    return 0.5 * math.pi / agm(1.0, math.sqrt(m1)) if m1 > 0.0 else math.inf


def sncndn(u: float, m1: float) -> tuple[float, float, float]:
    """Return sn(u), cn(u), dn(u) for the complementary parameter 0 <= m1 <= 1 (Bulirsch 1965).

    Intended for |u| up to about K; the caller removes whole periods.
    """
    if m1 == 0.0:
        # Beyond this cosh overflows and its inverse is 0.
        sech = 1.0 / math.cosh(u) if abs(u) < 700.0 else 0.0
        return math.tanh(u), sech, sech
    # Exact to round-off, and smaller u would overflow products of 1/sn below.
    if abs(u) < 1e-8:
        return u, 1.0, 1.0
    a, c, dn = 1.0, 1.0, 1.0
    e = m1
    bs, es, n = workspace(_MEANS), workspace(_MEANS), 0
    while True:
        e = math.sqrt(e)
        bs[n], es[n] = a, e
        n += 1
        c = 0.5 * (a + e)
        if not abs(a - e) > _CLOSE * a or n == _MEANS:
            break
        e *= a
        a = c
    u *= c
    sn, cn = math.sin(u), math.cos(u)
    if sn == 0.0:
        return sn, cn, 1.0
    a = cn / sn
    c *= a
    for k in range(n - 1, -1, -1):
        b, e = bs[k], es[k]
        a *= c
        c *= dn
        dn = (e + a) / (b + a)
        a = c / b
    a = 1.0 / norm((c, 1.0, 0.0))
    sn = math.copysign(a, sn)
    return sn, c * sn, dn


def rf(x: float, y: float, z: float) -> float:
    """Return Carlson's R_F, at most one argument 0 (Carlson 1995, algorithm 1)."""
    mean, power = (x + y + z) / 3.0, 1.0
    # Each iteration brings the arguments four times closer to each other.
    dx, dy = mean - x, mean - y
    spread = max(abs(dx), abs(dy), abs(mean - z))
    while power * spread / mean >= _SPREAD:
        rx, ry, rz = math.sqrt(x), math.sqrt(y), math.sqrt(z)
        lam = rx * ry + ry * rz + rz * rx
        x, y, z, mean = 0.25 * (x + lam), 0.25 * (y + lam), 0.25 * (z + lam), 0.25 * (mean + lam)
        power *= 0.25
    dx, dy = power * dx / mean, power * dy / mean
    dz = -(dx + dy)
    e2, e3 = dx * dy - dz * dz, dx * dy * dz
    return (1.0 - e2 / 10.0 + e3 / 14.0 + e2 * e2 / 24.0 - 3.0 * e2 * e3 / 44.0) / math.sqrt(mean)


def rj(x: float, y: float, z: float, p: float) -> float:
    """Return Carlson's R_J for p > 0, at most one of x, y, z being 0 (Carlson 1995, algorithm 3)."""
    total, power = 0.0, 1.0
    mean = (x + y + z + 2.0 * p) / 5.0
    dx, dy, dz = mean - x, mean - y, mean - z
    spread = max(abs(dx), abs(dy), abs(dz), abs(mean - p))
    while power * spread / mean >= _SPREAD:
        rx, ry, rz, rp = math.sqrt(x), math.sqrt(y), math.sqrt(z), math.sqrt(p)
        lam = rx * ry + ry * rz + rz * rx
        d = (rp + rx) * (rp + ry) * (rp + rz)
        # e = (p - x)(p - y)(p - z)/d^2 and 1 + e, both without cancellation.
        total += power / d * _rc1((rp - rx) * (rp - ry) * (rp - rz) / d, 2.0 * rp * (p + lam) / d)
        x, y, z, p = 0.25 * (x + lam), 0.25 * (y + lam), 0.25 * (z + lam), 0.25 * (p + lam)
        mean = 0.25 * (mean + lam)
        power *= 0.25
    dx, dy, dz = power * dx / mean, power * dy / mean, power * dz / mean
    dp = -0.5 * (dx + dy + dz)
    e2 = dx * dy + dx * dz + dy * dz - 3.0 * dp * dp
    e3 = dx * dy * dz + 2.0 * e2 * dp + 4.0 * dp * dp * dp
    e4 = (2.0 * dx * dy * dz + e2 * dp + 3.0 * dp * dp * dp) * dp
    e5 = dx * dy * dz * dp * dp
    series = (
        1.0
        - 3.0 * e2 / 14.0
        + e3 / 6.0
        + 9.0 * e2 * e2 / 88.0
        - 3.0 * e4 / 22.0
        - 9.0 * e2 * e3 / 52.0
        + 3.0 * e5 / 26.0
    )
    return 6.0 * total + power * series / (mean * math.sqrt(mean))


def _rc1(e: float, y: float) -> float:
    """Return Carlson's R_C(1, y) for y = 1 + e > 0, both given to full relative accuracy (DLMF 19.2.18, 19.2.19)."""
    if abs(e) < 1e-3:
        return 1.0 - e * (1.0 / 3.0 - e * (0.2 - e * (1.0 / 7.0 - e * (1.0 / 9.0 - e * (1.0 / 11.0 - e / 13.0)))))
    root = math.sqrt(abs(e))
    return math.atan(root) / root if e > 0.0 else math.log((1.0 + root) / math.sqrt(y)) / root
