"""Diagnostics against their definitions, on point masses in exact arithmetic; defects are the raw residuals."""

from __future__ import annotations

import dataclasses
import math
from fractions import Fraction

import pytest
from motions import EPS, forced

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.loads.combined_effects import CombinedEffects
from rb_dynamics.motion.phase_state import PhaseState
from rb_dynamics.numerics import rotation
from rb_dynamics.numerics.vector import ZERO, scale, subtract
from rb_dynamics.run.sample import Sample, SampleBuilder, kinetic_energy
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.scene.model import Solver

Point = tuple[Fraction, Fraction, Fraction]

MASSES = [Fraction(1), Fraction(2), Fraction(3, 2), Fraction(5, 2)]
PLACES: list[Point] = [
    (Fraction(1), Fraction(0), Fraction(1, 2)),
    (Fraction(-1, 2), Fraction(1), Fraction(0)),
    (Fraction(0), Fraction(-1), Fraction(1)),
    (Fraction(1, 4), Fraction(1, 2), Fraction(-3, 2)),
]
STATE = State(
    position_world=(1.5, -2.0, 0.25),
    orientation_xyzw=(0.5, -0.5, 0.5, 0.5),  # a cyclic change of axes: exact
    linear_velocity_world=(0.5, -0.25, 2.0),
    angular_velocity_body=(0.75, -1.25, 0.5),
)


def cross(a: Point, b: Point) -> Point:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def plus(a: Point, b: Point) -> Point:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def times(s: Fraction, a: Point) -> Point:
    return (s * a[0], s * a[1], s * a[2])


def total(points: list[Point]) -> Point:
    return (sum(p[0] for p in points), sum(p[1] for p in points), sum(p[2] for p in points))  # type: ignore[return-value]


def exact(v: tuple[float, float, float]) -> Point:
    return (Fraction(v[0]), Fraction(v[1]), Fraction(v[2]))


