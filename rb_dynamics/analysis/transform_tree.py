"""`pose_between`: the pose of one frame in another, through the tree of frames that /tf and /tf_static span."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.gaps import strays
from rb_dynamics.analysis.track import LARGEST, Array, Times, unit_rows
from rb_dynamics.errors import LogError
from rb_dynamics.formats.channel_metadata import is_latched
from rb_dynamics.formats.message_types import TRANSFORM, TRANSFORMS
from rb_dynamics.formats.topic_messages import Topic
from rb_dynamics.logs.bag_reader import Bag
from rb_dynamics.numerics.rotation_arrays import (
    interpolated,
    lengths,
    product,
    rotate_all,
    rotate_all_inverse,
    rotations_between,
)

# The transforms of a way, from the outer frame inwards, and whether each is taken from parent to child.
_Steps: TypeAlias = "list[tuple[Topic, bool]]"


@dataclass(frozen=True)
class FramePose:
    """A pose composed of transforms.

    Attributes:
        topics: of the transforms, from the outer frame inwards.
        time_ns: stamps of the transform that comes most often.
        values: rows of position (m) and quaternion x, y, z, w.
        unusable: number of transforms left out because a number in them is not finite or too large.
        far_ns: stamps of moving transforms that are left out because they are far from all the others.
    """

    topics: tuple[str, ...]
    time_ns: Times
    values: Array
    unusable: int
    far_ns: tuple[int, ...]


def pairs(bag: Bag, without: Topic | None = None) -> dict[tuple[str, str], Topic]:
    """Return the topic of each pair of frames, parent and child, of which a bag has transforms.

    Of several, as on /tf of two namespaces, the first that moves counts, else the first; `without` does not.
    """
    found: dict[tuple[str, str], Topic] = {}
    for topic in bag.topics.values():
        if topic.type_name == TRANSFORM and topic.count and topic is not without:
            texts = topic.kinds[0][0]
            frames = texts[0].lstrip("/"), texts[1].lstrip("/")
            if frames not in found or (is_fixed(found[frames]) and not is_fixed(topic)):
                found[frames] = topic
    return found


def is_fixed(topic: Topic) -> bool:
    """Return whether the transforms of a topic hold for all time: those of /tf_static."""
    return is_latched(topic.name, topic.qos) or topic.count == 1


def pose_between(bag: Bag, world: str, body: str) -> FramePose:
    """Return the pose of the frame `body` in the frame `world`.

    Transforms that come at other times are interpolated, as tf2 does, and never extrapolated.

    Raises:
        LogError: the transforms do not connect the frames, or not at one time.
    """
    known = pairs(bag)
    steps = _path(known, world.lstrip("/"), body.lstrip("/"))
    if not steps:
        raise _unconnected(bag, known, world, body)
    return _composed(bag, steps, world, body)


def other_ways(bag: Bag, world: str, body: str) -> list[str]:
    """Return one sentence for each other way from `world` to `body`: in a tree there is none, and they may differ."""
    steps = _path(pairs(bag), world.lstrip("/"), body.lstrip("/"))
    found: dict[tuple[str, ...], str] = {}
    for used, _ in steps:
        if other := _path(pairs(bag, used), world.lstrip("/"), body.lstrip("/")):
            names = tuple(topic.name for topic, _ in other)
            found[names] = found.get(names) or (
                f"The transforms also lead from {world} to {body} by {', '.join(names)}, where a tree has one way: "
                + _apart(bag, steps, other, world, body)
            )
    return list(found.values())


def _apart(bag: Bag, one: _Steps, other: _Steps, world: str, body: str) -> str:
    """Return how far the poses of two ways are apart."""
    try:
        first, second = (_composed(bag, steps, world, body) for steps in (one, other))
    except LogError:
        return "nothing says whether the two agree."
    begin, end = (first.time_ns[0], first.time_ns[-1]) if len(second.time_ns) == 1 else second.time_ns[[0, -1]]
    common = (first.time_ns >= begin) & (first.time_ns <= end)
    if not common.any():
        return "the two are of other times."
    rows = first.values[common]
    there = interpolated(second.time_ns, second.values, first.time_ns[common])
    far = lengths(there[:, :3] - rows[:, :3]).max()
    turned = lengths(rotations_between(rows[:, 3:], there[:, 3:])).max()
    return f"the two are up to {far:.3g} m and {turned:.3g} rad apart."


def _composed(bag: Bag, steps: _Steps, world: str, body: str) -> FramePose:
    """Return the pose along a way of transforms."""
    moving = [topic for topic, _ in steps if not is_fixed(topic)]
    parts = {topic.name: _rows(topic) for topic, _ in steps}
    far = {topic.name: strays(parts[topic.name][0]) for topic in moving}
    for name, stamps in far.items():
        at, rows = parts[name]
        usual = ~np.isin(at, stamps)
        parts[name] = at[usual], rows[usual]
    if moving:
        time_ns, _ = max((parts[topic.name] for topic in moving), key=lambda part: len(part[0]))
        begin, end = max(parts[t.name][0][0] for t in moving), min(parts[t.name][0][-1] for t in moving)
        time_ns = time_ns[(time_ns >= begin) & (time_ns <= end)]
    else:
        time_ns = next(iter(parts.values()))[0][-1:]
    if not len(time_ns):
        raise LogError(
            f"{bag.path}: the transforms from {world!r} to {body!r} ({', '.join(t.name for t in moving)}) are not of "
            "one time, expected some that are; record them together"
        )
    position, attitude = np.zeros((len(time_ns), 3)), np.tile([0.0, 0.0, 0.0, 1.0], (len(time_ns), 1))
    for topic, inwards in steps:
        at, rows = parts[topic.name]
        rows = np.tile(rows[-1], (len(time_ns), 1)) if is_fixed(topic) else interpolated(at, rows, time_ns)
        moved, turned = rows[:, :3], rows[:, 3:]
        if not inwards:
            moved = -rotate_all_inverse(turned, moved)
            turned = turned * np.array([-1.0, -1.0, -1.0, 1.0])
        position = position + rotate_all(attitude, moved)
        attitude = product(attitude, turned)
    return FramePose(
        tuple(topic.name for topic, _ in steps),
        time_ns,
        np.hstack([position, attitude]),
        sum(int((~_usable(topic) & (topic.kinds[1] == 0)).sum()) for topic, _ in steps),
        tuple(np.concatenate([np.empty(0, np.int64), *far.values()]).tolist()),
    )


def _usable(topic: Topic) -> NDArray[np.bool_]:
    usable: NDArray[np.bool_] = np.all(np.abs(topic.numbers) < LARGEST, axis=1)
    return usable


def _path(known: dict[tuple[str, str], Topic], world: str, body: str) -> _Steps:
    """Return the shortest way from `world` to `body`, and whether each transform is taken from parent to child."""
    reached: dict[str, _Steps] = {world: []}
    waiting = deque([world])
    while waiting:
        here = waiting.popleft()
        for (parent, child), topic in known.items():
            for start, end, inwards in ((parent, child, True), (child, parent, False)):
                if start == here and end not in reached:
                    reached[end] = [*reached[here], (topic, inwards)]
                    waiting.append(end)
    return reached.get(body, [])


def _unconnected(bag: Bag, known: dict[tuple[str, str], Topic], world: str, body: str) -> LogError:
    if faults := [topic.error for topic in bag.topics.values() if topic.type_name == TRANSFORMS and topic.error]:
        return faults[0]
    listed = ", ".join(f"{parent}:{child}" for parent, child in sorted(known))
    remedy = f"there are {listed}: name two of these frames" if listed else "it has none at all: name a topic of a pose"
    return LogError(
        f"{bag.path}: found no transforms from {world!r} to {body!r}, expected two frames that transforms connect; "
        + remedy
    )


def _rows(topic: Topic) -> tuple[Times, Array]:
    """Return stamps, ascending and each once, and rows with unit quaternions, without those that are not numbers."""
    rows, stamps = topic.numbers, topic.stamps if topic.stamps_given else topic.log_times
    _, kind = topic.kinds
    kept = (kind == 0) & _usable(topic) & (rows[:, 3:] != 0.0).any(axis=1)
    if not kept.any():
        raise LogError(f"topic {topic.name}: found no transform of usable numbers, expected some; record it again")
    # Of the same stamp the later counts, as in tf2.
    times, first = np.unique(stamps[kept][::-1], return_index=True)
    rows = rows[kept][::-1][first]
    return times, np.hstack([rows[:, :3], unit_rows(rows[:, 3:])])
