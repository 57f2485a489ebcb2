"""Torque-free rotation of a rigid body in closed form: any time in constant work.

Jacobi's elliptic functions solve Euler's equations (lecture 24, eqs. 20 to 22). The attitude follows from the azimuth
about the fixed angular momentum, an elliptic integral of the third kind. The formulas are arranged to avoid
cancellation for any body (sphere, symmetric, needle, plate, moments that differ by one unit in the last place) and any
rotation (about an axis, on the separatrix or close to it).

Sources: Jacobi, J. reine angew. Math. 39 (1850) 293; Landau & Lifshitz, Mechanics, section 37; Celledoni, Fasso,
Safstrom & Zanna, SIAM J. Sci. Comput. 30 (2008) 2084; DLMF 19.21.12 for the integral.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.motion.result_cache import cached_results
from rb_dynamics.motion.step_checks import NO_ATTITUDE, NOWHERE
from rb_dynamics.numerics.compilation import compiled_as
from rb_dynamics.numerics.elliptic import agm, rf, rj, sncndn
from rb_dynamics.numerics.rotation import Quaternion, exp, multiply, normalize
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, dot, norm, positive_zeros, scale, subtract
from rb_dynamics.numerics.vector import multiply as times

_Axes = tuple[tuple[int, float], tuple[int, float], tuple[int, float]]


# A rate of change below this (rad/s) is negligible in any run, and its inverse would overflow.
_SLOWEST = 1e-250


class _Tumble(NamedTuple):
    """A free rotation that is not a spin about a fixed axis, in axes a, b, c.

    b is the middle axis, and c the axis that the polhode encircles: that of the largest moment if L^2 > 2 T I_b, else
    of the smallest. The signs make the axes right-handed with w_c > 0 and w_a >= 0. Then

        w = (A cn u, B sn u, C dn u),  u = u0 + rate t.

    Attributes:
        axes: for a, b, c: index and sign of the principal axis.
        moments: I_a, I_b, I_c.
        amplitudes: A, B, C.
        rate: du/dt; negative where c is the axis of the smallest moment.
        m1: complementary parameter, 1 - k^2.
        quarter: K; infinite on the separatrix.
        u0: u at time 0, |u0| <= K.
        start: sn, cn, dn at u0, each to full relative accuracy.
        beta: (I_b B / I_a A)^2 >= 1.
        g: (beta - 1)(beta - m1)/beta.
        momentum: |L|.
        gain: factor of the integral for the azimuth, L (I_b - I_a) / (I_a I_b rate).
    """

    axes: _Axes
    moments: Vector
    amplitudes: Vector
    rate: float
    m1: float
    quarter: float
    u0: float
    start: Vector
    beta: float
    g: float
    momentum: float
    gain: float


def free_rotation(moments: Vector, angular_velocity: Vector, t: float) -> tuple[Quaternion, Vector]:
    """Return the rotation r during the first t s, q(t) = q(0) r, and the angular velocity at their end.

    Moments in kg m^2, angular velocities in principal axes, rad/s; t of any sign. The error of the attitude is below
    100 eps (1 + |w| t), those of energy and |L| are below 20 eps.

    Raises:
        ConvergenceError: the rotation angle is not finite.
    """
    spin = positive_zeros(angular_velocity)
    rate = norm(spin)
    if not math.isfinite(rate * t):
        return _beyond_range(rate, t)
    # In units near the largest moment and the largest rate, powers of two, to avoid overflow and underflow of products.
    unit = math.frexp(max(abs(spin[0]), abs(spin[1]), abs(spin[2])))[1]
    w = _in_units(spin, unit)
    moments = _in_units(moments, math.frexp(max(moments[0], moments[1], moments[2]))[1])
    if _spins_steadily(moments, w):
        return exp(scale(t, spin)), spin
    body, time = _tumble(moments, w), math.ldexp(t, unit)
    if body.rate == 0.0 or _stays(body, time):
        return exp(scale(t, spin)), spin
    turn, omega = _tumble_at(body, time)
    return turn, _in_units(_balanced(moments, w, omega), -unit)


@compiled_as((NO_ATTITUDE, NOWHERE))
def _beyond_range(rate: float, t: float) -> tuple[Quaternion, Vector]:
    raise ConvergenceError(
        f"exact: {rate:.3g} rad/s for {t:.3g} s is an angle beyond the range of double precision; "
        "check the angular velocity, the torque and the moments of inertia, or use a smaller step"
    )


@compiled_as((NO_ATTITUDE, NOWHERE))
def _unresolved(t: float) -> tuple[Quaternion, Vector]:
    raise ConvergenceError(
        f"exact: after {t:.3g} s the precession angle is not a finite number: the spin is closer to the middle axis "
        "than double precision resolves; use a method with a step"
    )


def _in_units(v: Vector, exponent: int) -> Vector:
    """Return v / 2^exponent."""
    return (math.ldexp(v[0], -exponent), math.ldexp(v[1], -exponent), math.ldexp(v[2], -exponent))


def _balanced(moments: Vector, start: Vector, w: Vector) -> Vector:
    """Return w corrected so that 2T = w . I w and L^2 = |I w|^2 are those at `start` again.

    Rounding of the closed form is biased by some hundredths of a unit in the last place; in n steps that adds up like
    n, not like its root. The correction is the shortest possible, perpendicular to the polhode. One that is larger than
    round-off is not applied, so that a real error stays visible.
    """
    gained = times(times(moments, subtract(w, start)), add(w, start))
    energy, square = gained[0] + gained[1] + gained[2], dot(moments, gained)
    a = times(moments, w)
    b = times(moments, a)
    aa, ab, bb = dot(a, a), dot(a, b), dot(b, b)
    determinant = aa * bb - ab * ab
    if not determinant > 1e-8 * aa * bb:
        return w
    x, y = (square * ab - energy * bb) / (2.0 * determinant), (energy * ab - square * aa) / (2.0 * determinant)
    change = add_scaled(scale(x, a), y, b)
    return add(w, change) if norm(change) <= 1e-14 * norm(w) else w


def _spins_steadily(moments: Vector, w: Vector) -> bool:
    """Return whether w is constant: w' = I^-1 (I w x w) vanishes (a sphere, or w along a principal axis)."""
    return (moments[1] == moments[2] or w[1] * w[2] == 0.0) and (
        (moments[2] == moments[0] or w[2] * w[0] == 0.0) and (moments[0] == moments[1] or w[0] * w[1] == 0.0)
    )


