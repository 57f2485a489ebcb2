"""Where a function of whole numbers becomes positive, by false position (Dowell and Jarratt, BIT 11 (1971) 168)."""

from __future__ import annotations

from typing import NamedTuple


class SignChange(NamedTuple):
    """Where the function is not positive and where it is, with its values there.

    `moved` is how often in succession the last end has moved (positive) or the first (negative). The value at an end
    that stays a second time is halved: the next guess then lies beyond the change, and that of a nearly straight
    function is found in some five guesses. Where an end stays for long, as at a jump, the interval is bisected.
    """

    first: int
    last: int
    below: float
    above: float
    moved: int = 0


def next_guess(found: SignChange) -> int:
    """Return where to evaluate next, between ends that are two or more apart."""
    first, last, below, above, moved = found
    share = below / (below - above)
    guess = (first + last) // 2
    if -4 < moved < 4 and 0.0 <= share <= 1.0:
        guess = first + int(share * (last - first))
    return min(max(guess, first + 1), last - 1)


def narrowed(found: SignChange, at: int, value: float) -> SignChange:
    """Return what is known with the value at `at`, too."""
    first, last, below, above, moved = found
    if value > 0.0:
        return SignChange(first, at, 0.5 * below if moved > 0 else below, value, max(moved, 0) + 1)
    return SignChange(at, last, value, 0.5 * above if moved < 0 else above, min(moved, 0) - 1)
