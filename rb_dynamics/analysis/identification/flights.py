"""`Flight`: what one recording measured of a body and what acted on it, in the time of its run, as arrays."""

from __future__ import annotations

import itertools
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Sequence, Set
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.acting_wrenches import channels_of, is_constant, timed_out, which_channel
from rb_dynamics.analysis.checks import losses
from rb_dynamics.analysis.clocks import APART, leaps, remarks
from rb_dynamics.analysis.continuity import continuity, contradictions, jumps_told, overlaps
from rb_dynamics.analysis.gaps import LONG_INTERVALS, LONG_S, NAMED, holes, listed, longest_usual
from rb_dynamics.analysis.interpolated_signal import Signal
from rb_dynamics.analysis.pose_twist_consistency import Agreement, agreements_of
from rb_dynamics.analysis.read_track import OF_SCENE, STRAYS, TopicChoice, as_measured, read_track
from rb_dynamics.analysis.spikes import spikes_of_attitude, spikes_of_position, without_spikes
from rb_dynamics.analysis.stalls import STOOD, Stall
from rb_dynamics.analysis.track import Array, RecordedWrench, Spikes, Times, TimeSeries, Track, frame_names, unit_rows
from rb_dynamics.analysis.wheel_speeds import WheelSpeeds, wheel_speeds
from rb_dynamics.errors import LogError, WrenchError
from rb_dynamics.formats.log_metadata import RUN, TOPICS, loss, part_ns
from rb_dynamics.formats.topic_messages import Topic
from rb_dynamics.loads.thruster import Thruster
from rb_dynamics.loads.wrench_channels import Channel
from rb_dynamics.logs import unset_stamps
from rb_dynamics.logs.bag_reader import Bag, read_bag
from rb_dynamics.logs.messages import APPLIED
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import IDENTITY
from rb_dynamics.numerics.rotation_arrays import exponentials, product, rotate_all_inverse, rotations_between
from rb_dynamics.scene.model import Scene

ATTITUDE, POSITION, VELOCITY, RATES, ACCELERATION = "attitude", "position", "velocity", "rates", "acceleration"
UNITS = {ATTITUDE: "rad", POSITION: "m", VELOCITY: "m/s", RATES: "rad/s", ACCELERATION: "m/s^2"}

NO_WRENCH = "no wrench is recorded: nothing but the effects of the scene is taken to act"

# A motion is followed over holes that together last this many times as long as is measured.
_BRIDGED = 10.0
# Of holes in which commands are missing, too, at most so many begin another piece: the longest.
_MOST_LOST = 20
# rad/s: no gyro has an error that large and constant.
_NO_SENSOR = 0.5
_FEWEST = 4
"""Samples of a stream without which it says nothing of its noise."""


@dataclass(frozen=True)
class Stream:
    """What one sensor measured.

    Attributes:
        topic: as recorded.
        kind: a key of `UNITS`; position and velocity are those of the body origin, acceleration is specific force.
        time_ns: stamps, ascending, from time 0 of the run.
        values: (n, 3); of attitude (n, 4), unit quaternions xyzw, body to world.
        world: velocity or rates in world axes; otherwise in the axes of the sensor.
        mount: (3, 3), from body axes to those of the sensor.
        place: position of the sensor, body axes, m.
        gyro: rates that may have a bias, a scale and an alignment of their own.
    """

    topic: str
    kind: str
    time_ns: Times
    values: Array
    world: bool = False
    mount: Array = field(default_factory=lambda: np.eye(3))
    place: Array = field(default_factory=lambda: np.zeros(3))
    gyro: bool = False

    def rows(self, of: slice | NDArray[np.bool_]) -> Stream:
        """Return the same with some of its samples."""
        return replace(self, time_ns=self.time_ns[of], values=self.values[of])


@dataclass(frozen=True)
class WrenchSeries:
    """A wrench that acted: each row is held until the next; nothing before the first.

    Attributes:
        topic: as recorded.
        time_ns: ascending, from time 0 of the run.
        held: (k, 15), force and torque in body axes, force and torque in world axes, about the centre of mass of the
            scene; and the force in body axes that acts at a point of the body: its torque depends on that centre.
        within_ns: how far off the times may be, each by itself, as in `RecordedWrench`.
    """

    topic: str
    time_ns: Times
    held: Array
    within_ns: int = 0

    def about(self, moved: Array) -> WrenchSeries:
        """Return the same with torques about a centre of mass that lies elsewhere by `moved`, body axes."""
        held = self.held.copy()
        held[:, 3:6] -= np.cross(moved, held[:, 12:])
        return replace(self, held=held)


