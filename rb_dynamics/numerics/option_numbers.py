"""Numbers on the command line: `type=` for argparse, whose own message would name a Python type or function."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable

from rb_dynamics.numerics.decimals import real_number, whole_number


def real(expected: str, accepts: Callable[[float], bool] = lambda _: True) -> Callable[[str], float]:
    """Return what reads a finite number that `accepts` accepts; `expected` says so in words."""

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
    """Return what reads a whole number that `accepts` accepts; `expected` says so in words."""

    def read(text: str) -> int:
        try:
            value: int | None = whole_number(text)
        except ValueError:
            value = None
        if value is None or not accepts(value):
            raise argparse.ArgumentTypeError(f"found {text!r}, expected {expected}")
        return value

    return read
