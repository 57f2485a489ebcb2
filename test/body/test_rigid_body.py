"""`RigidBody`: which values are accepted, and the messages for those that are not."""

from __future__ import annotations

import dataclasses
import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.errors import BodyError
from rb_dynamics.motion.phase_state import PhaseState
from rb_dynamics.numerics import rotation
from rb_dynamics.numerics.rotation import IDENTITY

EPS = 2.0**-52

INERTIA = [[2.1, 0.13, -0.27], [0.13, 1.7, 0.31], [-0.27, 0.31, 2.9]]


class TestFromMatrix:
    def test_keeps_what_was_given(self) -> None:
        body = RigidBody.from_matrix(3, INERTIA, [0.1, -0.2, 0.3])

        assert body.mass == 3.0
        assert isinstance(body.mass, float)
        assert body.inertia == tuple(map(tuple, INERTIA))
        assert body.center_of_mass == (0.1, -0.2, 0.3)

    def test_principal_axes_make_the_matrix_again(self) -> None:
        body = RigidBody.from_matrix(1.0, INERTIA)

        again = RigidBody.from_principal(1.0, body.principal_moments, body.principal_orientation_xyzw)

        for row, expected in zip(again.inertia, INERTIA, strict=True):
            assert row == pytest.approx(expected, abs=6.0 * EPS * 2.9)

    def test_integers_will_do(self) -> None:
        body = RigidBody.from_matrix(2, [[1, 0, 0], [0, 2, 0], [0, 0, 3]])

        assert body == RigidBody.from_diagonal(2.0, (1.0, 2.0, 3.0))
        assert body.principal_orientation_xyzw == IDENTITY

    def test_asymmetry_in_the_last_typed_digit_is_averaged(self) -> None:
        body = RigidBody.from_matrix(1.0, [[2.0, 0.1, 0.0], [0.1 + 1e-10, 2.0, 0.0], [0.0, 0.0, 2.0]])

        assert body.inertia[0][1] == body.inertia[1][0] == 0.5 * (0.1 + (0.1 + 1e-10))

    @pytest.mark.parametrize(
        ("inertia", "says"),
        [
            ([[1, 0, 0], [0, 1, 0]], "has 2 rows, expected a matrix: write 3 rows of 3"),
            (
                [[1, 0, 0], [0, 1], [0, 0, 1]],
                "inertia[1] is [0, 1], expected a row of the inertia matrix (kg m^2): write three numbers",
            ),
            ([[1, 0, 0], [0, math.nan, 0], [0, 0, 1]], ": three finite numbers"),
            ([[1, 0, 0], [0, math.inf, 0], [0, 0, 1]], ": three finite numbers"),
            ([[1, 0.1, 0], [0.2, 1, 0], [0, 0, 1]], "I[0][1] = 0.1 but I[1][0] = 0.2"),
            ([[1, 0, 0], [0, 1, 1e-8], [0, 0, 1]], "not symmetric"),
            ([[1, 0, 0], [0, 1, 0], [0, 0, 0]], "positive definite"),
            ([[1, 0, 0], [0, -1, 0], [0, 0, 1]], "positive definite"),
            ([[1, 2, 0], [2, 1, 0], [0, 0, 1]], "[-1.0, 3.0, 1.0]"),
            ([[1, 0, 0], [0, 1, 0], [0, 0, 2.1]], "1 + 1 < 2.1"),
        ],
    )
    def test_refuses_what_is_no_inertia_matrix(self, inertia: Any, says: str) -> None:
        with pytest.raises(BodyError) as error:
            RigidBody.from_matrix(1.0, inertia)

        assert says in str(error.value)


class TestMass:
    @pytest.mark.parametrize("mass", [0.0, -1.0, -0.0, math.nan, math.inf, -math.inf])
    @pytest.mark.parametrize("way", ["matrix", "diagonal", "principal"])
    def test_refuses_what_is_no_mass(self, mass: float, way: str) -> None:
        made = {
            "matrix": lambda: RigidBody.from_matrix(mass, INERTIA),
            "diagonal": lambda: RigidBody.from_diagonal(mass, (1, 1, 1)),
            "principal": lambda: RigidBody.from_principal(mass, (1, 1, 1), IDENTITY),
        }
        with pytest.raises(BodyError, match="expected a finite number greater than 0") as error:
            made[way]()

        assert repr(mass) in str(error.value)

    @pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
    def test_refuses_a_centre_of_mass_that_is_not_finite(self, bad: float) -> None:
        with pytest.raises(BodyError, match="center_of_mass"):
            RigidBody.from_matrix(1.0, INERTIA, (0.0, bad, 0.0))

    @pytest.mark.parametrize("scale", [1e-20, 1e20])
    def test_any_size_will_do(self, scale: float) -> None:
        body = RigidBody.from_matrix(scale, [[scale * v for v in row] for row in INERTIA])

        assert body.principal_moments == pytest.approx(
            [scale * m for m in RigidBody.from_matrix(1.0, INERTIA).principal_moments], rel=8.0 * EPS
        )


