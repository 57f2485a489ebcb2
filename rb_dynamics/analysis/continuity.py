"""Jumps of a recorded pose: intervals with much more motion than their neighbours, and than the twist explains.

Real motion is continuous. A pose jumps where markers are swapped, a filter is reset, or samples are lost while their
stamps go on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rb_dynamics.analysis.gaps import longest_usual
from rb_dynamics.analysis.track import Array, Times, Track, unit_rows
from rb_dynamics.numerics.rotation_arrays import rotation_vectors

# So many intervals on either side say how far the pose usually goes.
_AROUND = 3
# A jump goes farther than this many times that, and than so many times how much that varies.
_TIMES, _SPREADS = 3.0, 10.0
# What is smaller is none: rad; and as part of the longest distance between two positions.
_LEAST_TURN, _LEAST_PART = 0.02, 1e-3
# Where attitudes are farther apart, how the body turned between them is not known; rad.
FARTHEST = 0.5


@dataclass(frozen=True)
class Jump:
    """One jump.

    Attributes:
        turns: the attitude jumps; else the position.
        start_ns: stamp of the sample before.
        end_ns: stamp of the sample behind.
        size: rad or m.
    """

    turns: bool
    start_ns: int
    end_ns: int
    size: float


@dataclass(frozen=True)
class Continuity:
    """What `continuity` found.

    Attributes:
        jumps: in the order of time.
        turn: rad, the usual turn between two samples; where it is `FARTHEST` or more, no turn is called a jump.
    """

    jumps: tuple[Jump, ...]
    turn: float


def continuity(track: Track) -> Continuity | None:
    """Return the jumps of the pose; None for too few samples, and for a log of this package, whose run is its proof."""
    pose = track.pose
    if track.own or pose is None or len(pose.time_ns) <= 2 * _AROUND + 1:
        return None
    turned = np.linalg.norm(rotation_vectors(unit_rows(pose.values[:, 3:])), axis=1)
    position = pose.values[:, :3]
    moved = np.linalg.norm(np.diff(position, axis=0), axis=1)
    extent = float(np.linalg.norm(np.ptp(position, axis=0)))
    rounding = 100.0 * np.finfo(float).eps * float(np.abs(position).max())
    found = [
        *_jumps(track, pose.time_ns, turned, _LEAST_TURN, turns=True),
        *_jumps(track, pose.time_ns, moved, max(_LEAST_PART * extent, rounding), turns=False),
    ]
    turning = turned[turned > 0.0]
    return Continuity(
        jumps=tuple(sorted(found, key=lambda jump: (jump.start_ns, not jump.turns))),
        turn=float(np.median(turning)) if len(turning) else 0.0,
    )


def _jumps(track: Track, time_ns: Times, size: Array, least: float, *, turns: bool) -> list[Jump]:
    apart = np.diff(time_ns)
    # A hole is named as one. A pose that is held until the next measurement goes nowhere in between.
    at = np.flatnonzero((size > 0.0) & (apart <= longest_usual(time_ns)))
    if not len(at):
        return []
    since = np.diff(time_ns[at + 1]).astype(np.float64)
    usual = float(np.median(since)) if len(since) else float(apart[at[0]])
    since = np.clip(np.insert(since, 0, usual), 0.2 * usual, np.maximum(5.0 * usual, apart[at]))
    # Moves at one time take a nanosecond: their speed is a number too.
    since = np.maximum(since, 1.0) * 1e-9
    gone = size[at]
    expected = np.maximum(_around(gone / since) * since, _around(gone))
    # Where a pose stands still but for one move, or there and back, nothing says how much moves vary.
    spread = float(np.median(np.abs(gone - expected))) if len(gone) > 2 else 0.0
    beyond = gone > np.maximum(_TIMES * expected + _SPREADS * spread, least)
    # What begins at the first or last samples may go on.
    beyond &= (at >= _AROUND) & (at < len(size) - _AROUND)
    if turns:
        beyond &= expected < FARTHEST
    found = [Jump(turns, int(time_ns[k]), int(time_ns[k + 1]), float(size[k])) for k in at[beyond]]
    return [jump for jump in found if not _explained(track, jump)]


def _around(rates: Array) -> Array:
    """Return for each the larger of the medians of those before and behind it; 0 where there is none."""
    padded = np.pad(rates, _AROUND, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, _AROUND)
    middle = np.full(len(windows), 0.0)
    some = np.isfinite(windows).any(axis=1)
    middle[some] = np.nanmedian(windows[some], axis=1)
    result: Array = np.maximum(middle[: len(rates)], middle[_AROUND + 1 :])
    return result


def _explained(track: Track, jump: Jump) -> bool:
    """Return whether the twist goes as far, or so far that attitudes say nothing."""
    if track.twist is None:
        return False
    length = jump.end_ns - jump.start_ns
    begin, end = np.searchsorted(track.twist.time_ns, [jump.start_ns - length, jump.end_ns + length + 1])
    rates = track.twist.values[begin:end, 3:] if jump.turns else track.twist.values[begin:end, :3]
    told = float(np.linalg.norm(rates, axis=1).max(initial=0.0)) * length * 1e-9
    return jump.size <= _TIMES * told or (jump.turns and told > 0.5 * np.pi)
