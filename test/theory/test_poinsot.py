"""Poinsot's construction against the motion: curves, closed forms and statements of the lecture."""

from __future__ import annotations

import math
import random

import mpmath as mp
import numpy as np
import pytest
from free_reference import angle, free_rotation
from hypothesis import assume, given
from hypothesis import strategies as st

from rb_dynamics import RigidBody, State, free_motion
from rb_dynamics.body.inertia_quantities import middle_axis_growth_time
from rb_dynamics.errors import BodyError, ConvergenceError
from rb_dynamics.motion.step_checks import LARGEST_FREE_TURN
from rb_dynamics.theory.euler_equations import rotational_energy
from rb_dynamics.theory.poinsot import (
    PolhodeKind,
    Stability,
    axis_stability,
    energy_ellipsoid,
    herpolhode,
    invariable_plane,
    polhode,
    rolling,
)

ATTITUDE = (0.1, -0.4, 0.2, math.sqrt(0.79))
NEXT = math.nextafter(1.0, 2.0)
BODY = RigidBody.from_diagonal(1.0, (1.0, 2.0, 3.0))
SKEW = RigidBody.from_matrix(1.5, ((2.0, 0.3, -0.1), (0.3, 2.5, 0.2), (-0.1, 0.2, 3.0)), (0.1, 0.2, 0.0))
# With these moments w = (2, y, 1) is on the separatrix to the last digit: 3 (4 - 3) 2^2 = 6 (6 - 4) 1^2.
SPLIT = RigidBody.from_diagonal(1.0, (3.0, 4.0, 6.0))

BODIES = {
    "triaxial": BODY,
    "skew": SKEW,
    "needle": RigidBody.from_diagonal(1.0, (1e-9, 1.0, 1.0 + 5e-10)),
    "rod": RigidBody.from_diagonal(1.0, (1e-6, 1.0, 1.0)),
    "plate": RigidBody.from_diagonal(1.0, (0.4, 0.6, 1.0)),
    "disc": RigidBody.from_diagonal(1.0, (1.0, 2.0, 1.0)),
    "sphere": RigidBody.from_diagonal(1.0, (1.0, 1.0, 1.0)),
    "tiny": RigidBody.from_diagonal(1e-20, (1e-20, 2e-20, 2.5e-20)),
}
SPINS = {
    "general": (0.3, 0.5, -0.7),
    "about the first": (1.0, 0.1, 0.05),
    "about the last": (-0.02, 0.1, -1.0),
    "near the middle": (1e-9, 1.0, -2e-9),
    "on an axis": (0.0, 0.0, 0.8),
    "fast": (3e5, -1e6, 2e5),
    "slow": (3e-12, 1e-12, 2e-12),
}

components = st.floats(-2.0, 2.0).map(lambda x: x if abs(x) > 1e-3 else 0.0)
spins = st.tuples(components, components, components).filter(lambda w: math.hypot(*w) > 0.1)
# Sums of two positive numbers obey the triangle inequality, and all that do are such sums.
sides = st.floats(0.05, 1.0)
bodies = st.tuples(sides, sides, sides).map(
    lambda s: RigidBody.from_principal(1.0, (s[1] + s[2], s[2] + s[0], s[0] + s[1]), (0.5, 0.1, -0.3, math.sqrt(0.65)))
)


def state(spin: tuple[float, float, float], orientation: tuple[float, float, float, float] = ATTITUDE) -> State:
    return State(orientation_xyzw=orientation, angular_velocity_body=spin)


