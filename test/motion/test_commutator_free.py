"""Commutator-free methods: the table, the measured order, and that each coefficient is needed."""

from __future__ import annotations

import pytest
from motions import EPS, forced, move
from word_series import measured_orders

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.combined_effects import CombinedEffects
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import METHODS, Inertia, commutator_free
from rb_dynamics.motion.phase_state import PhaseState
from rb_dynamics.numerics.rotation import IDENTITY
from rb_dynamics.numerics.vector import norm
from rb_dynamics.run.sample import SampleBuilder


def test_is_the_classical_method_where_everything_commutes() -> None:
    assert commutator_free.weights(commutator_free.CF4_TABLE.end) == pytest.approx(
        (1 / 6, 1 / 3, 1 / 3, 1 / 6), abs=EPS
    )
    assert [sum(commutator_free.weights(product)) for product in commutator_free.CF4_TABLE.stages] == [0.5, 0.5, 1.0]


def test_order_is_the_declared_one() -> None:
    for quantity, order in measured_orders(forced(), METHODS["cf4"]).items():
        assert order == pytest.approx(4.0, abs=0.2), quantity


@pytest.mark.parametrize("part", ["end in one exponential", "end in the wrong order", "last stage in one exponential"])
def test_order_drops_without(part: str) -> None:
    table = commutator_free.CF4_TABLE
    wrong = {
        "end in one exponential": table._replace(end=(commutator_free.weights(table.end),)),
        "end in the wrong order": table._replace(end=table.end[::-1]),
        "last stage in one exponential": table._replace(
            stages=(*table.stages[:2], (commutator_free.weights(table.stages[2]),))
        ),
    }[part]

    assert measured_orders(forced(), commutator_free.method("wrong", 4, wrong, ""))["attitude"] <= 3.3


def test_momentum_balances_close_to_round_off() -> None:
    case = forced()
    start = SampleBuilder(CombinedEffects(case.body), PhaseState.of(case.body, case.initial))
    sample = start.sample(move(case, METHODS["cf4"], 0.1, 5.0), 0)

    assert norm(sample.angular_momentum_defect_world) <= 300.0 * EPS
    assert norm(sample.linear_momentum_defect_world) <= 100.0 * EPS


def test_too_long_a_step_is_an_error() -> None:
    with pytest.raises(ConvergenceError, match=r"cf4: a step of 5 s .* use a step below"):
        METHODS["cf4"].step(
            Inertia(1.0, (1.0, 2.0, 3.0)), HeldWrench(), 5.0, (0.0, 0.0, 0.0), IDENTITY, (1.0, 1.0, 1.0)
        )
