"""The methods compared but not in the package still work and have their order."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import ModuleType

import pytest

from rb_dynamics.motion import METHODS
from rb_dynamics.numerics.rotation import angle_between


@pytest.fixture(scope="module")
def methods(script: Callable[[str], ModuleType]) -> ModuleType:
    return script("methods")


def test_what_is_left_out_is_of_its_order(methods: ModuleType) -> None:
    driven = methods.WORKLOADS[1]
    expected = methods.run(METHODS["taylor"], driven, 400)

    for method in methods.LEFT_OUT:
        coarse, fine = (angle_between(methods.run(method, driven, n), expected) for n in (50, 100))
        assert math.log2(coarse / fine) == pytest.approx(method.order, abs=0.4), method.name
