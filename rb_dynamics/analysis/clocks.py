"""Clocks of a recording: message stamps compared with log times, and with each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rb_dynamics.analysis.gaps import after_gaps
from rb_dynamics.analysis.track import Array, Times, Track
from rb_dynamics.formats.topic_messages import Topic
from rb_dynamics.logs.stamp_order import standing

# The transport delay, by which stamps and log times may differ, changes by less than this; s.
_UNDER_WAY = 0.1
_ABOVE_NOISE = 10.0
# Means are taken of this many pieces of a topic, each of at least this many messages.
_PIECES, _LEAST = 16, 4
# A change is a drift if a straight line leaves at most this fraction of it.
_STRAIGHT = 0.3
# Part of the messages that are the quickest.
_QUICKEST = 0.05
APART = 1.0
"""Larger differences between stamps and log times mean different clocks; s."""


@dataclass(frozen=True)
class Clock:
    """Log times minus stamps of one topic.

    Attributes:
        topic: as recorded.
        stamped: whether its messages have stamps that do not stand still; otherwise the offset is 0.
        offset_s: of those that were quickest to be logged.
        range_s: its change, without the scatter; 0 if there is only scatter.
        drift: seconds per second, if it changes uniformly; otherwise None.
        jump_s: the largest change from one message to the next.
        jump_ns: stamp of the message before it.
    """

    topic: str
    stamped: bool
    offset_s: float
    range_s: float = 0.0
    drift: float | None = None
    jump_s: float = 0.0
    jump_ns: int = 0


def clocks(track: Track) -> tuple[Clock, ...]:
    """Return the clocks of pose, twist and wrenches; empty for a log of this package, whose stamps are log times."""
    if track.own:
        return ()
    names = [series.topic for series in track.motion]
    names += [steps.topic for steps in track.wrenches]
    topics = [track.bag.topics[name] for name in dict.fromkeys(names)]
    return tuple(clock(topic) for topic in topics if topic.count)


def clock(topic: Topic) -> Clock:
    """Return the clock of one topic."""
    stamps = topic.stamps
    if not topic.stamps_given or standing(stamps):
        return Clock(topic.name, False, 0.0)
    logged = topic.log_times
    offset = (logged - stamps) * 1e-9
    # Messages may wait to be logged, never the other way round.
    whole = float(np.quantile(offset, _QUICKEST))
    count = min(_PIECES, len(offset) // _LEAST)
    if count < _PIECES // 2:
        return Clock(topic.name, True, whole)
    pieces = np.array_split(offset - whole, count)
    middle = np.array([np.median(piece) for piece in pieces])
    scatter = float(np.median([np.median(np.abs(piece - m)) for piece, m in zip(pieces, middle, strict=True)]))
    if np.ptp(middle) <= max(_UNDER_WAY, _ABOVE_NOISE * scatter):
        return Clock(topic.name, True, whole)
    # A clock that was set leaves a hole in its own times, over which a line leads; not in those of the other.
    (drift, left), (_, beside) = (_line(times, middle) for times in (stamps, logged))
    straight = max(left, beside) <= _STRAIGHT * np.ptp(middle)
    steps = np.diff(offset)
    largest = int(np.abs(steps).argmax())
    return Clock(
        topic=topic.name,
        stamped=True,
        offset_s=whole,
        range_s=float(np.ptp(middle)),
        drift=drift if straight else None,
        jump_s=float(steps[largest]),
        jump_ns=int(stamps[largest]),
    )


def _line(time_ns: Times, middle: Array) -> tuple[float, float]:
    """Return the slope of the line through the medians of pieces, per s, and the range of what it leaves."""
    at = np.array([np.median(piece) for piece in np.array_split((time_ns - time_ns[0]) * 1e-9, len(middle))])
    slope, level = np.polyfit(at, middle, 1) if np.ptp(at) > 0.0 else (0.0, middle[0])
    return float(slope), float(np.ptp(middle - level - slope * at))


def leaps(topic: Topic) -> list[tuple[int, float]]:
    """Return the last stamp before each leap of the clock that stamps a topic, ns, and its size, s.

    It leaves a gap of the stamps, not of the log times, and the two differ by as much less from then on.
    """
    if not topic.count or not topic.stamps_given:
        return []
    stamps, offset = topic.stamps, (topic.log_times - topic.stamps) * 1e-9
    by = -np.diff(offset)
    at = after_gaps(stamps) - 1
    at = at[by[at] > np.maximum(_UNDER_WAY, 0.5e-9 * np.diff(stamps)[at])]
    levels = [float(np.median(part)) for part in np.split(offset, at + 1)]
    lasting = -np.diff(levels) > 0.5 * by[at]
    return list(zip(stamps[at[lasting]].tolist(), by[at[lasting]].tolist(), strict=True))


def log_time_of_zero(track: Track) -> int:
    """Return the log time (ns) from which the output counts, whose stamps may be those of another clock."""
    start = track.zero_ns
    for series in () if track.own else track.motion:
        topic = track.bag.topics.get(series.topic)
        if topic is not None and topic.count and topic.stamps_given:
            later = int(topic.log_times[0] - topic.stamps[0])
            return start + later if abs(later) > APART * 1e9 else start
    return start


def remarks(track: Track) -> list[str]:
    """Return remarks on the clocks for the reader."""
    found, told = clocks(track), []
    bare = ", ".join(each.topic for each in found if not each.stamped)
    stamps = f"Times here are those of the stamps{f'; {bare}, without stamps, goes by log times' if bare else ''}."
    for each in found:
        if each.drift is not None:
            told.append(
                f"The log times of {each.topic} drift against its stamps, by {each.range_s:.3g} s "
                f"({100.0 * each.drift:.2g} %): they come from two clocks, one of which may be that of a simulation. "
                + stamps
            )
        elif each.range_s > 0.0:
            at = float(track.seconds(np.array(each.jump_ns, dtype=np.int64)))
            told.append(
                f"Log times and stamps of {each.topic} do not run alike: their difference changes by "
                f"{each.range_s:.3g} s, by {each.jump_s:+.3g} s at once at t = {at:.6g} s: a clock was set, or a "
                f"computer stood still. {stamps}"
            )
    if not found:
        return told
    first, *others = (each for each in found if each.stamped) if any(each.stamped for each in found) else found
    for other in others:
        if abs(ahead := other.offset_s - first.offset_s) > APART:
            by = f"{abs(ahead):.6g} s {'behind' if ahead > 0.0 else 'ahead of'}"
            told.append(
                f"{other.topic} is stamped {by} {first.topic}, as logged at one time: by another clock, or for another "
                "time than that at which it was sent. The two are put together as they are stamped."
            )
    return told