@dataclass(frozen=True)
class Flight:
    """One recording.

    Attributes:
        name: of the recording.
        streams: what was measured.
        channels: what acted.
        notes: remarks for the user on how it was read.
        moved_ns: when the body was moved to another state, ascending, from time 0 of the run.
        set_ns: when the clock was set forward, likewise: the last stamp before.
        stalls: where the body stood still while the stamps went on, likewise.
        zero_ns: the stamp at which its times begin.
        frames_to_choose: as in `Track`.
        wheels: speeds of the reaction wheels of the scene.
        unknown: names of its actuators that are commanded and whose wrench is not known.
    """

    name: str
    streams: tuple[Stream, ...]
    channels: tuple[WrenchSeries, ...] = ()
    notes: tuple[str, ...] = ()
    moved_ns: tuple[int, ...] = ()
    set_ns: tuple[int, ...] = ()
    stalls: tuple[Stall, ...] = ()
    zero_ns: int = 0
    frames_to_choose: str = ""
    wheels: WheelSpeeds | None = None
    unknown: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse a recording without enough data.

        Raises:
            LogError: no stream has enough samples.
        """
        if not any(len(stream.time_ns) >= _FEWEST for stream in self.streams):
            most = max((len(stream.time_ns) for stream in self.streams), default=0)
            hint = self.frames_to_choose and f"{self.frames_to_choose}; "
            raise LogError(
                f"{self.name}: found {most} samples of the motion, expected at least {_FEWEST} of a pose, an odometry, "
                f"a twist or a gyro; {hint}record the flight again, or name another recording"
            )

    def about(self, moved: Array) -> Flight:
        """Return the same for a scene whose centre of mass lies elsewhere by `moved` (body axes, m)."""
        return replace(self, channels=tuple(each.about(moved) for each in self.channels))

    def pieces(self) -> list[Flight]:
        """Return what was measured before, between and after moves, leaps of the clock and holes: none is led across.

        Raises:
            LogError: no sensor measured on both sides of a hole.
        """
        first, last = self.span_ns
        moves, leapt = ([each for each in some if first <= each < last] for some in (self.moved_ns, self.set_ns))
        stalls = [each for each in self.stalls if first <= each.start_ns < last and each.start_ns not in leapt]
        stood = [each.start_ns for each in stalls]
        breaks, bridged = ([each for each in some if each[0] not in (*leapt, *stood)] for some in self._holes())
        inner = {each + 1 for each in (*moves, *leapt, *stood, *(begin for begin, _ in breaks))}
        edges = [first, *sorted(inner), last + 1]
        notes = []
        if bridged:
            each = listed([f"{(b - a) * 1e-9:.6g} s from {a * 1e-9:.6g} s" for a, b in bridged[:NAMED]], len(bridged))
            notes.append(
                f"nothing was measured for {each}: the motion there is that of the model alone; if a clock leapt "
                "there, cut the recording"
            )
        if len(edges) == 2:
            return [replace(self, notes=(*self.notes, *notes))]
        if moves:
            at = ", ".join(f"{each / 1e9:.9g}" for each in moves)
            notes.append(
                f"the body was moved to another state (set_state) at {at} s: each piece is fitted from a start of its "
                "own"
            )
        if leapt:
            at = ", ".join(f"{each * 1e-9:.6g}" for each in leapt)
            notes.append(
                f"by the log times, the clock of the stamps was set forward at {at} s: each piece is fitted from a "
                "start of its own"
            )
        if stalls:
            at = listed([each.told(0) for each in stalls[:NAMED]], len(stalls))
            notes.append(f"{STOOD[0].lower()}{STOOD[1:]} {at}: each piece is fitted from a start of its own")
        if breaks:
            each = listed([f"{(b - a) * 1e-9:.6g} s from {a * 1e-9:.6g} s" for a, b in breaks[:NAMED]], len(breaks))
            notes.append(
                f"nothing was measured for {each}, over which the motion is not followed, as it is too long or "
                "commands are missing, too: each piece is fitted from a start of its own; if a clock leapt there, cut "
                "the recording with convert --from or --to"
            )
        pieces = [
            self.between(*span)
            for span in itertools.pairwise(edges)
            if any(np.diff(np.searchsorted(stream.time_ns, span))[0] >= _FEWEST for stream in self.streams)
        ]
        return [
            replace(piece, moved_ns=(), set_ns=(), stalls=(), notes=() if k else (*self.notes, *notes))
            for k, piece in enumerate(pieces)
        ] or [self]

    def _holes(self) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
        """Return begin and end of the holes over which a motion is not followed, and of other long ones.

        It is not followed where it is too far, nor where commands are missing that otherwise come steadily.

        Raises:
            LogError: no sensor measured on both sides of one.
        """
        streams = [stream for stream in self.streams if len(stream.time_ns) >= _FEWEST]
        times = [stream.time_ns for stream in streams]
        found = holes(times, _turn_rate(streams), _BRIDGED)
        for begin, end in found:
            if not any(time[0] <= begin and time[-1] >= end for time in times):
                each = ", ".join(
                    f"{s.topic} {s.kind} from {s.time_ns[0] * 1e-9:.6g} to {s.time_ns[-1] * 1e-9:.6g} s"
                    for s in streams
                )
                raise LogError(
                    f"{self.name}: no sensor measured both before and after {begin * 1e-9:.6g} to {end * 1e-9:.6g} s: "
                    f"{each}; expected sensors of one clock; stamp them by one clock, or leave out all but those of one"
                )
        every = set(holes(times, np.inf)) - set(found)
        lost = sorted(self._without_commands(every), key=lambda hole: hole[0] - hole[1])[:_MOST_LOST]
        long = max(LONG_S * 1e9, LONG_INTERVALS * min(map(usual_interval, times), default=0.0))
        return sorted([*found, *lost]), sorted(hole for hole in every - {*lost} if hole[1] - hole[0] >= long)

    def _without_commands(self, some: Iterable[tuple[int, int]]) -> set[tuple[int, int]]:
        """Return the holes in which no command of a channel came for longer than usual, though some did about them."""
        found: set[tuple[int, int]] = set()
        for times in (channel.time_ns for channel in self.channels if len(channel.time_ns)):
            usual, ends = longest_usual(times), [-(2**62), *times.tolist(), 2**62]
            for begin, end in some if usual < np.inf else ():
                # The commands next to it, on either side.
                one, other = bisect_right(ends, begin) - 1, bisect_left(ends, end)
                # One may have come within it, as the one that `convert --from` keeps because it is held.
                pause = int(np.diff(np.clip(ends[one : other + 1], begin, end)).max())
                if pause > usual >= max(begin - ends[one], ends[other] - end):
                    found.add((begin, end))
        return found

    def between(self, first_ns: int, end_ns: int) -> Flight:
        """Return what was measured from `first_ns` to before `end_ns`."""
        streams = (stream.rows(slice(*np.searchsorted(stream.time_ns, [first_ns, end_ns]))) for stream in self.streams)
        return replace(self, streams=tuple(streams), notes=())

    def since_first_commands(self) -> Flight | None:
        """Return what was measured since every channel had a command; None if they had from the start, or too late.

        A recording may begin amid commands, and lack those that were held then.
        """
        first, last = self.span_ns
        begun = [at for each in self.channels for at in each.time_ns[:1].tolist() if first < at <= (first + last) // 2]
        kept = [stream for stream in self.streams if begun and (stream.time_ns >= max(begun)).sum() >= _FEWEST]
        return replace(self, streams=tuple(kept)).between(max(begun), last + 1) if kept else None

    def turning(self, wheels: WheelSpeeds) -> Flight:
        """Return the same with the speeds of wheels, without a second or less at an end that has none.

        Raises:
            LogError: more has none.
        """
        whole = self.span_ns
        first, last = part = wheels.part_of(*whole)
        if part == whole:
            return replace(self, wheels=wheels.reaching(*whole, self.name))
        told = (
            f"{wheels.topic} has speeds from {first * 1e-9:.6g} to {last * 1e-9:.6g} s: only that part is "
            f"fitted of the motion, which is recorded from {whole[0] * 1e-9:.6g} to {whole[1] * 1e-9:.6g} s"
        )
        kept = self.between(first, last + 1)
        return replace(kept, wheels=wheels.reaching(*kept.span_ns, self.name), notes=(*self.notes, told))

    def without_repeats(self) -> Flight:
        """Return the same with one sample of each time: others are recorded again, or the clock is too coarse for them.

        What is recorded again would make errors look smaller; of a coarse clock the first is nearest to its time.
        """
        again = [np.append(False, np.diff(stream.time_ns) == 0) for stream in self.streams]
        return self._without_samples(again, "of the one before, and are left out")

    def between_commands(self) -> Flight:
        """Return the same without samples of accelerometers at the very time at which a command begins to act.

        Sensors of this package, and a `Model`, show what acted before it. Of another program that is not known.
        """
        times = np.concatenate([np.zeros(0, np.int64), *(channel.time_ns for channel in self.channels)])
        at = [np.isin(stream.time_ns, times) & (stream.kind == ACCELERATION) for stream in self.streams]
        why = "whether they show what acted before or after it is not known, and they are left out"
        return self._without_samples(at, f"of a command: {why}")

    def without_spikes(self) -> Flight:
        """Return the same without spikes of poses, velocities and rates that nothing else follows.

        One far away leaves more than all noise, and nothing would be known.
        """
        found = [self._spikes(stream) for stream in self.streams]
        notes = [
            f"{each.topic} {each.kind}: of {len(each.time_ns)} samples {spikes.told(0)}"
            for each, spikes in zip(self.streams, found, strict=True)
            if spikes
        ]
        streams = (
            each.rows(~np.isin(each.time_ns, spikes.time_ns)) if spikes else each
            for each, spikes in zip(self.streams, found, strict=True)
        )
        return replace(self, streams=tuple(streams), notes=(*self.notes, *notes)) if notes else self

    def _spikes(self, stream: Stream) -> Spikes | None:
        """Return the spikes of a stream that nothing else follows; None of one without."""
        by_kind = {kind: [each for each in self.streams if each.kind == kind] for kind in UNITS}
        pushes = ((channel.time_ns, channel.held) for channel in self.channels)
        if stream.kind in (POSITION, ATTITUDE):
            of, derivative = (spikes_of_position, VELOCITY) if stream.kind == POSITION else (spikes_of_attitude, RATES)
            quick = [TimeSeries(s.topic, s.time_ns, np.linalg.norm(s.values, axis=1)) for s in by_kind[derivative]]
            return of(TimeSeries(stream.topic, stream.time_ns, stream.values), next(iter(quick), None), pushes)
        if stream.kind not in (VELOCITY, RATES):
            return None
        pose, turned = None, next(iter(by_kind[ATTITUDE]), None)
        if stream.kind == RATES and turned is not None:
            pose = TimeSeries(turned.topic, turned.time_ns, np.hstack([_blank(turned), turned.values]))
        elif stream.kind == VELOCITY and by_kind[POSITION]:
            return None
        parts = [stream.values if stream.kind == kind else _blank(stream) for kind in (VELOCITY, RATES)]
        twist = TimeSeries(stream.topic, stream.time_ns, np.hstack(parts))
        return next(iter(without_spikes(twist, pose, stream.world, pushes).spikes), None)

    def _without_samples(self, marked: Sequence[NDArray[np.bool_]], why: str) -> Flight:
        """Return the same without the samples `marked` in each stream, with a note: they have the time `why`."""
        told = tuple(
            f"{int(rows.sum())} of {len(rows)} samples of {stream.topic} {stream.kind} have the time {why}"
            for stream, rows in zip(self.streams, marked, strict=True)
            if rows.any()
        )
        streams = tuple(stream.rows(~rows) for stream, rows in zip(self.streams, marked, strict=True) if not rows.all())
        return replace(self, streams=streams, notes=(*self.notes, *told)) if told else self

    def require_dense(self) -> None:
        """Refuse a recording between whose samples the body may have turned any number of times.

        Raises:
            LogError: it turns by more than pi in the intervals of every sensor that measures its rotation, or no
                attitude follows from those before.
        """
        turning = [s for s in self.streams if s.kind in (ATTITUDE, RATES) and len(s.time_ns) >= _FEWEST]
        rates = [float(np.median(np.linalg.norm(s.values, axis=1))) for s in turning if s.kind == RATES]
        if not turning:
            return
        interval, place = min((usual_interval(s.time_ns) * 1e-9, k) for k, s in enumerate(turning))
        topic = turning[place].topic
        if rates:
            turn, far = min(rates) * interval, np.pi
            often = f"{np.ceil(turn / far + 1.0):.0f}"
            found = f"the body turns by {turn:.3g} rad in the {interval:.3g} s between two samples of {topic}"
        else:
            attitudes = turning[place].values
            steps = rotations_between(attitudes[:-1], attitudes[1:])
            often = "several"
            following = product(attitudes[1:-1], exponentials(steps[:-1]))
            turn, far = float(np.median(np.linalg.norm(rotations_between(following, attitudes[2:]), axis=1))), np.pi / 2
            found = f"attitudes of {topic}, {interval:.3g} s apart, are {turn:.3g} rad from what those before lead to"
        if turn > far:
            raise LogError(
                f"{self.name}: {found}, expected at most {far:.3g} rad; in between it may have turned any number of "
                "times, so its motion is ambiguous: check that times are in seconds, or the time_ms, time_us or "
                f"time_ns that they are called, and rates in rad/s; or record {often} times as often"
            )

    def require_agreement(self) -> Flight:
        """Return the same, with a note where pose and twist differ by more than sensors do.

        Raises:
            LogError: they contradict each other, and another convention explains that, or the attitudes are none.
        """
        notes = []
        for said, found in self._agreements():
            if found.remedy:
                raise LogError(
                    f"{self.name}: {said} contradict each other by {100.0 * (found.error or 0.0):.3g} %, expected the "
                    f"same motion of both: read {found.remedy} they fit to {100.0 * found.remaining:.2g} %; convert "
                    "what is otherwise than was said, or name other columns or frames"
                )
            if found.leaps:
                raise LogError(
                    f"{self.name}: {said} contradict each other: {found.leaps}, expected attitudes of one body; write "
                    "quaternions from angles in radians, or leave them out"
                )
            if found.of == "attitude" and found.speed > _NO_SENSOR and not found.words:
                raise LogError(
                    f"{self.name}: {said} contradict each other by {100.0 * (found.error or 0.0):.3g} %, and neither "
                    "other axes or units nor a delay explain it, expected those of one body; leave one of them out"
                )
            aligned = found.aligned
            if aligned.large and aligned.lag_s and not (aligned.scale or aligned.turn):
                notes.append(f"{said} are not of the same time: {aligned.words}; fit delay")
            elif found.contradicts and found.error is not None:
                words = f" ({found.words})" if found.words else ""
                some = f"in {100.0 * found.partly:.3g} % of the time" if found.partly else ""
                notes.append(f"{said} contradict each other {some or f'by {100.0 * found.error:.3g} %'}{words}")
        return replace(self, notes=(*self.notes, *notes)) if notes else self

    def _agreements(self) -> Iterator[tuple[str, Agreement]]:
        """Yield how rates agree with attitudes, and velocities with positions whose attitude is known, and of which."""
        by_kind = {kind: [stream for stream in self.streams if stream.kind == kind] for kind in UNITS}
        for rates, attitude in itertools.product(by_kind[RATES], by_kind[ATTITUDE]):
            pose = np.hstack([_blank(attitude), attitude.values])
            twist = np.hstack([_blank(rates), rates.values @ rates.mount])
            said = f"rates of {rates.topic} and attitudes of {attitude.topic}"
            yield from ((said, each) for each in _agreements_of(attitude, pose, rates, twist))
        for velocity, position in itertools.product(by_kind[VELOCITY], by_kind[POSITION]):
            turned, known = _attitudes(by_kind[ATTITUDE], position.time_ns, velocity.world)
            twist = np.hstack([velocity.values, np.zeros_like(velocity.values)])
            said = f"velocities of {velocity.topic} and positions of {position.topic}"
            every = _agreements_of(position.rows(known), np.hstack([position.values, turned])[known], velocity, twist)
            yield from ((said, each) for each in every if each.of == "position")

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last time that was measured."""
        times = [stream.time_ns for stream in self.streams if len(stream.time_ns)]
        return min(int(time[0]) for time in times), max(int(time[-1]) for time in times)

    @property
    def seconds(self) -> float:
        """How long was measured."""
        first, last = self.span_ns
        return (last - first) / NANOSECONDS

    def without(self, kinds: Sequence[str]) -> Flight:
        """Return the same without some kinds of measurements."""
        return replace(self, streams=tuple(stream for stream in self.streams if stream.kind not in kinds))

    def until(self, end_ns: int) -> Flight:
        """Return the same without what was measured after `end_ns`."""
        ends = (int(np.searchsorted(stream.time_ns, end_ns, side="right")) for stream in self.streams)
        return replace(self, streams=tuple(s.rows(slice(end)) for s, end in zip(self.streams, ends, strict=True)))


