"""`UnsetStamps`: which messages of a topic have a stamp of 0 because nobody set it, as `ros2 topic pub` leaves it."""

from __future__ import annotations

import os
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.formats.topic_messages import Times
from rb_dynamics.logs.stamp_clock import APART_NS, ClockLine

FAR_NS = 1_000_000_000_000_000
"""Stamps that are farther than this from 0 are of a clock that does not begin at 0; ns."""

ALWAYS = -(2**63)
"""As the log time from which on no stamp of 0 was set."""

WHEN = "each of these acts when it was recorded, less the least delay of the others"
"""What becomes of commands without a stamp beside others, as text."""


class Unset(NamedTuple):
    """Which stamps of a topic nobody set.

    Attributes:
        after_ns: log time after which a stamp of 0 is one of them.
        delay_ns: by how much the others were recorded after their stamps, at least.
    """

    after_ns: int
    delay_ns: int

    def among(self, log_times: Times, stamps: Times) -> NDArray[np.bool_]:
        """Return which of some messages have such a stamp."""
        found: NDArray[np.bool_] = (stamps == 0) & (log_times > self.after_ns)
        return found

    def placed(self, log_times: Times, line: ClockLine) -> Times:
        """Return with which stamps messages of these log times would have been sent."""
        return line.stamps(log_times) - (self.delay_ns if line.one_clock else 0)


class UnsetStamps:
    """Takes the messages of one topic, in any order and in pieces.

    Where its clock begins near 0, a stamp of 0 may be one like any other. It is not if it was recorded after a message
    that has another, or, where log times are of the same clock, long after 0.
    """

    def __init__(self) -> None:
        self._least_ns = APART_NS + 1
        self._nearest_ns: int | None = None
        self._given_ns: int | None = None
        self._bare_ns: tuple[int, int] | None = None

    def add(self, log_times: Times, stamps: Times) -> None:
        """Take messages."""
        bare, given = log_times[stamps == 0], log_times[stamps != 0]
        if len(given):
            nearest_ns, first_ns = int(np.abs(stamps[stamps != 0]).min()), int(given.min())
            self._least_ns = min(self._least_ns, int((log_times - stamps)[stamps != 0].min()))
            self._nearest_ns = min(nearest_ns, nearest_ns if self._nearest_ns is None else self._nearest_ns)
            self._given_ns = min(first_ns, first_ns if self._given_ns is None else self._given_ns)
        if len(bare):
            first_ns, last_ns = int(bare.min()), int(bare.max())
            known = self._bare_ns or (first_ns, last_ns)
            self._bare_ns = min(first_ns, known[0]), max(last_ns, known[1])

    @property
    def found(self) -> Unset | None:
        """Which were not set; None if each was."""
        after_ns = self._after_ns
        return None if after_ns is None else Unset(after_ns, self.delay_ns)

    @property
    def delay_ns(self) -> int:
        """By how much messages were recorded after their stamps, at least; 0 if that is not of one clock."""
        return self._least_ns if 0 <= self._least_ns <= APART_NS else 0

    @property
    def _after_ns(self) -> int | None:
        # Where no message has another stamp, one that stands still is none.
        if self._bare_ns is None:
            return None
        if self._given_ns is None or self._nearest_ns is None:
            return ALWAYS if self._bare_ns[0] < self._bare_ns[1] else None
        one_clock = abs(self._least_ns) <= APART_NS
        near_ns = min(self._given_ns, self.delay_ns + APART_NS) if one_clock else self._given_ns
        after_ns = ALWAYS if self._nearest_ns > FAR_NS else near_ns
        return after_ns if self._bare_ns[1] > after_ns else None


def told(path: str | os.PathLike[str]) -> str:
    """Return that commands of a bag have no stamp, as text."""
    return f"{path}: some of its commands have no stamps: {WHEN}"
