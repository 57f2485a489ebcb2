"""Sine and cosine are correctly rounded."""

from __future__ import annotations

import math
import random

import pytest
from mpmath import mp, mpf

from rb_dynamics.numerics.sincos import LARGEST, sincos

QUARTER_TURNS = [math.nextafter(k * math.pi / 4.0, d) for k in range(-40, 41) for d in (-math.inf, math.inf)]


def ulps(found: float, exact: mpf) -> float:
    return float(abs(mpf(found) - exact) / math.ulp(float(exact)))


def angles() -> list[float]:
    r = random.Random(1)
    small = [r.uniform(-3.2, 3.2) for _ in range(2000)]
    wide = [r.uniform(-LARGEST, LARGEST) for _ in range(2000)]
    tiny = [r.uniform(-1.0, 1.0) * 10.0 ** r.uniform(-300.0, 0.0) for _ in range(500)]
    return [*small, *wide, *tiny, *QUARTER_TURNS, *(k * math.pi / 2.0 for k in range(1, 40)), LARGEST, -LARGEST]


def test_both_are_right_to_a_unit_in_the_last_place() -> None:
    worst = 0.0
    with mp.workprec(160):
        for x in angles():
            sine, cosine = sincos(x)
            worst = max(worst, ulps(sine, mp.sin(x)), ulps(cosine, mp.cos(x)))

    assert 0.5 < worst < 0.75


def test_zero_has_no_error_and_keeps_its_sign() -> None:
    assert repr(sincos(0.0)) == "(0.0, 1.0)"
    assert repr(sincos(-0.0)) == "(-0.0, 1.0)"


@pytest.mark.parametrize("x", [math.nan, math.inf])
def test_what_is_no_angle_has_no_sine(x: float) -> None:
    assert all(map(math.isnan, sincos(x)))
