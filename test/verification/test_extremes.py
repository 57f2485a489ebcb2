"""Sizes, speeds and wrenches at the ends of the range of numbers: right within bounds or a clear error, never NaN."""

from __future__ import annotations

import dataclasses
import math
import random
from collections.abc import Iterable
from fractions import Fraction

import pytest
from free_reference import angle, free_rotation
from motions import EPS, METHODS, STEPPED, Case, forced, move, scene

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.errors import BodyError, ConvergenceError
from rb_dynamics.loads.wrench import HeldWrench, Wrench
from rb_dynamics.motion import Inertia
from rb_dynamics.motion import free_rotation as closed_form
from rb_dynamics.motion.phase_state import PhaseState
from rb_dynamics.numerics import rotation
from rb_dynamics.numerics.vector import ZERO, Vector, norm, scale
from rb_dynamics.run.sample import Sample
from rb_dynamics.run.simulate import simulate
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.scene.model import Scene, Solver

SECOND = 1_000_000_000

each_method = pytest.mark.parametrize("method", METHODS)
each_stepped = pytest.mark.parametrize("method", STEPPED)


def scaled(case: Case, length: int, mass: int) -> Case:
    """Return `case` in other units of length and mass, powers of two; the clock stays."""
    ell, m = 2.0**length, 2.0**mass
    body, held, initial = case.body, case.held, case.initial

    def larger(factor: float, v: Vector) -> Vector:
        return scale(factor, v)

    return Case(
        RigidBody(
            m * body.mass,
            tuple(larger(m * ell * ell, row) for row in body.inertia),  # type: ignore[arg-type]
            larger(ell, body.center_of_mass),
            larger(m * ell * ell, body.principal_moments),
            body.principal_orientation_xyzw,
        ),
        dataclasses.replace(
            initial,
            position_world=larger(ell, initial.position_world),
            linear_velocity_world=larger(ell, initial.linear_velocity_world),
        ),
        HeldWrench(
            larger(m * ell, held.force_body),
            larger(m * ell * ell, held.torque_body),
            larger(m * ell, held.force_world),
            larger(m * ell * ell, held.torque_world),
        ),
        {},
    )


def outcome(run: Scene, commands: Iterable[tuple[str, Wrench]] = ()) -> Sample | ConvergenceError:
    """Return how a run ends: with a state or with the one error that a run may end with."""
    try:
        return simulate(run, commands).sample
    except ConvergenceError as error:
        return error


def finite(sample: Sample) -> bool:
    values = [value for value in dataclasses.astuple(sample) if value is not None]
    return all(math.isfinite(c) for v in values for c in (v if isinstance(v, tuple) else (v,)))


class TestUnits:
    """Other units, powers of two apart, give the same digits to the last bit: masses and inertias 1e-20 to 1e20."""

    @each_stepped
    @pytest.mark.parametrize(("length", "mass"), [(0, 66), (0, -66), (33, 0), (-33, 0), (40, -66)])
    def test_of_length_and_mass_do_not_matter(self, method: str, length: int, mass: int) -> None:
        here, there = (move(case, STEPPED[method], 0.05, 2.0) for case in (forced(), scaled(forced(), length, mass)))

        ell, m = 2.0**length, 2.0**mass
        assert there.orientation == here.orientation
        assert there.angular_velocity == here.angular_velocity
        assert there.center_of_mass_world == scale(ell, here.center_of_mass_world)
        assert there.linear_momentum_world == scale(m * ell, here.linear_momentum_world)
        assert there.impulse_world == scale(m * ell, here.impulse_world)
        assert there.torque_impulse_world == scale(m * ell * ell, here.torque_impulse_world)
        assert there.work == m * ell * ell * here.work

    @each_stepped
    @pytest.mark.parametrize("exponent", [-330, -200, -60, -10, 10, 60, 200, 330])
    def test_of_time_do_not_matter(self, method: str, exponent: int) -> None:
        """Rates twice as fast, forces four times as large, steps half as long; a clear error where products overflow.

        At the ends the torques are 1e-200 and 1e200 and the rates 1e-100 and 1e100: their third powers are not numbers.
        """
        case, s = forced(), 2.0**exponent
        phase = PhaseState.of(case.body, case.initial)
        velocity = scale(1.0 / case.body.mass, phase.linear_momentum_world)
        inertia = (case.body.mass, case.body.principal_moments)
        quick = HeldWrench(*(scale(s * s, part) for part in case.held))
        step = STEPPED[method].step

        here = step(Inertia(*inertia), case.held, 0.125, velocity, phase.orientation, phase.angular_velocity)
        try:
            there = step(
                Inertia(*inertia),
                quick,
                0.125 / s,
                scale(s, velocity),
                phase.orientation,
                scale(s, phase.angular_velocity),
            )
        except ConvergenceError:
            assert exponent > 60
            return

        assert there.orientation == here.orientation
        assert there.displacement == here.displacement
        assert there.angular_velocity == scale(s, here.angular_velocity)
        assert there.impulse == scale(s, here.impulse)
        assert there.torque_impulse == scale(s, here.torque_impulse)
        assert there.work == s * s * here.work

    @pytest.mark.parametrize(("length", "mass"), [(33, 66), (-33, -66)])
    def test_do_not_matter_to_the_step_control(self, length: int, mass: int) -> None:
        solver = Solver("rkmk4", accuracy=1e-7)
        runs = [simulate(case.scene(solver, 1.0), case.commands) for case in (forced(), scaled(forced(), length, mass))]

        assert runs[0].steps == runs[1].steps
        assert runs[0].sample.orientation_xyzw == runs[1].sample.orientation_xyzw


