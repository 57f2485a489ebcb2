"""Checks of a recorded run: completeness, time, unit quaternions, balances.

A check that lacks data says so; one about a quantity that was not recorded at all is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rb_dynamics.analysis.continuity import FARTHEST, Continuity, Other, contradictions, jumps_told, overlaps
from rb_dynamics.analysis.gaps import NAMED, listed, longest_usual, told
from rb_dynamics.analysis.momentum_energy_balance import Balance
from rb_dynamics.analysis.pose_twist_consistency import RARE, Agreement, Leaps
from rb_dynamics.analysis.track import Array, TimeSeries, Track, frame_names, in_blocks, sizes_of
from rb_dynamics.formats.bag_source import by_number
from rb_dynamics.formats.channel_metadata import is_latched
from rb_dynamics.formats.mcap_records import END_OF_TIME
from rb_dynamics.formats.topic_messages import Topic
from rb_dynamics.logs.own_log import logged_scene

BOUND = 1e-6
"""Default of the largest accepted defect, relative to the largest energy or momentum."""

# Topics of one recording do not begin and end at the same time; s.
_APART = 1.0
# Topics of ROS and of its recorder do not show when a recording begins and ends.
_OF_ROS = ("rcl_interfaces/", "rosbag2_interfaces/")
# Pause (s) between files of one recording that is always accepted; so is ten times the longest pause within a file.
_FOLLOWS = 10.0


@dataclass(frozen=True)
class Check:
    """One check, its result and details.

    `judged` is False if the result is unknown, `share` the fraction of the time for which it is known.
    """

    name: str
    passed: bool
    detail: str
    judged: bool = True
    share: float = 1.0


def checks(
    track: Track,
    found: Sequence[Balance],
    bound: float,
    steady: Continuity | None = None,
    agreed: Sequence[Agreement] = (),
) -> list[Check]:
    """Return every check that the data of `track` allow; `bound` is relative to the largest energy or momentum."""
    whole = track.bag.whole
    detail = "it is complete" if whole else "cut off: it contains what was written until then"
    done = [Check("file is whole", whole, detail), _recorded(track)]
    done += [one_recording(track)] if track.bag.boundaries else []
    motion = _motion(track)
    done += [_whole(series, track) for series in motion]
    done += [
        unread(topic.name, topic.unread)
        for topic in _damaged(track)
        if topic.name not in {series.topic for series in motion}
    ]
    done += [
        Check(f"{steps.topic} is one stream", False, steps.disorder.told(track.zero_ns))
        for steps in track.wrenches
        if steps.disorder is not None and steps.disorder.restarts
    ]
    done += [
        Check(f"{steps.topic} is whole", False, "; ".join(faults))
        for steps in track.wrenches
        if (faults := steps.faults(track.zero_ns))
    ]
    leaps = next((each.leaps for each in agreed if each.leaps), None)
    done += [_continuous(track, steady, leaps)] if steady is not None else []
    done += [_frozen(track, steady)] if steady is not None and steady.frozen else []
    # What only the noise of the pose contradicts is a steady spin.
    if steady is not None and steady.frozen_twist and any(each.odd or each.contradicts for each in agreed):
        done.append(_frozen_twist(track, steady))
    done += [_one_body(track, steady.others)] if steady is not None and steady.others else []
    done += [_agrees(track, each) for each in agreed]
    if track.pose is not None and len(track.pose.time_ns):
        done.append(_unit(track.pose.values[:, 3:], bound))
    done += [balanced(track, balance, bound) for balance in found]
    return done


def _recorded(track: Track) -> Check:
    lacks = [part for part in (cut(track), missing(track)) if part]
    return Check(
        "recording has all its parts",
        not lacks,
        "; ".join(lacks) or "no file and no piece of one is known to be missing",
    )


def cut(track: Track) -> str:
    """Return when a recording was cut off, and how long the run should have been; "" if it is complete."""
    if track.bag.ended:
        return ""
    start, (_, end) = track.zero_ns, track.span_ns
    scene = logged_scene(track.bag.attachments)
    of = "" if scene is None or scene.duration is None else f" of {scene.duration - start * 1e-9:.9g}"
    lacks = f" (the next file, {track.bag.next_file}, is missing)" if track.bag.next_file else ""
    return f"cut off at t = {(end - start) * 1e-9:.9g}{of} s{lacks}"


def missing(track: Track) -> str:
    """Return which pieces of a recording are missing before its end; "" if none are known to be."""
    start, zero = track.span_ns[0], track.zero_ns
    first = track.own and (0, start) in track.missing
    pieces = [piece for piece in track.missing if not first or piece != (0, start)]
    times = [f"from t = {(a - zero) * 1e-9:.6g} to {_time_or_end(b, zero)}" for a, b in pieces]
    told = [f"{'a piece is' if len(times) == 1 else 'pieces are'} missing {', '.join(times)}"] if times else []
    told += ["messages may be missing of which no time is known"] * track.bag.unplaced
    told += [f"{name} is missing" for name in track.bag.missing_files]
    if first:
        told = [f"the first {start * 1e-9:.9g} s are missing", *told]
    return "; ".join(told)


def _time_or_end(time_ns: int, zero_ns: int) -> str:
    return "an end that is not known" if time_ns >= END_OF_TIME - 1 else f"{(time_ns - zero_ns) * 1e-9:.6g} s"


def losses(track: Track) -> list[str]:
    """Return what of a recording is missing, left out or doubtful, as text, for what goes on with the rest."""
    told = [*filter(None, (cut(track), missing(track))), *track.faults]
    damaged = {topic.name: len(topic.damaged) for topic in _damaged(track)}
    for series in _motion(track):
        if (unusable := series.unusable - damaged.get(series.topic, 0)) > 0:
            of = f"{unusable} of {series.count} messages of {series.topic}"
            told.append(f"{of} have a number that is not finite or too large, and are left out")
    return told


def _motion(track: Track) -> list[TimeSeries]:
    """Return pose and twist; if both are from one topic, only the one that lacks more rows."""
    found: dict[str, TimeSeries] = {}
    for series in track.motion:
        if series.topic not in found or series.left_out > found[series.topic].left_out:
            found[series.topic] = series
    return list(found.values())


def _whole(series: TimeSeries, track: Track) -> Check:
    name, count, begin = f"{series.topic} is whole", len(series.time_ns), track.zero_ns
    lost = [topic for topic in _damaged(track) if topic.name == series.topic]
    unusable = series.unusable - sum(len(topic.damaged) for topic in lost)
    lacks = [f"{unusable} of {series.count} messages have a number that is not finite or too large"] * (unusable > 0)
    parts = [each for each in track.motion if each.topic == series.topic]
    lacks += [topic.unread for topic in lost] + series.faults(begin)
    lacks += [spike.told(begin) for each in parts if each is not series for spike in each.spikes]
    lacks += [found(each, begin) for each in parts for found in (contradictions, overlaps)]
    steps = np.diff(series.time_ns)
    if len(steps):
        # As many messages in a row as are left out are no hole of their own.
        hole = not track.at_steps and steps.max() > (1 + series.left_out) * longest_usual(series.time_ns)
        lacks += [told(series.time_ns, begin) if hole else "", _late(series, track)]
    if lacks := [*filter(None, lacks)]:
        return Check(name, False, "; ".join(lacks))
    if not len(steps):
        return Check(name, True, f"{count} samples")
    return Check(
        name, True, f"{count} samples{_repeated(series)}, all finite, at most {int(steps.max()) * 1e-9:.6g} s apart"
    )


def _repeated(series: TimeSeries) -> str:
    """Return how many samples are recorded again, as by two recorders, or come faster than their clock ticks."""
    at = np.flatnonzero(np.diff(series.time_ns) == 0)
    same = (np.array_equal(series.values[row], series.values[row + 1], equal_nan=True) for row in at.tolist())
    again = sum(same)
    found = f", of which {again} repeat the one before, with its time" if again else ""
    if others := len(at) - again:
        tick = float(np.median(np.diff(series.once.time_ns))) * 1e-9
        found += f", of which {others} have the stamp of the one before, as of a clock that ticks every {tick:.6g} s: "
        found += "of each stamp, the first is judged"
    return found


def _damaged(track: Track) -> list[Topic]:
    """Return the topics with messages that cannot be read."""
    return [topic for _, topic in sorted(track.bag.topics.items()) if topic.damaged]


def unread(topic: str, words: str) -> Check:
    """Return that messages of a topic cannot be read, how many as `words` say."""
    return Check(f"{topic} is whole", False, words)


def _late(series: TimeSeries, track: Track) -> str:
    """Return how late the topic begins and how early it ends relative to the recording; "" if neither.

    By the log times, which all topics have; but one that is logged later may be stamped like the others.
    """
    own = track.bag.topics.get(series.topic)
    if track.own or track.at_steps or own is None or not own.count:
        return ""
    low, high = track.bag.cut_ns or (-(2**63), 2**63 - 1)
    others = [
        (times, each.name, within)
        for each in track.bag.topics.values()
        if not each.type_name.startswith(_OF_ROS) and not is_latched(each.name, each.qos)
        if len(times := each.log_times[within := (each.log_times >= low) & (each.log_times <= high)])
    ]
    begin, first, of_first = min(((int(times.min()), name, rows) for times, name, rows in others), key=lambda o: o[:2])
    end, last, of_last = max(((int(times.max()), name, rows) for times, name, rows in others), key=lambda o: o[:2])
    late, early = int(own.log_times.min()) - begin, end - int(own.log_times.max())
    if own.stamps_given and len(series.time_ns):
        if (other := track.bag.topics[first]).stamps_given:
            late = min(late, int(series.time_ns[0] - other.stamps[of_first].min()))
        if (other := track.bag.topics[last]).stamps_given:
            early = min(early, int(other.stamps[of_last].max() - series.time_ns[-1]))
    longest = float(np.diff(series.time_ns).max(initial=0))
    apart = max(_APART * 1e9, longest_usual(series.time_ns) if len(series.time_ns) > 3 else longest)
    lacks = [f"it begins {late * 1e-9:.6g} s after the recording does, with {first}"] if late > apart else []
    lacks += [f"it stops {early * 1e-9:.6g} s before the recording does, which goes on with {last}"] * (early > apart)
    return "; ".join(lacks)


def one_recording(track: Track) -> Check:
    """Return the check whether the files of a folder follow each other, as those of one recording do."""
    boundaries = track.bag.boundaries
    times = np.sort(np.concatenate([t.log_times for t in track.bag.topics.values()]))
    ends = np.searchsorted(times, [boundary.end_ns for boundary in boundaries], side="right") - 1
    within = np.delete(np.diff(times), ends[ends < len(times) - 1])
    far = max(_FOLLOWS * 1e9, 10.0 * float(within.max(initial=0)))
    apart = []
    for boundary in boundaries:
        seconds = (boundary.begin_ns - boundary.end_ns) * 1e-9
        if boundary.begin_ns - boundary.end_ns > far:
            apart.append(f"{seconds:.6g} s lie between {boundary.before} and {boundary.after}")
        elif boundary.end_ns - boundary.begin_ns > _FOLLOWS * 1e9:
            apart.append(f"{boundary.after} begins {-seconds:.6g} s before {boundary.before} ends")
    if not apart:
        names = [Path(boundaries[0].before), *(Path(boundary.after) for boundary in boundaries)]
        sorted_by = "" if names == sorted(names, key=by_number) else ", in the order of their times, not of their names"
        detail = f"{len(boundaries) + 1} files that follow one another{sorted_by}"
        return Check("files are one recording", True, detail)
    named = listed(apart[:NAMED], len(apart))
    return Check("files are one recording", False, f"{len(apart) + 1} recordings in one folder: {named}; inspect each")


def _continuous(track: Track, found: Continuity, leaps: Leaps | None) -> Check:
    topic = "" if track.pose is None else track.pose.topic
    name = f"{topic} has no jumps"
    if found.returns is not None:
        return Check(name, False, str(found.returns))
    if leaps:
        return Check(name, False, f"{leaps}: these are no attitudes of one body")
    if found.jumps:
        return Check(name, False, jumps_told(found.jumps, track.zero_ns))
    if found.turn >= FARTHEST:
        far = f"the attitude turns by {found.turn:.3g} rad from one sample to the next, so a jump cannot be detected"
        return Check(name, True, f"not judged; {far}", judged=False, share=0.0)
    return Check(name, True, "neither in attitude nor in position")


def _frozen(track: Track, found: Continuity) -> Check:
    topic = "" if track.pose is None else track.pose.topic
    what = "the same pose to the last bit although the body moved"
    return Check(f"{topic} does not freeze", False, f"{what}: {_times(track, found.frozen)}")


def _frozen_twist(track: Track, found: Continuity) -> Check:
    topic = "" if track.twist is None else track.twist.topic
    what = "the same twist to the last bit although the body turned otherwise"
    return Check(f"{topic} does not freeze", False, f"{what}: {_times(track, found.frozen_twist)}")


def _times(track: Track, spans: Sequence[tuple[int, int]]) -> str:
    times = [f"{(b - a) * 1e-9:.6g} s from t = {(a - track.zero_ns) * 1e-9:.6g} s" for a, b in spans]
    return listed(times[:NAMED], len(times))


def _one_body(track: Track, others: Sequence[Other]) -> Check:
    topic = "" if track.pose is None else track.pose.topic
    name, unlike = f"topics of {others[0].frame} are of one body", [other for other in others if not other.alike]
    apart = []
    for other in unlike or others:  # a star tracker tells no position
        distance = "" if np.isnan(other.distance) else f"{other.distance:.4g} m and "
        apart.append(f"{other.topic} by {distance}{np.rad2deg(other.angle):.4g}°")
    what = f"differ in the median from {topic}: {listed(apart[:NAMED], len(apart))}"
    if unlike:
        return Check(name, False, f"they move differently, and {what}; two bodies, or one of them is wrong")
    why = "they move alike, as do estimates of one body with drift, noise or another origin, and bodies side by side"
    return Check(name, True, f"not judged; {why}; they {what}", judged=False, share=0.0)


def _agrees(track: Track, each: Agreement) -> Check:
    rate = "angular velocity" if each.of == "attitude" else "linear velocity"
    name = f"{rate} fits the {each.of}"
    if each.error is None:
        return Check(name, True, f"not judged; {each.reason}", judged=False, share=0.0)
    if each.nothing:
        return Check(name, False, f"it is always zero although the {each.of} changes: it was not filled in")
    if each.leaps:
        return Check(name, False, str(each.leaps))
    measured = f"{100.0 * each.error:.3g} % (median of {each.windows} windows of {each.window_s:g} s)"
    aligned = f"; {each.words}" if each.words else ""
    if not each.contradicts:
        return Check(name, True, f"they differ by {measured}{f', {RARE}' * each.rare}{aligned}")
    if each.partly:
        zero = track.zero_ns
        when = [f"{(a - zero) * 1e-9:.6g} to {(b - zero) * 1e-9:.6g} s" for a, b in each.when_ns]
        part = f"in {100.0 * each.partly:.3g} % of them they contradict each other, from t = "
        part += f"{listed(when[:NAMED], len(when))}: for a while one of the two stood still, had another scale or told "
        part += "of another body"
        return Check(name, False, f"they differ by {measured}, but {part}")
    reading = f"; read {each.remedy} it fits to {100.0 * each.remaining:.2g} %" if each.remedy else aligned
    frames = [f"{s.topic} (frame {frame_names([s.frame])})" for s in track.motion]
    return Check(name, False, f"{' and '.join(frames)} contradict each other by {measured}{reading}")


def off_unit(orientation: Array) -> float:
    """Return the largest |norm - 1| of quaternions, 0 for none."""
    return max((float(np.abs(sizes_of(rows) - 1.0).max()) for rows in in_blocks(orientation)), default=0.0)


def _unit(orientation: Array, bound: float) -> Check:
    worst = off_unit(orientation)
    places = _decimal_places(orientation) if worst > bound else None
    rounded = 0.0 if places is None else 0.5 * 0.1**places * float(np.nanmax(np.abs(orientation).sum(axis=1)))
    why = f", as numbers have {places} decimal places" if rounded > bound else ""
    detail = f"|norm - 1| is at most {worst:.3g}, accepted {max(bound, rounded):.3g}{why}"
    return Check("quaternion is unit", worst <= max(bound, rounded), detail)


def _decimal_places(numbers: Array) -> int | None:
    """Return to how many decimal places, from 3 to 6, all numbers are rounded; None if they are not."""
    finite = numbers[np.isfinite(numbers)]
    for places in range(3, 7):
        scaled = finite * 10.0**places
        # Up to what writing them in single precision changes.
        if (np.abs(scaled - np.rint(scaled)) <= 1e-7 * np.abs(scaled) + 1e-9).all():
            return places
    return None


def balanced(track: Track, balance: Balance, bound: float) -> Check:
    """Return the check whether a balance holds to `bound`, or to the noise of the recording."""
    name = f"{balance.name} balance"
    if balance.covered == 0.0:
        return Check(name, True, f"not judged; {balance.basis}", judged=False, share=0.0)
    start = track.zero_ns
    worst = f"worst {balance.worst:.3g} {balance.unit} at t = {(balance.worst_ns - start) * 1e-9:.6g} s"
    onset = balance.onset_ns(bound)
    since = "" if onset is None else f", beyond it first at t = {(onset - start) * 1e-9:.6g} s"
    known = "" if balance.covered == 1.0 else f"; known for {100.0 * balance.covered:.3g} % of the time"
    noise = balance.noise
    if balance.relative > bound and noise is not None and (noise.coloured or not noise.beyond):
        told = bool(noise.sizes) and balance.relative <= 1.0 and not noise.coloured
        if noise.coloured:
            than = "not judged: correlated noise would look the same, and so would a load that varies as quickly"
        elif told:
            than = "no more than the noise of the recording"
        elif noise.sizes:
            than = "not judged: the noise of the recording is larger than the quantity itself"
        else:
            than = "not judged: too few samples to estimate the noise"
        detail = f"{worst}, relative {balance.relative:.3g}: {than}{known}"
        return Check(name, True, detail, told, balance.covered if told else 0.0)
    detail = f"{worst}, relative {balance.relative:.3g}, accepted {bound:g}{since}{known}"
    return Check(name, balance.relative <= bound, detail, share=balance.covered)