def _turn_rate(streams: Sequence[Stream]) -> float:
    """Return how fast the body turns, rad/s, the median; infinite where no sensor tells."""
    rates = [np.linalg.norm(stream.values, axis=1) for stream in streams if stream.kind == RATES]
    for stream in streams if not rates else ():
        spans = np.diff(stream.time_ns) * 1e-9
        if stream.kind == ATTITUDE and (spans > 0.0).any():
            turned = np.linalg.norm(rotations_between(stream.values[:-1], stream.values[1:]), axis=1)
            rates.append(turned[spans > 0.0] / spans[spans > 0.0])
    return min((float(np.median(each)) for each in rates), default=np.inf)


def usual_interval(time_ns: Times) -> float:
    """Return the median interval, ns, of those that are not 0: stamps may be coarser than samples."""
    steps = np.diff(time_ns)
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0


def _agreements_of(of_pose: Stream, pose: Array, of_twist: Stream, twist: Array) -> tuple[Agreement, ...]:
    one, other = TimeSeries(of_pose.topic, of_pose.time_ns, pose), TimeSeries(of_twist.topic, of_twist.time_ns, twist)
    return agreements_of(one, other, of_twist.world)


def _attitudes(streams: Sequence[Stream], time_ns: Times, in_world: bool) -> tuple[Array, NDArray[np.bool_]]:
    """Return the attitudes at these times of the stream that tells most of them, and where they are known.

    Between two samples h apart they are interpolated, off by at most |w'| h^2/8. Velocities `in_world` axes need none.
    """
    if not streams:
        return np.tile(IDENTITY, (len(time_ns), 1)), np.full(len(time_ns), in_world)
    found = [Signal.of(each.time_ns, each.values).at(time_ns) for each in streams]
    return max(found, key=lambda each: int(each[1].sum()))