def to_world(v: Point) -> Point:
    """Return R v for the orientation of STATE, which permutes axes and changes signs."""
    columns = [exact(rotation.rotate(STATE.orientation_xyzw, axis)) for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
    return total([times(v[i], columns[i]) for i in range(3)])


@pytest.fixture(scope="module")
def body() -> RigidBody:
    mass = sum(MASSES)
    center = times(1 / mass, total([times(m, p) for m, p in zip(MASSES, PLACES, strict=True)]))
    rows = [[Fraction(0)] * 3 for _ in range(3)]
    for m, place in zip(MASSES, PLACES, strict=True):
        r = plus(place, times(Fraction(-1), center))
        square = sum(c * c for c in r)
        for i in range(3):
            for j in range(3):
                rows[i][j] += m * ((square if i == j else 0) - r[i] * r[j])
    return RigidBody.from_matrix(float(mass), [[float(v) for v in row] for row in rows], [float(c) for c in center])


def particle_motion() -> list[tuple[Fraction, Point, Point]]:
    """Return mass, position and velocity of each particle in the world: x + R r and v + R (w x r)."""
    x, v = exact(STATE.position_world), exact(STATE.linear_velocity_world)
    w = exact(STATE.angular_velocity_body)
    return [(m, plus(x, to_world(r)), plus(v, to_world(cross(w, r)))) for m, r in zip(MASSES, PLACES, strict=True)]


def sample(body: RigidBody) -> Sample:
    phase = PhaseState.of(body, STATE)
    return SampleBuilder(CombinedEffects(body), phase).sample(phase, 42)


class TestParticles:
    """The sums over particles of lecture 24, exact, are what `observe` gives for the body made of them."""

    def test_kinetic_energy(self, body: RigidBody) -> None:
        energy = sum(m * sum(c * c for c in v) for m, _, v in particle_motion()) / 2

        assert sample(body).kinetic_energy == pytest.approx(float(energy), rel=8.0 * EPS)

    def test_linear_momentum(self, body: RigidBody) -> None:
        momentum = total([times(m, v) for m, _, v in particle_motion()])

        assert sample(body).linear_momentum_world == pytest.approx([float(c) for c in momentum], rel=16.0 * EPS)

    def test_angular_momentum_about_the_center_of_mass(self, body: RigidBody) -> None:
        motion = particle_motion()
        center = times(1 / sum(MASSES), total([times(m, x) for m, x, _ in motion]))
        spin = total([times(m, cross(plus(x, times(Fraction(-1), center)), v)) for m, x, v in motion])

        assert sample(body).angular_momentum_world == pytest.approx([float(c) for c in spin], abs=32.0 * EPS * 4.0)

    def test_center_of_mass(self, body: RigidBody) -> None:
        center = times(1 / sum(MASSES), total([times(m, x) for m, x, _ in particle_motion()]))

        assert PhaseState.of(body, STATE).center_of_mass_world == pytest.approx(
            [float(c) for c in center], rel=8.0 * EPS
        )


class TestSample:
    def test_is_the_state_itself(self, body: RigidBody) -> None:
        found = sample(body)

        assert found.time_ns == 42
        assert math.dist(found.position_world, STATE.position_world) <= 4.0 * EPS
        assert math.dist(found.linear_velocity_world, STATE.linear_velocity_world) <= 8.0 * EPS
        assert math.dist(found.angular_velocity_body, STATE.angular_velocity_body) <= 4.0 * EPS
        assert math.dist(found.orientation_xyzw, STATE.orientation_xyzw) <= 4.0 * EPS

    def test_defects_begin_at_zero_to_the_bit(self, body: RigidBody) -> None:
        found = sample(body)

        assert found.work == found.energy_defect == 0.0
        assert found.angular_momentum_defect_world == found.linear_momentum_defect_world == (0.0, 0.0, 0.0)

    def test_field_names_are_those_of_the_contract(self) -> None:
        assert [f.name for f in dataclasses.fields(Sample)] == [
            "time_ns",
            "position_world",
            "orientation_xyzw",
            "linear_velocity_world",
            "angular_velocity_body",
            "angular_momentum_world",
            "linear_momentum_world",
            "kinetic_energy",
            "work",
            "energy_defect",
            "angular_momentum_defect_world",
            "linear_momentum_defect_world",
            "potential_energy",  # which the contract leaves open, as it does what follows, of scenes with wheels
            "wheel_speeds",
            "motor_work",
            "friction_heat",
        ]


class TestDefects:
    """A motion with a known error shows exactly that error, neither projected nor smoothed."""

    def test_energy_that_nobody_put_in_shows_whole(self) -> None:
        case = forced()
        phase = PhaseState.of(case.body, case.initial)
        wrong = phase._replace(angular_velocity=tuple(1.001 * w for w in phase.angular_velocity))

        found = SampleBuilder(CombinedEffects(case.body), phase).sample(wrong, 0)

        gained = kinetic_energy(case.body, wrong) - kinetic_energy(case.body, phase)
        spin = phase.angular_momentum_world(case.body)
        assert gained > 1e-3
        assert found.energy_defect == gained
        assert found.angular_momentum_defect_world == pytest.approx([0.001 * c for c in spin], rel=1e-10)
        assert found.linear_momentum_defect_world == (0.0, 0.0, 0.0)

    def test_books_without_motion_show_with_the_opposite_sign(self) -> None:
        case = forced()
        phase = PhaseState.of(case.body, case.initial)
        high = list(phase.high)
        high[6:13] = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]  # impulse, torque impulse, work

        found = SampleBuilder(CombinedEffects(case.body), phase).sample(phase._replace(high=tuple(high)), 0)

        assert found.work == 7.0
        assert found.energy_defect == -7.0
        assert found.linear_momentum_defect_world == (-1.0, -2.0, -3.0)
        assert found.angular_momentum_defect_world == (-4.0, -5.0, -6.0)

    def test_baseline_is_the_start_not_zero(self) -> None:
        case = forced()
        phase = PhaseState.of(case.body, case.initial)
        later = phase._replace(angular_velocity=scale(2.0, phase.angular_velocity))
        first = SampleBuilder(CombinedEffects(case.body), phase).sample(phase, 0)

        found = SampleBuilder(CombinedEffects(case.body), phase).sample(later, 0)

        assert found.energy_defect == found.kinetic_energy - first.kinetic_energy
        assert found.angular_momentum_defect_world == subtract(
            found.angular_momentum_world, first.angular_momentum_world
        )
        assert found.linear_momentum_defect_world == ZERO


def test_acceleration_is_the_slope_of_the_velocities() -> None:
    """Of the body origin, away from the centre of mass, under torque and force of both kinds."""
    case, h = forced(), 1e-4
    run = Simulation(case.scene(Solver("taylor", step=0.01), 1.0, 1.0 / h))
    for topic, wrench in case.commands:
        run.post(topic, wrench)
    samples = []
    for k in (3999, 4000, 4001):
        run.advance(round(k * h * 1e9))
        samples.append(run.sample)
        if k == 4000:
            linear, angular = run.acceleration
    before, now, after = samples

    slope = [(b - a) / (2 * h) for a, b in zip(before.linear_velocity_world, after.linear_velocity_world, strict=True)]
    assert rotation.rotate(now.orientation_xyzw, linear) == pytest.approx(slope, rel=1e-6, abs=1e-7)
    slope = [(b - a) / (2 * h) for a, b in zip(before.angular_velocity_body, after.angular_velocity_body, strict=True)]
    assert angular == pytest.approx(slope, rel=1e-6, abs=1e-7)
