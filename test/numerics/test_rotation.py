"""SO(3) against 50-digit arithmetic in each region where a formula may lose digits: 0, small, generic, half turns."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpmath import matrix as mp_matrix
from mpmath import mp, mpf

from rb_dynamics.numerics import rotation
from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.vector import Vector, cross, norm, scale, subtract

EPS = 2.0**-52
DIGITS = 50

X: Vector = (1.0, 0.0, 0.0)
Y: Vector = (0.0, 1.0, 0.0)
Z: Vector = (0.0, 0.0, 1.0)


@st.composite
def directions(draw: st.DrawFn) -> Vector:
    """Axes, face diagonals and everything between."""
    part = st.one_of(st.sampled_from([0.0, 1.0, -1.0, 1e-9]), st.floats(-1.0, 1.0).filter(lambda x: abs(x) > 1e-12))
    v = (draw(part), draw(part), draw(part))
    length = norm(v)
    return scale(1.0 / length, v) if length > 0.0 else X


def log_uniform(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(math.log(low), math.log(high)).map(math.exp)


def angles(largest: float) -> st.SearchStrategy[float]:
    """Angles below `largest`, with the regions where a formula may fail as likely as the rest."""
    regions = [
        st.just(0.0),
        log_uniform(1e-12, 1e-3),
        log_uniform(1e-3, 0.49),
        st.floats(0.49, 1.01),  # around the switches from series to closed form
        st.floats(1.01, min(3.1, largest)),
        st.sampled_from([math.pi - 1e-9, math.pi - 1e-5, 0.5 * math.pi]),
    ]
    if largest > 3.2:
        regions.append(st.floats(3.1, largest))
    return st.one_of(regions)


def rotation_vectors(largest: float) -> st.SearchStrategy[Vector]:
    return st.tuples(angles(largest), directions()).map(lambda pair: scale(pair[0], pair[1]))


half_open = rotation_vectors(3.1)
turns = rotation_vectors(6.0)
quaternions = half_open.map(rotation.exp) | turns.map(rotation.exp)
vectors = st.tuples(*[st.floats(-10.0, 10.0).map(lambda x: x if abs(x) > 1e-9 else 0.0)] * 3)


def exact_hat(v: Vector) -> mp_matrix:
    x, y, z = (mpf(c) for c in v)
    return mp_matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def exact_exp(v: Vector) -> mp_matrix:
    """Return exp(hat(v)) by its power series: no trigonometric function, no closed form."""
    a, term, total = exact_hat(v), mp.eye(3), mp.eye(3)
    for k in range(1, 90):
        term = term * a / k
        total += term
    return total


def exact_dexp(v: Vector) -> mp_matrix:
    """Return dexp_v = sum hat(v)^k / (k + 1)!, its definition (IMNZ eq. 2.44)."""
    a, term, total = exact_hat(v), mp.eye(3), mp.eye(3)
    for k in range(1, 90):
        term = term * a / (k + 1)
        total += term
    return total


def apart(found: Vector, exact: mp_matrix) -> float:
    return float(mp.sqrt(mp.fsum((mpf(f) - exact[i]) ** 2 for i, f in enumerate(found))))


def column(v: Vector) -> mp_matrix:
    return mp_matrix([mpf(c) for c in v])


def same_rotation(p: Quaternion, q: Quaternion, tolerance: float) -> bool:
    return min(math.dist(p, q), math.dist(p, tuple(-c for c in q))) <= tolerance


class TestGroup:
    @given(quaternions)
    def test_identity_is_exact(self, q: Quaternion) -> None:
        assert rotation.multiply(q, rotation.IDENTITY) == q == rotation.multiply(rotation.IDENTITY, q)

    @given(quaternions, quaternions, quaternions)
    def test_product_is_associative(self, p: Quaternion, q: Quaternion, r: Quaternion) -> None:
        left = rotation.multiply(rotation.multiply(p, q), r)
        right = rotation.multiply(p, rotation.multiply(q, r))

        assert math.dist(left, right) <= 6.0 * EPS

    @given(quaternions)
    def test_inverse(self, q: Quaternion) -> None:
        product = rotation.multiply(rotation.conjugate(q), q)

        # The vector part cancels term by term, so it is as small as the rounding of its products.
        assert math.dist(product, rotation.IDENTITY) <= 3.0 * EPS

    @given(quaternions, quaternions)
    def test_product_is_a_rotation(self, p: Quaternion, q: Quaternion) -> None:
        assert abs(math.hypot(*rotation.multiply(p, q)) - 1.0) <= 4.0 * EPS
        assert abs(math.hypot(*rotation.normalize(rotation.multiply(p, q))) - 1.0) <= 1.0 * EPS

    @given(quaternions, quaternions, vectors)
    def test_product_turns_first_by_its_right_factor(self, p: Quaternion, q: Quaternion, v: Vector) -> None:
        once = rotation.rotate(rotation.multiply(p, q), v)
        twice = rotation.rotate(p, rotation.rotate(q, v))

        assert math.dist(once, twice) <= 20.0 * EPS * norm(v)

    def test_products_do_not_commute(self) -> None:
        quarter_x, quarter_z = rotation.exp(scale(0.5 * math.pi, X)), rotation.exp(scale(0.5 * math.pi, Z))

        turned = rotation.rotate(rotation.multiply(quarter_z, quarter_x), Y)

        assert math.dist(turned, Z) <= 4.0 * EPS  # y goes to z about x and stays there; the other order gives -x


class TestAction:
    @given(turns, vectors)
    @settings(max_examples=50)
    def test_rotate_is_the_matrix_exponential(self, v: Vector, u: Vector) -> None:
        with mp.workdps(DIGITS):
            exact = exact_exp(v) * column(u)

            assert apart(rotation.rotate(rotation.exp(v), u), exact) <= 8.0 * EPS * (1.0 + norm(v)) * norm(u)

    @given(quaternions, vectors)
    def test_rotate_inverse_undoes_it(self, q: Quaternion, v: Vector) -> None:
        assert math.dist(rotation.rotate_inverse(q, rotation.rotate(q, v)), v) <= 16.0 * EPS * norm(v)

    @given(vectors)
    def test_identity_leaves_every_bit(self, v: Vector) -> None:
        assert rotation.rotate(rotation.IDENTITY, v) == v == rotation.rotate_inverse(rotation.IDENTITY, v)

    @given(angles(3.1), st.sampled_from([X, Y, Z]), st.floats(-1e3, 1e3))
    def test_its_axis_is_kept_to_the_bit(self, angle: float, axis: Vector, length: float) -> None:
        v = scale(length, axis)

        assert rotation.rotate(rotation.exp(scale(angle, axis)), v) == v

    @given(quaternions)
    def test_matrix_is_a_rotation_whose_columns_are_the_turned_axes(self, q: Quaternion) -> None:
        rows = rotation.matrix(q)
        columns = list(zip(*rows, strict=True))

        for i, axis in enumerate((X, Y, Z)):
            assert math.dist(columns[i], rotation.rotate(q, axis)) <= 4.0 * EPS
            assert math.dist(columns[i], cross(columns[(i + 1) % 3], columns[(i + 2) % 3])) <= 16.0 * EPS

    @given(quaternions)
    def test_from_matrix_inverts_matrix(self, q: Quaternion) -> None:
        found = rotation.from_matrix(rotation.matrix(q))

        assert same_rotation(found, q, 4.0 * EPS)

    @pytest.mark.parametrize("axis", [X, Y, Z, (0.6, 0.8, 0.0), (0.0, -0.6, 0.8), (0.48, 0.6, 0.64)])
    @pytest.mark.parametrize("short", [0.0, 1e-15, 1e-12, 1e-9, 1e-6])
    def test_from_matrix_at_half_turns(self, axis: Vector, short: float) -> None:
        q = (*scale(math.cos(0.5 * short), axis), math.sin(0.5 * short))

        assert same_rotation(rotation.from_matrix(rotation.matrix(q)), q, 4.0 * EPS)


class TestExpAndLog:
    @given(turns)
    def test_exp_to_the_last_digits(self, v: Vector) -> None:
        q = rotation.exp(v)
        with mp.workdps(DIGITS):
            angle = mp.sqrt(mp.fsum(mpf(c) ** 2 for c in v))
            factor = mp.sin(angle / 2) / angle if angle else mpf(1) / 2

            # The angle has a rounding error of its own; what it makes grows with the angle.
            assert abs(mpf(q[3]) - mp.cos(angle / 2)) <= EPS * (1.0 + norm(v))
            assert apart(q[:3], column(v) * factor) <= EPS * min(3.0 * norm(v), 2.0 + norm(v))

    @given(st.one_of(half_open, st.sampled_from([X, Y, Z]).map(lambda axis: scale(math.pi - 1e-9, axis))))
    def test_log_inverts_exp(self, v: Vector) -> None:
        assert math.dist(rotation.log(rotation.exp(v)), v) <= 4.0 * EPS * norm(v)

    @given(quaternions)
    def test_exp_inverts_log(self, q: Quaternion) -> None:
        v = rotation.log(q)

        assert norm(v) <= math.pi * (1.0 + EPS)
        assert same_rotation(rotation.exp(v), q, 4.0 * EPS)

    @pytest.mark.parametrize("tiny", [5e-324, 1e-310, 1e-200, 1e-160, 1e-100])
    def test_tiny_turns_keep_their_digits(self, tiny: float) -> None:
        v = (tiny, -2.0 * tiny, 0.0)

        # Half of the smallest number is zero or itself, so that a subnormal turn is kept to its last bit only.
        assert math.dist(rotation.log(rotation.exp(v)), v) <= 4.0 * EPS * tiny + 4.0 * math.ulp(0.0)

    @pytest.mark.parametrize("w", [0.0, -0.0])
    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_log_of_a_half_turn(self, w: float, sign: float) -> None:
        v = rotation.log((0.0, sign, 0.0, w))

        assert v == (0.0, sign * math.pi, 0.0)

    def test_log_of_both_identities_is_zero(self) -> None:
        assert rotation.log((0.0, 0.0, 0.0, 1.0)) == (0.0, 0.0, 0.0) == rotation.log((0.0, 0.0, 0.0, -1.0))

    @given(quaternions)
    def test_log_does_not_see_the_sign_of_the_quaternion(self, q: Quaternion) -> None:
        x, y, z, w = q
        if w != 0.0:
            assert rotation.log((-x, -y, -z, -w)) == rotation.log(q)


class TestAngleBetween:
    @given(quaternions, rotation_vectors(3.1))
    def test_is_the_length_of_the_rotation_between(self, p: Quaternion, v: Vector) -> None:
        q = rotation.multiply(p, rotation.exp(v))

        assert abs(rotation.angle_between(p, q) - norm(v)) <= 8.0 * EPS
        assert abs(rotation.angle_between(q, p) - norm(v)) <= 8.0 * EPS
        assert abs(rotation.angle_between(p, tuple(-c for c in q)) - norm(v)) <= 8.0 * EPS

    @given(quaternions)
    def test_is_zero_for_the_same_attitude(self, q: Quaternion) -> None:
        assert rotation.angle_between(q, q) <= 2.0 * EPS


class TestDexpinv:
    @given(turns, vectors)
    @settings(max_examples=60)
    def test_dexpinv_is_the_inverse_of_the_power_series(self, v: Vector, u: Vector) -> None:
        with mp.workdps(DIGITS):
            exact = exact_dexp(v) ** -1 * column(u)
            # The inverse has a pole at a full turn.
            condition = 1.0 + norm(v) ** 2 / (2.0 * math.pi - norm(v))

            assert apart(rotation.dexpinv(v, u), exact) <= 4.0 * EPS * condition**2 * norm(u)

    @given(half_open, vectors)
    @settings(max_examples=25)
    def test_dexpinv_takes_the_derivative_of_exp_on_the_left_back(self, v: Vector, u: Vector) -> None:
        """d/dt exp(v + t u) exp(v)^-1 at t = 0, by a difference quotient at 50 digits: the side matters."""
        with mp.workdps(DIGITS):
            step = mpf(10) ** -15
            ahead, back = (
                exact_exp([mpf(a) + sign * step * mpf(b) for a, b in zip(v, u, strict=True)]) for sign in (1, -1)
            )
            quotient = (ahead - back) / (2 * step) * exact_exp(v).T
            turned = tuple(float(quotient[i]) for i in ((2, 1), (0, 2), (1, 0)))

            assert math.dist(rotation.dexpinv(v, turned), u) <= 16.0 * EPS * (1.0 + norm(v)) * norm(u) + 1e-27

    def test_nothing_is_lost_without_a_turn(self) -> None:
        u = (0.1, -0.7, 3.3)

        assert rotation.dexpinv((0.0, 0.0, 0.0), u) == u


class TestSwitch:
    """Of dexpinv, between a series and what cancels near the switch: 1 - (a/2) cot(a/2) = 1/48."""

    AT = 0.25

    def relative(self, square: float) -> float:
        with mp.workdps(2 * DIGITS):
            half = mp.sqrt(mpf(square)) / 2
            value = (1 - half * mp.cot(half)) / mpf(square)
            return float(abs(mpf(rotation._cotangent(square)) / value - 1))

    def test_series_is_exact_up_to_the_switch(self) -> None:
        below = math.nextafter(self.AT, 0.0)
        squares = [below, *(below * k / 200.0 for k in range(1, 200)), 1e-10, 1e-20]

        assert max(map(self.relative, squares)) <= 2.0 * EPS

    def test_closed_form_is_exact_from_the_switch_on(self) -> None:
        assert max(self.relative(self.AT * (1.0 + k / 50.0)) for k in range(200)) <= 50.0 * EPS

    def test_no_jump_at_the_switch(self) -> None:
        jump = rotation._cotangent(self.AT) - rotation._cotangent(math.nextafter(self.AT, 0.0))

        # What counts is the jump of the map: the coefficient times a^2.
        assert abs(jump) * self.AT <= 1.0 * EPS

    def test_value_at_zero(self) -> None:
        assert rotation._cotangent(0.0) == 1.0 / 12.0


class TestCayley:
    @given(rotation_vectors(6.0) | directions().map(lambda v: scale(1e6, v)))
    def test_is_the_rational_map(self, v: Vector) -> None:
        with mp.workdps(DIGITS):
            half = exact_hat(v) / 2
            exact = (mp.eye(3) - half) ** -1 * (mp.eye(3) + half)
            rows = rotation.matrix(rotation.cayley(v))

            assert max(float(abs(mpf(rows[i][j]) - exact[i, j])) for i in range(3) for j in range(3)) <= 8.0 * EPS

    @given(rotation_vectors(6.0))
    def test_is_a_rotation_about_v(self, v: Vector) -> None:
        q = rotation.cayley(v)

        assert abs(math.hypot(*q) - 1.0) <= 1.0 * EPS
        assert abs(norm(rotation.log(q)) - 2.0 * math.atan(0.5 * norm(v))) <= 4.0 * EPS
        assert norm(subtract(rotation.rotate(q, v), v)) <= 8.0 * EPS * norm(v)


class TestHat:
    @given(vectors, vectors)
    def test_hat_is_the_cross_product(self, v: Vector, u: Vector) -> None:
        rows = rotation.hat(v)
        product = tuple(math.fsum(row[i] * u[i] for i in range(3)) for row in rows)

        assert math.dist(product, cross(v, u)) <= 2.0 * EPS * norm(v) * norm(u)
        assert all(rows[i][j] == -rows[j][i] for i in range(3) for j in range(3))