class TestFarAway:
    @each_method
    def test_a_slow_body_at_1e12_m_arrives(self, method: str) -> None:
        """Each of 1000 steps moves it by a tenth of a unit in the last place; all together by 80 of them."""
        body = RigidBody.from_diagonal(1.0, (1.0, 1.5, 2.0))
        initial = State(position_world=(1e12, -1e12, 0.0), linear_velocity_world=(1e-2, 1e-2, 1e-2))

        phase = move(Case(body, initial, HeldWrench(), {}), METHODS[method], 1e-3, 1.0)

        expected = [Fraction(p) + Fraction(1e-2) for p in (1e12, -1e12, 0.0)]
        for found, exact in zip(phase.center_of_mass_world, expected, strict=True):
            assert abs(Fraction(found) - exact) <= Fraction(math.ulp(float(exact)))

    @each_stepped
    def test_a_tumbling_body_turns_there_as_it_does_here(self, method: str) -> None:
        here = forced()
        far = dataclasses.replace(here, initial=dataclasses.replace(here.initial, position_world=(1e12, 1e12, -1e12)))

        a, b = (move(case, STEPPED[method], 0.01, 1.0) for case in (here, far))

        assert b.orientation == a.orientation
        assert b.linear_momentum_world == a.linear_momentum_world
        moved = [
            p - q
            for p, q in zip(
                b.center_of_mass_world, PhaseState.of(far.body, far.initial).center_of_mass_world, strict=True
            )
        ]
        also = [
            p - q
            for p, q in zip(
                a.center_of_mass_world, PhaseState.of(here.body, here.initial).center_of_mass_world, strict=True
            )
        ]
        assert math.dist(moved, also) <= 2.0 * math.ulp(1e12)


class TestRest:
    @each_method
    def test_nothing_moves_what_nothing_acts_on(self, method: str) -> None:
        initial = dataclasses.replace(forced().initial, linear_velocity_world=ZERO, angular_velocity_body=ZERO)
        still = scene(forced().body, initial, Solver(method, step=0.1), 10.0, 1.0)

        sample = simulate(still).sample

        first = Simulation(still).sample
        assert dataclasses.replace(sample, time_ns=0) == first
        assert sample.angular_velocity_body == sample.linear_velocity_world == ZERO
        assert sample.energy_defect == 0.0

    @each_method
    @pytest.mark.parametrize("axis", [0, 1, 2])
    @pytest.mark.parametrize(
        ("orientation", "rate"),
        [((0.0, 0.0, 0.0, 1.0), 0.3), ((0.5, -0.1, 0.7, 0.5), -2.0), ((1.0, 0.0, 0.0, 0.0), 1e-12)],
    )
    def test_spin_on_a_principal_axis_stays_there_to_the_bit(
        self, method: str, axis: int, orientation: tuple[float, float, float, float], rate: float
    ) -> None:
        """Also on the middle axis, where the smallest deviation would grow."""
        spin = tuple(rate * (i == axis) for i in range(3))
        body = RigidBody.from_diagonal(1.0, (1.1, 2.3, 3.1))
        initial = State(orientation_xyzw=orientation, angular_velocity_body=spin)
        run = Simulation(scene(body, initial, Solver(method, step=0.1), 12.0, 1.0))

        run.advance(SECOND)
        early = run.sample
        run.advance(12 * SECOND)

        w = run.sample.angular_velocity_body
        assert [c for i, c in enumerate(w) if i != axis] == [0.0, 0.0]
        assert w[axis] == pytest.approx(rate, rel=600.0 * EPS)
        assert run.sample.time_ns > early.time_ns
        unit = tuple(float(i == axis) for i in range(3))
        before, after = (rotation.rotate(q, unit) for q in (orientation, run.sample.orientation_xyzw))
        assert math.dist(before, after) <= 600.0 * EPS


