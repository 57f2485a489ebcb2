"""`RunSummary`: a recorded run in numbers, and its checks; shown as text and HTML.

A check without data is left out, and `missing` says what would provide them.
"""

from __future__ import annotations

import contextlib
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from typing import NamedTuple

import numpy as np

from rb_dynamics.analysis.acting_wrenches import held_before
from rb_dynamics.analysis.checks import BOUND, Check, balanced, checks, cut, missing, off_unit, one_recording, unread
from rb_dynamics.analysis.clocks import log_time_of_zero
from rb_dynamics.analysis.command_outcomes import CommandOutcomes, outcomes_of
from rb_dynamics.analysis.continuity import Continuity, continuity, overlaps
from rb_dynamics.analysis.gaps import NAMED, listed, silences
from rb_dynamics.analysis.latency import CommandLatency, command_latencies
from rb_dynamics.analysis.momentum_energy_balance import Balance, balances
from rb_dynamics.analysis.onboard_devices import Onboard, onboard
from rb_dynamics.analysis.own_log_consistency import self_consistency
from rb_dynamics.analysis.pose_twist_consistency import Agreement, agreements
from rb_dynamics.analysis.read_track import SENSED, mean_rate
from rb_dynamics.analysis.stalls import STOOD
from rb_dynamics.analysis.track import Array, RecordedWrench, TimeSeries, Track, sizes_of
from rb_dynamics.analysis.unexplained_wrench import Residual, late_impulse, residual, times_unknown
from rb_dynamics.analysis.warnings import ChannelHistory, WorstStatus, warnings
from rb_dynamics.formats.log_metadata import EPOCH, RESULT, RUN, TOPICS
from rb_dynamics.formats.message_types import ACCELERATION, DIAGNOSTICS, SCALAR, TRANSFORMS, VECTOR
from rb_dynamics.formats.topic_messages import KEPT, Topic
from rb_dynamics.loads.wrench import WrenchFrames
from rb_dynamics.loads.wrench_channels import Channel
from rb_dynamics.logs.bag_reader import IMUS, Bag
from rb_dynamics.logs.messages import APPLIED
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.number_parsing import whole_number

EXPLAINS, MASS_EXPLAINS = "inertia explains the motion", "mass explains the motion"
POINTING = "angle from the target"
# |norm - 1| of a quaternion beyond which it was not filled in; single precision leaves 1e-7.
_NO_ATTITUDE = 1e-3
# How much more than the root mean square at its end the errors of many commands may leave somewhere along a path.
_ALONG_PATH = 2.0
HALF = 0.5
"""A check that covers less than this fraction of the run is reported with a reservation."""


@dataclass(frozen=True)
class TopicFacts:
    """Statistics of the messages of one topic, by log time.

    Attributes:
        name: as recorded.
        type_name: message type.
        use: what it is used for; in brackets why it is not used.
        count: messages.
        first_s: log time of the first message, s as t in the output.
        rate: mean, Hz; 0 for fewer than two messages.
        longest_s: longest time between two messages.
        longest_at_s: start of that interval, s as t in the output.
    """

    name: str
    type_name: str
    use: str
    count: int
    first_s: float
    rate: float
    longest_s: float
    longest_at_s: float


@dataclass(frozen=True)
class Range:
    """Smallest and largest value of a quantity, and when (s as t in the output)."""

    name: str
    unit: str
    low: float
    low_at_s: float
    high: float
    high_at_s: float


@dataclass(frozen=True)
class FirstAndLast:
    """One quantity at the first and the last sample."""

    name: str
    unit: str
    first: tuple[float, ...]
    last: tuple[float, ...]


