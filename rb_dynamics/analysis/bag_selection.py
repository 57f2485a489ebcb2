"""`part_of`: a bag with the messages of a part of its time, and with what was held when that part begins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.acting_wrenches import rejects
from rb_dynamics.analysis.track import Track
from rb_dynamics.errors import LogError
from rb_dynamics.formats.log_metadata import DAMAGED, INTERRUPTED, TOPICS, UNPLACED
from rb_dynamics.formats.message_types import INERTIA
from rb_dynamics.formats.topic_messages import KEPT, Times, Topic
from rb_dynamics.loads.thruster import Thruster
from rb_dynamics.logs.bag_reader import WRENCHES, Bag
from rb_dynamics.logs.stamp_clock import ClockLine, StampClock
from rb_dynamics.scene.model import Scene

Window = tuple[float | None, float | None]
"""First and last time, s; None: from the start, or to the end."""


def part_of(track: Track, window_s: Window, scene: Scene | None = None) -> Bag:
    """Return the bag of `track` with what lies in `window_s`.

    Times are simulation time of a log of this package, else s since the start of the motion.
    Of each topic of commands, what was held at the beginning is kept too, as are commands that then waited for their
    delay, and mass properties. In a bag of another program, `scene` says which commands these are.

    Raises:
        LogError: nothing of the motion lies in it.
    """
    start_ns, end_ns = track.span_ns
    zero_ns = 0 if track.own else start_ns
    first, last = (None if each is None else zero_ns + round(each * 1e9) for each in window_s)
    if (first is not None and first > end_ns) or (last is not None and last < start_ns) or _reversed(window_s):
        raise LogError(
            f"{track.bag.path}: found nothing {_words(window_s)}, expected a part of the motion, which goes from "
            f"{(start_ns - zero_ns) / 1e9:.9g} to {(end_ns - zero_ns) / 1e9:.9g} s; give --from and --to within it"
        )
    begin, end = (-(2**63) if first is None else first), (2**63 - 1 if last is None else last)
    motion = [series.topic for series in track.motion]
    stamped = [track.bag.topics[name] for name in motion if name in track.bag.topics]
    # Topics without stamps go by log times, which may be of another clock.
    line = ClockLine()
    if stamped and not track.own and stamped[0].stamps_given:
        line = StampClock.of(stamped[0].log_times, stamped[0].stamps).line
    waits_ns = dict.fromkeys((name for name, t in track.bag.topics.items() if t.type_name in WRENCHES), 0)
    waits_ns |= dict.fromkeys(track.bag.actuated, 0) | _waits(track, scene)
    rejected = {} if track.own else _rejected(track, scene)
    parts = {
        name: _part(topic, begin, end, line, waits_ns.get(name), rejected.get(name))
        for name, topic in track.bag.topics.items()
    }
    logged = np.concatenate([times for _, times in parts.values()])
    cut_ns = int(logged.min(initial=2**63 - 1)), int(logged.max(initial=-(2**63)))
    topics = {name: topic for name, (topic, _) in parts.items()}
    metadata = track.bag.metadata
    if track.own and track.missing:
        # That a later file of a bag, alone, does not begin at 0 is no longer seen in a part of it.
        pieces = [f"{a} {b}" for a, b in track.missing] + [UNPLACED] * track.bag.unplaced
        told = metadata.get(INTERRUPTED, {"reason": DAMAGED}) | {"missing_ns": ", ".join(pieces)}
        metadata = metadata | {INTERRUPTED: told}
    found = replace(track.bag, topics=topics, metadata=metadata)
    return replace(found, cut_ns=cut_ns, window_ns=(begin, end), zero_ns=zero_ns)


def _waits(track: Track, scene: Scene | None) -> dict[str, int]:
    """Return how long (ns) after commands to each topic what acts may still be that of those before."""
    if not track.own:
        found = {each.topic: each.channel.delay_ns for each in track.wrenches if each.channel is not None}
        for each in () if scene is None else scene.actuators:
            ramp = max(each.rise, each.fall) if isinstance(each, Thruster) else 0.0
            found |= dict.fromkeys(track.bag.actuated_of(each), round((each.delay + ramp) * 1e9))
        return found
    actuators = () if track.scene is None else track.scene.actuators
    found = {name: round(each.delay * 1e9) for each in actuators for name in track.bag.actuated_of(each)}
    names = track.bag.metadata.get(TOPICS, {})
    channels = () if track.scene is None else track.scene.channels
    return found | {names.get(channel.topic, ""): channel.delay_ns for channel in channels}


def _rejected(track: Track, scene: Scene | None) -> dict[str, NDArray[np.bool_]]:
    """Return which commands the scene rejects, by topics of a bag of another program: they leave what is held."""
    found: dict[str, NDArray[np.bool_]] = {}
    for each in track.wrenches:
        topic = track.bag.topics.get(each.topic)
        if topic is not None and topic.type_name in WRENCHES and each.channel is not None:
            channel = each.channel
            found[each.topic] = np.array([rejects(channel.limited, w) for _, w in track.bag.wrenches(each.topic)], bool)
    for actuator in () if scene is None else scene.actuators:
        for name in track.bag.actuated_of(actuator):
            found[name] = np.array([rejects(actuator.accept, value) for value in track.bag.scalars(name)[1]], bool)
    return found


def _part(
    topic: Topic, begin: int, end: int, line: ClockLine, wait: int | None, rejected: NDArray[np.bool_] | None
) -> tuple[Topic, Times]:
    """Return the messages from `begin` to `end` and those that are kept too, and the log times of the first alone.

    Of commands, those that came less than `wait` before are kept, and the last one before them that is not `rejected`.
    """
    if not topic.count:
        return topic, topic.log_times
    known = topic.type_name in KEPT
    times = topic.stamps if known and topic.stamps_given else line.stamps(topic.log_times)
    rows = (times >= begin) & (times <= end)
    logged = topic.log_times[rows]
    if wait is not None:
        rows |= (times >= begin - wait) & (times < begin)
        before = np.flatnonzero(times < begin - wait)
        if rejected is not None:
            before = before[~rejected[before]]
        if len(before):
            rows[before[times[before].argmax()]] = True
    return topic.only(rows | (topic.type_name == INERTIA)), logged


def _reversed(window_s: Window) -> bool:
    first, last = window_s
    return first is not None and last is not None and last < first


def _words(window_s: Window) -> str:
    told = zip(("from", "to"), window_s, strict=True)
    return " ".join(f"{word} {time:g} s" for word, time in told if time is not None)
