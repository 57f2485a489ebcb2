"""Kicks and exact free motion: coefficients, order, error proportional to a small torque, closed balances."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
from motions import EPS, Case, attitude_error, forced, free, move, slope
from word_series import measured_orders, worst

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.combined_effects import CombinedEffects
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import METHODS, Inertia, splitting
from rb_dynamics.motion.closed_form import EXACT
from rb_dynamics.motion.method import Method
from rb_dynamics.motion.phase_state import PhaseState
from rb_dynamics.motion.splitting import ABA82_STAGES, ABA104_STAGES, ABA864_STAGES
from rb_dynamics.numerics.rotation import angle_between
from rb_dynamics.numerics.vector import norm, scale
from rb_dynamics.run.sample import SampleBuilder

NAMES = ["strang2", "strang6"]
each = pytest.mark.parametrize("name", NAMES)

# For each number of kicks in a word the length up to which it is right: eps^k h^n.
ORDERS = {
    "aba82": (ABA82_STAGES, {1: 8, 2: 2}),
    "aba104": (ABA104_STAGES, {1: 10, 2: 4}),
    "aba864": (ABA864_STAGES, {1: 8, 2: 6, 3: 4}),
}
# What the stages do on the exact flow, at steps that the flow of dmv82, dmv104 and dmv864 cannot take.
ON_THE_EXACT_FLOW = {name: splitting.method(name, 4, stages, "") for name, (stages, _) in ORDERS.items()}


def right_to(orders: dict[int, int]) -> Callable[[str], bool]:
    last = max(orders)
    return lambda word: len(word) <= orders.get(min(max(1, word.count("B")), last), 0)


@pytest.mark.parametrize("name", ORDERS)
class TestNearIntegrableCoefficients:
    def test_satisfy_the_order_conditions(self, name: str) -> None:
        stages, orders = ORDERS[name]

        assert worst(stages, right_to(orders)) <= 1e-12

    def test_satisfy_no_more_of_them(self, name: str) -> None:
        stages, orders = ORDERS[name]

        for kicks in orders:
            more = {**orders, kicks: orders[kicks] + 1}
            assert worst(stages, right_to(more)) > 1e-4, kicks

    def test_are_symmetric_and_sum_up_to_one(self, name: str) -> None:
        kicks, flows = zip(*ORDERS[name][0], strict=True)

        assert kicks[1:] == kicks[:0:-1]
        assert flows == flows[::-1]
        assert sum(kicks) == pytest.approx(1.0, abs=4.0 * EPS)
        assert sum(flows) == pytest.approx(1.0, abs=4.0 * EPS)


class TestOrder:
    @each
    def test_is_the_declared_one(self, name: str) -> None:
        for quantity, order in measured_orders(forced(), METHODS[name]).items():
            assert order == pytest.approx(METHODS[name].order, abs=0.2), quantity

    @pytest.mark.parametrize("stage", [0, 1, 2])
    def test_drops_with_a_changed_coefficient(self, stage: int) -> None:
        stages = list(ABA864_STAGES)
        for k in (stage, len(stages) - 1 - stage):
            stages[k] = (stages[k][0], stages[k][1] + (0.01 if stage != 2 else -0.01))
        middle = 1 if stage != 1 else 0
        for k in (middle, len(stages) - 1 - middle):
            stages[k] = (stages[k][0], stages[k][1] - (0.01 if stage != 2 else -0.01))
        wrong = splitting.method("wrong", 4, tuple(stages), "")

        assert measured_orders(forced(), wrong)["attitude"] == pytest.approx(2.0, abs=0.3)


def weak(eps: float) -> Case:
    case = forced()
    held = HeldWrench(torque_body=scale(eps, case.held.torque_body), torque_world=scale(eps, case.held.torque_world))
    return Case(case.body, case.initial, held, {})


def weak_error(eps: float, method: Method, h: float) -> float:
    """Return the error of the attitude after 16 s; the reference is three decades better than what it is used for."""
    reference = move(weak(eps), METHODS["strang6"], 0.05, 16.0)
    return angle_between(move(weak(eps), method, h, 16.0).orientation, reference.orientation)


class TestWeakTorque:
    """Under a torque of size eps: eps times a high power of the step, at steps of several radians."""

    @pytest.mark.parametrize("name", list(ORDERS))
    def test_large_steps_fall_with_the_high_order(self, name: str) -> None:
        steps = [16.0 / n for n in (5, 6, 8)]
        found = [weak_error(1e-6, ON_THE_EXACT_FLOW[name], h) for h in steps]

        assert slope(steps, found) >= ORDERS[name][1][1] - 0.5, found

    @pytest.mark.parametrize("name", list(ORDERS))
    def test_error_is_proportional_to_it(self, name: str) -> None:
        small, large = (weak_error(eps, ON_THE_EXACT_FLOW[name], 16.0 / 6.0) for eps in (1e-5, 1e-4))

        assert large / small == pytest.approx(10.0, rel=0.1)

    @pytest.mark.parametrize(("name", "bound"), [("aba82", 1e-9), ("aba104", 2e-11), ("aba864", 1e-12)])
    def test_of_a_thousandth_allows_steps_of_most_of_a_radian(self, name: str, bound: float) -> None:
        assert weak_error(1e-3, ON_THE_EXACT_FLOW[name], 0.5) <= bound

    def test_is_out_of_reach_of_a_method_that_does_not_know_of_it(self) -> None:
        assert weak_error(1e-3, METHODS["rkmk4"], 0.5) > 1e-3


class TestBalances:
    @each
    @pytest.mark.parametrize("step", [0.05, 0.5])
    def test_close_to_round_off_at_any_step(self, name: str, step: float) -> None:
        case = forced()
        start = SampleBuilder(CombinedEffects(case.body), PhaseState.of(case.body, case.initial))
        sample = start.sample(move(case, METHODS[name], step, 5.0), 0)

        assert abs(sample.energy_defect) <= 1000.0 * EPS
        assert norm(sample.angular_momentum_defect_world) <= 500.0 * EPS
        assert norm(sample.linear_momentum_defect_world) <= 100.0 * EPS


class TestFreeMotion:
    @each
    def test_is_that_of_the_closed_form_to_the_bit(self, name: str) -> None:
        case = replace(free("dzhanibekov"), held=HeldWrench(force_world=(0.3, -0.1, 0.2)))

        assert move(case, METHODS[name], 0.7, 7.0) == move(case, EXACT, 0.7, 7.0)

    @each
    def test_under_a_force_in_body_axes_turns_exactly(self, name: str) -> None:
        """Only a torque disturbs the rotation: steps of 1.4 rad leave the attitude at round-off."""
        case = replace(free("dzhanibekov"), held=HeldWrench(force_body=(0.3, -0.1, 0.2)))
        time = min(case.states)

        phase = move(case, METHODS[name], time / math.ceil(time / 0.7), time)

        found = attitude_error(phase.state(case.body, 0).orientation_xyzw, case.states[time]["orientation_xyzw"])
        assert found <= 1e-12


class TestLimits:
    @each
    def test_turns_that_the_kicks_would_miss_are_an_error(self, name: str) -> None:
        torque = HeldWrench(torque_body=(0.0, 0.0, 1.0))

        with pytest.raises(ConvergenceError, match=rf"{name}: a step of .* rad between two kicks.*use a step below"):
            METHODS[name].step(
                Inertia(1.0, (1.0, 2.0, 3.0)), torque, 1.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), (30.0, 40.0, 50.0)
            )

    @each
    def test_free_motion_has_no_such_limit(self, name: str) -> None:
        METHODS[name].step(
            Inertia(1.0, (1.0, 2.0, 3.0)), HeldWrench(), 1e3, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), (30.0, 40.0, 50.0)
        )


@pytest.mark.parametrize("name", [*NAMES, "dlm2", "dlm4", "dlm6", "dmv82", "dmv104", "dmv864"])
@pytest.mark.parametrize("part", [0.45, 1.55])
def test_equal_kicks_are_not_all_rounded_the_same_way(name: str, part: float) -> None:
    """A sphere spins up by so many units in the last place a step: rounding is a random walk and no drift."""
    rate, h, steps = 1.3, 0.25, 200
    inertia, held = Inertia(1.0, (1.0, 1.0, 1.0)), HeldWrench(torque_body=(0.0, 0.0, part * EPS / h))
    phase = PhaseState((0.1, 0.5, -0.5, 0.7), (0.0, 0.0, rate), (0.0,) * 14, (0.0,) * 14)

    for _ in range(steps):
        step = METHODS[name].step(inertia, held, h, (0.0,) * 3, phase.orientation, phase.angular_velocity)
        phase = phase.after(step, h)

    assert abs((phase.angular_velocity[2] - rate) / EPS - part * steps) <= 4.0 * math.sqrt(10 * steps) / 2.0