class TestMoments:
    @pytest.mark.parametrize("moments", [(1.0, 2.0, 3.0), (3.0, 1.0, 2.0), (0.1, 0.2, 0.1 + 0.2), (1.0, 1.0, 2.0)])
    def test_a_plate_is_a_body(self, moments: tuple[float, float, float]) -> None:
        assert RigidBody.from_diagonal(1.0, moments).principal_moments == moments

    def test_a_plate_in_any_axes_is_a_body(self) -> None:
        """Rounding may leave I1 + I2 a little below I3."""
        for k in range(200):
            axes = rotation.exp((0.1 * k, 0.7, -0.03 * k))
            plate = RigidBody.from_principal(1.0, (1.0, 2.0, 3.0), axes)
            again = RigidBody.from_matrix(1.0, plate.inertia)
            assert sorted(again.principal_moments) == pytest.approx([1.0, 2.0, 3.0], rel=16.0 * EPS)

    @pytest.mark.parametrize("ratio", [1e-3, 1e-6, 1e-12, 1e-20])
    def test_a_needle_is_a_body(self, ratio: float) -> None:
        assert RigidBody.from_diagonal(1.0, (ratio, 1.0, 1.0)).principal_moments == (ratio, 1.0, 1.0)

    @pytest.mark.parametrize("excess", [2e-9, 1e-3])
    @pytest.mark.parametrize("place", [0, 1, 2])
    def test_no_moment_exceeds_the_sum_of_the_others(self, excess: float, place: int) -> None:
        moments = [1.0, 2.0]
        moments.insert(place, 3.0 * (1.0 + excess))

        with pytest.raises(BodyError, match="each moment is at most the sum of the other two"):
            RigidBody.from_diagonal(1.0, moments)

    @pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
    def test_moments_are_positive(self, bad: float) -> None:
        with pytest.raises(BodyError, match=r"(three finite numbers|greater than 0)"):
            RigidBody.from_diagonal(1.0, (1.0, 1.0, bad))

    def test_negated_products_are_suspected(self) -> None:
        """A needle along (1, 1, 1) has moments 2.9, 2.9, 0.2; with its products negated 1.1, 1.1, 3.8."""
        needle = [[2.0, -0.9, -0.9], [-0.9, 2.0, -0.9], [-0.9, -0.9, 2.0]]
        assert RigidBody.from_matrix(1.0, needle)

        with pytest.raises(BodyError, match="products of wrong sign suspected") as error:
            RigidBody.from_matrix(1.0, [[abs(v) for v in row] for row in needle])

        assert "1.1 + 1.1 < 3.8" in str(error.value)

    def test_no_suspicion_where_negated_products_are_no_body_either(self) -> None:
        with pytest.raises(BodyError) as error:
            RigidBody.from_matrix(1.0, [[1, 2, 0], [2, 1, 0], [0, 0, 1]])

        assert "products of wrong sign" not in str(error.value)