@dataclass(frozen=True)
class RunSummary:
    """A recorded run in numbers.

    Attributes:
        path: the file, as text.
        own: whether this package wrote it.
        sensed: whether it is what sensors of a log of this package measured, without the true motion of its run.
        complete: whether nothing is known to be missing.
        lacks: what is missing: when it was cut off, or which pieces; "" if nothing.
        scene: file name of the scene, "" if unknown.
        method: methods used, joined by "+"; the requested one if a log was cut off; "" if unknown.
        asked: the requested method, such as "auto"; "" if unknown.
        solver: the requested method with its settings, as the log describes it; "" if unknown.
        body: mass, centre of mass, moments, and the effects of the scene; empty if unknown.
        version: of the package that wrote the log; "" if unknown.
        steps: None if unknown.
        start_ns: time of the first sample.
        zero_ns: time from which the output counts: the first sample, of a part that of the whole.
        duration_s: from the first to the last sample.
        samples: rows of the motion.
        topics: by name.
        moments: first and last state.
        ranges: extremes.
        balances: conservation laws.
        channels: wrench channels.
        health: None if the log has no diagnostics.
        momenta_from: see `Track`.
        checks: results of the checks.
        residual: how well the given body explains a recording of another program; None if unknown.
        warnings: irregularities that are no failure.
        notes: remarks on the data for the reader.
        missing: what cannot be computed, and which data are needed for it.
        latencies: of the commands of a node that logged them.
        onboard: what wheels, actuators and sensors did, in a log of a scene that has them.
    """

    path: str
    own: bool
    sensed: bool
    complete: bool
    lacks: str
    scene: str
    method: str
    asked: str
    solver: str
    body: tuple[str, ...]
    version: str
    steps: int | None
    start_ns: int
    zero_ns: int
    duration_s: float
    samples: int
    topics: tuple[TopicFacts, ...]
    moments: tuple[FirstAndLast, ...]
    ranges: tuple[Range, ...]
    balances: tuple[Balance, ...]
    channels: tuple[ChannelHistory, ...]
    health: WorstStatus | None
    momenta_from: str
    checks: tuple[Check, ...]
    residual: Residual | None
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    missing: tuple[str, ...]
    latencies: tuple[CommandLatency, ...] = ()
    onboard: Onboard = Onboard()

    @property
    def passed(self) -> bool:
        """Whether every check passes."""
        return all(check.passed for check in self.checks)

    @property
    def clock(self) -> str:
        """Definition of the time t in checks, warnings and tables."""
        if self.own and self.zero_ns == 0:
            return "t is simulation time"
        shown = "simulation time" if self.own else "header.stamp"
        whole = " of the whole recording" * (self.zero_ns != self.start_ns)
        return f"t counts from the start{whole}, at {shown} {Decimal(self.zero_ns).scaleb(-9):f} s"

    @property
    def reservation(self) -> str:
        """Reservation of a "passed": the checks that cover less than half of the run; "" for none."""
        checked = [check for check in self.checks if check.judged and check.share < HALF]
        told = "".join(f", the {check.name} over {100.0 * check.share:.3g} % of the run" for check in checked)
        unknown = [check.name for check in self.checks if check.name in (EXPLAINS, MASS_EXPLAINS) and not check.judged]
        return told + "".join(f"; whether the {name} is not judged" for name in unknown)

    def balance(self, name: str) -> Balance | None:
        """Return the balance of "energy", "angular momentum" or "linear momentum"; None if unknown."""
        return next((balance for balance in self.balances if balance.name == name and balance.covered > 0.0), None)