class TestNeedle:
    """Slender bodies: the spin about the long axis hangs on the last digits of the angular momentum."""

    @pytest.mark.parametrize("method", ["euler", "rk4", "dverk", "dop853"])
    @pytest.mark.parametrize("ratio", [1e-3, 1e-6, 1e-9, 1e-12])
    def test_its_spin_takes_no_part_in_the_rounding_of_larger_products(self, method: str, ratio: float) -> None:
        """Symmetric: the spin is constant, as what turns it is the difference of two equal moments, not of products."""
        body = RigidBody.from_diagonal(1.0, (1.3 * ratio, 1.3, 1.3))
        case = Case(body, State(angular_velocity_body=(0.3, 0.5, -0.4)), HeldWrench(), {})

        assert move(case, METHODS[method], 0.01, 10.0).angular_velocity[0] == 0.3

    @each_stepped
    @pytest.mark.parametrize("ratio", [1e-3, 1e-6, 1e-9, 1e-12])
    def test_is_never_wrong_in_silence_by_more_than_its_energy_says(self, method: str, ratio: float) -> None:
        """If a method cannot resolve the motion, it raises an error or the defects show it; never NaN."""
        body = RigidBody.from_diagonal(1.0, (ratio, 1.0, 1.0))
        run = scene(body, State(angular_velocity_body=(0.3, 0.5, -0.4)), Solver(method, step=0.01), 2.0, 10.0)

        sample = outcome(run)

        if isinstance(sample, ConvergenceError):
            assert "use a step below" in str(sample)
            return
        assert finite(sample)
        gained = 0.5 * ratio * abs(sample.angular_velocity_body[0] ** 2 - 0.09)
        assert gained <= 1.01 * abs(sample.energy_defect) + 1e-9


# Moments, spin and time where a product of two rates or the distance from the separatrix underflows or overflows.
UNDERFLOWS = {
    "distance from the separatrix, prolate": ((1e-3, 1.0, 1.0), (1e-170, 1e-100, 2e-100), 1.0),
    "distance from the separatrix, needle at work": ((1e-3, 1.0, 1.0), (1e-170, 1.0, 2.0), 10.0),
    "distance from the separatrix, oblate": ((1.0, 1.0, 2.0), (1e-170, 1.0, 1e-170), 1.0),
    "distance from the separatrix, triaxial": ((1.3, 1.9, 1.0), (0.0143, 2e-167, 2.9e-156), 70.0),
    "on the middle axis but for 1e-170": ((1.0, 1.5, 2.0), (1e-170, 1.0, 1e-170), 1.0),
    "amplitude, about the axis of symmetry": ((2.0, 1.0, 2.0), (0.0, 1e-155, 1.0), 1.0),
    "amplitude, far below": ((7.4e19, 1.6e19, 7.4e19), (0.0, 5.5e-185, -1.7e-3), 600.0),
    "squares of all rates, large": ((1.0, 1.5, 2.0), (1e160, 2e160, -1e160), 3e-160),
    "squares of all rates, small": ((1.0, 1.5, 2.0), (1e-200, 2e-200, -1e-200), 3e200),
    "moments, small": ((1e-180, 1.5e-180, 2e-180), (0.1, 2.0, 0.1), 5.0),
    "moments, large": ((1e180, 1.5e180, 2e180), (0.1, 2.0, 0.1), 5.0),
    "moments one unit apart, spin between them": ((1.9, 1.0, math.nextafter(1.0, 2.0)), (0.0, 1.0, 1.0), 1.0),
    "the same, for an hour": ((1.0, 1.9, math.nextafter(1.0, 2.0)), (1.0, 0.0, 1.0), 4444.0),
    "moments 1e-9 apart, spin between them": ((1.0, 1.0 + 1e-9, 2.0), (1.0, 1.0, 0.0), 1.0),
}