@pytest.mark.parametrize("spin", SPINS.values(), ids=SPINS)
@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
def test_the_ellipsoid_rolls_on_the_plane(body: RigidBody, spin: tuple[float, float, float]) -> None:
    times = np.linspace(0.0, 30.0, 3) / math.hypot(*spin)

    left = rolling(body, state(spin), times)

    assert left.slip.shape == times.shape
    # The attitude is known to 100 eps (1 + |w| t). A needle's plane is far nearer to the centre than |w|.
    assert left.normal.max() <= 100 * 31 * 2.0**-52
    ratio = math.hypot(*spin) / invariable_plane(body, state(spin)).distance
    assert left.plane_distance.max() <= 100 * 31 * 2.0**-52 * ratio
    assert left.slip.max() <= 1e-12


def test_a_motion_with_another_momentum_does_not_roll() -> None:
    """The check can fail: on a body whose moments are not those that moved it, the plane is not fixed."""
    path = free_motion(BODY, state((0.3, 0.5, -0.7)), [0.0, 3.0])
    other = RigidBody.from_diagonal(1.0, (1.0, 2.0, 2.5))

    starts = [
        State(orientation_xyzw=tuple(q), angular_velocity_body=tuple(w))
        for q, w in zip(path.orientation_xyzw, path.angular_velocity_body, strict=True)
    ]

    normals = [invariable_plane(other, start).normal_world for start in starts]
    assert np.linalg.norm(normals[1] - normals[0]) > 1e-2
    assert invariable_plane(BODY, starts[1]).normal_world == pytest.approx(
        invariable_plane(BODY, starts[0]).normal_world
    )


@given(bodies, spins)
def test_the_polhode_is_closed_and_on_the_ellipsoid(body: RigidBody, spin: tuple[float, float, float]) -> None:
    curve, rate = polhode(body, state(spin), 9), math.hypot(*spin)

    if math.isfinite(curve.period):
        assert np.abs(curve.angular_velocity_body[-1] - curve.angular_velocity_body[0]).max() <= 1e-10 * rate
    on_ellipsoid = np.sum((curve.angular_velocity_principal / energy_ellipsoid(body, state(spin))) ** 2, axis=-1)
    assert on_ellipsoid == pytest.approx(1.0, abs=1e-13)
    energy = rotational_energy(body, curve.angular_velocity_body)
    assert energy == pytest.approx(energy[0], rel=1e-13)


@given(bodies, spins)
def test_the_herpolhode_keeps_to_its_ring(body: RigidBody, spin: tuple[float, float, float]) -> None:
    rate = math.hypot(*spin)
    assume(polhode(body, state(spin), 2).period * rate < LARGEST_FREE_TURN)
    curve = herpolhode(body, state(spin), 17)
    radius = np.hypot(*curve.points.T)

    # The last points of a ring that is nearly a point are rounding of the plane's normal.
    assert radius.min() >= curve.inner_radius - 1e-11 * rate
    assert radius.max() <= curve.outer_radius + 1e-11 * rate


def test_a_period_too_long_for_the_attitude_is_refused() -> None:
    nearly_a_sphere = RigidBody.from_diagonal(1.0, (1.0, NEXT, math.nextafter(NEXT, 2.0)))
    with pytest.raises(ConvergenceError, match=r"expected finite times and less than 1e\+15 rad of turn"):
        herpolhode(nearly_a_sphere, state((1e-3, 1.0, 1e-3)))


def test_the_ring_is_touched_inside_and_outside() -> None:
    for spin in ((0.3, 0.5, -0.7), (1.0, 0.1, 0.05)):
        curve = herpolhode(BODY, state(spin), 2001)
        radius = np.hypot(*curve.points.T)
        assert radius.min() == pytest.approx(curve.inner_radius, rel=1e-4)
        assert radius.max() == pytest.approx(curve.outer_radius, rel=1e-4)


@pytest.mark.parametrize("body", [BODY, SKEW, BODIES["plate"], BODIES["rod"], BODIES["disc"], SPLIT])
@pytest.mark.parametrize("spin", [(0.3, 0.5, -0.7), (1.0, 0.1, 0.05), (0.05, 0.2, 1.0), (-1.0, -0.6, 0.4)])
def test_the_advance_is_what_the_curve_shows(body: RigidBody, spin: tuple[float, float, float]) -> None:
    curve = herpolhode(body, state(spin), 501)
    azimuth = np.unwrap(np.arctan2(curve.points[:, 1], curve.points[:, 0]))

    assert azimuth[-1] - azimuth[0] == pytest.approx(curve.advance, rel=1e-11)