def summarize(track: Track, bound: float = BOUND) -> RunSummary:
    """Return the summary; `bound` is the largest accepted defect, relative to the largest energy or momentum."""
    bag = track.bag
    facts, result = bag.metadata.get(RUN, {}), bag.metadata.get(RESULT, {})
    start, end = track.span_ns
    motion = track.pose or track.moving
    logged = log_time_of_zero(track)
    used = onboard(track)
    uses = {**used.topics, **track.uses}
    topics = tuple(_topic(topic, logged, _use(uses, topic)) for _, topic in sorted(bag.topics.items()))
    health = _health(bag)
    steady, agreed = continuity(track), agreements(track)
    unsure = _unsure(track, steady, agreed)
    doubt = next((each.doubt for each in agreed if each.doubt), "")
    judgement = _judged(track, unsure, doubt, bound)
    found, left, unsure = judgement.balances, judgement.residual, judgement.unsure
    channels = tuple(_channels(track, None if bag.begins_later else health))
    return RunSummary(
        path=str(bag.path),
        own=track.own,
        sensed=SENSED in bag.metadata,
        complete=bag.complete,
        lacks="; ".join(filter(None, (cut(track), missing(track)))),
        scene=facts.get("scene_file", ""),
        method=result.get("method") or facts.get("method", ""),
        asked=facts.get("method", ""),
        solver=facts.get("solver", ""),
        body=tuple(_body(track, facts)),
        version=facts.get("version.rb_dynamics", "").replace("not installed", ""),
        steps=_whole(result.get("steps", "")),
        start_ns=start,
        zero_ns=track.zero_ns,
        duration_s=(end - start) / NANOSECONDS,
        samples=0 if motion is None else len(motion.time_ns),
        topics=topics,
        moments=tuple(_moments(track)),
        ranges=tuple(_ranges(track)),
        balances=found,
        channels=channels,
        health=health,
        momenta_from=track.momenta_from,
        checks=(
            *checks(track, found, bound, steady, agreed),
            *(unread(topic, words) for topic, words in used.damaged.items()),
            *self_consistency(track),
            *_explained(left),
            *_not_judged(track, unsure or track.unrecorded or (_fitted_instead(track) if left is None else "")),
        ),
        residual=left,
        warnings=(*warnings(track, channels, health), *used.warnings()),
        notes=(*track.notes, *judgement.notes, *_ended_early(track), *_moves(track), *_stalls(track), *_epoch(bag)),
        missing=tuple(_missing(track)),
        latencies=tuple(command_latencies(bag)) if track.own else (),
        onboard=used,
    )


def _unsure(track: Track, steady: Continuity | None, agreed: Sequence[Agreement]) -> str:
    """Return why a self-contradictory recording does not show what moved the body; "" if it is consistent."""
    if track.own:
        return ""
    if track.bag.boundaries and not one_recording(track).passed:
        return "these are several recordings"
    if any((series.disorder and series.disorder.restarts) or overlaps(series, 0) for series in track.motion):
        return "these are several runs"
    if any(series.hangs for series in track.motion):
        return "stamps stand still for a while"
    if any(each.contradicts for each in agreed):
        return "pose and twist contradict each other"
    if track.pose is not None and off_unit(track.pose.values[:, 3:]) > _NO_ATTITUDE:
        return "some quaternions are no attitude"
    if steady is not None and (steady.returns or not all(other.alike for other in steady.others)):
        return "the recording has two bodies under one name"
    if steady is not None and steady.frozen:
        return "the pose is frozen for a while"
    return "the pose jumps" if steady is not None and steady.jumps else ""


class _Judgement(NamedTuple):
    """What is judged of a body.

    Attributes:
        balances: of energy and momenta.
        residual: what its inertia leaves; None if nothing is judged by it.
        unsure: why nothing is; "" if something is, or the recording has nothing to judge by.
        passed: whether balances and body pass.
        notes: remarks for the reader.
    """

    balances: tuple[Balance, ...]
    residual: Residual | None
    unsure: str
    passed: bool
    notes: tuple[str, ...] = ()


def _judged(track: Track, unsure: str, doubt: str, bound: float) -> _Judgement:
    """Return the judgement; if it fails, that without what acts before the first commands, should that pass.

    Args:
        track: what is judged.
        unsure: why nothing is.
        doubt: why nothing is if the body does not explain the motion.
        bound: as for `summarize`.
    """
    first = _judged_by(track, unsure, doubt, bound)
    whole = first.residual
    begun = None if first.passed or whole is None else held_before(track)
    if begun is None or whole is None:
        return first
    again = _judged_by(begun, unsure, doubt, bound)
    left = again.residual
    if not again.passed or left is None:
        return first
    # Another inertia that explains the whole is not given up because the times of commands hide it in a part.
    hidden = not whole.explainable and (left.mistimed or whole.untold)
    if not hidden and (not left.explained or left.untold):
        return first
    told = (
        "It is not known what acts before the first command of a topic: if nothing does, the motion is not explained. "
        "The recording may have begun amid commands."
    )
    return again._replace(notes=(told,))