class TestFreeRotation:
    """The closed form where its formulas are worst, against hundreds of digits."""

    @pytest.mark.parametrize(("moments", "spin", "time"), UNDERFLOWS.values(), ids=list(UNDERFLOWS))
    def test_is_right_where_products_underflow(self, moments: Vector, spin: Vector, time: float) -> None:
        turn, omega = closed_form.free_rotation(moments, spin, time)

        expected, rates = free_rotation(moments, spin, time, 450)
        bound = 100.0 * EPS * (1.0 + norm(spin) * time)
        assert angle(expected, turn) <= bound
        assert max(abs(float(a - b)) for a, b in zip(rates, omega, strict=True)) <= bound * norm(spin)

    @pytest.mark.parametrize("off", [1e-8, 1e-30, 1e-100, 1e-140, 1e-160, 1e-190])
    @pytest.mark.parametrize("turned", [0.5, 1.5, 3.5])
    def test_flips_late_beside_the_middle_axis_or_says_that_it_cannot_tell(self, off: float, turned: float) -> None:
        """Times in units of the time of the first flip, ln(4/off) in du; each is longer the closer the axis is."""
        moments, spin = (1.0, 1.5, 2.0), (off, 1.0, 2.0 * off)
        time = turned * math.log(4.0 / off) / math.sqrt(1.0 / 6.0)

        try:
            turn, omega = closed_form.free_rotation(moments, spin, time)
        except ConvergenceError:
            assert off < 1e-130, "far enough to be told"
            assert turned > 1.0, "it has not left the axis"
            return

        # Squares of `off` beside 1, and 70 digits of those.
        expected, rates = free_rotation(moments, spin, time, round(70.0 - 2.0 * math.log10(off)))
        bound = 100.0 * EPS * (1.0 + norm(spin) * time)
        assert angle(expected, turn) <= bound
        assert max(abs(float(a - b)) for a, b in zip(rates, omega, strict=True)) <= bound

    @each_method
    def test_does_not_creep_where_it_underflows(self, method: str) -> None:
        """In 100 steps of 0.01 s a rate of 1e-100 rad/s changes nothing: neither itself nor the attitude."""
        spin = (1e-170, 1e-100, 2e-100)
        body = RigidBody.from_diagonal(1.0, (1e-3, 1.0, 1.0))

        sample = simulate(scene(body, State(angular_velocity_body=spin), Solver(method, step=0.01))).sample

        assert math.dist(sample.angular_velocity_body, spin) <= 1e-13 * 2e-100
        assert rotation.angle_between(sample.orientation_xyzw, rotation.IDENTITY) <= 100.0 * EPS

    @pytest.mark.parametrize("method", ["exact", "auto"])
    @pytest.mark.parametrize("rate", [1e17, 1e54, 1e150])
    def test_without_a_correct_digit_is_refused(self, method: str, rate: float) -> None:
        """1e17 rad are known to 10 rad only, so `free_motion` refuses."""
        body = RigidBody.from_diagonal(1.0, (1.0, 1.5, 2.0))

        with pytest.raises(ConvergenceError):
            simulate(scene(body, State(angular_velocity_body=(rate, 0.5 * rate, 2.0 * rate)), Solver(method)))