def test_period_and_advance_against_many_digits() -> None:
    """After one period w is what it was and the body has turned by the advance about L, to 50 digits."""
    generator = random.Random(7)
    for _ in range(5):
        moments = [1.0, generator.uniform(1.1, 1.4), generator.uniform(1.5, 2.0)]
        spin = tuple(generator.gauss(0.0, 1.0) for _ in range(3))
        body, start = RigidBody.from_diagonal(1.0, moments), state(spin, (0.0, 0.0, 0.0, 1.0))
        curve = herpolhode(body, start, 2)
        turn, omega = free_rotation(moments, spin, curve.period)
        normal = invariable_plane(body, start).normal_world
        half = 0.5 * curve.advance

        assert [float(w) for w in omega] == pytest.approx(spin, abs=1e-13)
        found = (*(math.sin(half) * normal), math.cos(half))
        assert angle(turn, [mp.mpf(float(c)) for c in found]) < 1e-13


@pytest.mark.parametrize(
    ("body", "spin", "kind"),
    [
        (BODY, (1.0, 0.1, 0.1), PolhodeKind.ABOUT_LEAST),
        (BODY, (0.1, 0.1, 1.0), PolhodeKind.ABOUT_GREATEST),
        (RigidBody.from_diagonal(1.0, (3.0, 1.0, 2.0)), (0.1, 1.0, 0.1), PolhodeKind.ABOUT_LEAST),
        (SPLIT, (2.0, 0.7, 1.0), PolhodeKind.SEPARATRIX),
        (SPLIT, (math.nextafter(2.0, 3.0), 0.7, 1.0), PolhodeKind.ABOUT_LEAST),
        (SPLIT, (2.0, 0.7, NEXT), PolhodeKind.ABOUT_GREATEST),
        (BODY, (0.0, -2.0, 0.0), PolhodeKind.FIXED_AXIS),
        (BODIES["disc"], (0.3, 0.0, 0.4), PolhodeKind.FIXED_AXIS),
        (BODIES["disc"], (0.3, 0.1, 0.4), PolhodeKind.ABOUT_GREATEST),
        (BODIES["rod"], (0.3, 0.1, 0.4), PolhodeKind.ABOUT_LEAST),
        (BODIES["sphere"], (0.3, 0.1, 0.4), PolhodeKind.SPHERE),
        (RigidBody.from_diagonal(1.0, (1.0, 1.0, NEXT)), (0.3, 0.1, 0.4), PolhodeKind.ABOUT_GREATEST),
    ],
)
def test_kinds(body: RigidBody, spin: tuple[float, float, float], kind: PolhodeKind) -> None:
    assert polhode(body, state(spin), 2).kind is kind


def test_a_fixed_spin_is_a_point() -> None:
    for body, spin in (
        (BODY, (0.0, -2.0, 0.0)),
        (BODIES["disc"], (0.3, 0.0, 0.4)),
        (BODIES["sphere"], (0.3, 0.1, 0.4)),
    ):
        on_ellipsoid, in_plane = polhode(body, state(spin), 3), herpolhode(body, state(spin), 3)
        assert (on_ellipsoid.period, in_plane.advance) == (0.0, 0.0)
        assert (in_plane.inner_radius, in_plane.outer_radius) == (0.0, 0.0)
        assert on_ellipsoid.angular_velocity_body.tolist() == [list(spin)] * 3
        assert np.abs(in_plane.points).max() < 1e-15


