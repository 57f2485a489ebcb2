"""Impulse of held wrenches from sample to sample of a log.

The impulse of a wrench held in world axes is exact. That of a wrench that rotates with the body is an integral over the
attitude, which is known at the samples only; quadrature gives it, with an error estimate that the caller must judge. If
a wrench changes between two samples, the attitude is interpolated. If attitude or wrench are unknown, so is the
impulse.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.noise import noise_of_path
from rb_dynamics.analysis.track import Array, RecordedWrench, Times, Track, parts, unit_rows
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.numerics.growing_array import give_back
from rb_dynamics.numerics.rotation_arrays import rotate_all, rotate_all_inverse, rotation_vectors

Rates = TypeVar("Rates", Array, Times)
_BLOCK = 1 << 16

# h^5/384 for the interpolated attitude and h^5/2880 for Simpson's rule, over h^5/720.
_INTERPOLATED = 720.0 / 384.0 + 720.0 / 2880.0


@dataclass(frozen=True)
class Impulse:
    """Total impulse of all channels in the interval that ends at each sample; the first row is zero.

    Attributes:
        exact: impulse of wrenches held in world axes.
        turning: impulse of wrenches that rotate with the body, by quadrature.
        error: estimated error of `turning`; infinite if unknown.
        idle: whether nothing acts.
    """

    exact: Array
    turning: Array
    error: Array
    idle: NDArray[np.bool_]


@dataclass(frozen=True)
class _Attitude:
    """Attitude and angular velocity (body axes) at the samples."""

    orientation_xyzw: Array
    angular_velocity: Array


def impulse_blocks(track: Track, kind: str, time_ns: Times) -> Iterator[Impulse]:
    """Yield the impulse of every "force" or "torque" (`kind`) of `track` between the samples at `time_ns`, in blocks.

    That of all samples of a long log needs more memory than the log.
    """
    acting, count = track.acting, len(time_ns)
    blocks = [slice(first, first + _BLOCK + 1) for first in range(0, max(count - 1, 1), _BLOCK)]
    known = all(_rows(track, time_ns[block]) for block in blocks) if _turns(acting, kind) else False
    for block in blocks:
        part = _between(acting, kind, _Samples(track, acting, time_ns[block], known))
        # The first row of a block belongs to no interval.
        new = slice(1 if block.start else 0, None)
        yield Impulse(part.exact[new], part.turning[new], part.error[new], part.idle[new])
        for series in (track.pose, track.twist) if known else ():
            if series is not None:
                give_back(series.values)


def wander(track: Track, turning: Iterable[Array], time_ns: Times) -> Array:
    """Return the variance that the noise of the attitude gives to `turning`, see `Impulse`, in each interval, (n,).

    Each error turns the impulse of about one interval, and stays in the sum of all.
    """
    squares = np.concatenate([np.sum(block**2, axis=1) for block in turning])
    # Where nothing turns with the body, it need not be known how well its attitude is.
    if track.pose is None or not squares.any() or not (rows := _rows(track, time_ns)):
        return np.zeros(len(time_ns))
    values, at = track.pose.values, rows[0]
    turned = (rotation_vectors(unit_rows(values[at[block], 3:])) for block in _ends(len(at)))
    result: Array = noise_of_path(turned, np.empty((0, 3)), track.pose.time_ns[at[1:]]) ** 2 * squares
    give_back(values)
    return result


def _ends(count: int) -> Iterator[slice]:
    """Yield the rows at the ends of the intervals between `count`, in blocks."""
    return (slice(part.start, part.stop + 1) for part in parts(count - 1))


@dataclass(frozen=True)
class _Samples:
    """The samples of one block; what only wrenches that turn with the body need is computed when it is asked for."""

    track: Track
    acting: tuple[RecordedWrench, ...]
    time_ns: Times
    known: bool

    @cached_property
    def attitude(self) -> _Attitude | None:
        return _attitude(self.track, self.time_ns) if self.known else None

    @cached_property
    def jolts(self) -> Array:
        return _jolts(self.acting, self.track.body, self.time_ns)


def _turns(acting: tuple[RecordedWrench, ...], kind: str) -> bool:
    """Return whether any wrench may act that is not held in world axes."""
    return any(bool((_vectors(each, kind)[~each.world] != 0.0).any() or not each.known.all()) for each in acting)


def _vectors(steps: RecordedWrench, kind: str) -> Array:
    return steps.force if kind == "force" else steps.torque


def _between(acting: tuple[RecordedWrench, ...], kind: str, samples: _Samples) -> Impulse:
    """Return the impulse between the samples of one block."""
    count = len(samples.time_ns)
    parts = [_of_channel(steps, kind, samples) for steps in acting]
    nothing = Impulse(np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count), np.ones(count, dtype=bool))
    return Impulse(
        exact=nothing.exact + sum(part.exact for part in parts),
        turning=nothing.turning + sum(part.turning for part in parts),
        error=nothing.error + sum(part.error for part in parts),
        idle=np.logical_and.reduce([nothing.idle, *(part.idle for part in parts)]),
    )


def integral(from_ns: Times, rates: Rates, time_ns: Times) -> Rates:
    """Return the integral over ns of a held quantity, from the first of `time_ns` to each.

    Row i of `rates` is held from `from_ns[i]` until the next; before the first there is nothing.
    """
    if not len(from_ns) or not len(time_ns):
        return np.zeros((len(time_ns), rates.shape[1]), dtype=rates.dtype)
    before = np.zeros_like(rates)
    np.cumsum(rates[:-1] * np.diff(from_ns)[:, None], axis=0, out=before[1:])
    row = np.searchsorted(from_ns, time_ns, side="right") - 1
    since = (time_ns - from_ns[row])[:, None]
    sums = np.where(row[:, None] >= 0, before[row] + rates[row] * since, 0)
    result: Rates = sums - sums[0]
    return result


def _jolts(acting: tuple[RecordedWrench, ...], body: RigidBody | None, time_ns: Times) -> Array:
    """Return the largest angular acceleration by torques in each interval in which one changes; else, or unknown, 0.

    Torques that cancel within an interval turn the body without a trace in the rates at its ends.
    """
    count = max(len(time_ns) - 1, 0)
    torque, jolted = np.zeros(count), np.zeros(count, dtype=bool)
    moments = [moment for moment in body.principal_moments if moment > 0.0] if body is not None else []
    for steps in acting if moments else ():
        if not count or not len(steps.time_ns):
            continue
        first = np.searchsorted(steps.time_ns, time_ns[:-1], side="right") - 1
        last = np.maximum(np.searchsorted(steps.time_ns, time_ns[1:], side="left") - 1, first)
        # Row 0 stands for the time before the first one, when nothing acts.
        values = np.vstack([np.zeros(3), steps.torque])
        world = np.concatenate([steps.world[:1], steps.world])
        differs = (values[1:] != values[:-1]).any(axis=1) | (world[1:] != world[:-1])
        changes = np.concatenate([[0], np.cumsum(differs)])
        jolted |= changes[last + 1] > changes[first + 1]
        rows, begins = _pieces(first + 1, last + 1)
        torque += np.maximum.reduceat(np.linalg.norm(values, axis=1)[rows], begins)
    result: Array = np.where(jolted, torque, 0.0) / min(moments, default=1.0)
    return result


def _of_channel(steps: RecordedWrench, kind: str, samples: _Samples) -> Impulse:
    vectors, time_ns = _vectors(steps, kind), samples.time_ns
    active = (vectors != 0.0).any(axis=1) | ~steps.known
    world = steps.world & steps.known
    flags = np.column_stack([active & ~world, active]).astype(np.int64)
    # Whether a wrench acts is counted in whole nanoseconds, so that rounding cannot make a free stretch look driven.
    turns, acts = np.diff(integral(steps.time_ns, flags, time_ns), axis=0, prepend=0).T != 0
    turning, error = np.zeros((len(time_ns), 3)), np.zeros(len(time_ns))
    if turns.any():
        # What is held in world axes adds nothing here, also where it comes within an interval.
        by_quadrature = _turning(steps, np.where(world[:, None], 0.0, vectors), samples, turns)
        turning[turns], error[turns] = (each[turns] for each in by_quadrature)
    exact = integral(steps.time_ns, np.where(world[:, None], vectors, 0.0), time_ns) * 1e-9
    return Impulse(np.diff(exact, axis=0, prepend=0.0), turning, error, ~acts)


def _turning(steps: RecordedWrench, vectors: Array, samples: _Samples, turns: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the integral of R b over each interval in which b is constant, and an estimate of its error.

    With f = R b and f' = R (w x b) at both ends: h/2 (f0 + f1) + h^2/12 (f0' - f1'), whose error is h^5/720 f''''
    (Stoer & Bulirsch, Introduction to Numerical Analysis, section 3.3: the first correction of the trapezoidal sum).
    """
    time_ns, attitude, jolts = samples.time_ns, samples.attitude, samples.jolts
    count = len(time_ns)
    turning, error = np.zeros((count, 3)), np.full(count, np.inf)
    if attitude is None or not len(steps.time_ns) or count < 2:
        return turning, error
    first = np.searchsorted(steps.time_ns, time_ns[:-1], side="right") - 1
    last = np.searchsorted(steps.time_ns, time_ns[1:], side="left") - 1
    held = (first >= 0) & (first == last) & steps.known[first]
    b = vectors[first]
    h: Array = np.diff(time_ns)[:, None] * 1e-9
    q, w = attitude.orientation_xyzw, attitude.angular_velocity
    turning[1:] = 0.5 * h * (rotate_all(q[:-1], b) + rotate_all(q[1:], b))
    before = np.cross(w[:-1], b).astype(np.float64)
    after = np.cross(w[1:], b).astype(np.float64)
    turning[1:] += h * h / 12.0 * (rotate_all(q[:-1], before) - rotate_all(q[1:], after))
    size_of_b = np.linalg.norm(b, axis=1)
    # With |r''| <= a the quadrature of |b| = 1 is wrong by at most h^3/31 a and the cubic by at most h^3/28 a, the
    # integrals of their Peano kernels; the worst a changes sign at about h/4 and 3h/4.
    rate = np.linalg.norm(w, axis=1)
    jolt = h[:, 0] ** 3 / 28.0 * np.where(jolts > 0.0, jolts + np.maximum(rate[:-1], rate[1:]) ** 2, 0.0)
    error[1:] = np.where(held, _remainder(h[:, 0], size_of_b, w) + size_of_b * jolt, np.inf)
    known = np.concatenate([[0], np.cumsum(steps.known)])
    begin = np.maximum(first, 0)
    changed = turns[1:] & (last > first) & (known[last + 1] - known[begin] == last + 1 - begin)
    rows = np.flatnonzero(changed)
    if len(rows):
        pieces = _pieces(begin[rows], last[rows])
        turning[rows + 1] = _by_pieces(steps.time_ns, vectors, time_ns, q, w, rows, *pieces)
        largest = np.maximum.reduceat(np.linalg.norm(vectors[pieces[0]], axis=1), pieces[1])
        whole = _INTERPOLATED * _remainder(h[:, 0], np.ones(count - 1), w)
        kink = h[:, 0] ** 3 / 100.0 * _acceleration(h[:, 0], w)
        error[rows + 1] = largest * (whole + np.maximum(kink, jolt))[rows]
        size_of_b[rows] = largest
    # A larger error than the impulse can have says that it is not known, as over a hole: its digits would drown others.
    void = error[1:] > h[:, 0] * size_of_b
    error[1:][void], turning[1:][void] = np.inf, 0.0
    return turning, error