class TestProducts:
    """Finite numbers whose products overflow or underflow."""

    @each_method
    @pytest.mark.parametrize("rate", [1e150, 1e160])
    def test_an_energy_beyond_the_range_is_an_error(self, method: str, rate: float) -> None:
        body = RigidBody.from_diagonal(1.0, (1e20, 1.5e20, 2e20))
        start = State(angular_velocity_body=(rate, 1.0, 2.0 * rate))

        with pytest.raises(ConvergenceError, match="no longer finite"):
            simulate(scene(body, start, Solver(method, step=1e-9), 1e-8))

    @each_stepped
    @pytest.mark.parametrize("rate", [1e54, 1e77, 1e103, 1e130])
    @pytest.mark.parametrize("step", [0.01, 1e-9])
    def test_a_spin_that_no_step_resolves_is_an_error(self, method: str, rate: float, step: float) -> None:
        """Second, third and higher powers of the rate leave the range one after the other."""
        body = RigidBody.from_diagonal(1.0, (1.0, 1.5, 2.0))
        start = State(angular_velocity_body=(rate, 0.5 * rate, 2.0 * rate))

        with pytest.raises(ConvergenceError, match=r"step|finite"):
            simulate(scene(body, start, Solver(method, step=step), 3.0 * step))

    @each_stepped
    @pytest.mark.parametrize("frame", ["body", "world"])
    def test_a_light_body_under_a_large_force_flies_as_newton_says(self, method: str, frame: str) -> None:
        """1e20 N on 1e-20 kg for a second: 5e39 m, whatever the body was doing before."""
        body = RigidBody.from_diagonal(1e-20, (1e-20, 1.5e-20, 2e-20))
        commands = [("wrench", Wrench((1e20, -2e20, 1e20), ZERO, frame))]

        sample = simulate(
            scene(body, State(linear_velocity_world=(1.0, 2.0, 3.0)), Solver(method, step=0.01)), commands
        )

        far = sample.sample
        for found, force in zip(far.position_world, (1e20, -2e20, 1e20), strict=True):
            # A method of low order may see the force at other times than all of them: order 1 by half a step.
            assert found == pytest.approx(0.5 * force / 1e-20, rel=0.011 if STEPPED[method].order < 2 else 1e-13)
        assert far.linear_velocity_world == pytest.approx((1e40, -2e40, 1e40), rel=1e-13)
        assert far.kinetic_energy == pytest.approx(0.5e-20 * 6e80, rel=1e-13)
        assert abs(far.energy_defect) <= (0.011 if STEPPED[method].order < 2 else 1e-13) * far.kinetic_energy

    @each_stepped
    @pytest.mark.parametrize("frame", ["body", "world"])
    def test_a_light_body_under_a_large_torque_coasts_or_keeps_its_books(self, method: str, frame: str) -> None:
        """1e6 turns in the first step. Where that is not rejected, the balances are those of the method."""
        body = RigidBody.from_diagonal(1e-20, (1e-20, 1.5e-20, 2e-20))
        commands = [("wrench", Wrench(ZERO, (1e-9, 0.0, 1e-9), frame))]
        run = scene(body, State(angular_velocity_body=(1.0, 0.5, 2.0)), Solver(method, step=0.01))

        end = outcome(run, commands)

        if isinstance(end, ConvergenceError):
            assert "step" in str(end)
            return
        if rejected := simulate(run, commands).rejected:
            assert "not one step can be taken under it" in rejected[0]
            assert end == outcome(run)
            return
        assert finite(end)
        assert "energy" in STEPPED[method].invariants
        assert abs(end.energy_defect) <= 1e-12 * end.kinetic_energy

    @pytest.mark.parametrize(
        "inertia",
        [
            [[1e308, 1e307, 0.0], [1e307, 1.2e308, 0.0], [0.0, 0.0, 1.5e308]],
            [[1e200, 1e199, -2e199], [1e199, 1.2e200, 0.0], [-2e199, 0.0, 1.5e200]],
            [[1e-200, 1e-201, -2e-201], [1e-201, 1.2e-200, 0.0], [-2e-201, 0.0, 1.5e-200]],
            [[5e-324, 0.0, 0.0], [0.0, 5e-324, 0.0], [0.0, 0.0, 5e-324]],
            [[1e-310, 1e-311, 0.0], [1e-311, 1e-310, 0.0], [0.0, 0.0, 1e-310]],
        ],
    )
    def test_an_inertia_at_the_ends_of_the_range_is_a_body_or_is_refused(self, inertia: list[list[float]]) -> None:
        try:
            body = RigidBody.from_matrix(1.0, inertia)
        except BodyError:
            return
        assert sum(body.principal_moments) == pytest.approx(sum(inertia[i][i] for i in range(3)), rel=1e-9)
        # Slow enough for every product of three: the motion of the same body in other units.
        exponent = math.frexp(inertia[0][0])[1]
        same = RigidBody.from_matrix(1.0, [[math.ldexp(c, -exponent) for c in row] for row in inertia])
        start = State(angular_velocity_body=(0.1, 2.0, 0.1))

        for method in METHODS:
            here = outcome(scene(body, start, Solver(method, step=0.01), 0.1))
            there = outcome(scene(same, start, Solver(method, step=0.01), 0.1))
            assert isinstance(there, Sample)
            if isinstance(here, Sample):
                assert finite(here)
                if min(body.principal_moments) > 1e-300:
                    turn = rotation.angle_between(here.orientation_xyzw, there.orientation_xyzw)
                    assert turn <= 1e-12, method

    @pytest.mark.parametrize("method", ["auto", "exact", "dop853", "radau"])
    def test_an_inertia_with_too_few_digits_is_refused(self, method: str) -> None:
        """Driven, a sphere of 1e-320 kg m^2 turned 4e-4 too little."""
        body = RigidBody.from_diagonal(1.0, (1e-320, 1e-320, 1e-320))

        end = outcome(scene(body, State(angular_velocity_body=(1.0, 2.0, 3.0)), Solver(method), 2.0))

        assert isinstance(end, ConvergenceError)
        assert "1e-320 kg m^2, expected at least 2.23e-308" in str(end)


