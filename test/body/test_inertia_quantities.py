"""Inertia matrices against point masses, boxes and motions with known answers."""

from __future__ import annotations

import contextlib
import math
from dataclasses import replace
from decimal import Decimal

import numpy as np
import pytest

from rb_dynamics.body.inertia_quantities import (
    NEAR_AXIS,
    MassProperties,
    equivalent_box,
    inertia_ellipsoid,
    middle_axis_growth_time,
    radius_of_gyration,
    scalar_inertia,
)
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import IDENTITY, State
from rb_dynamics.errors import BodyError
from rb_dynamics.loads.wrench import WrenchFrames
from rb_dynamics.numerics import rotation
from rb_dynamics.numerics.vector import Vector
from rb_dynamics.run.simulate import simulate
from rb_dynamics.scene.model import Scene, Solver
from rb_dynamics.sinks.memory_sink import MemorySink

SLANT: Vector = (0.3, -0.7, 0.5)
MASSES = np.array([1.0, 2.0, 0.5, 1.5, 3.0])
POINTS = np.array([[0.3, -0.2, 0.9], [-0.4, 0.1, 0.2], [1.1, 0.6, -0.3], [-0.2, -0.8, 0.4], [0.1, 0.5, -0.6]])


def point_masses() -> tuple[RigidBody, np.ndarray]:
    """Return a body of point masses, and their positions from its centre of mass."""
    center = MASSES @ POINTS / MASSES.sum()
    arms = POINTS - center
    inertia = sum(m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(MASSES, arms, strict=True))
    return RigidBody.from_matrix(MASSES.sum(), inertia.tolist(), center.tolist()), arms


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, -3.0, 0.0), (1.0, 2.0, -0.5), (1e-8, 2e-8, 3e-8)])
def test_scalar_inertia_is_the_sum_of_mass_times_squared_distance_from_the_axis(axis: Vector) -> None:
    body, arms = point_masses()
    along = np.array(axis) / np.linalg.norm(axis)
    distances = np.linalg.norm(np.cross(arms, along), axis=1)

    assert scalar_inertia(body, axis) == pytest.approx(MASSES @ distances**2, rel=1e-13)


def test_scalar_inertia_about_a_principal_axis_is_its_moment() -> None:
    body = RigidBody.from_principal(4.0, (1.0, 2.0, 2.5), rotation.exp(SLANT))
    axes = np.array(rotation.matrix(body.principal_orientation_xyzw)).T

    found = [scalar_inertia(body, tuple(axis)) for axis in axes.tolist()]

    assert found == pytest.approx(body.principal_moments, rel=1e-14)


@pytest.mark.parametrize("axis", [(0.0, 0.0, 0.0), (math.nan, 0.0, 1.0), (math.inf, 0.0, 0.0)])
@pytest.mark.parametrize("function", [scalar_inertia, radius_of_gyration])
def test_an_axis_without_direction_is_refused(function, axis: Vector) -> None:
    with pytest.raises(BodyError, match="expected a direction"):
        function(point_masses()[0], axis)


def test_a_point_mass_at_the_radius_of_gyration_has_the_same_inertia() -> None:
    body, _ = point_masses()

    assert body.mass * radius_of_gyration(body, SLANT) ** 2 == pytest.approx(scalar_inertia(body, SLANT), rel=1e-14)
    # A hoop has all of its mass at its radius.
    assert radius_of_gyration(RigidBody.from_diagonal(3.0, (0.06, 0.06, 0.12)), (0.0, 0.0, 1.0)) == pytest.approx(0.2)


@pytest.mark.parametrize("through", [(0.0, 0.0, 0.0), (1.0, -2.0, 0.5), (1e3, 0.0, 0.0)])
def test_an_axis_may_pass_through_any_point(through: Vector) -> None:
    body, _ = point_masses()
    along = np.array(SLANT) / np.linalg.norm(SLANT)
    distances = np.linalg.norm(np.cross(POINTS - through, along), axis=1)

    assert scalar_inertia(body, SLANT, through) == pytest.approx(MASSES @ distances**2, rel=1e-13)
    assert radius_of_gyration(body, SLANT, through) == pytest.approx(
        math.sqrt(MASSES @ distances**2 / MASSES.sum()), rel=1e-13
    )
    with pytest.raises(BodyError, match="expected a point of the axis"):
        scalar_inertia(body, SLANT, (0.0, math.nan, 0.0))