def test_the_separatrix_leads_from_the_middle_axis_to_the_middle_axis() -> None:
    start = state((2.0, 0.0, 1.0))
    curve, ring = polhode(SPLIT, start), herpolhode(SPLIT, start)
    ends = energy_ellipsoid(SPLIT, start)[1] * np.array([0.0, 1.0, 0.0])

    assert curve.period == ring.period == ring.advance == math.inf
    assert ring.inner_radius == 0.0
    assert np.abs(np.abs(curve.angular_velocity_body[[0, -1]]) - ends).max() < 1e-7
    assert curve.angular_velocity_body[0, 1] * curve.angular_velocity_body[-1, 1] < 0.0
    assert np.hypot(*ring.points.T).max() == pytest.approx(ring.outer_radius, rel=1e-12)


@pytest.mark.parametrize("gap", [1e-3, 1e-6, 1e-9, 1e-12, 1e-15])
def test_near_the_separatrix_the_period_grows_with_the_logarithm(gap: float) -> None:
    """4 K = 2 log(16 / m1) there (DLMF 19.12.1): a thousandth of the distance is one more flight of equal length."""
    periods = [polhode(BODY, state((scale * gap, 1.0, 0.0)), 2).period for scale in (1.0, 1e-3)]
    growth_time = middle_axis_growth_time(BODY, (0.0, 1.0, 0.0))

    assert growth_time is not None
    assert periods[1] - periods[0] == pytest.approx(4.0 * growth_time * math.log(1e3), rel=1e-3 + gap)


def test_moments_one_unit_apart_have_a_period() -> None:
    """The period is so long that the attitude is unknown by then and refused; the angular velocity is known."""
    body = RigidBody.from_diagonal(1.0, (1.0, NEXT, math.nextafter(NEXT, 2.0)))
    curve = polhode(body, state((1.0, 1.0, 1.0)), 5)

    assert 1e16 < curve.period < 1e18
    assert np.abs(curve.angular_velocity_body[-1] - 1.0).max() < 1e-13
    assert curve.angular_velocity_body.min() < -0.9
    with pytest.raises(ConvergenceError, match="less than"):
        herpolhode(body, state((1.0, 1.0, 1.0)))


def test_curves_at_given_times() -> None:
    times = [-3.0, 0.0, 2.5]
    motion = free_motion(SKEW, state((0.3, 0.5, -0.7)), times)

    assert polhode(SKEW, state((0.3, 0.5, -0.7)), times=times).angular_velocity_body == pytest.approx(
        motion.angular_velocity_body, abs=1e-15
    )
    in_plane = herpolhode(SKEW, state((0.3, 0.5, -0.7)), times=times)
    plane = invariable_plane(SKEW, state((0.3, 0.5, -0.7)))
    rebuilt = in_plane.points @ plane.axes_world + plane.distance * plane.normal_world
    assert rebuilt == pytest.approx(in_plane.angular_velocity_world, abs=1e-14)
    assert polhode(SKEW, state((0.3, 0.5, -0.7)), times=[]).angular_velocity_body.shape == (0, 3)


def test_the_plane_by_hand() -> None:
    """L = (1, 4, 3) and 2 T = 1 + 8 + 3, for w = (1, 2, 1)."""
    plane = invariable_plane(BODY, state((1.0, 2.0, 1.0), (0.0, 0.0, 0.0, 1.0)))

    assert plane.normal_world == pytest.approx(np.array([1.0, 4.0, 3.0]) / math.sqrt(26.0), rel=1e-15)
    assert plane.distance == pytest.approx(12.0 / math.sqrt(26.0), rel=1e-15)
    frame = np.array([*plane.axes_world, plane.normal_world])
    assert frame @ frame.T == pytest.approx(np.eye(3), abs=1e-15)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    assert energy_ellipsoid(BODY, state((1.0, 2.0, 1.0))) == pytest.approx(np.sqrt([12.0, 6.0, 4.0]), rel=1e-15)


