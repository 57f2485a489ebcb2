"""Preprocessed discrete Moser-Veselov: its equations, its order to many digits, its invariants, splittings with it."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import pytest
from motions import EPS, Case, attitude_error, forced, free, move
from mpmath import mp, mpf
from word_series import measured_orders

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import METHODS, Inertia, splitting
from rb_dynamics.motion.closed_form import EXACT
from rb_dynamics.motion.free_rotation import free_rotation
from rb_dynamics.motion.method import Method
from rb_dynamics.motion.moser_veselov import _DENOMINATORS, DMV82, DMV104, DMV864, _preprocessing, flow
from rb_dynamics.motion.phase_state import PhaseState
from rb_dynamics.motion.splitting import ABA82_STAGES, ABA104_STAGES, ABA864_STAGES, Stages
from rb_dynamics.numerics.rotation import IDENTITY, angle_between, matrix, rotate
from rb_dynamics.numerics.vector import Vector, dot, multiply, norm, scale, subtract

each = pytest.mark.parametrize("method", [DMV82, DMV864, DMV104], ids=lambda method: method.name)

MOMENTS: Vector = (1.5, 2.1, 3.1)
OMEGA: Vector = (0.7, -1.1, 0.9)
BODIES: list[Vector] = [MOMENTS, (1.0, 2.0, 2.9), (1.0, 1.0, 1.0), (1.0, 1.7, 2.7), (0.01, 1.0, 1.003), (2.0, 1.0, 1.0)]


def exact_momentum(moments: list[mpf], m: list[mpf], t: mpf) -> list[mpf]:
    """Return the body's angular momentum after t s of free motion by the Taylor series of Euler's equations."""
    series = [[x] for x in m]
    for k in range(30):
        new = []
        for j in range(3):
            a, b = (j + 1) % 3, (j + 2) % 3
            product = mp.fsum(x * y for x, y in zip(series[a], reversed(series[b]), strict=True))
            new.append((1 / moments[b] - 1 / moments[a]) * product / (k + 1))
        for row, x in zip(series, new, strict=True):
            row.append(x)
    return [mp.fsum(x * t**k for k, x in enumerate(row)) for row in series]


def discrete_momentum(moments: list[mpf], m: list[mpf], t: mpf) -> list[mpf]:
    """Return it after a step of Moser & Veselov's equation R D - D R^T = t hat(m), m1 = R^T m, by matrices."""
    half_trace = mp.fsum(moments) / 2
    d = mp.diag([half_trace - i for i in moments])
    target = t * mp.matrix([[0, -m[2], m[1]], [m[2], 0, -m[0]], [-m[1], m[0], 0]])

    def turn(v: list[mpf]) -> mp.matrix:
        return mp.expm(mp.matrix([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]]))

    v = [t * x / i for x, i in zip(m, moments, strict=True)]
    for _ in range(40):
        r = turn(v)
        rest = target - (r * d - d * r.T)
        change = [rest[2, 1] / moments[0], rest[0, 2] / moments[1], rest[1, 0] / moments[2]]
        v = [x + c for x, c in zip(v, change, strict=True)]
        if max(map(abs, change)) < mpf(10) ** -58:
            break
    return list(turn(v).T * mp.matrix(m))


@pytest.mark.parametrize("terms", range(5))
def test_each_term_of_the_preprocessing_raises_the_order_by_two(terms: int) -> None:
    """To 60 digits, where the order is an integer to many places and any wrong coefficient shows."""
    with mp.workdps(60):
        moments = [mpf(3) / 2, mpf(21) / 10, mpf(31) / 10]

        def error(m: list[mpf], t: mpf) -> mpf:
            energy = t * t * mp.fsum(x * x / i for x, i in zip(m, moments, strict=True)) / 2
            square = t * t * mp.fsum(x * x for x in m) / 2
            stretch, shift = mpf(1), mpf(0)
            rows = zip(_preprocessing(tuple(moments)), _DENOMINATORS, strict=True)
            for k, ((s, d), denominator) in enumerate(itertools.islice(rows, terms), 1):
                for a in range(k + 1):
                    stretch += s[a] * energy**a * square ** (k - a) / denominator
                    shift += d[a] * energy**a * square ** (k - a) / denominator
            modified = [1 / (stretch / i + shift) for i in moments]
            found, expected = discrete_momentum(modified, m, t), exact_momentum(moments, m, t)
            return mp.norm([x - y for x, y in zip(found, expected, strict=True)])

        for m in ([mpf(1), mpf(2), mpf(3)], [mpf(1), mpf(1) / 5, mpf(-1) / 2]):
            order = mp.log(error(m, mpf(1) / 500) / error(m, mpf(1) / 1000), 2)
            assert abs(order - (2 * terms + 3)) < 0.01