def test_the_ellipsoid_reaches_as_far_along_each_axis_as_its_inertia_lets_it() -> None:
    body = RigidBody.from_principal(4.0, (1.0, 4.0, 4.5), rotation.exp(SLANT))
    half = np.array(inertia_ellipsoid(body))
    axes = np.array(rotation.matrix(body.principal_orientation_xyzw))

    assert half == pytest.approx((math.sqrt(4.5), math.sqrt(1.125), 1.0), rel=1e-15)
    for direction in np.random.default_rng(4).normal(size=(20, 3)):
        point = axes @ (half * direction / np.linalg.norm(direction))
        assert point @ np.array(body.inertia) @ point == pytest.approx(4.5, rel=1e-13)
        assert scalar_inertia(body, tuple(point)) == pytest.approx(4.5 / (point @ point), rel=1e-13)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e5])
def test_the_box_with_the_mass_and_moments_of_a_box_is_that_box(scale: float) -> None:
    half = np.array([0.5, 1.0, 0.25]) * scale
    moments = 8.0 / 3.0 * (np.sum(half**2) - half**2)

    found, size = equivalent_box(RigidBody.from_diagonal(8.0, moments.tolist()))

    np.testing.assert_allclose(found, half, rtol=1e-12)
    assert size == pytest.approx(np.linalg.norm(half), rel=1e-12)


def test_the_box_has_the_moments_of_any_body() -> None:
    body, _ = point_masses()
    # The corners of a box with sides 1/sqrt(3) as long have the moments of the whole: both have its second moments.
    corners = np.stack(np.meshgrid(*([-1.0, 1.0],) * 3), axis=-1).reshape(8, 3) * equivalent_box(body)[0] / math.sqrt(3)

    squares = body.mass / 8.0 * (corners**2).sum(axis=0)

    np.testing.assert_allclose(squares.sum() - squares, body.principal_moments, rtol=1e-13)


@pytest.mark.parametrize(
    ("moments", "expected"),
    [
        ((1.0, 1.0, 2.0), (1.0, 1.0, 0.01 * math.sqrt(2.0))),
        ((1e-12, 1.0, 1.0), (1.0, 0.01, 0.01)),
    ],
    ids=["plate", "rod"],
)
def test_the_box_of_a_body_without_thickness_can_be_seen(moments: Vector, expected: Vector) -> None:
    half, size = equivalent_box(RigidBody.from_diagonal(3.0, moments))

    assert half == pytest.approx(expected, rel=1e-6)
    assert size == pytest.approx(np.linalg.norm([h for h in expected if h == 1.0]), rel=1e-6)


BODIES = {
    "diagonal": RigidBody.from_diagonal(1.0, (1.0, 2.0, 3.0)),
    "axes in another order": RigidBody.from_diagonal(1.0, (2.0, 1.0, 2.5)),
    "axes turned": RigidBody.from_principal(2.0, (0.31, 0.2, 0.27), rotation.exp(SLANT)),
    "nearly symmetric": RigidBody.from_diagonal(1.0, (1.0, 1.01, 1.8)),
}


def middle_axis(body: RigidBody) -> np.ndarray:
    """Return the eigenvector of the middle eigenvalue, body axes."""
    return np.linalg.eigh(np.array(body.inertia))[1][:, 1]


