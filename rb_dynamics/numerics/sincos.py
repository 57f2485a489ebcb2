"""Sine and cosine together by polynomials: the same bits on every machine, and no call into the C library.

Without that call the compiler can vectorise over bodies (`motion/batch_kernel.py`). Valid up to `LARGEST` only; steps
that turn a body that far are refused long before.
"""

from __future__ import annotations

LARGEST = 2.0**19
"""Largest angle (rad) for which all digits are correct."""

# Adding and subtracting it rounds to a whole number.
_ROUND = 1.5 * 2.0**52
_PER_QUARTER = 0.6366197723675814
_EIGHTH = 0.785
# pi/2 in three parts; integer multiples of the first two are exact.
_QUARTER = (1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21)


def sincos(x: float) -> tuple[float, float]:
    """Return sin x and cos x for |x| <= `LARGEST`, each to 1 unit in the last place.

    Reduced by multiples of pi/2 (Cody & Waite, Software Manual for the Elementary Functions (1980)), then the minimax
    polynomials of fdlibm (Sun Microsystems, 1993), evaluated as in FreeBSD's k_sin.c and k_cos.c.
    """
    k, y, tail = 0.0, x, 0.0
    if abs(x) > _EIGHTH:
        k = (x * _PER_QUARTER + _ROUND) - _ROUND
        first = x - k * _QUARTER[0]
        second = k * _QUARTER[1]
        rest = first - second
        third = k * _QUARTER[2] - ((first - rest) - second)
        y = rest - third
        # The rounding error of y.
        tail = (rest - y) - third

    z = y * y
    w = z * z
    p = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * 2.75573137070700676789e-06)
    p = p + z * w * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)
    cube = z * y
    s = y - ((z * (0.5 * tail - cube * p) - tail) + cube * 1.66666666666666324348e-01)
    p = z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * 2.48015872894767294178e-05))
    p = p + w * w * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))
    half = 0.5 * z
    one = 1.0 - half
    c = one + (((1.0 - one) - half) + (z * p - y * tail))
    if k == 0.0:
        return s, c
    # The quadrant, -2 to 2, kept as a float: odd ones exchange sine and cosine, then the signs follow.
    turn = k - 4.0 * ((k * 0.25 + _ROUND) - _ROUND)
    odd = turn == 1.0 or turn == -1.0
    opposite = turn == 2.0 or turn == -2.0
    sine, cosine = (c, s) if odd else (s, c)
    return (-sine if opposite or turn == -1.0 else sine), (-cosine if opposite or turn == 1.0 else cosine)
