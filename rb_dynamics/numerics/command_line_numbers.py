"""Number types for argparse options whose messages say what is expected, where argparse's name Python types."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable

from rb_dynamics.numerics.number_parsing import real_number, whole_number


def real(expected: str, accepts: Callable[[float], bool] = lambda _: True) -> Callable[[str], float]:
    """Return an argparse type for finite numbers that `accepts` accepts; `expected` describes them in words."""

    def read(text: str) -> float:
        try:
            value = real_number(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and accepts(value)):
            raise argparse.ArgumentTypeError(f"found {text!r}, expected {expected}")
        return value

    return read


def whole(expected: str, accepts: Callable[[int], bool] = lambda _: True) -> Callable[[str], int]:
    """Return an argparse type for whole numbers that `accepts` accepts; `expected` describes them in words."""

    def read(text: str) -> int:
        try:
            value: int | None = whole_number(text)
        except ValueError:
            value = None
        if value is None or not accepts(value):
            raise argparse.ArgumentTypeError(f"found {text!r}, expected {expected}")
        return value

    return read
