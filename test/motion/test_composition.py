"""Composition: coefficients, measured order, and invariants of the composed midpoint rule."""

from __future__ import annotations

import math

import pytest
from motions import EPS, Case, forced, move
from word_series import measured_orders, worst

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.combined_effects import CombinedEffects
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import METHODS, Inertia
from rb_dynamics.motion.composition import KAHAN_LI6, SUZUKI4, compose
from rb_dynamics.motion.midpoint import MIDPOINT
from rb_dynamics.motion.phase_state import PhaseState
from rb_dynamics.motion.splitting import kick_free_kick
from rb_dynamics.numerics.vector import norm
from rb_dynamics.run.sample import SampleBuilder

COEFFICIENTS = {4: SUZUKI4, 6: KAHAN_LI6}


def changed(coefficients: tuple[float, ...], by: float) -> tuple[float, ...]:
    """Return coefficients that are still symmetric and still sum up to 1, the outer ones changed."""
    middle = len(coefficients) // 2
    change = {0: by, len(coefficients) - 1: by, middle: -2.0 * by}
    return tuple(c + change.get(i, 0.0) for i, c in enumerate(coefficients))


@pytest.mark.parametrize("order", COEFFICIENTS)
class TestCoefficients:
    def test_are_symmetric_and_sum_up_to_one(self, order: int) -> None:
        coefficients = COEFFICIENTS[order]

        assert coefficients == coefficients[::-1]
        assert sum(coefficients) == pytest.approx(1.0, abs=2.0 * EPS)

    def test_satisfy_the_order_conditions(self, order: int) -> None:
        assert worst(kick_free_kick(COEFFICIENTS[order]), lambda word: len(word) <= order) <= 1e-14

    def test_satisfy_no_more_of_them(self, order: int) -> None:
        assert worst(kick_free_kick(COEFFICIENTS[order]), lambda word: len(word) <= order + 1) > 1e-4

    def test_changed_in_one_place_do_not(self, order: int) -> None:
        assert worst(kick_free_kick(changed(COEFFICIENTS[order], 1e-6)), lambda word: len(word) <= order) > 1e-7


class TestComposedMidpoint:
    @pytest.mark.parametrize("name", ["midpoint4", "midpoint6"])
    def test_has_its_order(self, name: str) -> None:
        for quantity, order in measured_orders(forced(), METHODS[name]).items():
            assert order == pytest.approx(METHODS[name].order, abs=0.2), quantity

    def test_with_a_changed_coefficient_is_of_order_2(self) -> None:
        wrong = compose("wrong", 4, MIDPOINT, changed(SUZUKI4, 0.02), "")

        assert measured_orders(forced(), wrong)["attitude"] == pytest.approx(2.0, abs=0.3)

    @pytest.mark.parametrize("name", ["midpoint4", "midpoint6"])
    def test_closes_every_balance_under_every_wrench(self, name: str) -> None:
        case = forced()
        start = SampleBuilder(CombinedEffects(case.body), PhaseState.of(case.body, case.initial))
        sample = start.sample(move(case, METHODS[name], 0.05, 5.0), 0)

        assert abs(sample.energy_defect) <= 300.0 * EPS
        assert norm(sample.angular_momentum_defect_world) <= 300.0 * EPS
        assert norm(sample.linear_momentum_defect_world) <= 300.0 * EPS

    def test_moves_a_body_in_free_fall_like_a_particle(self) -> None:
        case = forced()
        force = HeldWrench(force_world=case.held.force_world)

        coarse, fine = (
            move(Case(case.body, case.initial, force, {}), METHODS["midpoint6"], h, 2.0) for h in (0.5, 2.0)
        )

        assert math.dist(coarse.center_of_mass_world, fine.center_of_mass_world) <= 8.0 * EPS

    def test_names_itself_where_a_stage_fails(self) -> None:
        inertia = Inertia(1.0, (1.0, 2.0, 3.0))

        with pytest.raises(ConvergenceError, match=r"midpoint4: a stage of .* s failed: midpoint: "):
            METHODS["midpoint4"].step(
                inertia, HeldWrench(), 1e100, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), (3.0, -7.0, 5.0)
            )
