"""Parse numbers in text: plain decimals only, as people and other languages write them.

Python would also accept 1_0, 1/3, digits of other scripts, and exponents of a million that take minutes to expand.
"""

from __future__ import annotations

import re
from fractions import Fraction

_DECIMAL = re.compile(r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]{1,4})?")
_PLAIN = re.compile(r"([-+]?[0-9]{1,300})(?:\.([0-9]{0,9}))?")
_NOT_FINITE = re.compile(r"[-+]?(?:inf|infinity|nan)", re.IGNORECASE)
_WHOLE = re.compile(r"[-+]?[0-9]{1,300}")


def is_decimal(text: str) -> bool:
    """Return whether `text` is a number in decimal notation."""
    return _DECIMAL.fullmatch(text) is not None


def real_number(text: str) -> float:
    """Return the number written in `text`; accepts nan and inf, and returns inf for what overflows a double.

    Raises:
        ValueError: it is not a number.
    """
    return float(_required(text, is_decimal(text) or _NOT_FINITE.fullmatch(text)))


def rounded_multiple(text: str, unit: int) -> int:
    """Return `unit` times the finite number written in `text`, with all its digits, rounded to even.

    Raises:
        ValueError: it is not a finite number.
    """
    if plain := _PLAIN.fullmatch(text):
        decimals = plain[2] or ""
        scale: int = 10 ** len(decimals)
        if unit % scale == 0:
            return int(plain[1] + decimals) * (unit // scale)
    return round(Fraction(_required(text, is_decimal(text))) * unit)


def time_in_ns(text: str, unit: int) -> int:
    """Return the time (ns) written in `text`, in a unit of so many ns, rounded to even; in ns it must be whole.

    Raises:
        ValueError: it is not; the message says what is expected.
    """
    try:
        time_ns = rounded_multiple(text, unit)
    except ValueError:
        raise ValueError("a number") from None
    if unit == 1 and Fraction(text) != time_ns:
        raise ValueError("a whole number")
    return time_ns


def whole_number(text: str) -> int:
    """Return the whole number written in `text`, of at most 300 digits.

    Raises:
        ValueError: it is not a whole number.
    """
    return int(_required(text, _WHOLE.fullmatch(text)))


def _required(text: str, fits: object) -> str:
    if not fits:
        raise ValueError(f"{text[:60]!r} is not a number")
    return text