@pytest.mark.parametrize("rate", [0.05, 2.0])
@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
def test_growth_time_is_that_of_the_linearised_euler_equations(body: RigidBody, rate: float) -> None:
    inertia, spin = np.array(body.inertia), rate * middle_axis(body)

    def acceleration(w: np.ndarray) -> np.ndarray:
        return np.linalg.solve(inertia, -np.cross(w, inertia @ w))

    # Euler's equations are quadratic in w: central differences are exact but for round-off.
    columns = [(acceleration(spin + rate * e) - acceleration(spin - rate * e)) / (2.0 * rate) for e in np.eye(3)]
    growth = np.linalg.eigvals(np.array(columns).T).real.max()

    assert middle_axis_growth_time(body, tuple(spin)) == pytest.approx(1.0 / growth, rel=1e-8)
    assert middle_axis_growth_time(body, tuple(-spin)) == pytest.approx(1.0 / growth, rel=1e-8)


def test_a_simulated_deviation_grows_e_fold_in_the_growth_time() -> None:
    body = BODIES["diagonal"]
    growth_time = middle_axis_growth_time(body, (0.0, 2.0, 0.0))
    assert growth_time is not None
    # By eight growth times the part that decays is gone; the deviation is still 1e-6 and its square does not count.
    start, end = round(8.0 * growth_time * 1e9), round(9.0 * growth_time * 1e9)
    scene = Scene(
        body,
        WrenchFrames(),
        State(0, (0.0, 0.0, 0.0), IDENTITY, angular_velocity_body=(3e-10, 2.0, -1e-10)),
        solver=Solver("rk4", 0.005, None),
    )
    deviations = []
    for time_ns in (start, end):
        simulate(replace(scene, duration=time_ns * 1e-9), sinks=[memory := MemorySink()])
        x, _, z = memory.angular_velocity_body[-1]
        deviations.append(math.hypot(x, z))

    assert deviations[1] / deviations[0] == pytest.approx(math.e, rel=1e-5)


@pytest.mark.parametrize(
    ("moments", "spin"),
    [
        ((1.0, 2.0, 3.0), (1.0, 0.0, 0.0)),
        ((1.0, 2.0, 3.0), (0.0, 0.0, 1.0)),
        ((1.0, 2.0, 3.0), (1.0, 1.0, 1.0)),
        ((1.0, 2.0, 3.0), (0.0, 0.0, 0.0)),
        ((1.0, 1.0, 1.8), (0.0, 1.0, 0.0)),
        ((2.0, 2.0, 2.0), (0.0, 1.0, 0.0)),
    ],
    ids=["smallest axis", "largest axis", "no axis", "no spin", "symmetric", "sphere"],
)
def test_no_growth_time_where_a_spin_does_not_leave_the_middle_axis(moments: Vector, spin: Vector) -> None:
    assert middle_axis_growth_time(RigidBody.from_diagonal(1.0, moments), spin) is None


def test_near_the_middle_axis_ends_at_its_limit_on_both_sides() -> None:
    body = BODIES["diagonal"]

    assert middle_axis_growth_time(body, (0.0, 5.0, 4.99 * NEAR_AXIS)) is not None
    assert middle_axis_growth_time(body, (0.0, -5.0, 5.01 * NEAR_AXIS)) is None


def test_properties_hold_what_the_functions_say() -> None:
    body = BODIES["axes turned"]

    properties = MassProperties.of(body, (0.0, 0.0, 0.0))
    columns = list(zip(*properties.principal_axes, strict=True))

    assert properties.warnings == ()
    assert properties.inertia_ellipsoid == inertia_ellipsoid(body)
    assert [scalar_inertia(body, axis) for axis in columns] == pytest.approx(properties.principal_moments, rel=1e-14)
    assert [radius_of_gyration(body, axis) for axis in columns] == pytest.approx(
        properties.radii_of_gyration, rel=1e-14
    )
    assert properties.as_dict()["principal_moments"] == body.principal_moments
    assert set(properties.as_dict()) == set(MassProperties.__slots__)


