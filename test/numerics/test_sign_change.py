"""False position on whole numbers: the first number of every function, and few guesses where it is nearly straight."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from rb_dynamics.numerics.sign_change import SignChange, narrowed, next_guess

END = 10**9


def search(function: Callable[[int], float]) -> tuple[int, int]:
    """Return where the function becomes positive, and after how many guesses that was found."""
    found, guesses = SignChange(0, END, min(function(0), 0.0), function(END)), 0
    while found.last - found.first > 1:
        at = next_guess(found)
        assert found.first < at < found.last
        found, guesses = narrowed(found, at, function(at)), guesses + 1
    return found.last, guesses


@pytest.mark.parametrize("root", [0.5, 1.5, 123.4, 313_459_979.5, END - 1.5, END - 0.5])
def test_nearly_straight_functions_take_few_guesses(root: float) -> None:
    for bend in (0.0, 1e-3, -1e-3, 0.3):

        def bent(x: int, bend: float = bend) -> float:
            u = (x - root) / END
            return 0.03 * u * (1.0 + bend * u)

        found, guesses = search(bent)
        assert found == math.ceil(root)
        assert guesses <= 12


@pytest.mark.parametrize(
    "function",
    [
        lambda x: 1e-300 if x >= 777 else -1e300,
        lambda x: 1e300 if x >= 777 else -1e-300,
        lambda x: 1.0 if x >= 777 else 0.0,
        lambda x: 1.0 if x >= 777 else -math.inf,
        lambda x: math.nan if x < 777 else 1.0,
    ],
    ids=["mostly below", "mostly above", "zero", "infinite", "no number"],
)
def test_any_other_function_has_its_change_found(function: Callable[[int], float]) -> None:
    found, guesses = search(function)
    assert found == 777
    assert guesses < 130