class TestFlow:
    def test_solves_the_equation_of_moser_and_veselov(self) -> None:
        """Of the modified body: R D - D R^T and R^T of it are in the directions of m and m1 for one diagonal D."""
        t = 0.4
        q, omega = flow(MOMENTS, IDENTITY, OMEGA, t)
        r, m = matrix(q), multiply(MOMENTS, OMEGA)

        # R D - D R^T = t hat(m) is linear in D: three equations for its three entries.
        with mp.workdps(30):
            a = mp.matrix([[0, r[2][1], -r[1][2]], [-r[2][0], 0, r[0][2]], [r[1][0], -r[0][1], 0]])
            d = mp.lu_solve(a, mp.matrix([t * x for x in m]))
            modified = [float(d[1] + d[2]), float(d[2] + d[0]), float(d[0] + d[1])]

        # A sphere-like change: 1/J = stretch / I + shift for all three axes.
        x = [1.0 / i for i in MOMENTS]
        y = [1.0 / j for j in modified]
        assert (y[1] - y[0]) / (x[1] - x[0]) == pytest.approx((y[2] - y[0]) / (x[2] - x[0]), rel=1e-12)
        assert norm(subtract(rotate(q, multiply(MOMENTS, omega)), m)) <= 8.0 * EPS * norm(m)

    @pytest.mark.parametrize("moments", BODIES)
    def test_is_of_order_10(self, moments: Vector) -> None:
        def error(t: float) -> float:
            q, omega = flow(moments, IDENTITY, OMEGA, t)
            turn, spin = free_rotation(moments, OMEGA, t)
            return angle_between(q, turn) + math.dist(omega, spin)

        assert error(0.1) <= 1e-14
        assert math.log2(error(0.6) / error(0.3)) == pytest.approx(11.4, abs=0.4)

    @pytest.mark.parametrize("moments", BODIES)
    @pytest.mark.parametrize("t", [0.01, 0.3, 0.7, -0.5])
    def test_keeps_energy_and_angular_momentum(self, moments: Vector, t: float) -> None:
        """To round-off where its error is 1e-6."""
        q, omega = flow(moments, IDENTITY, OMEGA, t)

        m, after = multiply(moments, OMEGA), multiply(moments, omega)
        assert norm(subtract(rotate(q, after), m)) <= 16.0 * EPS * norm(m)
        assert dot(omega, after) == pytest.approx(dot(OMEGA, m), rel=16.0 * EPS)

    def test_is_symmetric(self) -> None:
        q, omega = flow(MOMENTS, *flow(MOMENTS, IDENTITY, OMEGA, 0.6), -0.6)

        assert angle_between(q, IDENTITY) <= 16.0 * EPS
        assert math.dist(omega, OMEGA) <= 32.0 * EPS

    @pytest.mark.parametrize("size", [1e-20, 1e20])
    def test_has_no_unit_of_its_own(self, size: float) -> None:
        q, omega = flow(scale(size, MOMENTS), IDENTITY, OMEGA, 0.5)
        expected, spin = flow(MOMENTS, IDENTITY, OMEGA, 0.5)

        assert angle_between(q, expected) <= 1e-14
        assert math.dist(omega, spin) <= 1e-14

    @pytest.mark.parametrize("omega", [(0.0, 0.0, 0.0), (0.0, 1e-310, 5e-324), (0.0, 0.0, 1.0)])
    def test_of_no_or_a_steady_spin_is_that_spin(self, omega: Vector) -> None:
        q, after = flow(MOMENTS, IDENTITY, omega, 0.5)

        assert math.dist(after, omega) <= EPS * norm(omega)
        assert angle_between(q, free_rotation(MOMENTS, omega, 0.5)[0]) <= 1e-10


