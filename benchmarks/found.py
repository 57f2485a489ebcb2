"""Results of `compare.py`, as values for `page.py`."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Point:
    """Result of one setting."""

    setting: float
    error: float
    seconds: float
    setup: float


@dataclass(frozen=True)
class Row:
    """A way to solve a problem, and its results.

    Attributes:
        points: in the order tried.
        chosen: the coarsest setting that meets the target, if any.
        seconds: of it, the median over the rounds.
        ratio: to the fastest way of ours, the median over the rounds.
        trouble: the reason if there is no result.
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
    """An rk4 step: ns per step and body, ratio to ours, and whether its bits equal ours."""

    name: str
    nanoseconds: float
    ratio: float
    same_bits: bool
