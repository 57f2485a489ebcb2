"""Suspicious mass properties are found with their cause; sound bodies raise no warning."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from rb_dynamics.body import inertia_mistakes, plausibility
from rb_dynamics.body.mesh import Solid
from rb_dynamics.body.plausibility import Symmetry, compare, examine, slip_behind, symmetry
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.shapes import box
from rb_dynamics.errors import BodyError
from rb_dynamics.numerics import rotation
from rb_dynamics.numerics.vector import scale

EPS = 2.0**-52
TURN = rotation.exp((0.5, 0.0, 0.0))
SIZE = (0.5, 1.0, 2.0)
MASS = 40.0

lengths = st.floats(0.2, 2.0)
turns = st.tuples(*(st.floats(-3.0, 3.0),) * 3)


def matrix(rows: Any) -> Any:
    return tuple(tuple(float(v) for v in row) for row in rows)


def names(body: RigidBody) -> list[str]:
    return [finding.name for finding in examine(body)]


def slanted(center_of_mass: Any = (0.0, 0.0, 0.0)) -> RigidBody:
    return box(SIZE).body(MASS, center_of_mass, TURN)


def steiner(body: RigidBody) -> Any:
    c = np.array(body.center_of_mass)
    return body.mass * (c @ c * np.eye(3) - np.outer(c, c))


class TestSymmetry:
    @pytest.mark.parametrize(
        ("moments", "expected"),
        [
            ((1.0, 1.0, 1.0), Symmetry.SPHERE),
            ((1.0, 1.0 + EPS, 1.0), Symmetry.SPHERE),
            ((1.0, 2.0, 1.0), Symmetry.OBLATE),
            ((2.0, 1.0, 2.0), Symmetry.PROLATE),
            ((1.0, 1.0, 1e-12), Symmetry.PROLATE),
            ((1.0, 2.0, 2.5), Symmetry.TRIAXIAL),
            ((1.0, 1.0 + 1e-8, 1.5), Symmetry.TRIAXIAL),
            ((1.0, 1.0 + 1e-10, 1.5), Symmetry.OBLATE),
            ((1.0, 1.5, 1.5 - 1e-10), Symmetry.PROLATE),
        ],
    )
    def test_of_moments(self, moments: Any, expected: Symmetry) -> None:
        assert symmetry(RigidBody.from_diagonal(1.0, moments)) is expected
        assert symmetry(RigidBody.from_diagonal(1.0, scale(1e-20, moments))) is expected


class TestSoundBodies:
    @given(st.tuples(lengths, lengths, lengths), turns, st.tuples(*(st.floats(-0.5, 0.5),) * 3))
    def test_nothing_is_found_in_a_box_with_its_origin_near_its_centre(self, size: Any, turn: Any, at: Any) -> None:
        """Near: within an eighth of each edge, less than half of the standard deviation edge / sqrt(12) along it."""
        q = rotation.exp(turn)
        along = tuple(0.25 * a * b for a, b in zip(size, at, strict=True))
        body = box(size).body(10.0, rotation.rotate(q, along), q)

        assert examine(body) == ()

    def test_nothing_is_found_in_the_recorded_body(self) -> None:
        inertia = ((0.2975, 0.0021, -0.0008), (0.0021, 0.2930, 0.0013), (-0.0008, 0.0013, 0.3104))

        assert examine(RigidBody.from_matrix(16.8, inertia)) == ()

    @pytest.mark.parametrize("size", [1e-20, 1e20])
    def test_units_do_not_matter(self, size: float) -> None:
        body = box(SIZE).body(size, (0.05, 0.05, 0.05))

        assert names(body) == ["size"]  # no box of that size weighs that


class TestTriangle:
    def test_a_plate_is_remarked(self) -> None:
        (finding,) = examine(RigidBody.from_diagonal(1.0, (1.0, 2.0, 3.0)))

        assert finding.name == "triangle"
        assert "1 + 2 = 3" in finding.seen
        assert "right for a plate" in finding.remedy

    def test_limit_is_a_thickness_of_a_thousandth(self) -> None:
        assert names(box((1.0, 1.0, 2e-3)).body(1.0)) == []
        assert names(box((1.0, 1.0, 5e-4)).body(1.0)) == ["triangle"]


class TestOrder:
    """Six numbers in one order, read in another order."""

    TRUE = ((2.0, 0.02, -0.03), (0.02, 1.8, 0.01), (-0.03, 0.01, 2.4))

    @pytest.mark.parametrize(
        ("order", "read"),
        [
            ("Ixx Iyy Izz Ixy Ixz Iyz", ((2.0, 1.8, 2.4), (1.8, 0.02, -0.03), (2.4, -0.03, 0.01))),
            ("Ixx Ixy Ixz Iyy Iyz Izz", ((2.0, 1.8, 0.01), (1.8, 0.02, 2.4), (0.01, 2.4, -0.03))),
            ("Ixx Ixy Iyy Ixz Iyz Izz", ((2.0, 0.02, 1.8), (0.02, -0.03, 0.01), (1.8, 0.01, 2.4))),
        ],
    )
    def test_a_slip_that_makes_an_impossible_matrix_is_named(self, order: str, read: Any) -> None:
        assert not inertia_mistakes.is_body(read)
        assert inertia_mistakes.ORDERS[order](read) == self.TRUE
        assert order in slip_behind(read)

    def test_no_order_is_named_where_none_helps(self) -> None:
        assert slip_behind(((1.0, 2.0, 0.0), (2.0, 1.0, 0.0), (0.0, 0.0, 1.0))) == ""
        assert slip_behind(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 3.0))) == ""

    @given(st.tuples(lengths, lengths, lengths), turns)
    def test_products_are_at_most_half_of_a_moment(self, size: Any, turn: Any) -> None:
        """The reason why only impossible matrices are examined: 2 |Ixz| <= Iyy, and cyclically."""
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = box(size).body(1.0, (0.0, 0.0, 0.0), rotation.exp(turn)).inertia

        assert 2.0 * abs(yz) <= xx * (1.0 + 1e-12)
        assert 2.0 * abs(xz) <= yy * (1.0 + 1e-12)
        assert 2.0 * abs(xy) <= zz * (1.0 + 1e-12)


class TestReferencePoint:
    @pytest.mark.parametrize(
        "center",
        [(0.5, 1.0, 2.0), (0.0, 0.0, 2.0), (0.5, 0.0, 0.0), (3.0, 1.0, -2.0)],
        ids=["corner", "end", "face", "outside"],
    )
    def test_an_inertia_about_the_origin_is_found(self, center: Any) -> None:
        """The origin at a corner, the end, a face, or outside a box of 1 x 2 x 4 m."""
        right = box((1.0, 2.0, 4.0)).body(10.0, center)
        wrong = RigidBody.from_matrix(10.0, (np.array(right.inertia) + steiner(right)).tolist(), center)

        assert names(right) == []
        (finding,) = examine(wrong)
        assert finding.name == "about-origin"
        assert "subtract m (|c|^2 1 - c c^T)" in finding.remedy

    @given(st.tuples(lengths, lengths, lengths), turns, st.tuples(*(st.floats(-3.0, 3.0),) * 3))
    def test_leverage_says_whether_the_inertia_could_be_about_the_origin(self, size: Any, turn: Any, c: Any) -> None:
        """m c^T S^-1 c < 1 just where I less the parallel-axis term is the inertia of a body."""
        body = box(size).body(2.0, c, rotation.exp(turn))
        share = inertia_mistakes.leverage(body)
        assume(abs(share - 1.0) > 1e-6)

        moved = np.array(body.inertia) - steiner(body)
        second = np.trace(moved) / 2.0 * np.eye(3) - moved
        assert (share < 1.0) == bool(np.linalg.eigvalsh(second).min() > 0.0)
        np.testing.assert_allclose(inertia_mistakes.about_center(body.inertia, 2.0, c), moved, atol=1e-12)

    @pytest.mark.parametrize(("c", "share"), [((0.0, 0.0, 0.1), float("inf")), ((0.1, 0.0, 0.0), 0.005)])
    def test_a_plate_has_no_leverage_along_its_normal(self, c: Any, share: float) -> None:
        """Moments 1, 2, 3 and 1 kg: second moments 2, 1 and 0."""
        assert inertia_mistakes.leverage(RigidBody.from_diagonal(1.0, (1.0, 2.0, 3.0), c)) == pytest.approx(share)


class TestDensityAndReach:
    @pytest.mark.parametrize("density", [5.0, 700.0, 23_000.0])
    def test_materials_are_believed(self, density: float) -> None:
        assert plausibility.examine_density(2.0 * density, 2.0) is None

    @pytest.mark.parametrize(("density", "says"), [(2.7, "lighter"), (2.7e-6, "lighter"), (2.7e6, "heavier")])
    def test_others_are_not(self, density: float, says: str) -> None:
        finding = plausibility.examine_density(2.0 * density, 2.0)

        assert finding is not None
        assert says in finding.why

    @pytest.mark.parametrize(("factor", "found"), [(1.0, False), (1e6, True), (1e-6, True)])
    def test_gyration_fits_the_geometry(self, factor: float, found: bool) -> None:
        body = RigidBody.from_diagonal(MASS, scale(factor, slanted().principal_moments))

        assert (plausibility.examine_reach(body, 0.5 * np.linalg.norm(SIZE)) is not None) is found


class TestComparison:
    """A body compared with its shape."""

    def solid(self, center: Any = (0.0, 0.0, 0.0)) -> Solid:
        body = slanted()
        return Solid(1.0, center, inertia_mistakes.scaled(body.inertia, 1.0 / MASS), 0.5 * float(np.linalg.norm(SIZE)))

    def found(self, rows: Any, center: Any = (0.0, 0.0, 0.0)) -> Any:
        return compare(RigidBody.from_matrix(MASS, rows, center), self.solid(center))

    def test_the_right_inertia_passes(self) -> None:
        assert self.found(slanted().inertia) == ()

    def test_a_body_that_is_not_quite_uniform_passes(self) -> None:
        assert self.found((np.array(slanted().inertia) * 1.2).tolist()) == ()

    def test_negated_products(self) -> None:
        (finding,) = self.found(inertia_mistakes.negated(slanted().inertia))

        assert finding.name == "negated-products"
        assert "negate them" in finding.remedy

    def test_small_negated_products(self) -> None:
        """The moments alone do not show it."""
        small = box(SIZE).body(MASS, (0.0, 0.0, 0.0), rotation.exp((0.03, 0.02, 0.01)))
        solid = Solid(1.0, (0.0, 0.0, 0.0), inertia_mistakes.scaled(small.inertia, 1.0 / MASS), 1.2)
        wrong = RigidBody.from_matrix(MASS, inertia_mistakes.negated(small.inertia))

        assert [finding.name for finding in compare(wrong, solid)] == ["negated-products"]
        assert compare(small, solid) == ()

    def test_about_the_origin(self) -> None:
        body = slanted((1.0, 0.5, 1.5))

        (finding,) = self.found((np.array(body.inertia) + steiner(body)).tolist(), body.center_of_mass)

        assert finding.name == "about-origin"

    def test_slightly_about_the_origin(self) -> None:
        """A difference that uneven mass could make is an offset's where undoing that leaves nothing."""
        body = slanted((0.1, 0.05, 0.15))
        wrong = (np.array(body.inertia) + steiner(body)).tolist()

        (finding,) = self.found(wrong, body.center_of_mass)

        assert finding.name == "about-origin"
        assert self.found(wrong, (0.1, 0.0, 0.0)) == ()

    @pytest.mark.parametrize(("factor", "unit"), inertia_mistakes.UNITS)
    def test_units(self, factor: float, unit: str) -> None:
        (finding,) = self.found((np.array(slanted().inertia) * factor).tolist())

        assert finding.name == "unit"
        assert unit in finding.why

    def test_axes(self) -> None:
        turned = np.array(slanted().inertia)[np.ix_([1, 2, 0], [1, 2, 0])]

        (finding,) = self.found(turned.tolist())

        assert finding.name == "axes"
        assert "z, x, y" in finding.why

    def test_what_no_slip_explains(self) -> None:
        (finding,) = self.found(np.diag([10.0, 11.0, 12.0]).tolist())

        assert (finding.name, finding.why) == ("mesh", "no common mistake explains it")

    def test_mass_and_place(self) -> None:
        body = RigidBody.from_matrix(1e-3, inertia_mistakes.scaled(slanted().inertia, 1e-3 / MASS), (0.0, 0.0, 5.0))

        assert [finding.name for finding in compare(body, self.solid())] == ["density", "centre-of-mass"]


