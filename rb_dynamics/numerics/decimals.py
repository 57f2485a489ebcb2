"""Numbers in text: plain decimals as people and other languages write them, and nothing else that Python would take.

Not 1_0, 1/3, digits of other scripts, or an exponent of a million; so no text, however it is written, takes long.
"""

from __future__ import annotations

import re
from fractions import Fraction

_DECIMAL = re.compile(r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]{1,4})?")
_NOT_FINITE = re.compile(r"[-+]?(?:inf|infinity|nan)", re.IGNORECASE)
_WHOLE = re.compile(r"[-+]?[0-9]{1,300}")


def is_decimal(text: str) -> bool:
    """Return whether `text` is a number in decimal notation."""
    return _DECIMAL.fullmatch(text) is not None


def real_number(text: str) -> float:
    """Return the number that is written in `text`; nan and inf among them, and inf for what is beyond the doubles.

    Raises:
        ValueError: it is none.
    """
    return float(_required(text, is_decimal(text) or _NOT_FINITE.fullmatch(text)))


def exact_number(text: str) -> Fraction:
    """Return the finite number that is written in `text`, with all its digits.

    Raises:
        ValueError: it is none.
    """
    return Fraction(_required(text, is_decimal(text)))


def whole_number(text: str) -> int:
    """Return the whole number that is written in `text`, of at most 300 digits.

    Raises:
        ValueError: it is none.
    """
    return int(_required(text, _WHOLE.fullmatch(text)))


def _required(text: str, fits: object) -> str:
    if not fits:
        raise ValueError(f"{text[:60]!r} is no number")
    return text