def _judged_by(track: Track, unsure: str, doubt: str, bound: float) -> _Judgement:
    """Return the judgement by what acts in `track`."""
    found, left = tuple(balances(track, bound)), None if unsure or track.unrecorded else residual(track, bound)
    of_body = _explained(left)
    if not all(check.passed for check in of_body):
        # What the fit of another body or load explains is not put down to correlated noise.
        found = tuple(each.without_colour() for each in found)
    judged = [*(balanced(track, each, bound) for each in found), *of_body]
    # Differences of pose and twist that matter nowhere else would be mistaken for a torque.
    if doubt and not unsure and not all(check.passed for check in judged):
        unsure, left = doubt, None
    if unsure:
        found = tuple(_unknown(each, unsure) for each in found)
    elif left is not None and left.explained and track.twist is not None and track.from_imu(track.twist):
        why = f"{track.twist.topic} has a constant error, as gyros have, with which the inertia explains the motion"
        found = tuple(each if balanced(track, each, bound).passed else _unknown(each, why) for each in found)
    elif left is not None and left.mistimed:
        found = tuple(each if balanced(track, each, bound).passed else _unknown(each, left.untold) for each in found)
    found = tuple(_unless_mistimed(track, each, left, bound) for each in found)
    passed = all(check.passed for check in (*(balanced(track, each, bound) for each in found), *_explained(left)))
    return _Judgement(found, left, unsure, passed)


def _unless_mistimed(track: Track, balance: Balance, left: Residual | None, bound: float) -> Balance:
    """Return a balance of momentum as unknown if errors of the times of commands may leave all that is left.

    That of angular momentum is not, where a body or a torque is found that explains what is left.
    """
    kind = {"linear momentum": "force", "angular momentum": "torque"}.get(balance.name)
    if kind is None or balanced(track, balance, bound).passed or (kind == "torque" and not (left and left.untold)):
        return balance
    if balance.worst <= _ALONG_PATH * late_impulse(track, kind):
        return _unknown(balance, f"{times_unknown(track)} would explain what is left as well")
    return balance


def _unknown(balance: Balance, reason: str) -> Balance:
    """Return an unknown balance with this reason."""
    unknown = [np.full_like(rows, np.nan) for rows in balance.blocks()]
    return replace(balance, blocks=lambda: iter(unknown), covered=0.0, basis=f"not known: {reason}", noise=None)


def _not_judged(track: Track, reason: str) -> list[Check]:
    if not reason or track.body is None or track.body.is_particle:
        return []
    return [Check(EXPLAINS, True, f"not judged; {reason}", judged=False, share=0.0)]


def _fitted_instead(track: Track) -> str:
    """Return why the inertia is not judged, and what judges it; "" if nothing could."""
    pose, twist = track.pose, track.twist
    if track.own or (pose is None and twist is None):
        return ""
    if unknown := [steps.topic for steps in track.acting if len(steps.known) and not steps.known.any()]:
        return f"the effect of {' and '.join(unknown)} is not known"
    if pose is None or twist is None:
        why = f"no topic of a {'pose' if pose is None else 'twist'}"
    elif twist.partial:
        why = f"{twist.topic} has only the angular velocity"
    else:
        why = f"too few samples of {pose.topic} and {twist.topic} share a stamp at which the wrench is known"
    if twist is None and pose is not None and (topic := track.bag.topics.get(pose.topic)) and topic.type_name in IMUS:
        return f"the attitude of {pose.topic} is an estimate, and nothing else is measured"
    scene = track.body_from if track.body_from.endswith((".yaml", ".yml")) else "SCENE"
    told = shlex.join(["rb-dynamics", "identify", scene, str(track.bag.path)])
    return f"{why}; fit it with its error: {told}"


def _body(track: Track, facts: Mapping[str, str]) -> list[str]:
    told, body = [], track.body
    if body is not None:
        center, moments = (", ".join(f"{x:.6g}" for x in v) for v in (body.center_of_mass, body.principal_moments))
        told.append(f"body: {body.mass:g} kg, centre of mass at ({center}) m, principal moments {moments} kg m²")
    if RUN in track.bag.metadata:
        told.append(f"effects: {facts.get('effects') or 'none'}")
    return told


def _explained(left: Residual | None) -> list[Check]:
    return [] if left is None else [*_by_inertia(left), *_by_mass(left)]


def _by_mass(left: Residual) -> list[Check]:
    told = left.mass_words
    if left.mass_untold:
        return [Check(MASS_EXPLAINS, True, f"not judged; {told}", judged=False, share=0.0)]
    return [Check(MASS_EXPLAINS, left.mass_explained, told)] if told else []


