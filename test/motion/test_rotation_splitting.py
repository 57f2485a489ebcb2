"""Rotations about the principal axes: exact for symmetric bodies, else of their order, angular momentum conserved."""

from __future__ import annotations

import math

import pytest
from motions import EPS, forced, move
from word_series import measured_orders

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.combined_effects import CombinedEffects
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import METHODS, Inertia
from rb_dynamics.motion import rotation_splitting as splitting
from rb_dynamics.motion.composition import SUZUKI4
from rb_dynamics.motion.free_rotation import free_rotation
from rb_dynamics.motion.phase_state import PhaseState
from rb_dynamics.motion.splitting import kick_free_kick
from rb_dynamics.numerics.rotation import IDENTITY, angle_between, rotate
from rb_dynamics.numerics.vector import Vector, multiply, norm, subtract
from rb_dynamics.run.sample import SampleBuilder

each = pytest.mark.parametrize("name", ["dlm2", "dlm4", "dlm6"])
OMEGA: Vector = (0.7, -1.1, 0.9)


class TestFlow:
    @pytest.mark.parametrize(
        "moments", [(1.0, 1.0, 1.0), (1.0, 1.0, 1.7), (1.0, 1.7, 1.0), (1.7, 1.0, 1.0), (2.0, 2.0, 1.1)]
    )
    @pytest.mark.parametrize("t", [0.1, 3.0, -2.0])
    def test_of_a_symmetric_body_is_exact(self, moments: Vector, t: float) -> None:
        q, omega = splitting.flow(moments, IDENTITY, OMEGA, t)

        turn, spin = free_rotation(moments, OMEGA, t)
        assert angle_between(q, turn) <= 32.0 * EPS
        assert math.dist(omega, spin) <= 32.0 * EPS

    def test_is_symmetric(self) -> None:
        moments = (1.5, 2.1, 3.1)
        q, omega = splitting.flow(moments, *splitting.flow(moments, IDENTITY, OMEGA, 0.8), -0.8)

        assert angle_between(q, IDENTITY) <= 16.0 * EPS
        assert math.dist(omega, OMEGA) <= 32.0 * EPS

    def test_keeps_the_angular_momentum_at_any_step(self) -> None:
        moments = (1.5, 2.1, 3.1)
        q, omega = splitting.flow(moments, IDENTITY, OMEGA, 50.0)

        found = subtract(rotate(q, multiply(moments, omega)), multiply(moments, OMEGA))
        assert norm(found) <= 32.0 * EPS * norm(multiply(moments, OMEGA))

    def test_error_is_of_third_order(self) -> None:
        moments = (1.5, 2.1, 3.1)

        def error(t: float) -> float:
            return angle_between(splitting.flow(moments, IDENTITY, OMEGA, t)[0], free_rotation(moments, OMEGA, t)[0])

        assert math.log2(error(0.1) / error(0.05)) == pytest.approx(3.0, abs=0.1)


@each
def test_order_is_the_declared_one(name: str) -> None:
    for quantity, order in measured_orders(forced(), METHODS[name]).items():
        assert order == pytest.approx(METHODS[name].order, abs=0.2), quantity


def test_order_drops_with_a_changed_coefficient() -> None:
    a, b, c = SUZUKI4[:3]
    wrong = splitting._method("wrong", 4, kick_free_kick((a + 0.02, b, c - 0.04, b, a + 0.02)), "")

    assert measured_orders(forced(), wrong)["attitude"] == pytest.approx(2.0, abs=0.3)


@each
def test_momentum_balances_close_to_round_off(name: str) -> None:
    case = forced()
    start = SampleBuilder(CombinedEffects(case.body), PhaseState.of(case.body, case.initial))
    sample = start.sample(move(case, METHODS[name], 0.25, 5.0), 0)

    assert norm(sample.angular_momentum_defect_world) <= 300.0 * EPS
    assert norm(sample.linear_momentum_defect_world) <= 100.0 * EPS


@each
def test_too_long_a_step_is_an_error(name: str) -> None:
    with pytest.raises(ConvergenceError, match=rf"{name}: a step of .* use a step below"):
        METHODS[name].step(Inertia(1.0, (1.0, 2.0, 3.0)), HeldWrench(), 20.0, (0.0, 0.0, 0.0), IDENTITY, OMEGA)
