"""`self_consistency`: whether a log of this package agrees with itself, without running its scene again.

A log says most things more than once: odometry repeats pose and twist, momenta and energies follow from them and the
mass properties, applied wrenches from commands, and the scene says what the log contains. Only `replay` finds a log
that is wrong and consistent.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from rb_dynamics.analysis.checks import Check
from rb_dynamics.analysis.read_track import momenta
from rb_dynamics.analysis.track import (
    Array,
    RecordedWrench,
    Times,
    TimeSeries,
    Track,
    in_blocks,
    motion_of,
    shared,
    sizes_of,
    unit_rows,
)
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import RigidBodyError
from rb_dynamics.formats.log_metadata import RESULT, RUN, SCENE
from rb_dynamics.formats.topic_messages import Topic
from rb_dynamics.loads.wrench import HeldWrench, Wrench
from rb_dynamics.loads.wrench_channels import Channel, WrenchChannels
from rb_dynamics.logs.messages import APPLIED, MASS_PROPERTIES, log_topics, sample_topics
from rb_dynamics.numerics.growing_array import give_back
from rb_dynamics.numerics.nanoseconds import NANOSECONDS, nanoseconds
from rb_dynamics.numerics.rotation_arrays import rotate_all_inverse
from rb_dynamics.scene.model import Scene
from rb_dynamics.scene.read import parse_scene

# Of the largest number in a sum of a few terms, each rounded once.
_SUM = 16.0 * np.finfo(float).eps
# Of the largest product in what is rotated, multiplied and added some hundred times, on any platform.
_PRODUCT = 1e-12
# Hz: above, two samples are less than 10 ns apart, and whole nanoseconds cannot distinguish them.
_FASTEST = 1e8

# Samples of which momenta are computed at a time.
_BLOCK = 10_000

# When a command came (ns), and what it does; None if it was rejected.
_Taken: TypeAlias = "tuple[int, HeldWrench | None]"


def self_consistency(track: Track) -> list[Check]:
    """Return the checks that the data of `track`, a log of this package, allow; none for other bags."""
    if not track.own:
        return []
    scene = track.scene
    found = [_odometry(track), _momenta(track, scene)]
    # In a part of a log the rest is not known: where it begins, and what came before.
    if not track.bag.cut_ns:
        found.insert(0, _energy(track))
    if scene is not None and not track.bag.cut_ns:
        found += [_applied(track, scene), _FitsScene(track, scene).check()]
    return [check for check in found if check is not None]


def _topic(track: Track, name: str) -> Topic | None:
    """Return the topic `name` of the scene; None without messages."""
    found = track.bag.topics.get(track.bag.called(name))
    return found if found is not None and found.count else None


def _seconds(track: Track, time_ns: int) -> str:
    return f"t = {(time_ns - track.zero_ns) * 1e-9:.6g} s"


@dataclass
class _Errors:
    """The largest of errors (0 to infinity), and the time (ns) of the first that exceeds what is `accepted`."""

    accepted: float
    worst: float = 0.0
    first_ns: int | None = None

    def add(self, time_ns: Times, errors: Array) -> None:
        self.worst = max(self.worst, float(errors.max(initial=0.0)))
        if self.first_ns is None and (beyond := errors > self.accepted).any():
            self.first_ns = int(time_ns[int(beyond.argmax())])

    def check(self, track: Track, name: str, unit: str, what: str) -> Check:
        explains = f"rounding explains {self.accepted:.3g}"
        if self.first_ns is None:
            return Check(name, True, f"{what} differ by at most {self.worst:.3g} {unit}, {explains}")
        first = f"{what} differ by {self.worst:.3g} {unit}, first at {_seconds(track, self.first_ns)}"
        return Check(name, False, f"{first}; {explains}")


def _energy(track: Track) -> Check | None:
    """T - T0 - W is the defect, so that T - W - defect is constant, whether or not the start is there."""
    parts = (track.kinetic_energy, track.work, track.energy_defect)
    kinetic, work, defect = parts
    if kinetic is None or work is None or defect is None or not _same_times(parts) or not len(work.time_ns):
        return None
    columns = [each.values for each in (kinetic, work, defect)]
    first = columns[0][0] - columns[1][0] - columns[2][0]
    errors = _Errors(_SUM * sum(max(float(np.abs(rows).max()) for rows in in_blocks(each)) for each in columns))
    for times, *rows in zip(in_blocks(kinetic.time_ns), *map(in_blocks, columns), strict=True):
        errors.add(times, np.abs(rows[0] - rows[1] - rows[2] - first))
    return errors.check(track, "energy/defect is T - T₀ - W", "J", "the topics of energy")


def _same_times(series: Sequence[TimeSeries | None]) -> bool:
    times = [each.time_ns for each in series if each is not None]
    return all(np.array_equal(times[0], other) for other in times[1:])


def _odometry(track: Track) -> Check | None:
    """Odometry has the very bits of pose and twist."""
    pose, twist, odom = (_topic(track, name) for name in ("pose", "twist", "odom"))
    if pose is None or twist is None or odom is None:
        return None
    name, wrong = f"{odom.name} repeats pose and twist", None
    for place, other in enumerate((pose, twist)):
        times, here, there = shared(odom.stamps, other.stamps)
        differing = np.zeros(len(times), dtype=bool)
        for first in range(0, len(times), _BLOCK):
            part = slice(first, first + _BLOCK)
            mine, others = (part if isinstance(rows, slice) else rows[part] for rows in (here, there))
            differing[part] = odom.fingerprints(mine)[:, place] != other.fingerprints(others)[:, 0]
        whole = len(times) == other.count == odom.count or not track.bag.complete
        if not whole:
            return Check(name, False, f"{odom.count} messages, {len(times)} of the same time as the {other.count} on "
                                      f"{other.name}")  # fmt: skip
        if differing.any() and wrong is None:
            when = _seconds(track, int(times[int(differing.argmax())]))
            wrong = f"{int(differing.sum())} of {len(times)} say something else than {other.name}, first at {when}"
    return Check(name, wrong is None, wrong or f"{odom.count} messages, to the last bit")


def _momenta(track: Track, scene: Scene | None) -> Check | None:
    """L = R I w, p = m v and T follow from pose, twist and mass properties, without parts that move inside."""
    body, pose, twist = track.body, track.pose, track.twist
    angular, linear, kinetic = track.angular_momentum, track.linear_momentum, track.kinetic_energy
    if body is None or pose is None or twist is None or track.momenta_from != "the log":
        return None
    largest = [
        max((float(sizes_of(rows[:, part]).max()) for rows in in_blocks(twist.values)), default=0.0)
        for part in (slice(0, 3), slice(3, 6))
    ]
    rate, speed = largest[1], largest[0] + largest[1] * float(np.linalg.norm(body.center_of_mass))
    spin = float(np.abs(np.array(body.inertia)).max()) * rate
    parts = [("p", "kg m/s", linear, "linear", body.mass * speed)]
    effects = track.bag.metadata.get(RUN, {}).get("effects", "")
    if (scene.combined_effects.storing() is None and not scene.wheels) if scene is not None else not effects:
        parts += [
            ("L", "kg m²/s", angular, "angular", spin),
            ("T", "J", kinetic, "kinetic", body.mass * speed**2 + spin * rate),
        ]
    parts = [part for part in parts if part[2] is not None and np.isfinite(part[4])]
    logged = {kind: (series, _Errors(_PRODUCT * scale)) for _, _, series, kind, scale in parts if series is not None}
    _add_errors(track, pose, twist, body, logged)
    name, worst = "momenta fit pose, twist and inertia", 0.0
    for symbol, unit, _, kind, scale in parts:
        errors = logged[kind][1]
        if errors.first_ns is not None:
            return errors.check(track, name, unit, f"{symbol} and what it follows from")
        worst = max(worst, errors.worst / scale if scale > 0.0 else 0.0)
    symbols = ", ".join(symbol for symbol, *_ in parts)
    return Check(name, True, f"{symbols}: to {worst:.3g}, rounding explains {_PRODUCT:g}")


def _add_errors(
    track: Track, pose: TimeSeries, twist: TimeSeries, body: RigidBody, logged: Mapping[str, tuple[TimeSeries, _Errors]]
) -> None:
    """Add by how much momenta and energy, by their names in `Momenta`, differ from those that follow.

    In blocks, for what is computed of a long log takes more memory than the log.
    """
    bounds = [*pose.time_ns[::_BLOCK].tolist(), np.iinfo(np.int64).max]
    for begin, end in itertools.pairwise(bounds):
        one, other = (_within(series, begin, end) for series in (pose, twist))
        computed = momenta(motion_of(one, other, track.twist_in_world), body)
        for kind, (series, errors) in logged.items():
            part = _within(series, begin, end)
            times, here, there = shared(part.time_ns, computed.time_ns)
            errors.add(times, sizes_of(part.values[here] - getattr(computed, kind)[there]))
            give_back(series.values)
        give_back(pose.values)
        give_back(twist.values)


def _within(series: TimeSeries, begin_ns: int, end_ns: int) -> TimeSeries:
    begin, end = np.searchsorted(series.time_ns, [begin_ns, end_ns])
    return replace(series, time_ns=series.time_ns[begin:end], values=series.values[begin:end])


def _applied(track: Track, scene: Scene) -> Check | None:
    """Each applied wrench is that of a command of the same time, as its channel takes it, or a drop at the timeout."""
    channels = WrenchChannels(scene.channels, scene.frames, (), scene.body)
    logged = {steps.topic: steps for steps in track.wrenches}
    sources: list[tuple[str, int, list[_Taken], int | None]] = []
    # What follows with a lag is not what a command of its time gives.
    for channel in (each for each in scene.channels if not each.lag):
        topic = _topic(track, channel.topic)
        came = track.bag.wrenches(topic.name) if topic is not None else []
        taken = [(at + channel.delay_ns, channels.check(channel.topic, wrench).held) for at, wrench in came]
        past = _taken_before(scene, channels, channel)
        acting = [each for each in past if each[0] <= 0][-1:]
        # A command at the start replaces what is held.
        since = acting[0][0] if acting and not any(at == 0 and held for at, held in taken) else None
        # A command that waited for the delay of its channel acts at its time. If that is the start, the log also has
        # what it replaces.
        taken += [(0, held) for _, held in [each for each in past if each[0] < 0][-1:]]
        taken += [each for each in past if each[0] >= 0]
        # A node that is at the start before a command of that time comes logs a timeout there, too.
        taken += [(0, scene.frames.hold(Wrench())) for at, _ in acting if 0 < channel.timeout_ns == -at]
        sources.append((channel.topic, channel.timeout_ns, taken, since))
    for name, entries in scene.combined_effects.schedules():
        start_ns = 0 if scene.past is None else scene.past.length_ns
        given: list[_Taken] = [
            (nanoseconds(seconds) - start_ns, scene.frames.hold(wrench)) for seconds, wrench in entries
        ]
        given += [(0, held) for at, held in [each for each in given if each[0] < 0][-1:]]
        sources.append((name, 0, given, None))
    check, count = "applied wrenches fit the commands", 0
    for name, timeout_ns, expected, since in sources:
        steps = logged.get(track.bag.called(name + APPLIED))
        if steps is None:
            continue
        count += len(steps.time_ns)
        if (at := _unexpected(track, steps, timeout_ns, expected, since)) is not None:
            wrong = f"{steps.topic} has at {_seconds(track, at)} what no command of that time gives"
            return Check(check, False, wrong)
    return Check(check, True, f"{count} wrench{'es' * (count != 1)}") if sources else None


def _taken_before(scene: Scene, channels: WrenchChannels, channel: Channel) -> list[_Taken]:
    """Return what a channel took before the start of a scene that continues a run, and when each acts (ns)."""
    past = scene.past
    if past is None:
        return []
    taken = [
        (at + channel.delay_ns - past.length_ns, channels.check(topic, wrench).held)
        for topic, wrench, at in past.commands
        if topic == channel.topic
    ]
    return [(at, held) for at, held in taken if held is not None]


def _unexpected(
    track: Track, steps: RecordedWrench, timeout_ns: int, expected: Sequence[_Taken], since: int | None
) -> int | None:
    """Return the time (ns) of the first applied wrench without a cause; None if there is none.

    `since` is when what is held at the beginning came, of a scene that continues a run.
    """
    by_time: Mapping[int, list[tuple[float, ...]]] = defaultdict(list)
    for at, held in expected:
        if held is not None:
            force = [a + b for a, b in zip(held.force_body, held.force_world, strict=True)]
            torque = [a + b for a, b in zip(held.torque_body, held.torque_world, strict=True)]
            by_time[at].append((*force, *torque))
    before: int | None = since
    numbered = np.hstack([steps.force, steps.torque]).tolist()
    for at, numbers, known in zip(steps.time_ns.tolist(), numbered, steps.known.tolist(), strict=True):
        given = any(_alike(numbers, each) for each in by_time.get(at, ()))
        dropped = timeout_ns > 0 and not any(numbers)
        if dropped and track.bag.complete:
            dropped = before is not None and at - before == timeout_ns
        # What is beyond the range of a track is not in its rows.
        if not (given or dropped) and known and not any(begin <= at <= end for begin, end in track.missing):
            return int(at)
        # What was held at the beginning has been so for longer.
        before = since if at == 0 and before == since and since is not None else at
    return None


def _alike(one: Sequence[float], other: Sequence[float]) -> bool:
    if tuple(one) == tuple(other):
        return True
    return all(
        max(abs(a - b) for a, b in zip(one[part], other[part], strict=True)) <= _PRODUCT * max(map(abs, other))
        for part in (slice(0, 3), slice(3, 6))
    )


def _method(text: bytes) -> str:
    """Return the method of a scene, "auto" if none is named or it is no longer there."""
    try:
        return parse_scene(text.decode("utf-8", "replace")).solver.method
    except RigidBodyError:
        return "auto"


@dataclass(frozen=True)
class _FitsScene:
    """Whether the log contains what its scene says; each method returns what is not so, "" for nothing."""

    track: Track
    scene: Scene

    def check(self) -> Check:
        parts = (self._text, self._mass, self._start, self._topics, self._times, self._end)
        wrong = next(filter(None, (part() for part in parts)), "")
        checked = "hash, mass properties, first state, topics, times of samples and end"
        return Check("log fits its scene", not wrong, wrong or checked)

    def _text(self) -> str:
        said, text = self.track.bag.metadata[RUN].get("scene_sha256", ""), self.track.bag.attachments[SCENE]
        if said and hashlib.sha256(text).hexdigest() != said:
            return f"the attached {SCENE} is not the one that ran: its SHA-256 differs from that in the metadata"
        method = _method(text)
        told = {self.track.bag.metadata.get(record, {}).get("method", "") for record in (RUN, RESULT)}
        if method != "auto" and (others := told - {"", method}):
            return f"the metadata say that {min(others)} moved the body, the scene asks for {method}"
        return ""

    def _mass(self) -> str:
        topic, body = _topic(self.track, MASS_PROPERTIES[0]), self.scene.body
        if topic is None:
            return ""
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = body.inertia
        expected = (
            ("mass", [body.mass]),
            ("centre of mass", body.center_of_mass),
            ("inertia", (xx, xy, xz, yy, yz, zz)),
        )
        column = 0
        for what, numbers in expected:
            logged = topic.numbers[:, column : column + len(numbers)]
            column += len(numbers)
            # NaN must not pass.
            if not (np.abs(logged - numbers) <= _PRODUCT * np.abs(numbers).max()).all():
                return f"{topic.name} and the scene do not give the same {what}"
        return ""

    def _start(self) -> str:
        pose, twist, initial, body = self.track.pose, self.track.twist, self.scene.initial, self.scene.body
        if pose is None or twist is None or not (len(pose.time_ns) and len(twist.time_ns)):
            return ""
        if pose.time_ns[0] != 0 or twist.time_ns[0] != 0:
            return ""
        q = unit_rows(np.array([initial.orientation_xyzw]))
        rate, arm = np.linalg.norm(initial.angular_velocity_body), np.linalg.norm(body.center_of_mass)
        velocity = rotate_all_inverse(q, np.array([initial.linear_velocity_world]))[0]
        here, turning = pose.values[0], twist.values[0]
        # A quaternion and its negative are one attitude.
        sign = 1.0 if here[3:] @ q[0] >= 0.0 else -1.0
        parts = (
            ("position", here[:3], initial.position_world, arm),
            ("attitude", sign * here[3:], q[0], 0.0),
            ("velocity", turning[:3], velocity, rate * arm),
            ("angular velocity", turning[3:], initial.angular_velocity_body, 0.0),
        )
        for what, logged, expected, more in parts:
            if not np.linalg.norm(logged - expected) <= _PRODUCT * (np.linalg.norm(expected) + more):
                return f"the first {what} is not that of the scene"
        return ""

    def _topics(self) -> str:
        expected = {self.track.bag.called(name) for name, *_ in log_topics(self.scene, False)}
        lacking = sorted(expected - self.track.bag.topics.keys())
        if not lacking or not self.track.bag.complete:
            return ""
        return f"{', '.join(lacking)} of the scene {'is' if len(lacking) == 1 else 'are'} not in the log"

    def _times(self) -> str:
        bag = self.track.bag
        topics = [bag.topics.get(self.track.bag.called(name)) for name, _ in sample_topics(self.scene, False)]
        pose, *others = topics
        if pose is None:
            return ""
        times, rate = pose.log_times, self.scene.output_rate * 1e-9
        for topic in others:
            if bag.complete and topic is not None and not np.array_equal(topic.log_times, times):
                return f"{topic.name} has other times than {pose.name}"
        if not np.array_equal(pose.stamps, times):
            return f"the stamps of {pose.name} are not its log times"
        if not 0.0 < self.scene.output_rate <= _FASTEST or len(times) < 2:
            return ""
        missing = ""
        for first in range(0, len(times) - 1, _BLOCK):
            part = times[first : first + _BLOCK + 1]
            at = part * rate
            # The last sample is at the end of the run.
            off = (np.abs(at - np.round(at)) > 0.5000001 * rate + _SUM * at)[:-1]
            if off.any():
                return f"{pose.name} has a sample at {_seconds(self.track, int(part[off.argmax()]))}, where none is due"
            wide = np.diff(at) > 1.0 + 1.5 * rate + _SUM * at[1:]
            if bag.complete and wide.any() and not missing:
                when = _seconds(self.track, int(part[int(wide.argmax())]))
                missing = f"samples after {when} are missing: {self.scene.output_rate:g} Hz were due"
        return missing

    def _unsampled(self, end_ns: int) -> float:
        """Return for how long (ns) a run that ended at `end_ns` may have gone on after its last sample."""
        if self.scene.output_rate > 0.0:
            return 1.5 * NANOSECONDS / self.scene.output_rate
        # Every step is an output. A run may be stopped within one, of a length that is not known here: where a sensor
        # measures, a wheel switches, or a state was refused. At the end of a scene there is always a sample.
        return 0.0 if end_ns == self.scene.end_ns else math.inf

    def _end(self) -> str:
        told, pose = self.track.bag.metadata.get(RESULT, {}).get("end_time_ns", ""), _topic(self.track, "pose")
        if not told or not told.isdecimal() or pose is None or not self.track.bag.complete:
            return ""
        end, last = int(told), int(pose.log_times[-1])
        if not last <= end <= last + self._unsampled(end):
            return f"the metadata say that the run ended at {end} ns, the last sample is at {last} ns"
        if self.scene.end_ns is not None and end > self.scene.end_ns:
            return f"the metadata say that the run ended at {end} ns, the scene at {self.scene.end_ns} ns"
        return ""
