"""The table of methods near the front: interpolation of costs between settings, and which methods count as near."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import ModuleType

import pytest


@pytest.fixture(scope="module")
def front(script: Callable[[str], ModuleType]) -> ModuleType:
    return script("front")


def test_cost_lies_between_two_settings_by_powers(front: ModuleType) -> None:
    runs = [(1e-4, 1.0, 10), (1e-8, 100.0, 1000), (1e-6, 200.0, 20)]

    assert front.cost(runs, 1e-6) == pytest.approx(10.0)
    assert front.cost(runs, 1e-3) == 1.0
    assert front.cost(runs, 1e-9) == math.inf


def test_only_what_is_near_the_least_is_told(front: ModuleType) -> None:
    """`dmv104` conserves energy at twice the cost of `rk4`, which does not; a closed form decides nothing."""
    runs = {"rk4": [(1e-13, 1.0, 100)], "dmv104": [(1e-13, 2.0, 100)], "strang6": [(1e-13, 3.0, 100)]}
    rows = {"driven": {"plain": runs}, "free": {"plain": {"exact": [(1e-16, 1.0, 1)], "strang6": [(1e-16, 1.0, 1)]}}}

    found = front.verdict(rows)
    all_errors = "driven 1e-3 to 1e-12"
    assert found["rk4"] == [all_errors, "", ""]
    assert found["dmv104"] == ["", all_errors, all_errors]
    assert found["strang6"] == ["", "", ""]
