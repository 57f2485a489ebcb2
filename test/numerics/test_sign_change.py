"""False position on whole numbers: the first number of every function, and few guesses where it is nearly straight."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from rb_dynamics.numerics.sign_change import SignChange, first_positive, narrowed, next_guess

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


@pytest.mark.parametrize("size", [1e-7, 1e-6, 1e-3, 0.5, 1.5])
@pytest.mark.parametrize("end", [1, 2, 1000, END])
def test_the_first_of_several_changes_is_found_between_negative_ends(size: float, end: int) -> None:
    """A wave of seven periods on a slope, whose last crest is the highest, `size` above zero."""
    slope, rate = 1e-2, 14.0 * math.pi
    crest = (13.0 * math.pi + math.asin(slope / rate)) / rate
    top, asked = slope * crest - math.cos(rate * crest), 0

    def wave(x: int) -> float:
        nonlocal asked
        asked += 1
        u = x / end
        return slope * u - math.cos(rate * u) - top + size

    found = first_positive(wave, 0, end, wave(0), wave(end), (rate / end) ** 2, 1e-13)
    assert asked < 150
    if end < END:
        assert found == next((x for x in range(1, end) if wave(x) > 0.0), 0)
    else:
        assert wave(found) > 0.0 >= wave(found - 1)
        assert found / end < (crest if size < slope / 7.0 else crest - 2.0 * math.pi / rate)


def test_what_cannot_be_told_is_no_answer() -> None:
    assert first_positive(lambda _: math.nan, 0, END, -1.0, -1.0, 1e-6, 0.0) == -1
    assert first_positive(lambda _: math.nan, 0, END, -1.0, -1.0, 0.0, 0.0) == 0
    assert first_positive(lambda x: math.nan if x > 0 else -1.0, 0, END, -1.0, 1.0, 0.0, 0.0) == -1
