"""Systems of particles against exact rational arithmetic, and bodies made of them."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rb_dynamics.body import particles
from rb_dynamics.errors import BodyError
from rb_dynamics.numerics import rotation
from rb_dynamics.numerics.rotation import Matrix
from rb_dynamics.numerics.vector import Vector, add, cross, norm, scale, subtract

EPS = 2.0**-52

parts = st.floats(-5.0, 5.0).map(lambda x: x if abs(x) > 1e-6 else 0.0)
vectors = st.tuples(parts, parts, parts)
masses = st.floats(0.01, 100.0)
systems = st.lists(st.tuples(masses, vectors, vectors), min_size=1, max_size=12)
offsets = st.sampled_from([(0.0, 0.0, 0.0), (1e3, -2e3, 5e2), (1e8, 1e8, -1e8)])


def exact(system: list[tuple[float, Vector]]) -> tuple[list[Fraction], list[list[Fraction]]]:
    """Return the centre of mass and the inertia about it, without rounding."""
    ms = [Fraction(m) for m, _ in system]
    xs = [[Fraction(c) for c in x] for _, x in system]
    center = [sum(m * x[i] for m, x in zip(ms, xs, strict=True)) / sum(ms) for i in range(3)]
    arms = [[c - o for c, o in zip(x, center, strict=True)] for x in xs]
    inertia = [
        [
            sum(m * ((sum(c * c for c in r) if i == j else 0) - r[i] * r[j]) for m, r in zip(ms, arms, strict=True))
            for j in range(3)
        ]
        for i in range(3)
    ]
    return center, inertia


@given(systems, offsets)
def test_centre_of_mass_and_inertia_are_exact_to_round_off(
    system: list[tuple[float, Vector, Vector]], offset: Vector
) -> None:
    """However far from the origin the particles are: positions are rounded there, the inertia of those is not."""
    ms, xs = [m for m, _, _ in system], [add(x, offset) for _, x, _ in system]
    center, inertia = exact(list(zip(ms, xs, strict=True)))

    found = particles.inertia_matrix(ms, xs)

    for a, b in zip(particles.center_of_mass(ms, xs), center, strict=True):
        assert abs(Fraction(a) - b) <= 2 * EPS * abs(b) + Fraction(4 * EPS) * max(
            abs(Fraction(c)) for x in xs for c in x
        )
    trace = sum(inertia[i][i] for i in range(3))
    for i in range(3):
        for j in range(3):
            assert abs(Fraction(found[i][j]) - inertia[i][j]) <= 8 * EPS * trace


def test_total_mass_is_rounded_once() -> None:
    assert particles.total_mass([0.1] * 10) == 1.0


@given(systems, vectors)
def test_momentum_and_angular_momentum_are_those_of_the_lecture(
    system: list[tuple[float, Vector, Vector]], about: Vector
) -> None:
    ms, xs, vs = (list(column) for column in zip(*system, strict=True))
    m, x, v = np.array(ms), np.array(xs), np.array(vs)

    np.testing.assert_allclose(particles.momentum(ms, vs), m @ v, atol=1e-11)
    np.testing.assert_allclose(
        particles.angular_momentum(ms, xs, vs, about), (m[:, None] * np.cross(x - about, v)).sum(axis=0), atol=1e-9
    )
    np.testing.assert_allclose(particles.external_force(vs), v.sum(axis=0), atol=1e-12)
    np.testing.assert_allclose(particles.total_torque(xs, vs, about), np.cross(x - about, v).sum(axis=0), atol=1e-10)


@given(systems, vectors)
def test_momentum_is_mass_times_velocity_of_the_centre_of_mass(
    system: list[tuple[float, Vector, Vector]], velocity: Vector
) -> None:
    """Page 16: P = M dX/dt, with dX/dt the centre of mass of the velocities."""
    ms, _, vs = (list(column) for column in zip(*system, strict=True))

    expected = scale(particles.total_mass(ms), particles.center_of_mass(ms, vs))

    assert math.dist(particles.momentum(ms, vs), expected) <= 1e-12 * particles.total_mass(ms)


@given(systems, vectors)
def test_of_a_rigid_motion_the_angular_momentum_is_inertia_times_rate(
    system: list[tuple[float, Vector, Vector]], omega: Vector
) -> None:
    """Pages 20 to 22: with v_k = v_0 + w x r_k and the origin at the centre of mass, L = I w whatever v_0 is."""
    ms, xs, vs = (list(column) for column in zip(*system, strict=True))
    center = particles.center_of_mass(ms, xs)
    velocities = [add(vs[0], cross(omega, subtract(x, center))) for x in xs]
    inertia = particles.inertia_matrix(ms, xs)

    found = particles.angular_momentum(ms, xs, velocities, center)

    np.testing.assert_allclose(found, np.array(inertia) @ omega, atol=1e-9)


@given(systems, vectors)
def test_parallel_axes(system: list[tuple[float, Vector, Vector]], about: Vector) -> None:
    ms, xs, _ = (list(column) for column in zip(*system, strict=True))
    center, mass = particles.center_of_mass(ms, xs), particles.total_mass(ms)

    moved = particles.inertia_matrix([*ms], xs, about)

    point = particles.inertia_matrix([mass], [center], about)
    expected = np.array(particles.inertia_matrix(ms, xs)) + np.array(point)
    np.testing.assert_allclose(moved, expected, atol=1e-10 * mass)


@given(systems, systems)
def test_inertia_about_one_point_adds_up(
    first: list[tuple[float, Vector, Vector]], second: list[tuple[float, Vector, Vector]]
) -> None:
    def about_origin(system: list[tuple[float, Vector, Vector]]) -> Any:
        return np.array(particles.inertia_matrix([m for m, _, _ in system], [x for _, x, _ in system], (0.0, 0.0, 0.0)))

    both = about_origin(first + second)

    np.testing.assert_allclose(both, about_origin(first) + about_origin(second), atol=16 * EPS * np.abs(both).max())


@given(systems, vectors)
def test_turned_particles_have_the_turned_inertia(system: list[tuple[float, Vector, Vector]], turn: Vector) -> None:
    """Eq. 11: A I A^T."""
    ms, xs, _ = (list(column) for column in zip(*system, strict=True))
    q = rotation.exp(turn)
    a = np.array(rotation.matrix(q))

    turned = np.array(particles.inertia_matrix(ms, [rotation.rotate(q, x) for x in xs]))

    inertia = np.array(particles.inertia_matrix(ms, xs))
    np.testing.assert_allclose(turned, a @ inertia @ a.T, atol=1e-12 * (1.0 + np.trace(inertia)))


@given(st.lists(st.tuples(masses, vectors), min_size=3, max_size=10))
def test_every_body_of_particles_is_sound(system: list[tuple[float, Vector]]) -> None:
    ms, xs = (list(column) for column in zip(*system, strict=True))
    inertia = np.array(particles.inertia_matrix(ms, xs))
    if np.linalg.eigvalsh(inertia).min() <= 1e-12 * np.trace(inertia):  # nearly on a line
        return

    body = particles.body_of_particles(ms, xs)

    assert body.mass == math.fsum(ms)
    assert all(moment > 0.0 for moment in body.principal_moments)


def dumbbell(count: int, along: Vector, offset: Vector) -> tuple[list[float], list[Vector]]:
    return [1.0 + k for k in range(count)], [add(offset, scale(0.3 * k, along)) for k in range(count)]


@pytest.mark.parametrize("count", [2, 3, 7])
@pytest.mark.parametrize("along", [(1.0, 0.0, 0.0), (0.1, 0.2, 0.3), (-1.0, 1.0, 1e-3), (1e-9, 0.0, 2e-9)])
@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (0.7, -0.1, 0.3), (1e3, 1e-3, -5.0)])
def test_particles_on_a_line_make_no_rigid_body(count: int, along: Vector, offset: Vector) -> None:
    """Their coordinates are rounded, so that in the computer they are never quite on it."""
    with pytest.raises(BodyError, match=r"on one line along .* the spin about it is not defined") as caught:
        particles.body_of_particles(*dumbbell(count, along, offset))

    assert "type: rod" in str(caught.value)


def test_a_needle_is_a_body_down_to_a_thickness_of_round_off() -> None:
    thin = 1e-6
    xs = [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, thin, 0.0), (0.0, -thin, thin), (0.0, 0.0, -thin)]

    body = particles.body_of_particles([1.0] * 5, xs)

    assert min(body.principal_moments) == pytest.approx(4.0 * thin**2, rel=1e-12)


@pytest.mark.parametrize("positions", [[(1.0, 2.0, 3.0)], [(0.1, 0.2, 0.3)] * 3])
def test_particles_at_one_point_make_no_rigid_body(positions: list[Vector]) -> None:
    with pytest.raises(BodyError, match="at one point"):
        particles.body_of_particles([1.0] * len(positions), positions)


@pytest.mark.parametrize(
    ("ms", "xs", "says"),
    [
        ([], [], "found no particles"),
        ([1.0, 0.0, 1.0], [(0.0, 0.0, 0.0)] * 3, r"masses\[1\] is 0.0"),
        ([1.0, math.nan, 1.0], [(0.0, 0.0, 0.0)] * 3, r"masses\[1\] is nan"),
        ([1.0] * 3, [(0.0, 0.0, 0.0), (0.0, 1.0, math.inf), (1.0, 0.0, 0.0)], r"positions\[1\]"),
        ([1.0] * 3, [(1e200, 0.0, 0.0), (0.0, 1e200, 0.0), (0.0, 0.0, 1e200)], "beyond 1e308"),
        ([1e308] * 3, [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)], "beyond 1e308"),
        ([1.0] * 3, [(1.7e308, 0.0, 0.0), (-1.7e308, 1e308, 0.0), (0.0, 0.0, 1e308)], "beyond 1e308"),
    ],
)
def test_what_is_refused(ms: list[float], xs: list[Vector], says: str) -> None:
    with pytest.raises(BodyError, match=says):
        particles.body_of_particles(ms, xs)


@pytest.mark.parametrize("size", [1e-20, 1e20])
def test_any_size_will_do(size: float) -> None:
    xs = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    body = particles.body_of_particles([size] * 3, [scale(size, x) for x in xs])

    reference: Matrix = particles.inertia_matrix([1.0] * 3, xs)
    np.testing.assert_allclose(np.array(body.inertia) / size**3, reference, rtol=1e-14)
    assert norm(body.center_of_mass) == pytest.approx(size / math.sqrt(3.0), rel=1e-15)
