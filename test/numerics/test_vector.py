"""R^3 against exact rational arithmetic: each operation is the textbook one, with few roundings."""

from __future__ import annotations

import math
from decimal import MAX_EMAX, MIN_EMIN, Context, Decimal, localcontext
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rb_dynamics.numerics import vector
from rb_dynamics.numerics.vector import Vector

EPS = 2.0**-52

components = st.floats(-1e6, 1e6).map(lambda x: x if abs(x) > 1e-6 else 0.0)
vectors = st.tuples(components, components, components)


def close(found: float, exact: Fraction, size: float) -> bool:
    return abs(Fraction(found) - exact) <= Fraction(2.0 * EPS * size)


@given(vectors, vectors)
def test_dot_and_cross_round_each_term_once(a: Vector, b: Vector) -> None:
    p, q = [Fraction(c) for c in a], [Fraction(c) for c in b]

    assert close(vector.dot(a, b), sum(x * y for x, y in zip(p, q, strict=True)), vector.norm(a) * vector.norm(b))
    for i, found in enumerate(vector.cross(a, b)):
        j, k = (i + 1) % 3, (i + 2) % 3
        assert close(found, p[j] * q[k] - p[k] * q[j], vector.norm(a) * vector.norm(b))


@given(vectors, vectors, components)
def test_sums_and_products_by_component(a: Vector, b: Vector, s: float) -> None:
    assert vector.add(a, b) == tuple(x + y for x, y in zip(a, b, strict=True))
    assert vector.subtract(a, b) == tuple(x - y for x, y in zip(a, b, strict=True))
    assert vector.scale(s, a) == tuple(s * x for x in a)
    assert vector.add_scaled(a, s, b) == vector.add(a, vector.scale(s, b))
    assert vector.multiply(a, b) == tuple(x * y for x, y in zip(a, b, strict=True))


@given(vectors, st.tuples(*[st.floats(1e-6, 1e6)] * 3))
def test_divide_is_correctly_rounded(a: Vector, b: Vector) -> None:
    assert vector.divide(a, b) == tuple(float(Fraction(x) / Fraction(y)) for x, y in zip(a, b, strict=True))


@given(st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 3))
def test_norm_is_right_to_two_units_in_the_last_place(a: Vector) -> None:
    found = vector.norm(a)

    with localcontext(Context(prec=50, Emax=MAX_EMAX, Emin=MIN_EMIN)):
        exact = sum((Decimal(c) * Decimal(c) for c in a), Decimal(0)).sqrt()
        if math.isinf(found):
            assert exact > Decimal(math.nextafter(math.inf, 0.0)) * (1 - Decimal(EPS))
        else:
            assert abs(Decimal(found) - exact) <= 2 * Decimal(math.ulp(found))


@pytest.mark.parametrize("size", [1e140, 1e-140])
def test_norm_has_no_seam_where_it_begins_to_scale(size: float) -> None:
    for k in range(-50, 51):
        a = (size * (1.0 + k * EPS), 0.0, 0.0)

        assert vector.norm(a) == a[0]


def test_norm_of_what_is_not_finite_is_not_finite() -> None:
    assert vector.norm((math.inf, 0.0, 1.0)) == math.inf
    assert math.isnan(vector.norm((math.nan, 0.0, 1e300)))


def test_norm_neither_overflows_nor_underflows() -> None:
    assert vector.norm((3e300, 4e300, 0.0)) == 5e300
    assert vector.norm((3e-300, 0.0, 4e-300)) == pytest.approx(5e-300, rel=2.0 * EPS, abs=0.0)
    assert vector.norm((0.0, -math.ulp(0.0), 0.0)) == math.ulp(0.0)
    assert vector.norm(vector.ZERO) == 0.0


@pytest.mark.parametrize("a", [(3e-320, 0.0, -4e-320), (1.5e308, 0.0, -1.5e308), (1e-301, 2e-310, 0.0)])
def test_a_direction_has_a_length_with_an_inverse(a: Vector) -> None:
    found = vector.resized(a)
    length = vector.norm(found)
    assert 0.5 <= length < 2.0
    largest = max(map(abs, a))
    assert found == pytest.approx([x / largest * max(map(abs, found)) for x in a], rel=1e-12)
    assert vector.resized((0.0, 2.0, 3.0)) == (0.0, 2.0, 3.0)
    assert vector.resized(vector.ZERO) == vector.ZERO
