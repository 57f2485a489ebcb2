"""What acts on a body by a scene: recorded commands with delay and timeout, and wrenches of the scene itself."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.track import RecordedWrench, Times, Track
from rb_dynamics.errors import LogError, WrenchError
from rb_dynamics.formats.log_metadata import part_ns
from rb_dynamics.loads.uniform_gravity import UniformGravity
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.loads.wrench_channels import Channel
from rb_dynamics.logs.bag_reader import Bag
from rb_dynamics.logs.messages import APPLIED
from rb_dynamics.logs.topics_of_channels import names_in_scene
from rb_dynamics.numerics.nanoseconds import nanoseconds
from rb_dynamics.numerics.vector import ZERO
from rb_dynamics.scene.model import Scene

_LONG_BEFORE_NS = -(2**62)


def channels_of(
    topics: Iterable[str], scene: Scene | None, chosen: Mapping[str, str] | None = None
) -> dict[str, Channel]:
    """Return the scene's channel of the commands on each of `topics` that has one, see `names_in_scene`.

    Raises:
        LogError: a topic is chosen for what is not a channel.
    """
    channels = {} if scene is None else {channel.topic.removeprefix("/"): channel for channel in scene.channels}
    for topic, name in (chosen or {}).items():
        if name.removeprefix("/") not in channels:
            raise LogError(
                f"topic {topic} is chosen for {name!r}, expected a channel of the scene: {[*channels]}; name one"
            )
    return {topic: channels[name] for topic, name in names_in_scene(topics, channels, chosen).items()}


def which_channel(commands: Mapping[str, Channel | None], scene: Scene) -> str:
    """Return why it cannot be told how those of `commands` act, by their topics, that have no channel; "" if it can.

    They may be those of a channel without recorded commands. Its bias acts whatever they are.
    """
    like = Channel()
    others = [
        channel.topic
        for channel in scene.channels
        if channel not in commands.values()
        and replace(channel, topic=like.topic, optional=False, bias_force=ZERO, bias_torque=ZERO) != like
    ]
    named = ", ".join(topic for topic, channel in commands.items() if channel is None)
    if not (named and others):
        return ""
    many = " or ".join(others)
    return f"cannot tell whether {named} has the commands of {many}, with the delay, timeout, lag or limits of that"


def timed_out(times: Times, timeout_ns: int) -> tuple[Times, NDArray[np.intp]]:
    """Return when commands begin to act or expire before the next one, and the row that acts then; -1 for nothing."""
    rows = np.arange(len(times))
    if not timeout_ns:
        return times, rows
    following = np.append(times[1:], np.iinfo(np.int64).max)
    expires = times[times + timeout_ns < following] + timeout_ns
    all_times = np.concatenate([times, expires])
    order = np.argsort(all_times, kind="stable")
    return all_times[order], np.concatenate([rows, np.full(len(expires), -1)])[order]


def acting_wrenches(
    wrenches: Sequence[RecordedWrench],
    scene: Scene,
    missing: Sequence[tuple[int, int]],
    zero_ns: int,
    whole: bool = True,
) -> tuple[RecordedWrench, ...]:
    """Return what acts of recorded `wrenches`, and what effects and biases of `scene` hold from `zero_ns` on.

    Commands are unknown after each `missing` piece (first and last ns) of the recording, until the next. Unless the
    recording is `whole`, so is what `scene` schedules: nothing says when the run began.
    """
    known = (steps.without(missing) for steps in wrenches)
    found = [each if each.channel is None else in_channel(each, each.channel) for each in known]
    recorded = {each.topic.removesuffix(APPLIED) for each in wrenches if each.topic.endswith(APPLIED)}
    return (
        *found,
        *(
            _scheduled(name, entries, scene, zero_ns, whole)
            for name, entries in scene.combined_effects.schedules()
            if not any(f"/{topic}".endswith(f"/{name}") for topic in recorded)
        ),
    )


def held_before(track: Track) -> Track | None:
    """Return the same where what acts before the first command of each topic is not known; None if it is.

    A recording of another program may begin amid commands, and lack those that were held then. That is not asked of
    topics whose first command comes in its second half.
    """
    start, end = track.span_ns
    sent = {each.topic for each in track.wrenches if not each.topic.endswith(APPLIED)}
    late = [
        each.topic in sent and len(each.time_ns) > 0 and start < each.time_ns[0] <= (start + end) // 2
        for each in track.acting
    ]
    if track.own or not any(late):
        return None
    before = [(_LONG_BEFORE_NS, _LONG_BEFORE_NS)]
    acting = (each.without(before) if at else each for each, at in zip(track.acting, late, strict=True))
    return replace(track, by_scene=tuple(acting))


def waiting(steps: RecordedWrench, bag: Bag, channel: Channel | None) -> RecordedWrench:
    """Return commands of which, in a part of a bag, those before the one that is held may still wait in `channel`.

    They are not in the part; nor is what the channel held if it rejects that one.
    """
    part, topic = part_ns(bag.metadata), bag.topics.get(steps.topic)
    if part is None or channel is None or topic is None or not topic.count:
        return steps
    if int(topic.log_times.min()) >= part[0]:
        return steps
    limited = min(channel.max_force, channel.max_torque) < math.inf
    if limited and rejects(channel.limited, min(bag.wrenches(steps.topic), key=lambda each: each[0])[1]):
        return steps.without([(_LONG_BEFORE_NS, _LONG_BEFORE_NS)])
    if not channel.delay_ns or not len(steps.time_ns):
        return steps
    first_ns = int(steps.time_ns[0])
    return steps.without([(first_ns - channel.delay_ns, first_ns)])


def rejects(accept: Callable[[Any], object], command: object) -> bool:
    """Return whether a channel or an actuator rejects a command, by what `accept` raises."""
    try:
        accept(command)
    except WrenchError:
        return True
    return False


def in_channel(steps: RecordedWrench, channel: Channel) -> RecordedWrench:
    """Return what acts of recorded commands, with delay and timeout of their channel."""
    times, rows = timed_out(steps.time_ns + channel.delay_ns, channel.timeout_ns)
    # What is not known may be a command that came later than the one before: it does not expire.
    kept = (rows >= 0) | np.append(True, steps.known[rows[:-1]])[: len(rows)]
    times, rows = times[kept], rows[kept]
    ends = (rows < 0)[:, None]
    return replace(
        steps,
        time_ns=times,
        force=np.where(ends, 0.0, steps.force[rows]),
        torque=np.where(ends, 0.0, steps.torque[rows]),
        known=steps.known[rows] | (rows < 0),
        **{name: getattr(steps, name)[rows] for name in ("world", "at_point")},
    )


def is_constant(schedule: Sequence[tuple[float, Wrench]]) -> bool:
    """Return whether a schedule holds one wrench all the time, whenever the run began."""
    return len(schedule) == 1 and schedule[0][0] <= 0.0


def _scheduled(
    name: str, entries: Sequence[tuple[float, Wrench]], scene: Scene, zero_ns: int, whole: bool
) -> RecordedWrench:
    frames = scene.frames
    held = [frames.hold(wrench) for _, wrench in entries]
    found = RecordedWrench(
        topic=name,
        time_ns=np.array([zero_ns + nanoseconds(time) for time, _ in entries], dtype=np.int64),
        force=np.array([np.add(each.force_body, each.force_world) for each in held], dtype=np.float64),
        torque=np.array([np.add(each.torque_body, each.torque_world) for each in held], dtype=np.float64),
        world=np.array([wrench.frame_id == frames.world_frame for _, wrench in entries], dtype=bool),
        at_point=np.array([wrench.frame_id in (frames.fixed or {}) for _, wrench in entries], dtype=bool),
        known=np.ones(len(entries), dtype=bool),
        frames=tuple(sorted({wrench.frame_id for _, wrench in entries})),
        weight=name.rstrip("_0123456789") == f"effects/{UniformGravity.kind}",
    )
    if whole or is_constant(entries):
        return found
    # Some entry acts from long before the part on, and which one never becomes known.
    always = found.without([(_LONG_BEFORE_NS, zero_ns)])
    return replace(always, known=np.zeros(len(always.time_ns), dtype=bool))
