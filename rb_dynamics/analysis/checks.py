"""What has to hold in a recorded run: it is whole, time runs evenly, attitudes are unit, the balances close.

Judges only what it can: a check that lacks its data says so, or is not there where nothing of it is recorded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rb_dynamics.analysis.balance import Balance
from rb_dynamics.analysis.track import Array, Series, Times, Track
from rb_dynamics.errors import RigidBodyError
from rb_dynamics.run.provenance import SCENE
from rb_dynamics.scene.model import Scene
from rb_dynamics.scene.read import parse_scene

BOUND = 1e-6
"""Default of the largest defect accepted, relative to the largest energy or momentum seen."""

# An interval this much longer than the usual one is a gap, where intervals are even.
_GAP = 1.5
# The same where they are not: a lost message or two is none.
_FAR = 5.0
# Streams of one recording do not begin and end at once; s.
_APART = 1.0


@dataclass(frozen=True)
class Check:
    """One thing that has to hold, whether it does, and by how much.

    `judged` is False where that is not known, `share` the fraction of the time for which it is.
    """

    name: str
    passed: bool
    detail: str
    judged: bool = True
    share: float = 1.0


def checks(track: Track, found: Sequence[Balance], bound: float) -> list[Check]:
    """Return every check that `track` has the data for; `bound` is relative to the largest energy or momentum."""
    whole = track.bag.whole
    detail = "it has its end" if whole else "cut off: it holds what was written until then"
    done = [Check("file is whole", whole, detail), _recorded(track)]
    done += [_whole(series, track) for series in _motion(track)]
    if track.pose is not None and len(track.pose.time_ns):
        done.append(_unit(track.pose.values[:, 3:], bound))
    done += [_balanced(track, balance, bound) for balance in found]
    return done


def _recorded(track: Track) -> Check:
    lacks = [part for part in (cut(track), missing(track)) if part]
    return Check("recording is whole", not lacks, "; ".join(lacks) or "nothing is known to be missing")


def cut(track: Track) -> str:
    """Return when a recording was cut off, and of what a run was to be; "" for one that has its end."""
    if track.bag.ended:
        return ""
    start, end = track.span_ns
    scene = logged_scene(track)
    of = "" if scene is None or scene.duration is None else f" of {scene.duration - start * 1e-9:.9g}"
    lacks = f" (the next file, {track.bag.next_file}, is missing)" if track.bag.next_file else ""
    return f"cut off at t = {(end - start) * 1e-9:.9g}{of} s{lacks}"


def missing(track: Track) -> str:
    """Return which pieces of a recording are missing before its end; "" where none is known to be."""
    start, _ = track.span_ns
    times = [f"from t = {(a - start) * 1e-9:.6g} to {(b - start) * 1e-9:.6g} s" for a, b in track.bag.missing]
    told = [f"{'a piece is' if len(times) == 1 else 'pieces are'} missing {', '.join(times)}"] if times else []
    told += [f"the next file, {name}, is missing" for name in track.bag.missing_files]
    # A run begins at 0: a later file of a bag, alone, does not.
    if track.own and start > 0 and not any(begin < start for begin, _ in track.bag.missing):
        told = [f"the first {start * 1e-9:.9g} s are missing", *told]
    return "; ".join(told)


def logged_scene(track: Track) -> Scene | None:
    """Return the scene in a log; None where there is none, or it needs a plug-in that is not here."""
    scene = track.bag.attachments.get(SCENE)
    try:
        return None if scene is None else parse_scene(scene.decode("utf-8", "replace"))
    except RigidBodyError:
        return None


def _motion(track: Track) -> list[Series]:
    """Return pose and twist, once where both are from one topic."""
    found = {series.topic: series for series in (track.pose, track.twist) if series is not None}
    return list(found.values())


def _whole(series: Series, track: Track) -> Check:
    name, count = f"{series.topic} is whole", len(series.time_ns)
    if series.unusable:
        of = f"{series.unusable} of {count + series.unusable} messages"
        return Check(name, False, f"{of} have a number that is not finite or too large")
    if series.backwards:
        return Check(name, False, f"stamps go back {series.backwards}×; two runs in one file cannot be told apart")
    steps = np.diff(series.time_ns)
    if not len(steps):
        return Check(name, True, f"{count} samples")
    longest = int(steps.argmax())
    apart = f"{int(steps[longest]) * 1e-9:.6g} s"
    if missing := gaps(series.time_ns):
        start = track.seconds(series.time_ns)[longest]
        return Check(name, False, f"gaps: {missing}, the longest {apart} from t = {start:.6g} s")
    if late := _stops(series, track):
        return Check(name, False, late)
    return Check(name, True, f"{count} samples, all finite, at most {apart} apart")


def _stops(series: Series, track: Track) -> str:
    """Return how long before the end of the recording its messages stop; "" where they do not."""
    own = track.bag.topics.get(series.topic)
    if track.own or own is None or not own.count:
        return ""
    last = max(own.log_times)
    name, end = max(((each.name, max(each.log_times)) for each in track.bag.topics.values() if each.count), key=_second)
    if end - last <= max(_APART * 1e9, longest_usual(series.time_ns) if len(series.time_ns) > 3 else 0.0):
        return ""
    return f"it stops {(end - last) * 1e-9:.6g} s before the recording does, which goes on with {name}"


def _second(pair: tuple[str, int]) -> int:
    return pair[1]


def _unit(orientation: Array, bound: float) -> Check:
    worst = float(np.abs(np.linalg.norm(orientation, axis=1) - 1.0).max())
    return Check("quaternion is unit", worst <= bound, f"|norm - 1| is at most {worst:.3g}, accepted {bound:g}")


def _balanced(track: Track, balance: Balance, bound: float) -> Check:
    name = f"{balance.name} balance"
    if balance.covered == 0.0:
        return Check(name, True, f"not judged; {balance.basis}", judged=False, share=0.0)
    start, _ = track.span_ns
    worst = f"worst {balance.worst:.3g} {balance.unit} at t = {(balance.worst_ns - start) * 1e-9:.6g} s"
    onset = balance.onset_ns(bound)
    since = "" if onset is None else f", beyond it first at t = {(onset - start) * 1e-9:.6g} s"
    known = "" if balance.covered == 1.0 else f"; known for {100.0 * balance.covered:.3g} % of the time"
    if balance.relative > bound and balance.noise is not None and not balance.noise.beyond:
        told = bool(balance.noise.sizes)
        than = "no more than the noise of the recording" if told else "not judged: too few samples to tell noise"
        detail = f"{worst}, relative {balance.relative:.3g}: {than}{known}"
        return Check(name, True, detail, told, balance.covered if told else 0.0)
    detail = f"{worst}, relative {balance.relative:.3g}, accepted {bound:g}{since}{known}"
    return Check(name, balance.relative <= bound, detail, share=balance.covered)


def gaps(time_ns: Times) -> int:
    """Return how many intervals are longer than `longest_usual`."""
    return int((np.diff(time_ns) > longest_usual(time_ns)).sum())


def longest_usual(time_ns: Times) -> float:
    """Return the longest interval (ns) that is no gap; infinite for fewer than three.

    Where nine in ten are even to 1 %, one and a half of the usual one. Else what lies far beyond the spread of the
    intervals: times at random, of exponential intervals, go beyond it once in 20 million.
    """
    steps = np.diff(time_ns)
    if len(steps) < 3:
        return float(np.inf)
    usual, long = (float(part) for part in np.quantile(steps, (0.5, 0.9)))
    if usual > 0.0 and float((np.abs(steps - usual) <= 0.01 * usual).mean()) >= 0.9:
        return _GAP * usual
    return max(_FAR * usual, usual + 10.0 * (long - usual))