class TestFromPrincipal:
    parts = st.floats(-1.0, 1.0)

    @given(st.tuples(parts, parts, parts, parts).filter(lambda q: math.hypot(*q) > 0.01))
    def test_is_from_matrix_of_its_matrix(self, q: tuple[float, float, float, float]) -> None:
        """Both have the same inertia matrix to round-off, though their frames may name the axes differently."""
        body = RigidBody.from_principal(2.0, (1.0, 1.5, 2.0), rotation.normalize(q))
        other = RigidBody.from_matrix(2.0, body.inertia)

        again = RigidBody.from_principal(2.0, other.principal_moments, other.principal_orientation_xyzw)
        assert sorted(other.principal_moments) == pytest.approx([1.0, 1.5, 2.0], rel=16.0 * EPS)
        for a, b in zip(again.inertia, body.inertia, strict=True):
            assert a == pytest.approx(b, abs=16.0 * EPS)

    def test_matrix_turns_the_moments_into_body_axes(self) -> None:
        """Principal axis 1 turned by a quarter about z lies along y: so Iyy is the first moment."""
        quarter = (0.0, 0.0, math.sin(math.pi / 4.0), math.cos(math.pi / 4.0))

        inertia = RigidBody.from_principal(1.0, (1.0, 2.0, 2.5), quarter).inertia

        assert [inertia[i][i] for i in range(3)] == pytest.approx([2.0, 1.0, 2.5], rel=4.0 * EPS)

    def test_matrix_is_symmetric_to_the_bit(self) -> None:
        inertia = RigidBody.from_principal(1.0, (1.0, 2.0, 2.5), (0.5, -0.1, 0.7, 0.5)).inertia

        assert all(inertia[i][j] == inertia[j][i] for i in range(3) for j in range(3))

    @pytest.mark.parametrize(
        "q", [(0.0, 0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.01), (0, 0, math.nan, 1)]
    )
    def test_refuses_what_is_no_unit_quaternion(self, q: tuple[float, float, float, float]) -> None:
        with pytest.raises(BodyError, match="expected a unit quaternion"):
            RigidBody.from_principal(1.0, (1.0, 1.0, 1.0), q)

    @pytest.mark.parametrize("q", [(0.0, 0.0, 0.0, 1.0005), (0.0, 0.0, 0.0, -0.9995), (0.5003, 0.5, -0.5, 0.5)])
    def test_a_quaternion_of_few_digits_is_normalised(self, q: tuple[float, float, float, float]) -> None:
        """Otherwise the attitude would not be a rotation."""
        body = RigidBody.from_principal(1.0, (1.0, 1.5, 2.0), q)

        assert math.hypot(*body.principal_orientation_xyzw) == pytest.approx(1.0, abs=EPS)
        state = State(orientation_xyzw=(0.5, -0.1, 0.7, 0.5), angular_velocity_body=(1.0, 2.0, 3.0))
        assert math.hypot(*PhaseState.of(body, state).orientation) == pytest.approx(1.0, abs=4.0 * EPS)

    def test_from_diagonal_leaves_every_bit(self) -> None:
        body = RigidBody.from_diagonal(1.0, (0.1, 0.2, 0.25))

        assert body.inertia == ((0.1, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, 0.25))
        assert body.principal_orientation_xyzw == IDENTITY


class TestPointMasses:
    def test_moments_of_real_particles_are_always_a_body(self) -> None:
        """Exact sums over any point masses: I1 + I2 - I3 = 2 sum m z^2 >= 0."""
        masses = [Fraction(n) for n in (1, 2, 3, 5)]
        places = [(1, 0, 2), (0, -1, 1), (2, 2, 0), (-1, 1, -3)]
        total = sum(masses)
        center = [sum(m * p[i] for m, p in zip(masses, places, strict=True)) / total for i in range(3)]
        inertia = [[Fraction(0)] * 3 for _ in range(3)]
        for m, place in zip(masses, places, strict=True):
            r = [Fraction(place[i]) - center[i] for i in range(3)]
            square = sum(c * c for c in r)
            for i in range(3):
                for j in range(3):
                    inertia[i][j] += m * ((square if i == j else 0) - r[i] * r[j])

        body = RigidBody.from_matrix(float(total), [[float(v) for v in row] for row in inertia])

        trace = float(sum(inertia[i][i] for i in range(3)))
        assert math.fsum(body.principal_moments) == pytest.approx(trace, rel=8.0 * EPS)


@pytest.mark.parametrize("given", [(2.0, INERTIA), (2.0, (1.0, 2.0, 3.0)), (2.0, INERTIA, (0.0, 0.0, 0.1))])
def test_the_bare_class_names_what_makes_a_body(given: tuple[Any, ...]) -> None:
    with pytest.raises(TypeError, match=r"from_matrix\(mass, inertia, center_of_mass\).*from_diagonal.*particle"):
        RigidBody(*given)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"mass": -1.0}, "mass is -1.0, expected a finite number greater than 0"),
        ({"inertia": ((9.0, 0.0, 0.0), (0.0, 9.0, 0.0), (0.0, 0.0, 9.0))}, "RigidBody.from_matrix"),
        ({"principal_moments": (9.0, 9.0, 9.0)}, "RigidBody.from_matrix"),
        ({"principal_moments": (0.0, 0.0, 0.0)}, "RigidBody.from_matrix"),
        ({"principal_orientation_xyzw": (0.0, 0.6, 0.0, 0.8)}, "RigidBody.from_matrix"),
        ({"principal_moments": (1.0, 1.0, 9.0)}, "no body has them"),
        ({"center_of_mass": (math.nan, 0.0, 0.0)}, "center_of_mass"),
    ],
)
def test_a_copy_with_parts_of_another_body_is_refused(changes: dict[str, Any], named: str) -> None:
    """The motion uses the principal moments, so a different inertia beside them would be ignored silently."""
    body = RigidBody.from_matrix(2.0, [[1.0, 0.1, 0.0], [0.1, 1.5, 0.0], [0.0, 0.0, 2.0]])

    with pytest.raises(BodyError) as error:
        dataclasses.replace(body, **changes)

    assert named in str(error.value)
    heavier = dataclasses.replace(body, mass=3, center_of_mass=np.ones(3))
    assert heavier == RigidBody.from_matrix(3.0, body.inertia, (1.0, 1.0, 1.0))
    assert hash(heavier) != hash(body)
