"""Results of `compare.py`, as values for `page.py`."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Point:
    """What a setting led to."""

    setting: float
    error: float
    seconds: float
    setup: float


@dataclass(frozen=True)
class Row:
    """A way to solve a problem, and what was found.

    Attributes:
        points: in the order tried.
        chosen: the coarsest setting that is right enough, if any is.
        seconds: of it, the median over the rounds.
        ratio: to the fastest way of ours, the median over the rounds.
        trouble: why there is nothing, if so.
    """

    peer: str
    way: str
    kind: str
    points: tuple[Point, ...] = ()
    chosen: Point | None = None
    seconds: float = math.nan
    ratio: float = math.nan
    trouble: str = ""

    @property
    def name(self) -> str:
        return f"{self.peer} {self.way}".strip()

    @property
    def is_ours(self) -> bool:
        return self.peer == "rb_dynamics"

    @property
    def best(self) -> Point:
        """The most accurate setting tried."""
        return min(self.points, key=lambda point: point.error)


@dataclass(frozen=True)
class StepRow:
    """An rk4 step: ns for each step of each body, its ratio to ours, and whether its numbers are ours to the bit."""

    name: str
    nanoseconds: float
    ratio: float
    same_bits: bool