def _by_inertia(left: Residual) -> list[Check]:
    name = EXPLAINS
    if not left.told:
        return [Check(name, True, f"not judged; {left.untold}", judged=False, share=0.0)]
    if left.explained and left.noise:
        part = "" if left.covered > 0.99 else f"; {100.0 * left.covered:.3g} % of the time judged"
        detail = f"up to its noise, {left.noise:.3g} of the angular momentum in a sample{part}"
        return [Check(name, True, detail, share=left.covered)]
    unexplained = f"{left.relative:.3g} of the angular momentum has no cause"
    verdict = "" if left.explained or left.explainable else "; no inertia explains it"
    return [Check(name, left.explained, f"{unexplained}; with the best fit {left.best:.3g}{verdict}")]


def _use(uses: Mapping[str, str], topic: Topic) -> str:
    if use := uses.get(topic.name):
        return use
    if not topic.count:
        return "(no messages)"
    if topic.type_name == DIAGNOSTICS:
        return "health"
    if topic.type_name == TRANSFORMS:
        # Each pair of frames on it is a topic of its own.
        used = dict.fromkeys(use for name, use in uses.items() if name.startswith(f"{topic.name} "))
        return ", ".join(used) or "(another used)"
    if topic.type_name in (VECTOR, SCALAR):
        return "(other name)"
    if topic.type_name == ACCELERATION:
        return "(not used)"
    return "(another used)" if topic.type_name in KEPT else "(other type)"


def _topic(topic: Topic, zero_ns: int, use: str) -> TopicFacts:
    times = topic.log_times
    if not len(times):
        return TopicFacts(topic.name, topic.type_name, use, 0, 0.0, 0.0, 0.0, 0.0)
    steps = np.diff(times)
    longest = int(steps.argmax()) if len(steps) else 0
    return TopicFacts(
        name=topic.name,
        type_name=topic.type_name,
        use=use,
        count=len(times),
        first_s=int(times[0] - zero_ns) / NANOSECONDS,
        rate=mean_rate(times),
        longest_s=int(steps[longest]) / NANOSECONDS if len(steps) else 0.0,
        longest_at_s=int(times[longest] - zero_ns) / NANOSECONDS,
    )


def _moments(track: Track) -> list[FirstAndLast]:
    pose, twist = track.pose, track.moving
    axes = "world" if track.twist_in_world else "body"
    all_of_it = slice(None)
    parts = [
        ("position, world", "m", pose, slice(0, 3)),
        ("orientation x y z w", "", pose, slice(3, 7)),
        (f"linear velocity, {axes}", "m/s", twist, slice(0, 3)),
        (f"angular velocity, {axes}", "rad/s", twist, slice(3, 6)),
        ("angular momentum, world", "kg m²/s", track.angular_momentum, all_of_it),
        ("linear momentum, world", "kg m/s", track.linear_momentum, all_of_it),
        ("kinetic energy", "J", track.kinetic_energy, all_of_it),
        ("work", "J", track.work, all_of_it),
        ("motor work of the wheels", "J", track.motor_work, all_of_it),
        ("friction heat of the wheels", "J", track.friction_heat, all_of_it),
        ("specific force, sensor", "m/s²", track.specific_force, all_of_it),
        (POINTING, "rad", track.pointing, all_of_it),
    ]
    return [
        FirstAndLast(name, unit, _row(series, 0, columns), _row(series, -1, columns))
        for name, unit, series, columns in parts
        if series is not None and len(series.time_ns) and not np.isnan(_row(series, 0, columns)).any()
    ]


def _row(series: TimeSeries, index: int, columns: slice) -> tuple[float, ...]:
    return tuple(np.atleast_1d(series.values[index])[columns].tolist())


