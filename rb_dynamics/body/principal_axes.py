"""Principal axes: the eigen-decomposition of an inertia matrix by cyclic Jacobi rotations.

Jacobi's method computes small moments of a positive definite matrix to full relative accuracy (Demmel & Veselic, SIAM
J. Matrix Anal. Appl. 13 (1992) 1204). It needs no linear algebra library, whose bits differ between builds, always
gives a right-handed frame, and rotates no more than necessary: a diagonal matrix stays as it is, and repeated moments
do not turn the frame at random.
"""

from __future__ import annotations

import math

from rb_dynamics.numerics.rotation import IDENTITY, Matrix, Quaternion, multiply, normalize
from rb_dynamics.numerics.vector import Vector, norm

_SWEEPS = 30


def diagonalize(inertia: Matrix) -> tuple[Vector, Quaternion]:
    """Return (moments, axes) with I = R diag(moments) R^T, R the rotation of `axes` from principal to body axes.

    Lecture 24, eqs. 10 and 11 (there A = R^T). A matrix that is nearly diagonal keeps the order of its axes.
    """
    a = [list(row) for row in inertia]
    axes = IDENTITY
    for _ in range(_SWEEPS):
        turned = False
        for p, q in ((0, 1), (0, 2), (1, 2)):
            if abs(a[p][q]) > 0.5 * math.ulp(math.sqrt(abs(a[p][p])) * math.sqrt(abs(a[q][q]))):
                axes = multiply(axes, _annihilate(a, p, q))
                turned = True
        if not turned:
            break
    return (a[0][0], a[1][1], a[2][2]), axes if axes == IDENTITY else normalize(axes)


def _annihilate(a: list[list[float]], p: int, q: int) -> Quaternion:
    """Rotate `a` in the plane (p, q) by at most 45 degrees so that a[p][q] becomes 0; return that rotation.

    Golub & Van Loan, Matrix Computations, 4th ed., section 8.5.2.
    """
    apq = a[p][q]
    theta = (a[q][q] - a[p][p]) / (2.0 * apq)
    t = math.copysign(1.0, theta) / (abs(theta) + norm((1.0, theta, 0.0)))
    c = 1.0 / norm((1.0, t, 0.0))
    s = t * c
    a[p][p] -= t * apq
    a[q][q] += t * apq
    a[p][q] = a[q][p] = 0.0
    r = 3 - p - q
    arp, arq = a[r][p], a[r][q]
    a[r][p] = a[p][r] = c * arp - s * arq
    a[r][q] = a[q][r] = s * arp + c * arq
    # Columns p and q of the frame become c p - s q and s p + c q: a turn about axis r by -atan(t) where (p, q, r) is
    # cyclic, by +atan(t) where it is not, as for (0, 2).
    half = 0.5 * math.atan(t)
    sine = math.sin(half) if (p, q) == (0, 2) else -math.sin(half)
    vector = [0.0, 0.0, 0.0]
    vector[r] = sine
    return (vector[0], vector[1], vector[2], math.cos(half))