def _stays(body: _Tumble, t: float) -> bool:
    """Return whether w is so close to the middle axis that rounding errors, growing by exp, stay negligible in t s."""
    _, cn, dn = body.start
    return norm((cn, dn, 0.0)) < 1e-130 and abs(body.rate * t) < 200.0


# A change of the angular velocity that is negligible.
_STEADY = _Tumble(((0, 1.0), (1, 1.0), (2, 1.0)), ZERO, ZERO, 0.0, 0.0, 0.0, 0.0, ZERO, 0.0, 0.0, 0.0, 0.0)


# Cached, because an arc is often evaluated many times from one start.
@cached_results(8)
def _tumble(moments: Vector, w: Vector) -> _Tumble:
    low, middle, high = 0, 1, 2
    if moments[low] > moments[middle]:
        low, middle = middle, low
    if moments[middle] > moments[high]:
        middle, high = high, middle
    if moments[low] > moments[middle]:
        low, middle = middle, low
    # L^2 - 2 T I_b, the distance from the separatrix: a difference of two positive terms that may cancel almost
    # completely.
    unit, d = _separation(moments[high], moments[middle], moments[low], w[high], w[low])
    # If it is 0, perhaps by underflow, the body rotates about the axis whose moment differs from the others.
    about_high = d > 0.0 or (d == 0.0 and moments[high] > moments[middle])
    a, b, c = (low, middle, high) if about_high else (high, middle, low)
    ia, ib, ic = moments[a], moments[b], moments[c]
    sign_a, sign_c = math.copysign(1.0, w[a]), math.copysign(1.0, w[c])
    parity = 1.0 if (b - a) % 3 == 1 else -1.0
    sign_b = parity * sign_a * sign_c
    wa, wb, wc = abs(w[a]), sign_b * w[b], abs(w[c])

    ca, cb, ba = abs(ic - ia), abs(ic - ib), abs(ib - ia)
    ratio = math.sqrt(ib * cb / (ia * ca))
    amplitude_a, amplitude_b = norm((wa, wb * ratio, 0.0)), norm((wb, wa / ratio, 0.0))
    amplitude_c = norm((wc, wb * math.sqrt(ib * ba / (ic * ca)), 0.0))
    rate = math.copysign(amplitude_c * math.sqrt(cb / ia * (ca / ib)), ic - ia)
    if abs(rate) < _SLOWEST:
        return _STEADY
    k1 = min(1.0, math.sqrt(abs(d) / (ic * cb)) * (unit / amplitude_c))
    m1 = k1 * k1
    sn, cn, dn = (wb / amplitude_b, wa / amplitude_a, wc / amplitude_c) if amplitude_a > 0.0 else (0.0, 1.0, 1.0)
    if cn + dn == 0.0:
        return _STEADY
    momentum = norm((ia * wa, ib * wb, ic * wc))
    beta = ib / ia * (ca / cb)
    return _Tumble(
        axes=((a, sign_a), (b, sign_b), (c, sign_c)),
        moments=(ia, ib, ic),
        amplitudes=(amplitude_a, amplitude_b, amplitude_c),
        rate=rate,
        m1=m1,
        quarter=0.5 * math.pi / agm(1.0, k1) if k1 > 0.0 else math.inf,
        u0=sn * _first_kind(cn, dn),
        start=(sn, cn, dn),
        beta=beta,
        g=ic / ia * (ba / cb) * max(0.0, 1.0 - m1 / beta),
        momentum=momentum,
        gain=(ib - ia) / ia * (momentum / ib) / rate,
    )