class TestWrenches:
    @each_stepped
    def test_that_reverse_each_step_leave_nothing_behind(self, method: str) -> None:
        """From rest, +N and -N in turn about one axis: after each pair the rate is zero, the angle N h^2 / I more."""
        body = RigidBody.from_diagonal(2.0, (0.5, 1.0, 1.25))
        h_ns, pairs = 10_000_000, 250
        commands = [
            ("wrench", Wrench((0.0, 8.0 * (-1) ** k, 0.0), (0.0, 0.0, 2.0 * (-1) ** k), "world", k * h_ns))
            for k in range(2 * pairs)
        ]

        run = simulate(scene(body, State(), Solver(method, step=0.01), 2 * pairs * 0.01, 1.0), commands)

        h = 0.01
        assert run.steps == 2 * pairs
        assert norm(run.sample.angular_velocity_body) <= 2 * pairs * EPS * 2.0 * h / 1.25
        assert norm(run.sample.linear_velocity_world) <= 2 * pairs * EPS * 8.0 * h / 2.0
        assert run.sample.position_world[1] == pytest.approx(pairs * h * h * 8.0 / 2.0, rel=1e-13)
        turned = rotation.log(run.sample.orientation_xyzw)
        assert turned[:2] == (0.0, 0.0)
        assert turned[2] == pytest.approx(pairs * h * h * 2.0 / 1.25, rel=1e-9)
        assert abs(run.sample.energy_defect) <= 1e-14

    @each_stepped
    @pytest.mark.parametrize("frame", ["body", "world"])
    def test_that_reverse_each_step_on_a_tumbling_body_are_followed(self, method: str, frame: str) -> None:
        """Force and torque change sign 200 times a second, off all axes: within the order of the method of `taylor`."""
        case, h_ns, count = forced(), 5_000_000, 200
        commands = [
            (
                "body",
                Wrench(scale((-1.0) ** k, (8.0, 3.0, -5.0)), scale((-1.0) ** k, (2.0, -3.0, 1.0)), frame, k * h_ns),
            )
            for k in range(count)
        ]

        ends = [
            simulate(case.scene(Solver(name, step=0.005), 1.0, 1.0), commands).sample for name in (method, "taylor")
        ]

        order = STEPPED[method].order
        tolerance = max(1e-12, 20.0 * 0.02**order)
        assert rotation.angle_between(*(end.orientation_xyzw for end in ends)) <= tolerance
        for name in ("angular_velocity_body", "position_world", "linear_velocity_world"):
            assert math.dist(*(getattr(end, name) for end in ends)) <= tolerance, name

    @each_stepped
    @pytest.mark.parametrize("size", [5e-324, 1e-310, 1e-160])
    @pytest.mark.parametrize("frame", ["body", "world"])
    def test_that_are_hardly_there_do_hardly_anything(self, method: str, size: float, frame: str) -> None:
        commands = [("wrench", Wrench((size, -size, size), (size, size, -size), frame))]

        sample = simulate(scene(forced().body, State(), Solver(method, step=0.1), 1.0, 10.0), commands).sample

        assert finite(sample)
        for found in (sample.linear_momentum_world, sample.angular_momentum_world):
            assert norm(found) <= 4.0 * size
        # Ten steps of 0.1 s; the impulse of a step is rounded to the smallest number there is.
        assert sample.linear_momentum_world[0] == pytest.approx(size, rel=1e-2, abs=20 * 5e-324 + 0.3 * size)

    @each_stepped
    def test_of_zero_are_no_wrench(self, method: str) -> None:
        commands = [("wrench", Wrench(ZERO, ZERO, frame, 0)) for frame in ("body", "world")]
        plain = scene(forced().body, forced().initial, Solver(method, step=0.05), 1.0, 10.0)

        assert simulate(plain, commands).sample == simulate(plain).sample

    @each_stepped
    @pytest.mark.parametrize("part", ["force", "torque"])
    @pytest.mark.parametrize("frame", ["body", "world"])
    @pytest.mark.parametrize("size", [1e200, 1.7e308])
    def test_that_leave_the_range_of_numbers_are_rejected(
        self, method: str, part: str, frame: str, size: float
    ) -> None:
        commands = [("wrench", Wrench(**{part: (size, -size, size)}, frame_id=frame))]
        plain = scene(forced().body, forced().initial, Solver(method, step=0.05), 1.0, 1.0)

        run = simulate(plain, commands)

        assert f"wrench {part} about the centre of mass" in run.rejected[0]
        assert run.sample == simulate(plain).sample

    @each_stepped
    def test_that_are_possible_for_an_hour_are_an_error_where_they_last_longer(self, method: str) -> None:
        commands = [("wrench", Wrench((3e150, -3e150, 0.0), ZERO, "world"))]

        with pytest.raises(ConvergenceError, match="no longer finite"):
            simulate(scene(forced().body, State(), Solver(method, step=500.0), 1e5, 1e-4), commands)

    @each_stepped
    def test_large_but_finite_is_no_error(self, method: str) -> None:
        """The sum of finite numbers may overflow; the numbers are still good."""
        far = State(position_world=(1.2e308, 1.2e308, -1.2e308))

        assert simulate(scene(forced().body, far, Solver(method, step=0.5), 1.0)).sample.time_ns == SECOND