def _blank(stream: Stream) -> Array:
    """Return rows for quantities that a stream does not measure."""
    return np.full((len(stream.time_ns), 3), np.nan)


def read_flight(path: str, scene: Scene, commands: Sequence[str] = (), topics: TopicChoice | None = None) -> Flight:
    """Return what the bag `path` measured; `commands` are bags with the wrenches, where they are not in it.

    `topics` describe the body; of a log of this package, where they are not the true motion of its run. Wrenches are in
    `commands`, where these are given.

    Raises:
        LogError: a bag cannot be read, has no motion, or a wrench whose effect is not known, or not the `topics`, or
            its stamps stand still for a while.
    """
    return flight_of(read_bag(path, repeated=topics is not None and topics.moving), scene, commands, topics)


def flight_of(bag: Bag, scene: Scene, commands: Sequence[str] = (), topics: TopicChoice | None = None) -> Flight:
    """Return what `bag` measured; see `read_flight`."""
    path = str(bag.path)
    logged = RUN in bag.metadata
    bag, choice = as_measured(bag, topics or TopicChoice())
    own = RUN in bag.metadata
    mine = replace(choice, wrenches=() if commands else choice.wrenches)
    turning = wheel_speeds(bag, scene.wheels, choice.pose or choice.twist or "") if scene.wheels else None
    track = read_track(bag, None if own else scene, None if own else mine, wheels=turning)
    if any(series.hangs or (series.disorder and series.disorder.restarts) for series in track.motion):
        raise LogError(
            f"{path}: {'; '.join(track.faults)}; cut it to before or after that, with convert --from or --to"
        )
    _require_one_clock(track)
    _require_begin(bag, scene)
    # In a log of this package times count from that of its run, whichever samples of a sensor were lost.
    zero = 0 if logged else track.span_ns[0]
    for each in track.motion:
        if told := overlaps(each, zero):
            raise LogError(f"{path}: {each.topic}: {told}; cut it to before or after that, with convert --from or --to")
    # What concerns `inspect` alone is left out: a fit models the effects, and says itself what it takes actuators for.
    ours = ("inspected", "not checked", "nothing is judged", OF_SCENE)
    notes = [note for note in track.notes if not any(word in note for word in ours)]
    notes += [*losses(track), *remarks(track), *_of_actuators(bag, scene)]
    if own and choice.frames:
        notes.append(f"the motion of the run is fitted, and not that of the frames {':'.join(choice.frames)}")
    wheels = track.wheels.since(zero) if track.wheels else None
    notes += [*wheels.remarks, *wheels.beyond(scene.wheels)] if wheels else []
    notes += [f"{each.topic}: {told}" for each in track.motion if (told := contradictions(each, zero))]
    streams = [*_of_pose(track, zero, notes), *_of_twist(track, scene, zero, notes)]
    notes += _jumps(track, {each.kind for each in streams}, zero)
    end = track.span_ns[1]
    channels = _channels(track, scene, zero, end, path, notes)
    motion = next((each.topic for each in track.motion), "")
    choice = TopicChoice(wrenches=choice.wrenches, near=motion)
    beside = next((bag.topics[each.topic] for each in track.motion if each.topic in bag.topics), None)
    beside = beside if beside is not None and beside.stamps_given else None
    elsewhere, heard = acting_elsewhere(commands, scene, zero, end, path, notes, choice, beside)
    channels += elsewhere
    unknown = unknown_commands(scene, heard | commanded_in(bag, scene), own, notes)
    moved = tuple((track.moved_ns - zero).tolist())
    found = Flight(
        path,
        tuple(streams),
        tuple(channels),
        (*notes, *([] if channels else [NO_WRENCH])),
        moved,
        () if own else _set_forward(track, zero),
        tuple(each.since(zero) for each in track.stalls),
        zero,
        track.frames_to_choose,
        unknown=unknown,
    )
    found = found.turning(wheels) if wheels else found
    return found if own else found.between_commands()


