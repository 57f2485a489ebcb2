"""Jumps of a recorded pose: intervals with much more motion than their neighbours, and than the twist explains.

Real motion is continuous. A pose jumps if markers are swapped, a filter is reset, or samples are lost while their
stamps continue.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rb_dynamics.analysis.gaps import longest_usual
from rb_dynamics.analysis.track import Array, Times, Track, unit_rows
from rb_dynamics.numerics.rotation_arrays import rotation_vectors

# Number of intervals on either side that define the usual motion.
_AROUND = 3
# A jump exceeds this multiple of the usual motion, and this multiple of its variation.
_TIMES, _SPREADS = 3.0, 10.0
# Smaller changes are no jumps: rad; and as a fraction of the longest distance between two positions.
_LEAST_TURN, _LEAST_PART = 0.02, 1e-3
# Two samples of one body and one of another come back at every third.
_RETURNS = 0.3
# A larger rotation between samples is ambiguous; rad.
FARTHEST = 0.5


@dataclass(frozen=True)
class Jump:
    """One jump.

    Attributes:
        turns: whether the attitude jumps; otherwise the position.
        start_ns: stamp of the sample before.
        end_ns: stamp of the sample after it.
        size: rad or m.
    """

    turns: bool
    start_ns: int
    end_ns: int
    size: float


@dataclass(frozen=True)
class Continuity:
    """Result of `continuity`.

    Attributes:
        jumps: in order of time.
        turn: usual rotation between two samples, rad; from `FARTHEST` on, no rotation is called a jump.
        returns: if the position is that of one of two places by turns, the fraction of the samples at which it comes
            back, and from how far (median, m).
    """

    jumps: tuple[Jump, ...]
    turn: float
    returns: tuple[float, float] | None = None


def continuity(track: Track) -> Continuity | None:
    """Return the jumps of the pose; None for too few samples, and for a log of this package."""
    pose = track.pose
    if track.own or pose is None or len(pose.time_ns) <= 2 * _AROUND + 1:
        return None
    turned = np.linalg.norm(rotation_vectors(unit_rows(pose.values[:, 3:])), axis=1)
    position = pose.values[:, :3]
    moved = np.linalg.norm(np.diff(position, axis=0), axis=1)
    extent = float(np.linalg.norm(np.ptp(position, axis=0)))
    rounding = 100.0 * np.finfo(float).eps * float(np.abs(position).max())
    found = _jumps(track, pose.time_ns, turned, _LEAST_TURN, turns=True)
    placed = not np.isnan(extent)
    if placed:
        found += _jumps(track, pose.time_ns, moved, max(_LEAST_PART * extent, rounding), turns=False)
    turning = turned[turned > 0.0]
    return Continuity(
        jumps=tuple(sorted(found, key=lambda jump: (jump.start_ns, not jump.turns))),
        turn=(turn := float(np.median(turning)) if len(turning) else 0.0),
        returns=_returns(track, pose.time_ns, position, moved) if placed and turn < FARTHEST else None,
    )


def _returns(track: Track, time_ns: Times, position: Array, moved: Array) -> tuple[float, float] | None:
    """Return how often, and from how far, the position comes back from where it was for one sample.

    None if that is seldom, or if the twist explains it. Noise about one place comes back a tenth as near at most in
    6 % of the samples.
    """
    back = np.linalg.norm(position[2:] - position[:-2], axis=1)
    least = np.zeros(len(back))
    if track.twist is not None and len(track.twist.time_ns):
        speed = np.nan_to_num(np.linalg.norm(track.twist.values[:, :3], axis=1))
        told = np.interp(time_ns[1:-1] - time_ns[0], track.twist.time_ns - time_ns[0], speed)
        least = _TIMES * told * np.diff(time_ns)[1:] * 1e-9
    home = (moved[1:] > least) & (back < 0.1 * moved[1:])
    share = float(home.mean())
    return (share, float(np.median(moved[1:][home]))) if share > _RETURNS else None


def _jumps(track: Track, time_ns: Times, size: Array, least: float, *, turns: bool) -> list[Jump]:
    apart = np.diff(time_ns)
    # A gap is reported elsewhere. A pose that repeats the last measurement does not move in between.
    at = np.flatnonzero((size > 0.0) & (apart <= longest_usual(time_ns)))
    if not len(at):
        return []
    since = np.diff(time_ns[at + 1]).astype(np.float64)
    usual = float(np.median(since)) if len(since) else float(apart[at[0]])
    since = np.clip(np.insert(since, 0, usual), 0.2 * usual, np.maximum(5.0 * usual, apart[at]))
    # Moves at equal times take a nanosecond, to keep the speed finite.
    since = np.maximum(since, 1.0) * 1e-9
    gone = size[at]
    expected = np.maximum(_around(gone / since) * since, _around(gone))
    # If a pose moves only once, or there and back, nothing shows the usual variation.
    spread = float(np.median(np.abs(gone - expected))) if len(gone) > 2 else 0.0
    beyond = gone > np.maximum(_TIMES * expected + _SPREADS * spread, least)
    # A motion at the first or last samples may continue outside.
    beyond &= (at >= _AROUND) & (at < len(size) - _AROUND)
    if turns:
        beyond &= expected < FARTHEST
    found = [Jump(turns, int(time_ns[k]), int(time_ns[k + 1]), float(size[k])) for k in at[beyond]]
    return [jump for jump in found if not _explained(track, jump)]


def _around(rates: Array) -> Array:
    """Return for each the larger of the medians of its neighbours before and after; 0 if there are none."""
    padded = np.pad(rates, _AROUND, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, _AROUND)
    middle = np.full(len(windows), 0.0)
    some = np.isfinite(windows).any(axis=1)
    middle[some] = np.nanmedian(windows[some], axis=1)
    result: Array = np.maximum(middle[: len(rates)], middle[_AROUND + 1 :])
    return result


def _explained(track: Track, jump: Jump) -> bool:
    """Return whether the twist explains the motion, or turns so far that attitudes are ambiguous."""
    if track.twist is None:
        return False
    length = jump.end_ns - jump.start_ns
    begin, end = np.searchsorted(track.twist.time_ns, [jump.start_ns - length, jump.end_ns + length + 1])
    rates = track.twist.values[begin:end, 3:] if jump.turns else track.twist.values[begin:end, :3]
    told = float(np.linalg.norm(rates, axis=1).max(initial=0.0)) * length * 1e-9
    return jump.size <= _TIMES * told or (jump.turns and told > 0.5 * np.pi)