def _first_kind(cn: float, dn: float) -> float:
    """Return R_F(cn^2, dn^2, 1); close to the middle axis, where the squares underflow, by its limit (DLMF 19.27.2)."""
    return rf(cn * cn, dn * dn, 1.0) if cn + dn > 1e-9 else math.log(4.0) - math.log(cn + dn)


def _tumble_at(body: _Tumble, t: float) -> tuple[Quaternion, Vector]:
    u = body.u0 + body.rate * t
    if body.m1 < 1e-290 and abs(u) > body.quarter:
        return _unresolved(t)
    start = _angles(body, body.start)
    if abs(body.rate * t) < 1.0:
        # u0 + rate t would lose a slow motion to rounding.
        half_periods, functions = _sum(body, body.rate * t)
    else:
        half_periods = round(u / (2.0 * body.quarter))
        functions = sncndn(u - 2.0 * half_periods * body.quarter if half_periods else u, body.m1)
    now = _angles(body, functions)

    azimuth = now.integral - start.integral
    if half_periods:
        azimuth += 2.0 * half_periods * body.m1 / (3.0 * body.beta) * rj(0.0, body.m1, 1.0, body.m1 / body.beta)
    phi = body.momentum / body.moments[1] * t + body.gain * azimuth
    if not math.isfinite(phi):
        return _unresolved(t)
    # chi grows by pi in half a period; removing whole turns of the quaternion avoids rounding.
    chi = now.chi + (half_periods % 4) * math.pi
    turn = multiply(
        multiply(multiply(_about_c(start.chi), _about_b(start.theta)), _about_c(phi)),
        multiply(_about_b(-now.theta), _about_c(-chi)),
    )
    sign = -1.0 if half_periods % 2 else 1.0
    x, y, z = _in_principal_axes(body.axes, (turn[0], turn[1], turn[2]))
    omega = times(body.amplitudes, (sign * now.cn, sign * now.sn, now.dn))
    return normalize((x, y, z, turn[3])), _in_principal_axes(body.axes, omega)


class _Angles(NamedTuple):
    """Values for the attitude at one u: direction of the angular momentum (theta, chi), integral for the azimuth."""

    sn: float
    cn: float
    dn: float
    theta: float
    chi: float
    integral: float


def _sum(body: _Tumble, v: float) -> tuple[int, Vector]:
    """Return sn, cn, dn at u0 + v, |v| <= 1, less the half periods before, by the addition theorem (DLMF 22.8)."""
    (s, c, d), (sv, cv, dv) = body.start, sncndn(v, body.m1)
    m = 1.0 - body.m1
    under = cv * cv + sv * sv * d * d
    sn, cn, dn = (
        (s * cv * dv + sv * c * d) / under,
        (c * cv - s * d * sv * dv) / under,
        (d * dv - m * s * c * sv * cv) / under,
    )
    if cn >= 0.0:
        return 0, (sn, cn, dn)
    return (1 if v > 0.0 else -1), (-sn, -cn, dn)


