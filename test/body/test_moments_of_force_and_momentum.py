"""Moments about points and lines: definitions, and independence of the choice of point."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rb_dynamics.body import moments_of_force_and_momentum as moments
from rb_dynamics.errors import BodyError
from rb_dynamics.numerics.vector import Vector, add_scaled, cross, dot, norm, scale, subtract

numbers = st.floats(-10.0, 10.0).map(lambda x: x if abs(x) > 1e-6 else 0.0)
vectors = st.tuples(numbers, numbers, numbers)
directions = vectors.filter(lambda v: norm(v) > 1e-3)


def test_moment_of_a_force_by_hand() -> None:
    """2 N along y at 3 m along x turn about z with 6 N m; seen from (1, 0, 0) with 4 N m."""
    assert moments.moment_of_force((0.0, 2.0, 0.0), (3.0, 0.0, 0.0)) == (0.0, 0.0, 6.0)
    assert moments.moment_of_force((0.0, 2.0, 0.0), (3.0, 0.0, 0.0), (1.0, 0.0, 0.0)) == (0.0, 0.0, 4.0)
    assert moments.moment_of_force_about_line((0.0, 2.0, 0.0), (3.0, 0.0, 0.0), (0.0, 0.0, 5.0)) == 6.0
    assert moments.moment_of_force_about_line((0.0, 2.0, 0.0), (3.0, 0.0, 0.0), (0.0, 0.0, -5.0)) == -6.0
    assert moments.moment_of_force_about_line((0.0, 2.0, 0.0), (3.0, 0.0, 0.0), (4.0, 0.0, 0.0)) == 0.0


def test_moment_of_momentum_by_hand() -> None:
    assert moments.moment_of_momentum((0.0, 0.0, 2.0), (0.0, 3.0, 0.0)) == (6.0, 0.0, 0.0)
    assert moments.moment_of_momentum((0.0, 0.0, 2.0), (0.0, 3.0, 0.0), (0.0, 4.0, 0.0)) == (
        -2.0,
        0.0,
        0.0,
    )
    assert moments.moment_of_momentum_about_line((0.0, 0.0, 2.0), (0.0, 3.0, 0.0), (2.0, 0.0, 0.0)) == 6.0


@given(vectors, vectors, vectors, vectors)
def test_another_point_adds_the_moment_of_the_force_there(f: Vector, x: Vector, a: Vector, b: Vector) -> None:
    about_a, about_b = moments.moment_of_force(f, x, a), moments.moment_of_force(f, x, b)

    assert math.dist(subtract(about_b, about_a), cross(subtract(a, b), f)) <= 1e-12


@given(vectors, vectors, directions, vectors, numbers)
def test_any_point_of_a_line_gives_the_same(f: Vector, x: Vector, along: Vector, at: Vector, t: float) -> None:
    here = moments.moment_of_force_about_line(f, x, along, at)
    there = moments.moment_of_force_about_line(f, x, along, add_scaled(at, t, scale(1.0 / norm(along), along)))

    assert there == pytest.approx(here, abs=1e-11)
    assert here == pytest.approx(dot(moments.moment_of_force(f, x, at), along) / norm(along), abs=1e-11)


@pytest.mark.parametrize("size", [1e-320, 1e-200, 1.0, 1e200, 1.7e308])
def test_a_direction_may_have_any_length(size: float) -> None:
    assert moments.unit((0.0, -size, 0.0)) == (0.0, -1.0, 0.0)


@pytest.mark.parametrize("direction", [(0.0, 0.0, 0.0), (math.nan, 1.0, 0.0), (math.inf, 0.0, 0.0)])
def test_no_direction_is_refused(direction: Vector) -> None:
    with pytest.raises(BodyError, match="expected a direction"):
        moments.moment_of_force_about_line((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), direction)