def test_a_finding_reads_as_a_sentence() -> None:
    assert (
        str(plausibility.Finding("a", "this was seen", "that is odd", "do so")) == "this was seen: that is odd; do so"
    )


@pytest.mark.parametrize(
    ("moments", "words"),
    [((298e3, 293e3, 310e3), "less dense than any structure"), ((2.98e-7, 2.93e-7, 3.1e-7), "heavier than osmium")],
)
def test_a_unit_that_cannot_be_meant_is_named(moments: tuple[float, float, float], words: str) -> None:
    """16.8 kg with moments in kg mm^2, and in units of a thousand kg m^2."""
    (finding,) = [f for f in examine(RigidBody.from_diagonal(16.8, moments)) if f.name == "size"]
    assert words in str(finding)
    assert not [f for f in examine(RigidBody.from_diagonal(16.8, (0.298, 0.293, 0.310))) if f.name == "size"]


def test_a_boom_is_believed() -> None:
    """20 kg on 100 m."""
    moment = 20.0 * 100.0**2 / 12.0
    assert not [f for f in examine(RigidBody.from_diagonal(20.0, (moment, moment, 1e-2))) if f.name == "size"]


@pytest.mark.parametrize("mass", [1e-100, 1.0, 1e308])
@pytest.mark.parametrize("moment", [1e-300, 1e-100, 1e300, 1.7e308])
def test_numbers_at_the_ends_of_the_range_are_examined(mass: float, moment: float) -> None:
    body = RigidBody.from_diagonal(mass, (moment,) * 3, (1.0, 1e300, -1e300))
    assert {finding.name for finding in examine(body)} <= {"size", "about-origin"}
    ball = Solid(1e210, (0.0, 0.0, 0.0), ((1e140, 0.0, 0.0), (0.0, 1e140, 0.0), (0.0, 0.0, 1e140)), 1e70)
    with contextlib.suppress(BodyError):
        assert len(compare(body, ball)) == 3