def _angles(body: _Tumble, functions: Vector) -> _Angles:
    sn, cn, dn = functions
    ma, mb, mc = times(body.moments, times(body.amplitudes, (cn, sn, dn)))
    theta = math.atan2(norm((ma, mb, 0.0)), mc)
    chi = math.atan2(math.sqrt(body.beta) * sn, cn)
    return _Angles(sn, cn, dn, theta, chi, _azimuth_integral(body, sn, cn, dn))


def _azimuth_integral(body: _Tumble, sn: float, cn: float, dn: float) -> float:
    """Return the integral of cn^2/(cn^2 + beta sn^2) du from 0 to |u| <= K, as a sum of terms of one sign.

    phi' = L/I_b + L (I_b - I_a)/(I_a I_b) cn^2/(cn^2 + beta sn^2). The textbook form R_F - beta/3 R_J(.., p) cancels
    for a needle; the relation between R_J of p and of its reflection q (DLMF 19.21.12) leaves an arctangent and
    R_J(.., q), both positive.
    """
    root = math.sqrt(body.g)
    x = sn * cn / dn if dn > 0.0 else math.copysign(1.0, sn)
    first = math.atan(root * x) / root if root > 0.0 else x
    factor = body.m1 / body.beta
    square = sn * sn
    if factor * square == 0.0:
        return first
    return first + factor / 3.0 * sn * square * rj(cn * cn, dn * dn, 1.0, cn * cn + factor * square)


def _about_c(angle: float) -> Quaternion:
    return (0.0, 0.0, math.sin(0.5 * angle), math.cos(0.5 * angle))


def _about_b(angle: float) -> Quaternion:
    return (0.0, math.sin(0.5 * angle), 0.0, math.cos(0.5 * angle))


def _in_principal_axes(axes: _Axes, vector: Vector) -> Vector:
    """Return a vector given in axes a, b, c in principal axes: an exact permutation with signs."""
    (a, sign_a), (b, sign_b), (_, sign_c) = axes
    x, y, z = sign_a * vector[0], sign_b * vector[1], sign_c * vector[2]
    return (
        x if a == 0 else (y if b == 0 else z),
        x if a == 1 else (y if b == 1 else z),
        x if a == 2 else (y if b == 2 else z),
    )


def _separation(high: float, middle: float, low: float, w_high: float, w_low: float) -> tuple[float, float]:
    """Return a unit of rate and high (high - middle) w_high^2 - low (middle - low) w_low^2 in it, to the last digit.

    In doubled precision (Dekker, Numer. Math. 18 (1971) 224), because of cancellation. The unit is a power of two near
    the larger term, so that no relevant square underflows.
    """
    p, q = _product(_two_difference(high, middle), high), _product(_two_difference(middle, low), low)
    # A term with weight 0 is left out: its rate may be many orders larger than the other one.
    w_high, w_low = w_high if p[0] > 0.0 else 0.0, w_low if q[0] > 0.0 else 0.0
    largest = max(math.sqrt(p[0]) * abs(w_high), math.sqrt(q[0]) * abs(w_low))
    exponent = math.frexp(largest / math.sqrt(max(p[0], q[0])))[1] if largest > 0.0 else 0
    w_high, w_low = math.ldexp(w_high, -exponent), math.ldexp(w_low, -exponent)
    p, q = _product(_product(p, w_high), w_high), _product(_product(q, w_low), w_low)
    difference, rest = _two_difference(p[0], q[0])
    return math.ldexp(1.0, exponent), difference + (rest + (p[1] - q[1]))


def _two_difference(a: float, b: float) -> tuple[float, float]:
    d = a - b
    part = d - a
    return d, (a - (d - part)) - (b + part)


def _product(x: tuple[float, float], y: float) -> tuple[float, float]:
    """Return (x[0] + x[1]) y as a sum of two numbers."""
    p = x[0] * y
    xh, xl = _split(x[0])
    yh, yl = _split(y)
    error = ((xh * yh - p) + xh * yl + xl * yh) + xl * yl + x[1] * y
    total = p + error
    return total, error - (total - p)


def _split(a: float) -> tuple[float, float]:
    c = 134217729.0 * a
    high = c - (c - a)
    return high, a - high