def test_text_has_every_number_with_its_unit() -> None:
    body = RigidBody.from_diagonal(2.0, (1.28, 2.0, 1.125), (0.1, -0.25, 0.0))

    text = MassProperties.of(body, (0.0, 0.0, 0.0)).as_text()

    assert [line.split() for line in text.splitlines()] == [
        ["mass", "2", "kg"],
        ["centre", "of", "mass", "0.1", "-0.25", "0", "m,", "from", "the", "body", "origin"],
        ["inertia", "about", "the", "centre", "of", "mass,", "body", "axes,", "kg", "m^2"],
        ["1.28", "0", "0"],
        ["0", "2", "0"],
        ["0", "0", "1.125"],
        [],
        ["principal", "axis", "moment", "gyration", "ellipsoid", "direction", "in", "body", "axes"],
        ["kg", "m^2", "m", "(relative)"],
        ["1", "1.28", "0.8", "1.25", "1", "0", "0"],
        ["2", "2", "1", "1", "0", "1", "0"],
        ["3", "1.125", "0.75", "1.33333", "0", "0", "1"],
        ["symmetry", "triaxial", "(three", "different", "moments)"],
    ]
    assert "warning" not in text


def test_text_warns_of_a_spin_about_the_middle_axis() -> None:
    text = MassProperties.of(BODIES["diagonal"], (0.1, 2.0, 0.1)).as_text()

    warning = text.splitlines()[-1]
    # 1 / (|w| sqrt((2 - 1)(3 - 2) / (1 3))) with |w| = sqrt(4.02)
    assert warning.startswith("warning: ")
    assert "e-fold in 0.864 s" in warning


ENDS = ((1e308, 1.1e308, 1.2e308), (1.7e308,) * 3, (1e-200, 1.5e-200, 2e-200), (5e-324,) * 3, (5e-324, 1e308, 1e308))


@pytest.mark.parametrize("mass", [5e-324, 1e-308, 1.0, 1e308])
@pytest.mark.parametrize("moments", ENDS)
@pytest.mark.parametrize("center", [(0.0, 0.0, 0.0), (1e308, -1e308, 0.0), (1e-300, 0.0, 0.0)])
def test_what_a_body_at_the_ends_of_the_range_says_is_right_or_refused(
    mass: float, moments: Vector, center: Vector
) -> None:
    body = RigidBody.from_diagonal(mass, moments, center)
    roots = [Decimal(moment) for moment in moments]
    expected = [float((each / Decimal(mass)).sqrt()) for each in roots]
    if max(expected) == math.inf:
        with pytest.raises(BodyError, match="a ratio beyond double precision"):
            radius_of_gyration(body, (0.0, 0.0, 1.0))
        return
    assert [radius_of_gyration(body, axis) for axis in np.eye(3)] == pytest.approx(expected)
    with contextlib.suppress(BodyError):
        assert inertia_ellipsoid(body) == pytest.approx([float((max(roots) / each).sqrt()) for each in roots])
        assert "inf" not in MassProperties.of(body, (0.0, 1.0, 0.0)).as_text().partition("warning")[0]
    half, size = equivalent_box(body)
    assert all(0.0 < each <= size for each in half)
    for through in ((1e308, 0.0, 0.0), (-1e308, 1e308, 0.0)):
        with contextlib.suppress(BodyError):
            assert math.isfinite(scalar_inertia(body, (1.0, 0.0, 1.0), through))
    with pytest.raises(BodyError, match=r"through is \[1e\+308, .* expected a point"):
        scalar_inertia(RigidBody.from_diagonal(1.0, (1.0, 1.0, 1.0)), (0.0, 0.0, 1.0), (1e308, 0.0, 0.0))


@pytest.mark.parametrize("unit", [1e-200, 1.0, 1e200])
def test_the_middle_axis_is_found_in_any_unit(unit: float) -> None:
    body = RigidBody.from_diagonal(1.0, (unit, 2.0 * unit, 3.0 * unit))
    assert middle_axis_growth_time(body, (0.0, 1.0, 0.0)) == pytest.approx(math.sqrt(3.0))


def test_columns_of_long_numbers_stay_apart() -> None:
    body = RigidBody.from_diagonal(1.0, (1.0, 1.0, 1.0), (-1.23456789e-123,) * 3)
    assert " ".join(["-1.23456789e-123"] * 3) in MassProperties.of(body, (0.0, 0.0, 0.0)).as_text()