class TestLimits:
    @pytest.mark.parametrize("t", [1.0, -2.5, 1e9, math.inf])
    def test_turns_beyond_a_radian_are_an_error(self, t: float) -> None:
        with pytest.raises(ConvergenceError, match=r"dmv: .* turn the body by .* expected less than 1\.2 rad; use a"):
            flow(MOMENTS, IDENTITY, OMEGA, t)

    def test_slender_bodies_are_an_error(self) -> None:
        with pytest.raises(
            ConvergenceError, match=r"dmv: the smallest moment .* 0\.0005 .* at least 0\.001; use method"
        ):
            flow((0.0005, 1.0, 1.0), IDENTITY, OMEGA, 0.1)

    @each
    def test_of_a_step_names_the_remedy(self, method: Method) -> None:
        held = HeldWrench(torque_body=(0.0, 0.0, 1.0))
        with pytest.raises(ConvergenceError, match="use a step"):
            method.step(Inertia(1.0, MOMENTS), held, 0.1, (0.0, 0.0, 0.0), IDENTITY, (30.0, 40.0, 50.0))


class TestSplitting:
    @each
    def test_has_the_declared_order(self, method: Method) -> None:
        for quantity, order in measured_orders(forced(), method).items():
            assert order == pytest.approx(method.order, abs=0.2), quantity

    @each
    @pytest.mark.parametrize("step", [0.05, 0.25])
    def test_closes_every_balance(self, method: Method, step: float) -> None:
        case = forced()
        start, end = PhaseState.of(case.body, case.initial), move(case, method, step, 5.0)

        def kinetic(phase: PhaseState) -> float:
            w, p = phase.angular_velocity, phase.linear_momentum_world
            return 0.5 * (dot(w, multiply(case.body.principal_moments, w)) + dot(p, p) / case.body.mass)

        spin = subtract(end.angular_momentum_world(case.body), start.angular_momentum_world(case.body))
        assert kinetic(end) - kinetic(start) == pytest.approx(end.work, abs=1000.0 * EPS)
        assert norm(subtract(spin, end.torque_impulse_world)) <= 500.0 * EPS

    @each
    def test_free_motion_is_that_of_the_closed_form_to_the_bit(self, method: Method) -> None:
        case = replace(free("dzhanibekov"), held=HeldWrench(force_world=(0.3, -0.1, 0.2)))

        assert move(case, method, 0.7, 7.0) == move(case, EXACT, 0.7, 7.0)

    @each
    def test_under_a_force_in_body_axes_turns_all_but_exactly(self, method: Method) -> None:
        """Steps of 1.2 rad in 4 to 7 flows, then half of that."""
        case = replace(free("dzhanibekov"), held=HeldWrench(force_body=(0.3, -0.1, 0.2)))
        time = min(case.states)

        def error(steps: int) -> float:
            q = move(case, method, time / steps, time).state(case.body, 0).orientation_xyzw
            return attitude_error(q, case.states[time]["orientation_xyzw"])

        n = math.ceil(time / 0.6)
        assert error(n) <= 2e-7
        assert error(2 * n) <= max(2e-12, error(n) / 800.0)

    @pytest.mark.parametrize(
        ("method", "stages"), [(DMV82, ABA82_STAGES), (DMV864, ABA864_STAGES), (DMV104, ABA104_STAGES)]
    )
    def test_errs_by_what_the_splitting_errs_by(self, method: Method, stages: Stages) -> None:
        """Under a torque of 1e-3, in steps of a third of a radian, the flow is as good as the exact one."""
        case = forced()
        held = HeldWrench(
            torque_body=scale(1e-3, case.held.torque_body), torque_world=scale(1e-3, case.held.torque_world)
        )
        weak = Case(case.body, case.initial, held, {})
        reference = move(weak, METHODS["strang6"], 0.02, 8.0).orientation

        exact = splitting.method("exact", 4, stages, "")
        found, expected = (angle_between(move(weak, m, 0.16, 8.0).orientation, reference) for m in (method, exact))
        assert found <= expected + 1e-12
        assert found <= 1e-8