def _pieces(first: NDArray[np.intp], last: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the indices from each `first` to its `last`, concatenated, and where those of each begin."""
    counts = last - first + 1
    begins = np.cumsum(counts) - counts
    return np.arange(int(counts.sum())) - np.repeat(begins - first, counts), begins


def _by_pieces(
    from_ns: Times,
    vectors: Array,
    time_ns: Times,
    q: Array,
    w: Array,
    rows: NDArray[np.intp],
    pieces: NDArray[np.intp],
    begins: NDArray[np.intp],
) -> Array:
    """Return the integral of R b over the interval after each of `rows`, in which b changes, by Simpson's rule.

    The rotation since the begin is interpolated by a cubic (Hermite) in its rotation vector r, r' = w + r x w / 2 + ...
    (Iserles, Munthe-Kaas, Norsett & Zanna, Acta Numerica 9 (2000) 215, section B.2). Where r'' jumps by a, the cubic is
    wrong by at most about h^2 a / 200.
    """
    of = np.repeat(np.arange(len(rows)), np.diff(begins, append=len(pieces)))
    h = (time_ns[rows + 1] - time_ns[rows]).astype(np.float64) * 1e-9
    turned = rotation_vectors(q)[rows]
    twist = np.cross(turned, w[rows + 1])
    initial = (h[:, None] * w[rows])[of]
    final = (h[:, None] * (w[rows + 1] + 0.5 * twist + np.cross(turned, twist) / 12.0))[of]
    since = np.clip(from_ns[pieces] - time_ns[rows][of], 0, None) * 1e-9 / h[of]
    until = np.append(since[1:], 1.0)
    until[np.append(begins[1:] - 1, len(pieces) - 1)] = 1.0
    length = (until - since)[:, None]
    total = np.zeros((len(pieces), 3))
    for part, weight in ((0.0, 1.0), (0.5, 4.0), (1.0, 1.0)):
        u = since[:, None] + part * length
        angle = u * (1.0 - u) ** 2 * initial + u**2 * (3.0 - 2.0 * u) * turned[of] - u**2 * (1.0 - u) * final
        size = np.linalg.norm(angle, axis=1, keepdims=True)
        relative = np.hstack([0.5 * np.sinc(size / (2.0 * np.pi)) * angle, np.cos(0.5 * size)])
        total += weight / 6.0 * length * rotate_all(relative, vectors[pieces])
    return rotate_all(q[rows], h[:, None] * np.add.reduceat(total, begins, axis=0))


def _remainder(h: Array, size_of_b: Array, w: Array) -> Array:
    """Return h^5/720 |b| (W^4 + 18 W^2 A + 5 A^2), which is |f''''| with W and A the largest rate and acceleration.

    Euler's equations give |w''| <= 2 W A and |w'''| <= 2 A^2 + 4 W^2 A; A is their W^2 added to the mean acceleration.
    """
    rate = np.linalg.norm(w, axis=1)
    size, turn = np.maximum(rate[:-1], rate[1:]), _acceleration(h, w)
    fourth = size**4 + 18.0 * size**2 * turn + 5.0 * turn**2
    result: Array = h**5 / 720.0 * size_of_b * fourth
    return result


def _acceleration(h: Array, w: Array) -> Array:
    """Return the mean angular acceleration of each interval, plus W^2."""
    rate = np.linalg.norm(w, axis=1)
    mean = np.linalg.norm(np.diff(w, axis=0), axis=1) / np.where(h > 0.0, h, 1.0)
    result: Array = mean + np.maximum(rate[:-1], rate[1:]) ** 2
    return result


def _rows(track: Track, time_ns: Times) -> list[NDArray[np.intp]]:
    """Return the rows of pose and twist at `time_ns`; empty unless both have all of these stamps."""
    if track.pose is None or track.twist is None:
        return []
    rows = []
    for series in (track.pose, track.twist):
        row = np.searchsorted(series.time_ns, time_ns)
        if (row == len(series.time_ns)).any() or (series.time_ns[row] != time_ns).any():
            return []
        rows.append(row)
    return rows


def _attitude(track: Track, time_ns: Times) -> _Attitude:
    """Return attitude and rate at `time_ns`, which pose and twist both have."""
    assert track.pose is not None
    assert track.twist is not None
    at_pose, at_twist = _rows(track, time_ns)
    orientation = unit_rows(track.pose.values[at_pose, 3:])
    omega = track.twist.values[at_twist, 3:]
    if track.twist_in_world:
        omega = rotate_all_inverse(orientation, omega)
    return _Attitude(orientation, omega)