class TestSteps:
    @each_method
    @pytest.mark.parametrize("turns", [0.6, 1.4, 3.3, 25.0])
    def test_of_several_turns_are_right_or_an_error(self, method: str, turns: float) -> None:
        """In free motion, conserved energy and momentum do not reveal unresolved rotations; the attitude does."""
        moments, spin = (1.0, 1.5, 2.0), (0.3, 1.1, 0.7)
        step = turns * 2.0 * math.pi / norm(spin)
        start = State(angular_velocity_body=spin)

        end = outcome(scene(RigidBody.from_diagonal(1.0, moments), start, Solver(method, step=step), 10.0 * step, 0.0))

        if isinstance(end, ConvergenceError):
            assert "step" in str(end)
            return
        assert finite(end)
        expected, _ = free_rotation(moments, spin, 10.0 * step)
        error = angle(expected, end.orientation_xyzw)
        if error > 1e-9:
            # Not resolved, as its order says of such a step; then at least the books must show it or be kept.
            kept = "energy" in METHODS[method].invariants
            assert abs(end.energy_defect) <= 1e-12 * end.kinetic_energy if kept else end.energy_defect != 0.0

    @each_stepped
    @pytest.mark.parametrize("step", [5.0, 1e6, 1e300])
    def test_of_many_turns_are_an_error_or_keep_what_is_declared(self, method: str, step: float) -> None:
        duration = min(10.0 * step, 1e9)
        run = scene(
            forced().body, forced().initial, Solver(method, step=step), duration, 1.0 / step if step < 1e9 else 1e-9
        )

        sample = outcome(run)

        if isinstance(sample, ConvergenceError):
            assert "step" in str(sample)
            return
        assert finite(sample)
        assert abs(math.hypot(*sample.orientation_xyzw) - 1.0) <= 4.0 * EPS
        if "energy" in STEPPED[method].invariants:
            assert abs(sample.energy_defect) <= 1e-12 * sample.kinetic_energy

    @each_stepped
    @pytest.mark.parametrize("rate", [1e10, 1e50, 1e155, 1e300])
    def test_of_a_body_that_spins_beyond_measure_are_an_error(self, method: str, rate: float) -> None:
        spin = State(angular_velocity_body=(0.7 * rate, -1.1 * rate, 0.9 * rate))

        with pytest.raises(ConvergenceError):
            simulate(scene(forced().body, spin, Solver(method, step=1.0), 10.0))

    @pytest.mark.parametrize("field", ["position_world", "linear_velocity_world", "angular_velocity_body"])
    @pytest.mark.parametrize("bad", [math.nan, math.inf])
    def test_a_state_that_is_not_finite_is_an_error(self, field: str, bad: float) -> None:
        start = dataclasses.replace(State(), **{field: (bad, 0.0, 0.0)})

        with pytest.raises(ValueError, match=rf"initial\.{field} is .* expected .* three finite numbers"):
            scene(forced().body, start, Solver("auto"), 1.0)

    @each_method
    def test_an_energy_that_is_not_finite_is_an_error(self, method: str) -> None:
        """The velocity is finite, its square overflows."""
        start = State(linear_velocity_world=(1e160, 0.0, 0.0))

        with pytest.raises(ConvergenceError, match="no longer finite"):
            simulate(scene(forced().body, start, Solver(method, step=0.1), 1.0))

    @each_stepped
    def test_of_a_nanosecond_add_up(self, method: str) -> None:
        case = forced()
        run = case.scene(Solver(method, step=1e-9), 2e-7, 0.0)

        many = simulate(run, case.commands)
        one = simulate(case.scene(Solver(method, step=2e-7), 2e-7, 0.0), case.commands)

        assert many.steps == 200
        # The attitude walks at random, a rounding in each step, and takes the body origin with it.
        assert rotation.angle_between(many.sample.orientation_xyzw, one.sample.orientation_xyzw) <= 600 * EPS
        assert math.dist(many.sample.position_world, one.sample.position_world) <= 600 * EPS
        assert many.sample.work == pytest.approx(one.sample.work, rel=1e-12)


