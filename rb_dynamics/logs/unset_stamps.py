"""`UnsetStamps`: which messages of a topic have a stamp of 0 because nobody set it, as `ros2 topic pub` leaves it."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.formats.topic_messages import Times

FAR_NS = 1_000_000_000_000_000
"""Stamps that are farther than this from 0 are of a clock that does not begin at 0; ns."""

ALWAYS = -(2**63)
"""As the log time from which on no stamp of 0 was set."""


class UnsetStamps:
    """Takes the messages of one topic, in any order and in pieces.

    Where its clock begins near 0, a stamp of 0 may be one like any other: it is not if it was recorded after a message
    that has another.
    """

    def __init__(self) -> None:
        self._nearest_ns: int | None = None
        self._given_ns: int | None = None
        self._bare_ns: tuple[int, int] | None = None

    def add(self, log_times: Times, stamps: Times) -> None:
        """Take messages."""
        bare, given = log_times[stamps == 0], log_times[stamps != 0]
        if len(given):
            nearest_ns, first_ns = int(np.abs(stamps[stamps != 0]).min()), int(given.min())
            self._nearest_ns = min(nearest_ns, nearest_ns if self._nearest_ns is None else self._nearest_ns)
            self._given_ns = min(first_ns, first_ns if self._given_ns is None else self._given_ns)
        if len(bare):
            first_ns, last_ns = int(bare.min()), int(bare.max())
            known = self._bare_ns or (first_ns, last_ns)
            self._bare_ns = min(first_ns, known[0]), max(last_ns, known[1])

    @property
    def after_ns(self) -> int | None:
        """Log time (ns) after which a stamp of 0 was not set; None if each was.

        Where no message has another stamp, one that stands still is none.
        """
        if self._bare_ns is None:
            return None
        if self._given_ns is None or self._nearest_ns is None:
            return ALWAYS if self._bare_ns[0] < self._bare_ns[1] else None
        after_ns = ALWAYS if self._nearest_ns > FAR_NS else self._given_ns
        return after_ns if self._bare_ns[1] > after_ns else None


def told(path: str | os.PathLike[str]) -> str:
    """Return that commands of a bag have no stamp, as text."""
    return f"{path}: some of its commands have no stamps: each of these acts when it was recorded"


def unset(log_times: Times, stamps: Times, after_ns: int | None) -> NDArray[np.bool_]:
    """Return which of some messages have a stamp that nobody set."""
    if after_ns is None:
        return np.zeros(len(stamps), dtype=bool)
    found: NDArray[np.bool_] = (stamps == 0) & (log_times > after_ns)
    return found
