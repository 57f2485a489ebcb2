"""Evaluations per step equal the known stages of each method."""

from __future__ import annotations

import pytest

from rb_dynamics.motion import METHODS
from rb_dynamics.study.trade.load_evaluations import evaluations_in

# Stages of the tables in their sources; `dlm2` kicks at both ends of its step.
STAGES = {"euler": 1, "rk4": 4, "rkmk4": 4, "cf4": 4, "dlm2": 2}


@pytest.mark.parametrize("name", STAGES)
def test_a_fixed_step_has_the_stages_of_its_method(name: str) -> None:
    assert evaluations_in(name, 7, by_accuracy=False) == 7 * STAGES[name]


def test_doubling_takes_three_steps_for_a_stride_and_a_pair_one() -> None:
    assert evaluations_in("rk4", 7, by_accuracy=True) == 7 * 3 * 4
    # Dormand and Prince: 12 stages, of which both results are made; rkmk54: 7, the last for the comparison.
    assert evaluations_in("dop853", 7, by_accuracy=True) == 7 * 12
    assert evaluations_in("dverk", 7, by_accuracy=True) == 7 * 8
    assert evaluations_in("rkmk54", 7, by_accuracy=True) == 7 * 7


def test_a_closed_form_evaluates_nothing() -> None:
    assert evaluations_in("exact", 1, by_accuracy=True) == 0


@pytest.mark.parametrize("name", ["midpoint", "midpoint6", "radau", "taylor", "exact+taylor", "dop853+rk4"])
def test_where_there_is_no_fixed_number_there_is_none(name: str) -> None:
    assert evaluations_in(name, 7, by_accuracy=False) is None


def test_every_explicit_method_has_a_number() -> None:
    without = {name for name in METHODS if evaluations_in(name, 1, by_accuracy=False) is None}
    assert without == {"taylor", "midpoint", "midpoint4", "midpoint6", "radau"}
