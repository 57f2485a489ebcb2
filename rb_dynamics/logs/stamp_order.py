"""Stamps that do not ascend in the file: single messages that come late, another run, a clock that stands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Times = NDArray[np.int64]

BACK_NS = 1_000_000_000
"""Stamps of one topic that go back by more are those of another run, or another clock; ns."""

# Fewer messages than this in a row are not a run of their own.
_RUN = 3
# Messages are often late if one of so many is, and another run goes back by this many times their usual lateness.
_COMMON, _MUCH = 50, 5.0
# Fewer messages with one stamp may be sent at once.
_STILL = 4
# A clock hangs while this many samples have one stamp, and this many times as many as usual.
_HANGS, _TIMES = 10, 5


@dataclass(frozen=True)
class Disorder:
    """Stamps that are less than one before them.

    Attributes:
        count: of all messages.
        odd: of messages out of order, without those of a run that begins again.
        most_ns: largest time by which such a stamp is earlier than one before it, or later than the one after it.
        first_ns: the first such stamp.
        restarts: last stamp of a run, and first of the next.
    """

    count: int
    odd: int
    most_ns: int
    first_ns: int
    restarts: tuple[tuple[int, int], ...]

    def told(self, start_ns: int) -> str:
        """Return it as text, with times from `start_ns`."""
        parts = []
        if self.restarts:
            end, begin = ((time_ns - start_ns) * 1e-9 for time_ns in self.restarts[0])
            runs = "two" if len(self.restarts) == 1 else str(len(self.restarts) + 1)
            first = ", first" * (len(self.restarts) > 1)
            parts.append(
                f"stamps begin again{first} after t = {end:.6g} s at {begin:.6g} s: {runs} runs in one file, which "
                "cannot be told apart, or a clock that was set back"
            )
        if self.odd:
            is_are, most = ("is", "") if self.odd == 1 else ("are", "at most ")
            parts.append(
                f"{self.odd} of {self.count} stamps {is_are} out of order, by {most}{self.most_ns * 1e-9:.6g} s, "
                f"{'' if self.odd == 1 else 'first '}at t = {(self.first_ns - start_ns) * 1e-9:.6g} s; messages are "
                "taken by their stamps"
            )
        return "; ".join(parts)


def disorder(time_ns: Times) -> Disorder | None:
    """Return what is not ascending in the stamps, in the order of the file; None if all ascend."""
    if not (np.diff(time_ns) < 0).any():
        return None
    restarts: list[tuple[int, int]] = []
    ahead = _ahead(time_ns)
    odd: list[int] = time_ns[ahead].tolist()
    by: list[int] = (time_ns[ahead] - time_ns[ahead + 1]).tolist()
    run = np.delete(time_ns, ahead)
    while True:
        newest = np.maximum.accumulate(run)
        is_late = run < newest
        end = _restart(run, newest, is_late)
        at = np.flatnonzero(is_late[:end])
        odd += run[at].tolist()
        by += (newest[at] - run[at]).tolist()
        if end == len(run):
            break
        restarts.append((int(newest[end - 1]), int(run[end])))
        run = run[end:]
    return Disorder(len(time_ns), len(odd), max(by, default=0), min(odd, default=0), tuple(restarts))


def standing(time_ns: Times) -> str:
    """Return that most messages have one stamp, as text; "" if they have not."""
    count = len(time_ns)
    same = int((time_ns == np.partition(time_ns, count // 2)[count // 2]).sum()) if count >= _STILL else 0
    return f"stamps stand still: {count} messages, {same} with one stamp" if 2 * same > max(count, _STILL) else ""


def hangs(time_ns: Times) -> list[tuple[int, int]]:
    """Return each ascending stamp at which a clock hangs, and how many samples have it: the next are stamped too early.

    A coarse clock stands still for about as many samples each time; one that then leaps by their time is no longer off.
    """
    begins = np.flatnonzero(np.diff(time_ns, prepend=time_ns[:1] - 1))
    if len(begins) < _STILL:
        return []
    count, steps = np.diff(begins, append=len(time_ns)), np.diff(time_ns[begins], append=time_ns[-1:])
    usual = float(np.median(count))
    hung = (count > max(_HANGS, _TIMES * usual)) & (2.0 * usual * steps < count * np.median(steps))
    return list(zip(time_ns[begins[hung]].tolist(), count[hung].tolist(), strict=True))


def _ahead(time_ns: Times) -> NDArray[np.intp]:
    """Return which single messages are later than all the next ones, which continue those before."""
    if len(time_ns) <= _RUN:
        return np.empty(0, np.intp)
    following = np.lib.stride_tricks.sliding_window_view(time_ns[1:], _RUN)
    goes_on = np.append(True, time_ns[: -_RUN - 1] <= following[1:, 0])
    return np.flatnonzero((time_ns[:-_RUN] > following.max(axis=1)) & goes_on)


def _restart(run: Times, newest: Times, late: NDArray[np.bool_]) -> int:
    """Return where another run begins: late messages in a row that neither lead back nor fill a hole; the end if none.

    Messages that were under way for longer lead back to the newest by a jump, or are of a time without others. Where
    many are late, another run goes back by more than these usually are.
    """
    edges = np.diff(late.astype(np.int8), prepend=0, append=0)
    begins = np.flatnonzero(edges == 1)
    many = len(begins) >= _RUN and _COMMON * len(begins) >= len(run)
    usual = _MUCH * float(np.quantile((newest - run)[begins], 0.9)) if many else 0.0
    for first, end in zip(begins.tolist(), np.flatnonzero(edges == -1).tolist(), strict=True):
        far = np.flatnonzero((newest - run)[first:end] > usual)
        begin = first + int(far[0]) if len(far) else end
        if end - begin < _RUN:
            continue
        if end < len(run) and 2 * (run[end] - run[end - 1]) >= newest[begin] - run[begin]:
            continue
        among = np.count_nonzero((run[:begin] >= run[begin]) & (run[:begin] <= run[end - 1]))
        if run[begin] <= run[0] or 2 * among >= end - begin:
            return begin
    return len(run)
