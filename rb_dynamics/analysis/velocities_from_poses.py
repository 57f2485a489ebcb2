"""`rates_of`: angular and linear velocity from poses, with the noise that results from that of the poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rb_dynamics.analysis.gaps import longest_usual
from rb_dynamics.analysis.noise import typical_at
from rb_dynamics.analysis.track import Array, TimeSeries, unit_rows
from rb_dynamics.numerics.rotation_arrays import rotate_all, rotate_all_inverse, rotation_vectors


@dataclass(frozen=True)
class Rates:
    """A twist that was computed from poses.

    Attributes:
        twist: rows of linear velocity (m/s, of the body origin) and angular velocity (rad/s), body axes; without those
            next to a gap.
        noise: standard deviation of each of the two, all components together.
        interval_s: over which the differences are taken (median).
    """

    twist: TimeSeries
    noise: tuple[float, float]
    interval_s: float


def rates_of(pose: TimeSeries) -> Rates | None:
    """Return the rates at each sample from the difference of its neighbours; None for fewer than three in a row.

    With t0, t1, t2 and slopes a, b before and after t1, the slope at t1 is (b (t1 - t0) + a (t2 - t1)) / (t2 - t0),
    whose error is of second order for uneven times too.
    """
    time_ns, first = np.unique(pose.time_ns, return_index=True)
    steps = np.diff(time_ns)
    if len(steps) < 2:
        return None
    attitude, position = unit_rows(pose.values[first, 3:]), pose.values[first, :3]
    turned = rotate_all(attitude[:-1], rotation_vectors(attitude))
    moved = np.diff(position, axis=0)
    before, after = steps[:-1, None] * 1e-9, steps[1:, None] * 1e-9

    def slope(gone: Array) -> Array:
        result: Array = (gone[1:] / after * before + gone[:-1] / before * after) / (before + after)
        return rotate_all_inverse(attitude[1:-1], result)

    near = steps <= longest_usual(time_ns)
    kept = near[1:] & near[:-1]
    if not kept.any():
        return None
    twist = np.hstack([slope(moved), slope(turned)])[kept]
    path = np.concatenate([np.zeros((1, 3)), np.cumsum(turned, axis=0)])
    interval_s = float(np.median((before + after)[kept]))
    linear, angular = (float(np.sqrt(2.0) * typical_at(rows, time_ns) / interval_s) for rows in (position, path))
    return Rates(TimeSeries("", time_ns[1:-1][kept], twist), (linear, angular), interval_s)