def _ranges(track: Track) -> list[Range]:
    twist = track.moving
    speed = twist and TimeSeries(twist.topic, twist.time_ns, twist.values[:, :3])
    rate = twist and TimeSeries(twist.topic, twist.time_ns, twist.values[:, 3:])
    parts = [
        ("speed of the body origin", "m/s", speed),
        ("angular rate", "rad/s", rate),
        ("angular momentum |L|", "kg m²/s", track.angular_momentum),
        ("linear momentum |p|", "kg m/s", track.linear_momentum),
        ("kinetic energy T", "J", track.kinetic_energy),
        ("work W", "J", track.work),
        ("motor work of the wheels", "J", track.motor_work),
        ("friction heat of the wheels", "J", track.friction_heat),
        ("specific force", "m/s²", track.specific_force),
        (POINTING, "rad", track.pointing),
    ]
    return [
        _range(track, name, unit, series)
        for name, unit, series in parts
        if series and len(series.time_ns) and not np.isnan(series.values[0]).any()
    ]


def _range(track: Track, name: str, unit: str, series: TimeSeries) -> Range:
    values = series.values if series.values.ndim == 1 else sizes_of(series.values)
    ends = [int(values.argmin()), int(values.argmax())]
    (low_at, high_at), (low, high) = track.seconds(series.time_ns[ends]).tolist(), values[ends].tolist()
    return Range(name, unit, low, low_at, high, high_at)


def _moves(track: Track) -> list[str]:
    """Return a note on when the body was moved, if it was."""
    at = ", ".join(f"{each:.9g}" for each in track.seconds(track.moved_ns).tolist())
    return [f"The body was moved to another state (set_state) at t = {at} s: nothing is judged across."] if at else []


def _stalls(track: Track) -> list[str]:
    """Return a note on where the body stood still, if it did."""
    at = listed([each.told(track.zero_ns) for each in track.stalls[:NAMED]], len(track.stalls))
    return [f"{STOOD} {at}: nothing is judged across."] if at else []


def _ended_early(track: Track) -> list[str]:
    """Return a note that a run ended before the duration of its scene, as an error or Ctrl-C ends it, if it did."""
    bag, planned_ns = track.bag, None if track.scene is None else track.scene.end_ns
    end_ns = _whole(bag.metadata.get(RESULT, {}).get("end_time_ns", ""))
    if end_ns is None or planned_ns is None or end_ns >= planned_ns or bag.cut_ns or not bag.ended:
        return []
    return [f"The run ended early, by an error or a stop: at t = {end_ns * 1e-9:.9g} s of {planned_ns * 1e-9:.9g} s."]


def _epoch(bag: Bag) -> list[str]:
    """Return a note on the ROS time of time 0, if a node stamped its messages with that."""
    epoch = bag.metadata.get(EPOCH, {}).get("epoch_ns", "")
    if not epoch.isdecimal():
        return []
    return [f"t = 0 is ROS time {Decimal(epoch).scaleb(-9):f} s, as it was last: a pause or a dropped lag moves it"]


def _channels(track: Track, health: WorstStatus | None) -> list[ChannelHistory]:
    scene, names = track.scene, track.bag.metadata.get(TOPICS, {})
    channels = {names.get(each.topic, ""): each for each in (() if scene is None else scene.channels)}
    declared = None if scene is None else scene.frames
    return [
        _channel(track, steps, health, declared, channels.get(steps.topic.removesuffix(APPLIED), Channel()))
        for steps in track.wrenches
    ]


def _channel(
    track: Track, steps: RecordedWrench, health: WorstStatus | None, declared: WrenchFrames | None, channel: Channel
) -> ChannelHistory:
    name = steps.topic.removesuffix(APPLIED)
    applied = len(steps.time_ns) if steps.topic.endswith(APPLIED) else None
    source = track.bag.topics.get(name)
    known = track.own and applied is not None and source is not None
    became = (
        outcomes_of(track, steps, source, declared, channel)
        if known and source is not None
        else CommandOutcomes(applied or 0)
    )
    rejected = [count for count in (became.rejected, _counted(name, "rejected", health)) if count is not None]
    received = None if source is None else source.count
    frames, commands = steps.frames, steps.time_ns
    if applied is not None:
        commands = np.empty(0, np.int64) if source is None else source.log_times
    if source is not None and applied is not None and source.count:
        frames = tuple(sorted({wrench.frame_id for _, wrench in track.bag.wrenches(name)}))
    if known and track.bag.window_ns:
        commands = commands[commands >= track.bag.window_ns[0]]
        received = len(commands)
    at = track.seconds(commands)
    return ChannelHistory(
        topic=name,
        frames=frames,
        received=received,
        applied=None if applied is None else became.applied,
        timeouts=became.timeouts,
        timed_out_s=None if became.timed_out_ns is None else float(track.seconds(np.array(became.timed_out_ns))),
        # The node also counts invalid messages, but reports them only once a second.
        rejected=max(rejected, default=None),
        undeclared=became.undeclared,
        late=_counted(name, "late", health),
        superseded=_counted(name, "superseded", health),
        lost=_counted(name, "lost", health),
        first_s=float(at[0]) if len(at) else None,
        last_s=float(at[-1]) if len(at) else None,
        usual_s=float(np.median(np.diff(at))) if len(at) > 1 else None,
        held_s=_held_at_the_end(track, steps.without(track.missing), at),
        largest_force=_largest(steps.force, steps),
        largest_torque=_largest(steps.torque, steps),
        silences=() if source is None else _silences(track, source),
    )