class TestAnyNumbers:
    """Whatever the numbers are, a run ends, with a finite state or with the one error that a run may end with."""

    @pytest.mark.parametrize(
        ("solver", "moments", "spin", "torque", "frame"),
        [
            pytest.param(
                Solver("strang6", step=1e-3),
                (1.9e-25, 2.65e-18, 2.65e-18),
                (0.0, 2.96e-272, -1.36e-271),
                (0.0, -6e-57, 0.0),
                "body",
                id="squares of the rates underflow",
            ),
            pytest.param(
                Solver("taylor", accuracy=3e-5),
                (1.4e-8, 1.4e-8, 1.4e-8),
                (1.5e-28, 6e-36, 0.0),
                ZERO,
                "body",
                id="coefficients underflow",
            ),
            pytest.param(
                Solver("taylor", accuracy=2e-5),
                (5e-21, 3.5e-12, 3.5e-12),
                (0.0, 1e144, 3e146),
                ZERO,
                "body",
                id="coefficients overflow",
            ),
            pytest.param(
                Solver("midpoint4", step=1466.257141729185),
                (1.78e-5, 1.78e-5, 3.56e-5),
                (0.0, 8396.0, 450.0),
                (-1.7e23, 4.2e22, -4.4e24),
                "world",
                id="Jacobian is singular",
            ),
            pytest.param(
                Solver("strang6", step=0.05),
                (7.6e16, 7.5e19, 7.5e19),
                (0.0, 4.2e-159, -1.4e-159),
                (0.0, 0.0, -4.9e152),
                "body",
                id="iterations on what is no number",
            ),
            pytest.param(
                Solver("auto"), (3.3e-20, 5.7e-20, 5.7e-20), (0.0, -1.8e156, 0.0), ZERO, "body", id="angle overflows"
            ),
            pytest.param(
                Solver("exact"), (4.85e8, 7.28e8, 9.7e8), (1e-269, 1.4e6, 0.0), ZERO, "body", id="near the middle axis"
            ),
        ],
    )
    def test_found_by_searching(
        self, solver: Solver, moments: Vector, spin: Vector, torque: Vector, frame: str
    ) -> None:
        turning = scene(
            RigidBody.from_diagonal(1.0, moments), State(angular_velocity_body=spin), solver, 3.0 * (solver.step or 1.0)
        )

        end = outcome(turning, [("wrench", Wrench(ZERO, torque, frame))] if torque != ZERO else [])

        assert isinstance(end, ConvergenceError) or finite(end)

    @each_method
    def test_drawn_at_random(self, method: str) -> None:
        """Sizes uniform in the exponent over the whole range, many components zero; the seed is fixed."""
        draw = random.Random(method)

        def vector(low: float, high: float) -> Vector:
            middle = draw.uniform(low, high)
            x, y, z = (
                draw.choice((0.0, 1.0, -1.0, 1.0)) * 10.0 ** min(max(draw.gauss(middle, 2.0), -323.0), 308.0)
                for _ in range(3)
            )
            return (x, y, z)

        for _ in range(40):
            size, ratio = 10.0 ** draw.uniform(-20.0, 20.0), 10.0 ** draw.uniform(-9.0, 0.0)
            shapes = ((ratio, 1.0, 1.0), (1.0, 1.0 + ratio, 2.0), (1.0, 1.0, 1.0), (1.0, 1.0 + EPS, 1.5))
            body = RigidBody.from_diagonal(10.0 ** draw.uniform(-20.0, 20.0), scale(size, draw.choice(shapes)))
            low, high = draw.choice(((-12.0, 6.0), (-320.0, 300.0)))
            start = State(0, vector(low, high), (0.5, -0.5, 0.5, 0.5), vector(low, high), vector(low, high))
            duration = 10.0 ** draw.uniform(-6.0, 4.0)
            run = scene(body, start, Solver(method, step=max(1e-9, duration / 3.0)), duration, 0.0)
            wrench = Wrench(vector(low, high), vector(low, high), draw.choice(("body", "world")))

            end = outcome(run, [("wrench", wrench)] if draw.random() < 0.7 else [])

            assert isinstance(end, ConvergenceError) or finite(end)