def _of_actuators(bag: Bag, scene: Scene) -> list[str]:
    """Return a remark on commands to actuators that the scene does not have."""
    told = ", ".join(sorted({*bag.actuated}.difference(*map(bag.actuated_of, scene.actuators))))
    return [f"{told}: taken for commands to actuators, which the scene does not have"] if told else []


def commanded_in(bag: Bag, scene: Scene) -> set[str]:
    """Return the names of the actuators of the scene to which a bag has commands."""
    return {each.name for each in scene.actuators if any(bag.topics[name].count for name in bag.actuated_of(each))}


def unknown_commands(scene: Scene, heard: set[str], own: bool, notes: list[str]) -> tuple[str, ...]:
    """Return the names of actuators that did what is not known of those `heard`; `notes` receives those that are not.

    What wheels did is recorded, what thrusters did follows from their commands. In a log of this package (`own`) that
    is logged, but the ramp of a thruster at outputs alone.
    """
    others = [each for each in scene.actuators if each not in scene.wheels]
    if quiet := ", ".join(each.name for each in others if each.name not in heard):
        notes.append(f"{quiet}: no command is recorded: taken to have done nothing")
    return tuple(
        each.name
        for each in others
        if each.name in heard and not (isinstance(each, Thruster) and not (own and (each.rise or each.fall)))
    )


