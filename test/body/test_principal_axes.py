"""Principal moments and axes of any inertia matrix, also if moments repeat or differ by a factor of 1e12."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mpmath import matrix as mp_matrix
from mpmath import mp, mpf

from rb_dynamics.body.principal_axes import diagonalize
from rb_dynamics.numerics import rotation
from rb_dynamics.numerics.rotation import IDENTITY, Matrix, Quaternion
from rb_dynamics.numerics.vector import Vector, norm, scale

EPS = 2.0**-52

MOMENTS: list[Vector] = [
    (1.0, 2.0, 2.5),
    (1.0, 1.0, 1.0),
    (1.0, 1.0, 2.0),
    (2.0, 1.0, 2.0),
    (1.0, 2.0, 3.0),
    (1.0, 1.0 + EPS, 1.5),
    (1e-12, 1.0, 1.0),
    (1e-6, 1.0, 1.0 + 1e-6),
    (1e20, 1.5e20, 2e20),
    (1e-20, 1.5e-20, 2e-20),
]

parts = st.floats(-1.0, 1.0).map(lambda x: x if abs(x) > 1e-9 else 0.0)
quaternions = st.tuples(parts, parts, parts, parts).filter(lambda q: math.hypot(*q) > 1e-3).map(rotation.normalize)
small_turns = st.tuples(parts, parts, parts).map(lambda v: rotation.exp(scale(0.2, v)))


def turned(moments: Vector, axes: Quaternion) -> Matrix:
    """Return R diag(moments) R^T, symmetric, each entry rounded once."""
    with mp.workdps(60):
        x, y, z, w = (mpf(c) for c in axes)
        n = x * x + y * y + z * z + w * w
        r = mp_matrix(
            [
                [n - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), n - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), n - 2 * (x * x + y * y)],
            ]
        )
        a = r * mp.diag([mpf(m) for m in moments]) * r.T / n**2
        rows = [[float(a[min(i, j), max(i, j)]) for j in range(3)] for i in range(3)]
    return tuple(tuple(row) for row in rows)


def deviation(a: Matrix, b: Matrix) -> float:
    return max(abs(x - y) for p, q in zip(a, b, strict=True) for x, y in zip(p, q, strict=True))


@given(st.sampled_from(MOMENTS), quaternions)
def test_matrix_is_made_again_from_moments_and_axes(moments: Vector, axes: Quaternion) -> None:
    inertia = turned(moments, axes)

    found, frame = diagonalize(inertia)

    assert deviation(turned(found, frame), inertia) <= 6.0 * EPS * max(moments)
    assert abs(math.hypot(*frame) - 1.0) <= EPS
    for a, b in zip(sorted(found), sorted(moments), strict=True):
        assert abs(a - b) <= 8.0 * EPS * max(moments)


@given(st.sampled_from(MOMENTS), quaternions)
def test_axes_are_right_handed_and_carry_their_moment(moments: Vector, axes: Quaternion) -> None:
    inertia = turned(moments, axes)

    found, frame = diagonalize(inertia)

    columns = list(zip(*rotation.matrix(frame), strict=True))
    for i, axis in enumerate(columns):
        image = tuple(math.fsum(row[j] * axis[j] for j in range(3)) for row in inertia)
        assert math.dist(image, scale(found[i], axis)) <= 10.0 * EPS * max(moments)
    a, b, c = columns
    assert math.fsum(
        a[i] * (b[(i + 1) % 3] * c[(i + 2) % 3] - b[(i + 2) % 3] * c[(i + 1) % 3]) for i in range(3)
    ) == pytest.approx(1.0, abs=16.0 * EPS)


@given(st.permutations([1.0, 1e-12, 1.0]) | st.sampled_from(MOMENTS) | st.permutations([1e-20, 1.0, 1e20]))
def test_diagonal_matrix_is_left_alone(moments: list[float]) -> None:
    i1, i2, i3 = moments

    assert diagonalize(((i1, 0.0, 0.0), (0.0, i2, 0.0), (0.0, 0.0, i3))) == ((i1, i2, i3), IDENTITY)


def test_products_below_round_off_turn_nothing() -> None:
    tiny = 1e-17

    assert diagonalize(((1.0, tiny, 0.0), (tiny, 1.0, -tiny), (0.0, -tiny, 1.0))) == ((1.0, 1.0, 1.0), IDENTITY)


@pytest.mark.parametrize(("i", "j"), [(0, 1), (0, 2), (1, 2)])
def test_repeated_moments_turn_only_in_the_plane_that_needs_it(i: int, j: int) -> None:
    """The axis of a symmetric body stays where it is to the bit; only the two others are chosen."""
    rows = [[2.0 if a == b else 0.0 for b in range(3)] for a in range(3)]
    rows[i][j] = rows[j][i] = 0.25

    moments, frame = diagonalize(tuple(tuple(row) for row in rows))

    k = 3 - i - j
    assert moments[k] == 2.0
    assert sorted((moments[i], moments[j])) == pytest.approx([1.75, 2.25], rel=2.0 * EPS)
    assert [frame[i], frame[j]] == [0.0, 0.0]
    assert abs(frame[k]) == pytest.approx(math.sin(math.pi / 8.0), rel=2.0 * EPS)


@given(st.sampled_from([(1.0, 2.0, 2.5), (1e-12, 1.0, 2.0), (1.0, 1.5, 2.4)]), small_turns)
def test_nearly_diagonal_matrix_keeps_its_axes(moments: Vector, axes: Quaternion) -> None:
    found, frame = diagonalize(turned(moments, axes))

    assert rotation.angle_between(frame, axes) <= 200.0 * EPS
    assert all(abs(a - b) <= 8.0 * EPS * max(moments) for a, b in zip(found, moments, strict=True))


@pytest.mark.parametrize("turn", [1e-9, 1e-6])
def test_needle_mildly_rotated_keeps_its_small_moment(turn: float) -> None:
    """Ratio 1e12. Turned by 1e-6 rad, the small moment is no smaller than its own row's rounding: it is kept to 1e-3.

    Turned by 1e-9 rad the matrix is scaled diagonally dominant, and Jacobi's method keeps nearly all digits.
    """
    needle = (1e-12, 1.0, 1.0 + 1e-12)
    axes = rotation.exp((0.0, 0.6 * turn, -0.8 * turn))

    found, frame = diagonalize(turned(needle, axes))

    assert found[0] == pytest.approx(1e-12, rel=4.0 * EPS * (1.0 + turn**2 / 1e-12))
    assert math.dist(rotation.rotate(frame, (1.0, 0.0, 0.0)), rotation.rotate(axes, (1.0, 0.0, 0.0))) <= 4.0 * EPS


@given(st.sampled_from([(1.0, 2.0, 2.5), (1.0, 1.0, 2.0), (1e-6, 1.0, 1.0)]), quaternions)
def test_names_of_the_axes_do_not_matter(moments: Vector, axes: Quaternion) -> None:
    inertia = turned(moments, axes)
    sorted_moments = sorted(diagonalize(inertia)[0])

    for p in itertools.permutations(range(3)):
        named = tuple(tuple(inertia[i][j] for j in p) for i in p)
        found, frame = diagonalize(named)
        assert deviation(turned(found, frame), named) <= 6.0 * EPS * max(moments)
        for a, b in zip(sorted(found), sorted_moments, strict=True):
            assert abs(a - b) <= 8.0 * EPS * max(moments)


@given(quaternions, st.integers(-200, 200))
def test_units_do_not_matter_to_the_bit(axes: Quaternion, exponent: int) -> None:
    inertia = turned((1.0, 2.0, 2.5), axes)
    factor = 2.0**exponent

    moments, frame = diagonalize(inertia)
    scaled, same = diagonalize(tuple(scale(factor, row) for row in inertia))

    assert scaled == scale(factor, moments)
    assert same == frame


def test_indefinite_matrix_is_diagonalised_too() -> None:
    """The later check that moments are positive names the true ones."""
    moments, _ = diagonalize(((1.0, 2.0, 0.0), (2.0, 1.0, 0.0), (0.0, 0.0, 1.0)))

    assert sorted(moments) == pytest.approx([-1.0, 1.0, 3.0], rel=4.0 * EPS)
    assert norm(moments) == pytest.approx(math.sqrt(11.0))
