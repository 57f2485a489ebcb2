"""Where a function of whole numbers becomes positive, by false position (Dowell and Jarratt, BIT 11 (1971) 168)."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

# Fraction of the interval that is searched: what happens within one so short is not looked for.
_SHORTEST = 2.0**-17


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


def first_positive(function: Any, first: int, last: int, below: float, above: float, bend: float, noise: float) -> int:
    """Return how far behind `first` a function is positive first; 0 if nowhere up to `last`, -1 where it is NaN.

    Its values are `below` (not positive) at `first` and `above` at `last`, and it has a second derivative of at most
    `bend`: it is evaluated between the ends only where it may be positive by that. It may also be the largest of
    several such functions. If it exceeds 0 between them by no more than `noise`, that is overlooked.
    """
    low, at_low, high, at_high = first, below, last, above
    end, at_end, found = last, above, 0
    shortest = max(1, int(_SHORTEST * (last - first)))
    while True:
        if at_high > 0.0:
            change = SignChange(low, high, at_low, at_high, 0)
            while change.last - change.first > 1:
                middle = next_guess(change)
                value = _value(function, middle)
                if math.isnan(value):
                    return -1
                change = narrowed(change, middle, value)
            # It may have been positive before.
            found, high, at_high = change.last - first, change.first, 0.0
            end, at_end = high, at_high
        length = float(high - low)
        if high - low <= shortest or peak(at_low, at_high, 0.125 * bend * length * length) <= noise:
            if high == end:
                return found
            low, at_low, high, at_high = high, at_high, end, at_end
            continue
        # So far, or half the way, the value at `low` lets it be negative.
        ahead = min(0.5 * length, math.sqrt(8.0 * (noise - at_low) / bend))
        high = low + max(shortest, int(ahead))
        at_high = _value(function, high)
        if math.isnan(at_high):
            return -1
        at_high = at_high if at_high > noise else min(at_high, 0.0)


def peak(below: float, above: float, bulge: float) -> float:
    """Return a bound on a function between two ends, where it has these values.

    Its second derivative is at most that of a parabola that deviates from its chord by `bulge` in the middle.
    """
    top, spare = max(below, above), 4.0 * bulge - abs(above - below)
    return top + spare * spare / (16.0 * bulge) if spare > 0.0 else top


def _value(function: Any, at: int) -> float:
    """Return the value of a function. A kernel has its own version."""
    value: float = function(at)
    return value