def _jumps(track: Track, kinds: Set[str], zero: int) -> list[str]:
    """Return remarks on jumps of the pose in what is measured.

    Raises:
        LogError: it shows two bodies by turns, for which a fit is searched for minutes.
    """
    steady = continuity(track)
    if steady is None or track.pose is None:
        return []
    if steady.returns and (ATTITUDE if steady.returns.turns else POSITION) in kinds:
        raise LogError(
            f"{track.bag.path}: {track.pose.topic}: {steady.returns}; expected the pose of one body; record each on a "
            "topic of its own, or choose another with --pose-topic"
        )
    found = [jump for jump in steady.jumps if (ATTITUDE if jump.turns else POSITION) in kinds]
    told = f"{track.pose.topic} jumps, as no body moves: {jumps_told(found, zero)}; cut the recording there"
    return [told] if found else []


def _require_begin(bag: Bag, scene: Scene) -> None:
    """Refuse a part of a recording for a scene whose wrenches are scheduled: it does not say when the run began.

    Raises:
        LogError: it is such a part.
    """
    scheduled = [name for name, schedule in scene.combined_effects.schedules() if not is_constant(schedule)]
    if scheduled and part_ns(bag.metadata) is not None:
        raise LogError(
            f"{bag.path}: found a part of a recording, which does not say when the schedule of {', '.join(scheduled)} "
            "began, expected the whole; give the recording that it was cut from"
        )


def _require_one_clock(track: Track) -> None:
    """Refuse sensors that are stamped one after the other although they were logged at one time.

    Raises:
        LogError: there are such sensors.
    """
    measured = [series for series in track.motion if len(series.time_ns)]
    for pair in itertools.combinations(measured, 2):
        first, second = sorted(pair, key=lambda series: int(series.time_ns[0]))
        logs = [track.bag.topics[series.topic].log_times for series in (first, second)]
        apart = int(second.time_ns[0] - first.time_ns[-1])
        if apart > 0 and logs[1].min() < logs[0].max() and logs[0].min() < logs[1].max():
            raise LogError(
                f"{track.bag.path}: {first.topic} ends {apart * 1e-9:.6g} s before {second.topic} begins, by the "
                "stamps, while both were logged at one time; expected sensors of one clock; stamp them by one, or "
                "leave out all but those of one"
            )