def _silences(track: Track, source: Topic) -> tuple[tuple[float, float], ...]:
    """Return when and for how long (s) a steady stream of commands paused, other than after a zero."""
    times = source.log_times if track.own or not source.stamps_given else source.stamps
    order = np.argsort(times, kind="stable")
    times, sent = times[order], source.numbers[order]
    at = track.seconds(times)
    return tuple((float(at[k]), float(at[k + 1] - at[k])) for k in silences(times) if sent[k].any())


def _largest(vectors: Array, steps: RecordedWrench) -> float | None:
    """Return the largest magnitude of those that are known; None if there are only others."""
    if len(vectors) and not steps.known.any():
        return None
    return float(np.linalg.norm(vectors[steps.known], axis=1).max(initial=0.0))


def _held_at_the_end(track: Track, steps: RecordedWrench, at: Array) -> float | None:
    """Return how long after the last command, at `at` (s), its wrench was still held; None if unknown."""
    if not len(at) or not steps.known[-1:].all():
        return None
    _, end_ns = track.span_ns
    acts = bool(steps.force[-1:].any() or steps.torque[-1:].any())
    return max(0.0, float(track.seconds(np.array(end_ns))) - float(at[-1])) if acts else 0.0


def _counted(topic: str, what: str, health: WorstStatus | None) -> int | None:
    for key, value in health.values if health else ():
        match = re.fullmatch(rf"(.+): {what}", key)
        if match and f"/{topic}".endswith(f"/{match[1].lstrip('/')}") and (count := _whole(value)) is not None:
            return count
    return None


def _whole(text: str) -> int | None:
    with contextlib.suppress(ValueError):
        return whole_number(text)
    return None


def _health(bag: Bag) -> WorstStatus | None:
    topics = [topic for topic in bag.topics.values() if topic.type_name == DIAGNOSTICS and topic.count]
    statuses = [status for topic in topics for message in topic.decoded() for status in message[2]]
    ours = [status for status in statuses if status[1] == "rb_dynamics" or RUN in bag.metadata]
    if not ours:
        return None
    _, _, message, _, values = ours[-1]
    return WorstStatus(max(status[0] for status in ours), message, tuple(values))


def _missing(track: Track) -> list[str]:
    lacks = []
    if track.pose is None:
        lacks.append("No topic of a pose: position, attitude and everything in world axes are not known.")
    elif track.pose.partial:
        lacks.append(f"{track.pose.topic} has only the attitude: the position is not known.")
    if track.twist is None:
        rest = "momenta and energy" if track.rates else "velocities, momenta and energy"
        lacks.append(f"No topic of a twist: {rest} are not known.")
    elif track.twist.partial:
        lacks.append(
            f"{track.twist.topic} has only the angular velocity: velocity, linear momentum and energy are not known."
        )
    if track.pose and track.twist and track.body is None and not track.momenta_from:
        lacks.append(
            "No mass properties: momenta and energy are not computed. Give them as a scene file with --scene SCENE "
            "(its keys body.mass, body.center_of_mass and body.inertia are used)."
        )
    if track.momenta_from and not track.wrenches and not track.own:
        lacks.append(
            "No wrench topic: a change of momentum or energy cannot be distinguished from a defect, and is not judged."
        )
    if track.momenta_from and track.work is None:
        lacks.append("No energy/work topic: the energy is judged only while no wrench acts.")
    return lacks
