"""R^3 against exact rational arithmetic: each operation is the textbook one, rounded a few times and no more."""

from __future__ import annotations

import math
from fractions import Fraction

from hypothesis import given
from hypothesis import strategies as st

from rb_dynamics import vector
from rb_dynamics.vector import Vector

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


def test_norm_neither_overflows_nor_underflows() -> None:
    assert vector.norm((3e300, 4e300, 0.0)) == 5e300
    assert vector.norm((3e-300, 0.0, 4e-300)) == 5e-300
    assert vector.norm((0.0, -math.ulp(0.0), 0.0)) == math.ulp(0.0)
    assert vector.norm(vector.ZERO) == 0.0