def _set_forward(track: Track, zero: int) -> tuple[int, ...]:
    """Return when the clock of the stamps was set forward, by the log times, from `zero`: the last stamps before.

    Raises:
        LogError: that of another topic was not.
    """
    found = {name: leaps(track.bag.topics[name]) for name in dict.fromkeys(each.topic for each in track.motion)}
    for one, other in itertools.pairwise(found.values()):
        if len(one) != len(other) or any(abs(a - b) > APART for (_, a), (_, b) in zip(one, other, strict=True)):
            told = "; ".join(
                f"{name} {' and '.join(f'by {by:.6g} s at {(at - zero) * 1e-9:.6g} s' for at, by in each) or 'never'}"
                for name, each in found.items()
            )
            raise LogError(
                f"{track.bag.path}: by the log times, clocks of the stamps were set forward at different times: {told}"
                "; expected sensors of one clock; cut the recording to before that, with convert --to"
            )
    return tuple(max(at for at, _ in each) - zero for each in zip(*found.values(), strict=True))


def with_points(flight: Flight, bag: Bag, scene: Scene) -> Flight:
    """Return the flight of a log of `scene` with the forces that acted at points of the body, in their channels.

    What acted is logged about the centre of mass; the commands say the frames in which they came.
    """
    names = bag.metadata.get(TOPICS, {})
    named = {names[channel.topic]: channel.topic for channel in scene.channels if channel.topic in names}
    taken = channels_of((channel.topic for channel in flight.channels), scene, named)
    return replace(
        flight, channels=tuple(_with_points(each, bag, scene, taken.get(each.topic)) for each in flight.channels)
    )


def _with_points(channel: WrenchSeries, bag: Bag, scene: Scene, taken: Channel | None) -> WrenchSeries:
    if channel.topic not in bag.topics or taken is None:
        return channel
    frames, times, at_point = scene.frames, [-1], [False]
    for log_time, wrench in bag.wrenches(channel.topic):
        try:
            frames.hold(taken.limited(wrench))
        except WrenchError:
            continue
        times.append(log_time + taken.delay_ns)
        at_point.append(wrench.frame_id in (frames.fixed or {}))
    newest = np.searchsorted(times, channel.time_ns, side="right") - 1
    held = channel.held.copy()
    held[:, 12:] = np.where(np.array(at_point)[newest, None], held[:, :3], 0.0)
    return replace(channel, held=held)


def acting_elsewhere(
    commands: Sequence[str],
    scene: Scene,
    zero: int,
    end_ns: int,
    path: str,
    notes: list[str],
    choice: TopicChoice | None = None,
    beside: Topic | None = None,
) -> tuple[list[WrenchSeries], set[str]]:
    """Return the wrenches of bags of the same clock, up to `end_ns`, from `zero`; `path` is the flight's.

    Beside them are the names of the actuators of the scene that these bags command. `notes` receives remarks for the
    user; `choice` says which wrenches are the body's, `beside` how log times follow the stamps of the motion.

    Raises:
        LogError: a bag cannot be read or has no wrench, or one whose effect is not known.
    """
    channels, heard = list[WrenchSeries](), set[str]()
    for other in commands:
        bag = read_bag(other)
        found = read_track(bag, scene, choice, beside=beside)
        notes += [f"{other}: {note}" for note in found.notes if "has no stamps" in note]
        heard |= commanded_in(bag, scene)
        if lost := loss(bag.complete, bag.metadata):
            notes.append(f"{other} {lost}")
        if bag.unset:
            notes.append(unset_stamps.told(other))
        if not (found.wrenches or heard):
            raise LogError(f"{other}: found no wrench topic, expected the commands of {path}; name another bag")
        channels += _channels(found, scene, zero, end_ns, path, notes)
    return channels, heard


def _channels(track: Track, scene: Scene, zero: int, end_ns: int, path: str, notes: list[str]) -> list[WrenchSeries]:
    # A log of this package also contains what effects of the scene did, in any namespace.
    acting = [wrench for wrench in track.wrenches if "/effects/" not in f"/{wrench.topic}"]
    taken = {wrench.topic: wrench.channel for wrench in acting if not wrench.topic.endswith(APPLIED)}
    if doubt := which_channel(taken, scene):
        raise LogError(f"{path}: {doubt}; choose it with --wrench-topic TOPIC=CHANNEL")
    if track.doubt:
        raise LogError(f"{path}: {track.doubt}")
    found = [_accepted(wrench, end_ns, path, notes).without(track.missing) for wrench in acting]
    return [_channel(wrench, zero, end_ns, path) for wrench in found if len(wrench.time_ns)]


