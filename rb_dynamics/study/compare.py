"""`compare`: read two recordings, or fly a scene under the commands of one, put them on one clock, and compare them."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from decimal import Decimal
from operator import attrgetter
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from rb_dynamics.analysis.checks import losses
from rb_dynamics.analysis.interpolated_signal import MotionSignals
from rb_dynamics.analysis.read_track import TopicChoice, read_track
from rb_dynamics.analysis.recording_differences import MOTION, Bound, Comparison, Given, compare_tracks
from rb_dynamics.analysis.time_alignment import Alignment, best_lag, misfit
from rb_dynamics.analysis.track import Times, Track
from rb_dynamics.analysis.transform_tree import other_ways
from rb_dynamics.errors import LogError
from rb_dynamics.formats.log_metadata import RUN, TOPICS
from rb_dynamics.formats.message_types import SCALAR
from rb_dynamics.loads.wrench_channels import WrenchChannels
from rb_dynamics.logs import unset_stamps
from rb_dynamics.logs.bag_reader import POSES, TWISTS, Bag, read_bag
from rb_dynamics.logs.bag_reader import WRENCHES as WRENCH_TYPES
from rb_dynamics.logs.messages import APPLIED
from rb_dynamics.logs.own_log import opened_scene
from rb_dynamics.logs.ros_time import in_time_of
from rb_dynamics.logs.topics_of_channels import names_in_scene
from rb_dynamics.logs.unset_stamps import FAR_NS
from rb_dynamics.logs.wrench_bags import RecordedWrenches, Start, origin_of
from rb_dynamics.numerics.argument_checks import number, shown
from rb_dynamics.run.simulate import simulate
from rb_dynamics.scene.model import Scene
from rb_dynamics.scene.read import parse_scene, with_true_text
from rb_dynamics.sinks.mcap_sink import McapSink

Source: TypeAlias = "Scene | str | os.PathLike[str]"
Align: TypeAlias = Literal["start", "stamp"] | float | Decimal | None

# By stamps a foreign recording is called misaligned if a lag leaves this many times less, and this many samples away.
_BETTER = 10.0
# Recordings no further apart by their stamps may be pieces of one flight (ns).
_ONE_FLIGHT_NS = 3600 * 10**9


def compare(
    a: Source,
    b: Source | None = None,
    *,
    scene: Source | None = None,
    align: Align = None,
    bound: Bound | None = None,
    share: float = 0.0,
    start_s: float | None = None,
    end_s: float | None = None,
    wrench_start: Start = "auto",
    mapping: Mapping[str, str] | None = None,
    topics: TopicChoice | tuple[TopicChoice, TopicChoice] | None = None,
) -> Comparison:
    """Return how two flights differ.

    Args:
        a: a log of this package, a bag of another program, or a scene, which is simulated under the commands of `b`.
        b: likewise; None: `scene`, simulated under the commands of `a`.
        scene: body and frames for recordings without them; it is also simulated if a recording has only commands, and
            if both are one bag.
        align: "start": both motions begin at one time; "stamp": the stamps are of one clock;
            seconds: time of B minus time of A at one instant. None: by the commands if one was simulated under those of
            the other, else by stamps if the recordings then overlap, else by the lag that fits best, if it is certain.
        bound: largest difference accepted in attitude (rad), position (m) and velocities (rad/s, m/s): one for all, or
            some by name, as in {"attitude": 0.01, "position": 0.05}.
        share: least fraction of the longer recording, between `start_s` and `end_s`, over which each quantity with a
            bound must be compared.
        start_s: compare from here on, s as in the result.
        end_s: compare up to here.
        wrench_start: for a simulated scene, which time of the commands is time 0; see `simulate --wrench-start`.
        mapping: for a simulated scene, the channel that each topic drives, if their names differ.
        topics: topics of the body in bags from other programs; by default found by type and name. A pair is for A and
            for B, also for logs of this package. If A and B are one bag, other topics are used for neither, because
            each would agree with itself.

    Raises:
        TypeError: an argument has the wrong type.
        ValueError: a bound is less than 0, or names no quantity of `MOTION`; the share is not from 0 to 1.
        LogError: a recording cannot be read, nothing can be compared, or no lag is certain.
        SceneError: a scene is not valid.
    """
    if isinstance(bound, Mapping) and not bound:
        raise ValueError(f"bound names nothing, expected {' or '.join(MOTION)}; leave it out to judge nothing")
    for name, most in bound.items() if isinstance(bound, Mapping) else [("", bound)]:
        if name and name not in MOTION:
            raise ValueError(f"bound names {shown(name)}, expected {' or '.join(MOTION)}; name one of these")
        if most is not None:
            number(most, "bound", "a finite number, 0 or more", least=0.0)
    number(share, "share", "a number from 0 to 1", least=0.0, most=1.0)
    if b is None:
        if scene is None:
            raise LogError(
                f"found one flight, {a}, expected two; name another, or a scene to simulate with --scene SCENE"
            )
        b = scene
    if _is_scene(a) and _is_scene(b):
        raise LogError(
            f"found two scenes, {shown(a)} and {shown(b)}, expected a recording in one place at least; run one with "
            "simulate --mcap RUN.mcap and compare its log"
        )
    flight = _Flights(a, b, scene, wrench_start, mapping or {}, topics)
    one, other = flight.both()
    alignment, notes = _aligned(one, other, flight.offset_ns, align)
    return compare_tracks(one, other, alignment, bound, (start_s, end_s), [*flight.notes, *notes], share)


def _is_scene(source: Source) -> bool:
    if not isinstance(source, (str, os.PathLike, Scene)):
        raise TypeError(f"a flight is {shown(source)}, expected a path or a Scene; give its file, or read_scene(file)")
    return isinstance(source, Scene) or Path(source).suffix in (".yaml", ".yml")


def _is_one(a: Source, b: Source) -> bool:
    """Return whether both are one bag."""
    return not (_is_scene(a) or _is_scene(b)) and Path(str(a)).exists() and Path(str(a)).samefile(str(b))


def _require_different(a: Track, b: Track) -> None:
    """Refuse a topic of a bag that is compared with itself beside others.

    Raises:
        LogError: there is one.
    """
    for what, one, other in (("pose", a.pose, b.pose), ("twist", a.twist, b.twist)):
        if one is not None and other is not None and one.topic == other.topic:
            raise LogError(
                f"{a.bag.path}: the {what} of both is that of {one.topic}, which agrees with itself; name a {what} for "
                f"each, with --{what}-topic twice, or leave it out"
            )


class _Flights:
    """Reads two flights, and simulates one of them if it is a scene or has no motion.

    Attributes:
        offset_ns: time of B minus time of A, if known from the commands; None otherwise.
        notes: on how the scene was simulated.
    """

    def __init__(
        self,
        a: Source,
        b: Source,
        scene: Source | None,
        wrench_start: Start,
        mapping: Mapping[str, str],
        topics: TopicChoice | tuple[TopicChoice, TopicChoice] | None,
    ) -> None:
        self._sources = (a, b)
        self._choices = topics if isinstance(topics, tuple) else None
        self._one_bag = self._choices is not None and _is_one(a, b)
        self._scene = None if scene is None else opened_scene(scene)
        self._start, self._mapping = wrench_start, mapping
        self._topics = None if isinstance(topics, tuple) else topics
        self.offset_ns: int | None = None
        self.notes: list[str] = []

    def both(self) -> tuple[Given, Given]:
        """Return the two."""
        repeated = self._choices is not None
        bags = [
            None if isinstance(each, Scene) or _is_scene(each) else read_bag(each, repeated) for each in self._sources
        ]
        self._take_out_pauses([each for each in bags if each is not None])
        a, b = (None if bag is None else self._of_bag(bag, k, bags[1 - k]) for k, bag in enumerate(bags))
        if a is not None and b is not None:
            if self._one_bag:
                _require_different(a.track, b.track)
                return a, b
            if self._scene is not None and not a.track.own and _is_one(*self._sources):
                # Comparing a bag with itself shows nothing: the scene has to be simulated.
                return self._flown(self._scene, a, 0), b
            if self._scene is not None and not (_moves(a.track) and _moves(b.track)):
                if not _moves(b.track):
                    return a, self._flown(self._scene, b, 1)
                return self._flown(self._scene, a, 0), b
            return a, b
        if b is None and a is not None:
            return a, self._flown(opened_scene(self._sources[1]), a, 1)
        assert b is not None
        return self._flown(opened_scene(self._sources[0]), b, 0), b

    def _take_out_pauses(self, bags: list[Bag]) -> None:
        """Put a bag on the clock of the log beside it, which stands still in pauses and lags."""
        logs = [bag for bag in bags if RUN in bag.metadata]
        if len(logs) == 1 and len(bags) == 2 and (stood := in_time_of(*logs, *bags)):
            self.notes.append(
                f"Simulation time stood still for {stood:.9g} s in all, by {logs[0].path}: in pauses, or where the "
                "node fell behind. ROS times are compared without that."
            )

    def _of_bag(self, bag: Bag, place: int, other: Bag | None) -> Given:
        """Return a recording; `place` is 0 for A."""
        own, source = RUN in bag.metadata, self._sources[place]
        scene = None if own else self._scene or self._other_scene()
        choice = None if own else self._topics or _named_in_log(bag, other)
        if self._choices is not None:
            choice = replace(self._choices[place], alone=self._one_bag)
        track = read_track(bag, scene, choice, spikes=True, thrusters=False)
        for topic in bag.topics.values():
            if topic.damaged:
                part = f"{len(topic.damaged)} of {topic.count} messages of {topic.name}"
                self.notes.append(f"{bag.path}: {part} are cut short or damaged, and left out.")
        self.notes += [unset_stamps.told(bag.path)] * bool(bag.unset)
        self.notes += [f"{bag.path}: {each}." for each in losses(track)]
        if choice is not None and choice.frames is not None:
            self.notes += [f"{bag.path}: {each}" for each in other_ways(bag, *choice.frames)]
        motion = [each.topic for each in track.motion] if self._one_bag else []
        return Given(track, ", ".join([str(source), *dict.fromkeys(motion)]))

    def _other_scene(self) -> Scene | None:
        """Return the scene to simulate; it also gives body and frames of the recording."""
        return next((opened_scene(source) for source in self._sources if _is_scene(source)), None)

    def _flown(self, scene: Scene, other: Given, place: int) -> Given:
        """Return the flight of `scene` under the commands of the other recording; `place` is 0 for A."""
        bag = other.track.bag
        commands = self._commands(scene, other.track)
        if scene.duration is None:
            begin, end = other.track.span_ns
            # Without commands, stamps count from time 0 of the run only where they are not those of another clock.
            first = begin * (begin > FAR_NS) if commands is None else _start_of(commands)
            length = end - first if end > begin else 0
            if length <= 0:
                raise LogError(
                    f"{scene.source} has no duration and {bag.path} no motion, expected one of them; write duration "
                    "in the scene"
                )
            if with_true_text(scene) is scene:
                # With its text, the log of the flight says how the channels of the scene act.
                scene = parse_scene(scene.text, scene.source, {"duration": length * 1e-9})
            else:
                scene = replace(scene, duration=length * 1e-9, text="")
        with tempfile.TemporaryDirectory() as folder:
            log = Path(folder) / "flight.mcap"
            if commands is None:
                simulate(scene, sinks=[McapSink(log)])
            else:
                result = simulate(scene, commands, [McapSink(log)], facts=commands.facts)
                start = _start_of(commands)
                self.offset_ns = start if place == 0 else -start
                new = [note for note in commands.notes if note not in self.notes]
                self.notes += [*new, *[commands.superseded_words] * bool(commands.superseded)]
                if result.rejected:
                    self.notes.append(
                        f"{len(result.rejected)} of {len(commands)} commands were rejected; the first: "
                        f"{result.rejected[0]}"
                    )
            track = read_track(read_bag(log, repeated=False), spikes=True)
        return Given(track, scene.source, flown=True)

    def _commands(self, scene: Scene, track: Track) -> RecordedWrenches | None:
        """Return the commands for the scene; None if the recording has none at all."""
        bag, actuators = track.bag, [each.topic for each in scene.actuators]
        topics = [channel.topic for channel in scene.channels]
        # A log says how its topics are called in a scene; what the user says comes first.
        renamed = {each.topic: each.channel.topic for each in track.wrenches if each.channel and not track.doubt}
        renamed |= {bag.metadata.get(TOPICS, {}).get(topic, topic): topic for topic in (*topics, *actuators)}
        mapping = {
            name: topic
            for name, topic in renamed.items()
            if name in bag.topics and name.lstrip("/") != topic.lstrip("/") and topic not in self._mapping.values()
        }
        mapping |= self._mapping
        scalars = [topic.name for topic in bag.topics.values() if topic.type_name == SCALAR]
        driven = names_in_scene(scalars, actuators, mapping)
        commanding = [
            topic
            for topic in bag.topics.values()
            if topic.count and (topic.type_name in WRENCH_TYPES or topic.name in driven)
        ]
        if not commanding:
            self.notes.append(f"{bag.path} has no commands: {scene.source} is simulated without any.")
            return None
        channels = WrenchChannels(scene.channels, scene.frames, body=scene.body)
        # Of a scene without an end, stamps beyond that are those of another clock.
        end_ns = FAR_NS if scene.end_ns is None else scene.end_ns
        commands = RecordedWrenches([bag.path], topics, end_ns, mapping, self._start, channels, scene.actuators)
        commands.require_some(continues=scene.past is not None)
        return commands


def _named_in_log(bag: Bag, log: Bag | None) -> TopicChoice | None:
    """Return the motion in a bag by its names in the log beside it; None without these: a bag may have other bodies."""
    if log is None or RUN not in log.metadata:
        return None
    for names in (("pose", "twist"), ("odom", "odom")):
        pose, twist = map(log.called, names)
        found = [bag.topics.get(name) for name in (pose, twist)]
        if all(
            each is not None and each.count and each.type_name in types
            for each, types in zip(found, (POSES, TWISTS), strict=True)
        ):
            return TopicChoice(pose, twist)
    return None


def _start_of(commands: RecordedWrenches) -> int:
    """Return the time (ns) of the bag that is time 0 of the run."""
    return int(commands.facts["wrench_start_ns"].partition(",")[0])


def _moves(track: Track) -> bool:
    return track.pose is not None or track.twist is not None


def _aligned(a: Given, b: Given, flown_ns: int | None, align: Align) -> tuple[Alignment, list[str]]:
    """Return how the times belong together, and remarks on that."""
    one, other = MotionSignals.of(a.track), MotionSignals.of(b.track)
    for each, motion in ((a, one), (b, other)):
        if motion == MotionSignals():
            hint = each.track.frames_to_choose and f"{each.track.frames_to_choose}; "
            raise LogError(
                f"{each.path} has no pose and no twist, expected a motion to compare; {hint}to run the commands in it, "
                "give the recording of a motion and --scene SCENE"
            )
    if align == "start":
        return Alignment("start", other.span_ns[0] - one.span_ns[0], asked=True), []
    if align == "stamp":
        return Alignment("stamp", 0, asked=True), []
    if align is not None:
        if not isinstance(align, (int, float, Decimal)):
            raise TypeError(
                f"align is {shown(align)}, expected start, stamp or a number of seconds; write one of these"
            )
        return Alignment("seconds", round(align * 10**9), asked=True), []
    if flown_ns is None:
        flown_ns = _flown_from(a.track, b.track)
    if flown_ns:
        return Alignment("commands", flown_ns), []
    (begin_a, end_a), (begin_b, end_b) = one.span_ns, other.span_ns
    if max(begin_a, begin_b) <= min(end_a, end_b) or flown_ns == 0:
        return Alignment("stamp", 0), [] if flown_ns == 0 else _off_stamps(a.track, b.track, one, other)
    lag = _lag(a, b, one, other)
    if lag.doubtful:
        offset = Decimal(lag.offset_ns) / 10**9
        raise LogError(
            f"found no lag that is certain: {offset} s (time of B minus that of A) fits best, but "
            f"{' and '.join(lag.doubts)}; say how the times belong together: --align {offset}, "
            "--align start or --align SECONDS"
        )
    apart_ns = max(begin_a, begin_b) - min(end_a, end_b)
    if apart_ns > _ONE_FLIGHT_NS:
        return lag, []
    later = "B" if begin_b > end_a else "A"
    told = (
        f"By their stamps they have no time in common: {later} begins {apart_ns / 10**9:.6g} s after the other ends. "
        "If their clocks are one, these are two pieces of a flight, and there is nothing to compare."
    )
    return lag, [told]


def _flown_from(a: Track, b: Track) -> int | None:
    """Return the time of B minus that of A if the commands in the log of one came from the other; None otherwise."""
    for log, bag, sign in ((a, b, 1), (b, a, -1)):
        start = _recorded_start(log, bag)
        if log.own and not bag.own and start is not None:
            first, last = bag.span_ns
            if first <= start + log.span_ns[1] and start + log.span_ns[0] <= last:
                return sign * start
    return None


def _recorded_start(log: Track, bag: Track) -> int | None:
    """Return which time of `bag` is time 0 of `log`, by the stamps of commands in both; None if they do not show it.

    Only commands without stamps are known by the name of their bag: it may have been renamed, or be another's.
    """
    origin = origin_of(log.bag.metadata)
    (times, stamps), (_, recorded) = _stamped(log), _stamped(bag)
    if not len(stamps) or not len(recorded):
        return origin.get(bag.bag.path.name)
    enough = 0.5 * min(len(stamps), len(recorded))
    # Stamps of commands from bags are those of the run.
    for start in origin.values():
        if np.isin(stamps + start, recorded).sum() >= enough:
            return start
    shared = np.isin(stamps, recorded)
    starts, counts = np.unique((stamps - times)[shared], return_counts=True)
    # Where commands acted on arrival, it is another time for each.
    return int(starts[counts.argmax()]) if counts.max(initial=0) >= enough else None


def _stamped(track: Track) -> tuple[Times, Times]:
    """Return log times and stamps of all commands that have one."""
    topics = (track.bag.topics.get(steps.topic.removesuffix(APPLIED)) for steps in track.wrenches)
    found = [topic for topic in topics if topic is not None and topic.count]
    times, stamps = (
        np.concatenate([np.empty(0, np.int64), *map(attrgetter(name), found)]) for name in ("log_times", "stamps")
    )
    return times[stamps != 0], stamps[stamps != 0]


def _lag(a: Given, b: Given, one: MotionSignals, other: MotionSignals) -> Alignment:
    """Return the lag that fits best of two recordings that have no time in common.

    Raises:
        LogError: nothing in them changes.
    """
    try:
        return best_lag(one, other)
    except LogError as error:
        spans = [f"from {begin / 1e9:.16g} to {end / 1e9:.16g} s" for begin, end in (one.span_ns, other.span_ns)]
        raise LogError(
            f"{a.path} goes {spans[0]} and {b.path} {spans[1]} by their stamps, with no time in common; {error}"
        ) from error


def _off_stamps(a: Track, b: Track, one: MotionSignals, other: MotionSignals) -> list[str]:
    """Return a remark if a lag fits much better than the stamps do; two logs of this package are of one clock."""
    if a.own and b.own:
        return []
    try:
        lag = best_lag(one, other)
    except LogError:
        return []
    left = misfit(one, other, 0)
    apart = abs(lag.offset_ns) / 1e9
    if lag.doubtful or left is None or lag.uncertainty_s is None or lag.remaining is None:
        return []
    if apart <= 5.0 * lag.uncertainty_s or left < _BETTER * lag.remaining:
        return []
    told = (
        f"Aligned by stamps; rates and velocities fit better with B {apart:.6g} s "
        f"{'earlier' if lag.offset_ns > 0 else 'later'} (+- {lag.uncertainty_s:.2g} s): the clocks may differ, or one "
        f"is delayed. To compare so: --align {lag.offset_ns / 1e9:.9g}"
    )
    return [told]
