"""`stalls`: where the stamps of a pose go on while the body stands still.

A simulator with wall-clock stamps does that when it falls behind or is paused; the body then goes on from where it
stood.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rb_dynamics.analysis.track import Array, Times, TimeSeries, unit_rows
from rb_dynamics.numerics.rotation_arrays import rotation_vectors, rotations_between

# Intervals so many usual ones long are looked at. Rates are means over so many intervals on either side, and their
# noise is told by so many.
_LONG, _BESIDE, _AROUND = 1.4, 3, 12
# The body stood still for this part of the interval at least, and so long that noise does not explain it so many times.
_PART, _SURE = 0.4, 50.0
# When it goes on, the next sample comes at least this part of a usual interval later.
_NEXT = 0.5
# What it moved may be off by the motion of a usual interval, or by so many times the noise.
_NOISE = 10.0
# A larger turn in an interval is mistaken for another (rad), so that attitudes alone do not tell.
_TURN = 2.0


STOOD = "The body stood still while the stamps went on, as when a simulator falls behind or is paused,"


class Stall(NamedTuple):
    """Stamps of the samples before and after, and for how long the body stood still between them, s."""

    start_ns: int
    end_ns: int
    stood_s: float

    def since(self, zero_ns: int) -> Stall:
        """Return the same with stamps that count from `zero_ns`."""
        return self._replace(start_ns=self.start_ns - zero_ns, end_ns=self.end_ns - zero_ns)

    def told(self, zero_ns: int) -> str:
        """Return it as text, with its time from `zero_ns`."""
        return f"for {self.stood_s:.4g} s after t = {(self.start_ns - zero_ns) * 1e-9:.6g} s"


def stalls(pose: TimeSeries) -> tuple[Stall, ...]:
    """Return where the body stood still: it moved as by the rates on either side in a part of the interval only."""
    steps = np.diff(pose.time_ns)
    if len(steps) <= 2 * _AROUND:
        return ()
    usual_s = 1e-9 * float(np.median(steps))
    found = []
    long = steps > _LONG * 1e9 * usual_s
    alone = long & (np.convolve(long, np.ones(2 * _BESIDE + 1), "same") == 1.0)
    for at in np.flatnonzero(alone).tolist():
        first, last = np.searchsorted(pose.time_ns, [pose.time_ns[at] - steps[at], pose.time_ns[at + 1] + steps[at]])
        rows = slice(max(min(int(first), at - _AROUND), 0), max(int(last), at + _AROUND + 2))
        stood_s = _stood_s(pose.time_ns[rows], pose.values[rows], at - rows.start, usual_s)
        if stood_s > 0.0:
            found.append(Stall(int(pose.time_ns[at]), int(pose.time_ns[at + 1]), stood_s))
    return tuple(found)


def _stood_s(time_ns: Times, values: Array, at: int, usual_s: float) -> float:
    """Return how long the body stood still after sample `at`; 0 if it went on, or that is not certain."""
    steps = 1e-9 * np.diff(time_ns)
    beside = steps[at - _BESIDE : at + _BESIDE + 1]
    if at < _BESIDE or len(beside) <= 2 * _BESIDE or beside.min() == 0.0:
        return 0.0
    even = (steps > 0.0) & (steps <= _LONG * usual_s)
    even[: max(at - _AROUND, 0)] = even[at + _AROUND + 1 :] = False
    length, passed, sizes = float(steps[at]), 0.0, 0.0
    parts, noises = [], []
    for moved in (rotation_vectors(unit_rows(values[:, 3:])), np.nan_to_num(np.diff(values[:, :3], axis=0))):
        rates = moved[even] / steps[even, None]
        noise = usual_s * float(np.median(np.linalg.norm(np.diff(rates, axis=0), axis=1))) + 1e-12
        before, after = moved[at - _BESIDE : at], moved[at + 1 : at + 1 + _BESIDE]
        rate = 0.5 * (before.sum(axis=0) / beside[:_BESIDE].sum() + after.sum(axis=0) / beside[-_BESIDE:].sum())
        noises.append(noise)
        parts.append((moved[at] / noise, rate / noise))
        passed += float(moved[at] @ rate) / noise**2
        sizes += float(rate @ rate) / noise**2
    passed /= max(sizes, 1e-300)
    stood_s = length - passed
    (_, turning), (_, travelling) = parts
    if length * np.linalg.norm(turning) * noises[0] > _TURN:
        sizes = float(travelling @ travelling)
    if stood_s < _PART * length or stood_s * np.sqrt(sizes) < _SURE or passed < _NEXT * usual_s:
        return 0.0
    near = [max(_NOISE, usual_s * float(np.linalg.norm(rate))) for _, rate in parts]
    if any(np.linalg.norm(moved - passed * rate) > most for (moved, rate), most in zip(parts, near, strict=True)):
        return 0.0
    reach = [(most + float(np.linalg.norm(moved))) * n for (moved, _), most, n in zip(parts, near, noises, strict=True)]
    return 0.0 if _comes_back(values[at::-1], reach) or _comes_back(values[at + 1 :], reach) else stood_s


def _comes_back(values: Array, reach: list[float]) -> bool:
    """Return whether a body that has gone farther than `reach` (rad, m) from the first pose comes back to it.

    What swings or spins may have done so in a hole, too.
    """
    q = unit_rows(values[:, 3:])
    turned = np.linalg.norm(rotations_between(np.broadcast_to(q[:1], q.shape), q), axis=1)
    moved = np.linalg.norm(np.nan_to_num(values[:, :3] - values[0, :3]), axis=1)
    near = (turned <= reach[0]) & (moved <= reach[1])
    return bool(np.any(near[1:] & ~near[:-1]))