def _accepted(wrench: RecordedWrench, end_ns: int, path: str, notes: list[str]) -> RecordedWrench:
    """Return what a channel takes of its commands: one in an undeclared frame leaves the one before, as in a run.

    Raises:
        LogError: there are too many of these to be a mishap.
    """
    within = wrench.time_ns <= end_ns
    refused, count = int((~wrench.known[within]).sum()), int(within.sum())
    said = f"{refused} of {count} wrenches on {wrench.topic} are damaged or in a frame that is not declared (frames: "
    said += f"{frame_names(wrench.frames)})"
    if refused == count > 0 or refused > max(1, STRAYS * count):
        raise LogError(
            f"{path}: {said}, so that what acted is not known; declare the frame under body.frames of the scene"
        )
    if refused:
        notes.append(f"{said}: taken as rejected, so that those before them went on acting.")
    return wrench.accepted()


def _of_pose(track: Track, zero: int, notes: list[str]) -> list[Stream]:
    series = track.pose
    if series is None or not len(series.time_ns):
        return []
    if track.from_imu(series):
        notes.append(f"{series.topic}: its attitude is an estimate, not a measurement; left out")
        return []
    position, attitude = series.values[:, :3], series.values[:, 3:]
    found = []
    norms = np.linalg.norm(attitude, axis=1)
    unit = np.abs(norms - 1.0) < 1e-2
    several = f"{int((~unit).sum())} of {len(unit)} quaternions are no attitudes (lengths {norms.min():.3g} to "
    if unit.mean() >= 1.0 - STRAYS:
        found.append(Stream(series.topic, ATTITUDE, series.time_ns[unit] - zero, unit_rows(attitude[unit])))
        notes += [] if unit.all() else [f"{series.topic}: {several}{norms.max():.3g}), and are left out"]
    else:
        notes.append(f"{series.topic}: {several}{norms.max():.3g}); all are left out")
    return found + _unless_blank(track, series, POSITION, position, zero, notes)


def _of_twist(track: Track, scene: Scene, zero: int, notes: list[str]) -> list[Stream]:
    series = track.twist
    if series is None or not len(series.time_ns):
        return []
    parts = ((VELOCITY, series.values[:, :3]), (RATES, series.values[:, 3:]))
    found = [s for kind, values in parts for s in _unless_blank(track, series, kind, values, zero, notes)]
    if not track.from_imu(series):
        return [replace(stream, world=track.twist_in_world) for stream in found]
    if track.specific_force is not None:
        force = track.specific_force
        found += _unless_blank(track, force, ACCELERATION, force.values, zero, notes)
    fixed = (scene.frames.fixed or {}).get(series.frame)
    place = np.zeros(3) if fixed is None else np.array(fixed.position)
    if series.turned_by is None:
        return [replace(stream, gyro=True, place=place) for stream in found]
    # Its errors are those of its own axes: a factor of each is no factor along others.
    mount = rotate_all_inverse(series.turned_by, np.eye(3)).T
    return [replace(s, values=s.values @ mount.T, mount=mount, gyro=True, place=place) for s in found]


def _unless_blank(
    track: Track, series: TimeSeries, kind: str, values: Array, zero: int, notes: list[str]
) -> list[Stream]:
    """Return the stream, none where another program left the field empty."""
    measured = np.isfinite(values).all(axis=1)
    if not measured.any():
        return []
    if not track.own and not values[measured].any():
        notes.append(f"{series.topic}: its {kind} is zero throughout and taken as not measured")
        return []
    return [Stream(series.topic, kind, series.time_ns[measured] - zero, values[measured])]


def _channel(wrench: RecordedWrench, zero: int, end_ns: int, path: str) -> WrenchSeries:
    """Return what acted of a recorded wrench, its timeout included.

    Raises:
        LogError: its effect is not known.
    """
    within = wrench.time_ns <= end_ns
    if not wrench.known[within].all():
        raise LogError(
            f"{path}: a piece of the recording is missing, in which the wrench on {wrench.topic} may have changed; "
            "cut the flight to before or after it, with convert --from or --to"
        )
    held = held_rows(wrench)
    times = wrench.time_ns - zero
    if wrench.topic.endswith(APPLIED):
        return WrenchSeries(wrench.topic.removesuffix(APPLIED), times, held)
    acting = commanded(wrench.topic, times, held, wrench.channel or Channel())
    return replace(acting, within_ns=wrench.within_ns)


def held_rows(wrench: RecordedWrench) -> Array:
    """Return the rows of a recorded wrench as those of a `WrenchSeries`."""
    nothing, world = np.zeros_like(wrench.force), wrench.world[:, None]
    parts = (wrench.force, wrench.torque)
    return np.hstack(
        [
            *(np.where(world, nothing, part) for part in parts),
            *(np.where(world, part, nothing) for part in parts),
            np.where(wrench.at_point[:, None], wrench.force, nothing),
        ]
    )


def commanded(topic: str, times: Times, held: Array, channel: Channel) -> WrenchSeries:
    """Return what acts of commands, with the delay and the timeout of their channel."""
    acting, rows = timed_out(times + channel.delay_ns, channel.timeout_ns)
    return WrenchSeries(topic, acting, np.vstack([held, np.zeros((1, held.shape[1]))])[rows])
