"""`command_differences`: channels on which two recordings hold different wrenches, and from when on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from rb_dynamics.analysis.acting_wrenches import in_channel, waiting
from rb_dynamics.analysis.time_alignment import Alignment
from rb_dynamics.analysis.track import Array, RecordedWrench, Times, Track
from rb_dynamics.formats.log_metadata import TOPICS
from rb_dynamics.loads.actuator import Actuator
from rb_dynamics.loads.thruster import Thruster
from rb_dynamics.loads.wrench_channels import Channel
from rb_dynamics.logs.bag_reader import Bag
from rb_dynamics.logs.messages import APPLIED
from rb_dynamics.logs.topics_of_channels import names_in_scene
from rb_dynamics.logs.wrench_bags import driven_of

# ns by which a node may hear a command after another program stamped or recorded it, or intervals of its outputs: after
# a lag that it drops, it hears what came meanwhile at the next one.
_ARRIVAL_NS, _ARRIVAL_OUTPUTS = 50_000_000, 1.5
# Why commands on some channels are not said to differ.
_LAGGED = (
    "are not compared: what acted followed them with a lag, and the two recordings do not say what acted at the same "
    "times"
)
_IN_GAPS = "differ only within gaps of the motion, where they may be missing, too"

# When a wrench begins to act, and its bytes; None for one that is not known.
_Change: TypeAlias = tuple[int, "bytes | None"]


@dataclass(frozen=True)
class CommandDifference:
    """What differs on one channel.

    Attributes:
        topic: name of the channel in A; in B if A does not have it.
        a: number of commands (or changes of the applied wrench) of A within the time compared; None without a channel.
        b: the same of B.
        first_ns: since when the wrenches held differ, by the clock of A.
        force: largest difference, N.
        torque: largest difference, N m.
        axes: whether one is in world and the other in body axes at some time, and so cannot be subtracted.
        value: largest difference of the commands to an actuator, in its unit.
        unit: of an actuator's commands; "" for a wrench.
    """

    topic: str
    a: int | None
    b: int | None
    first_ns: int
    force: float = 0.0
    torque: float = 0.0
    axes: bool = False
    value: float = 0.0
    unit: str = ""

    def as_dict(self, zero_ns: int) -> dict[str, Any]:
        """Return plain values for JSON; times in s from `zero_ns`."""
        numbers: dict[str, Any] = {"force": self.force, "torque": self.torque, "axes_differ": self.axes}
        if self.unit:
            numbers = {"value": self.value, "unit": self.unit}
        first = {"first_difference_s": (self.first_ns - zero_ns) / 1e9}
        return {"topic": self.topic, "a": self.a, "b": self.b} | first | numbers


def command_differences(
    a: Track, b: Track, alignment: Alignment, span_ns: tuple[int, int], gaps: Sequence[tuple[int, int]] = ()
) -> tuple[list[CommandDifference] | None, list[str]]:
    """Return what differs within `span_ns` of A's clock, and remarks; None if one has no commands, or doubtful ones.

    What differs only within `gaps` of the motion (first and last ns, ascending) is a remark: commands may be missing.

    Channels of one name belong together, and so do a topic and the channel that it drove according to a log; if one is
    left on each side, these two. A difference that the uncertainty of the lag may cause does not count.
    """
    unknown = [name for name, track in (("A", a), ("B", b)) if not (track.own or track.wrenches)]
    if unknown:
        return None, [f"Commands are not compared: {' and '.join(unknown)} without them."]
    if doubts := [f"in {name} {track.doubt}" for name, track in (("A", a), ("B", b)) if track.doubt]:
        return None, [f"Commands are not compared: {'; '.join(doubts)}."]
    one, other = _sides(a, b)
    log = a if a.own else b
    devices = [] if a.own == b.own else [each.name for each in _actuators(log)]
    pushing = {_plain(log.bag.called(name + APPLIED)) for name in devices}
    one, other = ({name: side[name] for name in side if name not in pushing} for side in (one, other))
    pairs = [(name, one.get(name), other.get(name)) for name in dict.fromkeys((*one, *other))]
    told = _not_compared(devices)
    left = [[name for name in names if name not in others] for names, others in ((one, other), (other, one))]
    if all(len(names) == 1 for names in left):
        (mine,), (its,) = left
        pairs = [pair for pair in pairs if pair[0] not in (mine, its)] + [(mine, one[mine], other[its])]
        told.append(f"The commands on {mine} in A are compared with those on {its} in B.")
    # As a float, a time since 1970 in seconds is accurate to less than a microsecond.
    tolerance_ns = 1000 if alignment.by == "seconds" else 0
    if alignment.uncertainty_s is not None:
        intervals = [np.diff(steps.time_ns) for each in (one, other) for steps in each.values()]
        usual_s = min((float(np.median(each)) / 1e9 for each in intervals if len(each)), default=np.inf)
        if usual_s < 4.0 * alignment.uncertainty_s:
            told.append(
                f"Commands are not compared: the lag is known to +- {alignment.uncertainty_s:.2g} s, and they come "
                f"every {usual_s:.2g} s."
            )
            return None, told
        if np.isfinite(alignment.uncertainty_s):
            tolerance_ns = round(2e9 * alignment.uncertainty_s)
    found, others, late_ns = _of_wrenches(
        pairs, _sampled(a) | _sampled(b), alignment.offset_ns, span_ns, tolerance_ns, gaps, _latest_ns(log)
    )
    told += [f"Commands on {', '.join(names)} {why}." for why, names in others.items()]
    if late_ns:
        told.append(
            f"Commands on {', '.join(late_ns)} differ in nothing but when they act, by up to "
            f"{max(late_ns.values()) * 1e-6:.3g} ms: a node takes them on arrival, unless it is told otherwise, and "
            "the bag has their stamps or when they were recorded."
        )
    if a.own and b.own:
        found += _of_actuators(a, b, alignment.offset_ns, span_ns, tolerance_ns)
    doubtful = [(steps.topic, track) for track in (a, b) for steps in track.wrenches if not steps.known.all()]
    unknown = sorted({topic for topic, _ in doubtful})
    if unknown:
        remedy = "; --scene SCENE says what frames are" if any(track.by_scene is None for _, track in doubtful) else ""
        told.append(
            f"Not all commands on {', '.join(unknown)} are compared: some are in frames that are not declared, or are "
            f"no usable numbers{remedy}."
        )
    sides = (steps for side in (one, other) for steps in side.values())
    limited = sorted({steps.topic for steps in sides if not steps.known.all()} - {*unknown})
    if limited:
        told.append(
            f"Not all commands on {', '.join(limited)} are compared: some may be beyond the limits of their channel, "
            "which --scene SCENE applies, wait in it where a part of a bag begins, or be in a missing piece."
        )
    return found if found or not (unknown or devices or limited or others) else None, told


def _of_wrenches(
    pairs: Sequence[tuple[str, RecordedWrench | None, RecordedWrench | None]],
    sampled: set[str],
    offset_ns: int,
    span_ns: tuple[int, int],
    tolerance_ns: int,
    gaps: Sequence[tuple[int, int]],
    latest_ns: int,
) -> tuple[list[CommandDifference], dict[str, list[str]], dict[str, int]]:
    """Return the channels that hold different wrenches within `span_ns`.

    Beside them are others by why they are not said to, and by how much later the same acted on the rest, at most, ns.
    """
    found, told, late_ns = list[CommandDifference](), dict[str, list[str]](), dict[str, int]()
    for name, x, y in pairs:
        times = None
        # A channel on which nothing ever acted is known at all times.
        if x and y and len(x.time_ns) and len(y.time_ns) and sampled & {x.topic, y.topic}:
            times = _common_times(x, y, offset_ns, span_ns)
            if tolerance_ns or not len(times):
                told.setdefault(_LAGGED, []).append(name)
                continue
        compared = partial(_compared, name, offset_ns=offset_ns, span_ns=span_ns, only=times)
        differs = compared(x, y, tolerance_ns=tolerance_ns)
        if differs is None:
            continue
        if gaps and (differs := compared(x, y, tolerance_ns=tolerance_ns, gaps=gaps)) is None:
            told.setdefault(_IN_GAPS, []).append(name)
            continue
        late = None if times is not None else _on_arrival(x, y, offset_ns, span_ns, tolerance_ns, gaps, latest_ns)
        if late is None:
            found.append(differs)
        else:
            late_ns[name] = late
    return found, told, late_ns


def _on_arrival(
    x: RecordedWrench | None,
    y: RecordedWrench | None,
    offset_ns: int,
    span_ns: tuple[int, int],
    tolerance_ns: int,
    gaps: Sequence[tuple[int, int]],
    latest_ns: int,
) -> int | None:
    """Return by how much later than in a bag the same acted in a log, one after the other, at most, ns; None if others.

    Those at the ends of `span_ns` and in `gaps` may be in one alone, and so may what was rejected or is not understood,
    or has the time of a later one in the bag.
    """
    if x is None or y is None or x.topic.endswith(APPLIED) == y.topic.endswith(APPLIED):
        return None
    loose = [(at - latest_ns, at + latest_ns) for at in span_ns] + list(gaps)
    log, bag = _changes(x, 0, span_ns), _changes(y, offset_ns, span_ns)
    sent = y
    if y.topic.endswith(APPLIED):
        log, bag, sent = bag, log, x
    late_ns = -tolerance_ns - sent.within_ns, latest_ns
    most_ns, next_ns = 0, span_ns[1]
    while log or bag:
        (at, _), (stamp, commanded) = (each[-1] if each else (span_ns[1], None) for each in (log, bag))
        if log and bag and _same(log[-1], bag[-1], late_ns):
            most_ns = max(most_ns, abs(at - stamp))
            log.pop()
            next_ns, _ = bag.pop()
        elif bag and commanded is None:
            next_ns, _ = bag.pop()
            # Backwards in time: what acted since is that of the command, if it was accepted.
            while log and log[-1][0] >= stamp and not (bag and _same(log[-1], bag[-1], late_ns)):
                log.pop()
        elif log and (not bag or at >= stamp) and any(begin <= at <= end for begin, end in loose):
            log.pop()
        elif bag and (stamp == next_ns or any(begin <= stamp <= end for begin, end in loose)):
            next_ns, _ = bag.pop()
        else:
            return None
    return most_ns


def _latest_ns(log: Track) -> int:
    rate = 0.0 if log.scene is None else log.scene.output_rate
    return max(_ARRIVAL_NS, round(_ARRIVAL_OUTPUTS / rate * 1e9) if rate > 0.0 else 0)


def _same(acting: _Change, commanded: _Change, late_ns: tuple[int, int]) -> bool:
    """Return whether a change is that which a bag has, later by at least and less than so much."""
    least, most = late_ns
    return acting[1] == commanded[1] and least <= acting[0] - commanded[0] < most


def _changes(steps: RecordedWrench, offset_ns: int, span_ns: tuple[int, int]) -> list[_Change]:
    """Return when each wrench begins to act within `span_ns`, ascending, and its bytes; None if it is not known."""
    acts = steps.force.any(axis=1) | steps.torque.any(axis=1)
    # No zero has a sign or axes.
    rows = np.column_stack([steps.force, steps.torque, steps.world & acts]) + 0.0
    found: list[_Change] = [(span_ns[0], np.zeros(rows.shape[1]).tobytes())]
    for at, row, known in zip((steps.time_ns - offset_ns).tolist(), rows, steps.known.tolist(), strict=True):
        wrench = row.tobytes() if known else None
        if at <= span_ns[0]:
            found = [(span_ns[0], wrench)]
        elif at < span_ns[1] and wrench != found[-1][1]:
            found.append((at, wrench))
    return found


def _not_compared(devices: Sequence[str]) -> list[str]:
    if not devices:
        return []
    return [f"Commands to {', '.join(devices)} are not compared: in the bag of another program they have no stamps."]


def _sides(a: Track, b: Track) -> tuple[dict[str, RecordedWrench], dict[str, RecordedWrench]]:
    """Return the wrenches of both by channel.

    A bag of another program does not say which effects and biases act: they are left out of a log beside it.
    """
    one, other = _channels(a, b), _channels(b, a)
    if a.own != b.own:
        one, other = _without_effects(one, other), _without_effects(other, one)
    return one, other


def _channels(track: Track, flown: Track) -> dict[str, RecordedWrench]:
    """Return the wrenches by channel; topics of a bag by the channel that they drove in the run `flown` from it."""
    driven = {} if track.own else driven_of(flown.bag.metadata)
    if track.own and flown.own:
        # Each of two logs says what its topics are in its scene, those of effects too.
        names = track.bag.metadata.get(TOPICS, {}).items()
        driven = {topic.removesuffix(APPLIED): name.removesuffix(APPLIED) for name, topic in names}
    channels = {topic.removeprefix("/"): channel.removeprefix("/") for topic, channel in driven.items()}
    recorded = [_name(steps) for steps in track.recorded]
    # One of the two may have been recorded in a namespace.
    theirs = {*map(_name, flown.wrenches)} - {*channels.values()}
    channels = names_in_scene([name for name in recorded if name not in channels], theirs) | channels
    scene = None if track.own else flown.scene
    # What is in a namespace has the name that the log says, or that of the scene.
    topics = flown.bag.metadata.get(TOPICS, {})
    acts = {
        name.removeprefix("/"): each
        for each in (() if scene is None else scene.channels)
        for name in (each.topic, topics.get(each.topic, each.topic))
    }
    called = [channels.get(name, name) for name in recorded]
    found = zip(called, track.recorded, strict=True)
    return {name: _acting(steps, track.bag, acts.get(name)) for name, steps in found}


def _acting(steps: RecordedWrench, bag: Bag, channel: Channel | None) -> RecordedWrench:
    """Return what acts of commands recorded in `bag` in `channel` of the log beside them, as that has what acted."""
    if channel is None or steps.topic.endswith(APPLIED):
        return steps
    # Commands that were read without their channel are not known where its limits may change them.
    steps = waiting(steps if steps.channel else _within_limits(steps, channel), bag, channel)
    return in_channel(steps, channel)


def _within_limits(steps: RecordedWrench, channel: Channel) -> RecordedWrench:
    """Return commands that are not known beyond the limits of `channel`, and where a torque has a lever arm in it."""
    most = 1.0 + 1e-12
    within = np.linalg.norm(steps.force, axis=1) <= channel.max_force * most
    within &= np.linalg.norm(steps.torque, axis=1) <= channel.max_torque * most
    return replace(steps, known=steps.known & within & ~(steps.at_point & np.isfinite(channel.max_torque)))


def _without_effects(side: dict[str, RecordedWrench], other: dict[str, RecordedWrench]) -> dict[str, RecordedWrench]:
    # A node in a namespace has them in it.
    return {name: steps for name, steps in side.items() if name in other or "/effects/" not in f"/{name}"}


def _name(steps: RecordedWrench) -> str:
    return _plain(steps.topic)


def _plain(topic: str) -> str:
    return topic.removesuffix(APPLIED).removeprefix("/")


def _of_actuators(
    a: Track, b: Track, offset_ns: int, span_ns: tuple[int, int], tolerance_ns: int
) -> list[CommandDifference]:
    """Return the actuators of two logs that hold different commands within `span_ns`.

    Thrusters are compared by the wrench that acts. Before the first command, none is held.
    """
    found = []
    one, other = _setpoints(a, 0), _setpoints(b, offset_ns)
    for name in dict.fromkeys((*one, *other)):
        sides = one.get(name), other.get(name)
        unit = next(side.unit for side in sides if side is not None)
        edges = [side.time_ns for side in sides if side is not None]
        at = np.unique(np.concatenate([np.array(span_ns[:1], dtype=np.int64), *edges]))
        at = at[(at >= span_ns[0]) & (at < span_ns[1])]
        x, y = (np.full(len(at), np.nan) if side is None else side.held(at) for side in sides)
        # A difference no longer than the possible shift between the two means nothing.
        long = np.diff(at, append=span_ns[1]) > tolerance_ns
        differ = long & (x != y) & ~(np.isnan(x) & np.isnan(y))
        if differ.any():
            counts = tuple(None if side is None else int(np.isin(side.time_ns, at).sum()) for side in sides)
            apart = np.abs(np.nan_to_num(x) - np.nan_to_num(y))
            since, most = int(at[differ.argmax()]), float(apart[long].max())
            found.append(CommandDifference(name, counts[0], counts[1], since, value=most, unit=unit))
    return found


@dataclass(frozen=True)
class _Setpoints:
    """The commands to an actuator, each held until the next.

    Attributes:
        unit: of the values.
        time_ns: when they came, ascending.
        values: the commands.
    """

    unit: str
    time_ns: Times
    values: Array

    def held(self, at: Times) -> Array:
        """Return what is held at each time; NaN before the first command."""
        last = self.time_ns.searchsorted(at, "right") - 1
        return np.append(self.values, np.nan)[last]


def _setpoints(track: Track, offset_ns: int) -> dict[str, _Setpoints]:
    """Return the commands to each actuator of a log but its thrusters, by its topic in the scene."""
    found = {}
    for actuator in _actuators(track):
        if not isinstance(actuator, Thruster):
            topic = track.bag.topics.get(track.bag.called(actuator.topic))
            times, values = np.empty(0, np.int64), np.empty(0)
            if topic is not None and topic.count:
                times, values = track.bag.scalars(topic.name)
            found[actuator.topic] = _Setpoints(actuator.unit, times - offset_ns, values)
    return found


def _actuators(track: Track) -> tuple[Actuator, ...]:
    """Return the actuators of the scene of a log."""
    scene = track.scene
    return () if scene is None else scene.actuators


def _sampled(track: Track) -> set[str]:
    """Return the topics of a log on which wrenches change gradually: each row holds for its own time only."""
    scene = track.scene
    if scene is None:
        return set()
    names = [channel.topic for channel in scene.channels if channel.lag]
    names += [each.name for each in scene.actuators if isinstance(each, Thruster) and (each.rise or each.fall)]
    return {track.bag.called(name + APPLIED) for name in names}


def _common_times(a: RecordedWrench, b: RecordedWrench, offset_ns: int, span_ns: tuple[int, int]) -> Times:
    """Return the times within `span_ns` at which both wrenches are known, by the clock of A."""
    times = np.intersect1d(a.time_ns, b.time_ns - offset_ns)
    acted = a.topic.endswith(APPLIED) and b.topic.endswith(APPLIED)
    return times[(times >= span_ns[0]) & (times < span_ns[1]) & acted]


def _compared(
    name: str,
    a: RecordedWrench | None,
    b: RecordedWrench | None,
    offset_ns: int,
    span_ns: tuple[int, int],
    tolerance_ns: int,
    only: Times | None = None,
    gaps: Sequence[tuple[int, int]] = (),
) -> CommandDifference | None:
    """Return how two channels differ within `span_ns`, outside `gaps`, at all times or `only` at some; None if not."""
    begin, end = span_ns
    # A command at the very end has no time to act.
    after = [last for _, last in gaps if begin <= last < end]
    times = [np.array([begin, *after], dtype=np.int64)]
    counts: dict[str, int | None] = {}
    for side, steps, later in (("a", a, 0), ("b", b, offset_ns)):
        counts[side] = None
        if steps is None:
            continue
        at = steps.time_ns - later
        at = at[(at >= begin) & (at < end)]
        counts[side] = len(at)
        times.append(at)
    at = np.unique(np.concatenate(times)) if only is None else only
    (force_a, torque_a, world_a, known_a), (force_b, torque_b, world_b, known_b) = (
        _held(a, at, 0),
        _held(b, at, offset_ns),
    )
    # A difference no longer than the possible shift between the two means nothing.
    known = known_a & known_b & (np.diff(at, append=end) > tolerance_ns)
    if gaps:
        firsts, lasts = np.array(gaps, dtype=np.int64).T
        place = firsts.searchsorted(at, "right") - 1
        known &= (place < 0) | (at >= lasts[place])
    turned = (world_a != world_b) & (force_a.any(axis=1) | torque_a.any(axis=1))
    turned &= force_b.any(axis=1) | torque_b.any(axis=1)
    forces, torques = (np.linalg.norm(x - y, axis=1) for x, y in ((force_a, force_b), (torque_a, torque_b)))
    differ = known & ((forces > 0.0) | (torques > 0.0) | turned)
    if not differ.any():
        return None
    return CommandDifference(
        name,
        counts["a"],
        counts["b"],
        first_ns=int(at[differ.argmax()]),
        force=float(forces[known].max()),
        torque=float(torques[known].max()),
        axes=bool(turned[known].any()),
    )


def _held(steps: RecordedWrench | None, at: Times, offset_ns: int) -> Sequence[Any]:
    """Return force, torque, whether in world axes and whether known, as held at each time; zero before the first."""
    count = len(at)
    zero = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count, dtype=bool), np.ones(count, dtype=bool)
    if steps is None or not len(steps.time_ns):
        return zero
    last = (steps.time_ns - offset_ns).searchsorted(at, "right") - 1
    begun = last >= 0
    columns = (steps.force, steps.torque, steps.world, steps.known)
    return [
        np.where(begun.reshape((-1,) + (1,) * (column.ndim - 1)), column[np.maximum(last, 0)], default)
        for column, default in zip(columns, zero, strict=True)
    ]
