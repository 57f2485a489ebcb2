"""Where a function of whole numbers becomes positive, by false position (Dowell and Jarratt, BIT 11 (1971) 168)."""

from __future__ import annotations

from typing import NamedTuple


class SignChange(NamedTuple):
    """Where the function is not positive and where it is, its values there, and which end moved last (-1, 1; 0: none).

    The value at an end that stays a second time is halved: the next guess lies beyond the change, and that of a nearly
    straight function is found in some five guesses.
    """

    first: int
    last: int
    below: float
    above: float
    moved: int = 0


def next_guess(found: SignChange) -> int:
    """Return where to evaluate next, between ends that are two or more apart."""
    first, last, below, above, _ = found
    share = below / (below - above)
    guess = first + int(share * (last - first)) if 0.0 <= share <= 1.0 else (first + last) // 2
    return min(max(guess, first + 1), last - 1)


def narrowed(found: SignChange, at: int, value: float) -> SignChange:
    """Return what is known with the value at `at`, too."""
    first, last, below, above, moved = found
    if value > 0.0:
        return SignChange(first, at, 0.5 * below if moved == 1 else below, value, 1)
    return SignChange(at, last, value, 0.5 * above if moved == -1 else above, -1)