@pytest.mark.parametrize("spin", [(0.0, 0.0, 0.0), (math.nan, 0.0, 1.0), (math.inf, 0.0, 1.0)])
@pytest.mark.parametrize("function", [polhode, herpolhode, invariable_plane, energy_ellipsoid])
def test_no_spin_is_refused(function, spin: tuple[float, float, float]) -> None:
    with pytest.raises(BodyError, match=r"no invariable plane|three finite numbers"):
        function(BODY, state(spin))


def test_the_middle_axis_alone_is_unstable() -> None:
    first, second, third = axis_stability(BODY, 2.0)

    assert [axis.stability.value for axis in (first, second, third)] == ["stable", "unstable", "stable"]
    assert second.growth_rate == pytest.approx(2.0 * math.sqrt(1.0 / 3.0), rel=1e-15)
    assert first.oscillation_rate == pytest.approx(2.0 * math.sqrt(1.0 * 2.0 / 6.0), rel=1e-15)
    assert third.oscillation_rate == pytest.approx(2.0 * math.sqrt(2.0 * 1.0 / 2.0), rel=1e-15)


def test_equal_moments_are_neutral() -> None:
    disc = [axis.stability for axis in axis_stability(BODIES["disc"])]

    assert disc == [Stability.NEUTRAL, Stability.STABLE, Stability.NEUTRAL]
    assert {axis.stability for axis in axis_stability(BODIES["sphere"])} == {Stability.NEUTRAL}


def test_small_deviations_do_what_is_said() -> None:
    """The period about a stable axis and the growth about the unstable one, from the exact motion."""
    for axis in axis_stability(SKEW, 1.5):
        nudge = np.array([0.6, 0.64, 0.48]) * 1e-7
        spin = tuple((1.5 * np.array(axis.axis_body) + nudge).tolist())
        curve = polhode(SKEW, state(spin), 2)
        if axis.stability is Stability.STABLE:
            assert curve.period == pytest.approx(2.0 * math.pi / axis.oscillation_rate, rel=1e-6)
            continue
        times = np.linspace(3.0, 8.0, 3) / axis.growth_rate
        path = polhode(SKEW, state(spin), times=times).angular_velocity_body
        off = np.linalg.norm(np.cross(path, axis.axis_body), axis=-1)
        assert np.diff(np.log(off)) / np.diff(times) == pytest.approx(axis.growth_rate, rel=2e-3)


def test_a_particle_does_not_turn() -> None:
    particle = RigidBody(1.0, ((0.0,) * 3,) * 3, (0.0,) * 3, (0.0,) * 3, (0.0, 0.0, 0.0, 1.0))

    with pytest.raises(BodyError, match="is a particle"):
        axis_stability(particle)
    with pytest.raises(BodyError, match="is a particle"):
        polhode(particle, state((1.0, 0.0, 0.0)))


def test_odd_arguments_are_refused_by_name() -> None:
    body, spin = RigidBody.from_diagonal(1.0, (1.0, 2.0, 3.0)), State(angular_velocity_body=(0.1, 1.0, 0.1))
    for call in (
        lambda: polhode(body, spin, n=2.5),  # type: ignore[arg-type]
        lambda: polhode(body, spin, n=-1),
        lambda: polhode(body, spin, times="abc"),
        lambda: polhode(body, spin, times=1j),  # type: ignore[arg-type]
        lambda: herpolhode(body, spin, times=1.0),
        lambda: rolling(body, spin, times=np.ma.masked),
        lambda: axis_stability(body, "1"),  # type: ignore[arg-type]
        lambda: axis_stability(body, np.nan),
        lambda: invariable_plane("body", spin),  # type: ignore[arg-type]
        lambda: energy_ellipsoid(body, (0.1, 1.0, 0.1)),  # type: ignore[arg-type]
    ):
        with pytest.raises((TypeError, ValueError), match=r"^\w+ (is|has the shape) .*, expected "):
            call()
