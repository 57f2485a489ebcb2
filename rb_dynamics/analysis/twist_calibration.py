"""`fit_of_twist`: by how much a twist lags the pose, and by which factor and turn of axes it differs, from kinematics.

The change of the pose over a block of time is (1 + s) R(θ) W + b t, where W is the integral of the twist over the
block, shifted by the lag, R(θ) the rotation by θ, and b a constant error as gyros have. Gauss-Newton gives lag, s, θ
and b. Their standard errors come from the scatter between groups of blocks, so that they hold for noise that is not
white (Liang and Zeger, Biometrika 73 (1986) 13), and from the rounding of the twist, which scatters little where the
twist stays at one value.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.track import Array, Times, TimeSeries, in_blocks, parts
from rb_dynamics.numerics.growing_array import give_back, stored
from rb_dynamics.numerics.rotation import exp, log, multiply
from rb_dynamics.numerics.rotation_arrays import rotate_all, rotate_all_inverse
from rb_dynamics.numerics.vector import norm

# A value counts if it is this multiple of its standard error, which comes from few groups.
_SIGNIFICANT = 8.0
_GROUPS, _LEAST_IN_GROUP = 12, 2
# An instrument is this many samples of the twist away from its block, and correlates with it by at least this.
_AWAY, _FOLLOWS = 3.0, 0.9
# A twist that changes less than this fraction of itself determines neither lag nor factor.
_CHANGES = 1e-6
# The longest lag looked for: s, and as a fraction of the recording; and the number of lags tried on either side.
_LONGEST, _PART, _TRIED = 1.0, 0.1, 80
# A lag further away is taken only if it leaves less than this fraction of what is left by the nearest.
_BETTER = 0.5
_MOST_BLOCKS, _ITERATIONS = 20_000, 8
# Quadrature explains smaller differences than this, and than this fraction of the squared rotation between two samples.
_LEAST, _QUADRATURE = 2e-3, 0.5
# Directions in which the motion says nothing.
_SEEN = 1e-9
# Columns of the model: lag, s, θ and b; a simpler model is taken unless F is larger than this.
_MODELS = ((0, 1, 5, 6, 7), (1, 2, 3, 4, 5, 6, 7), tuple(range(8)))
_NEEDED = _SIGNIFICANT**2
# What may look like a lag, and like a factor: of a uniform acceleration a lag is a constant error, of a motion that
# dies out under drag it is a factor. What looks like turned axes is told apart by the models.
_LIKE = ([1, 5, 6, 7], [5, 6, 7])
# The twist contradicts the pose from these values on: factor and axes (rad). Sensors have smaller errors.
_FACTOR, _TURN = 0.05, 0.035
# A lag up to this many intervals of the twist may be how a program stamps.
_INTERVALS = 1.5
# A twist of so many steps of rounding, or more, is as good as not rounded; what counts as zero, relative to the twist.
_STEPS, _ZERO = 1000, 1e-5


@dataclass(frozen=True)
class TwistFit:
    """How a twist differs from the change of the pose; values that are not significant are 0.

    Attributes:
        lag_s: by how much the twist is stamped late, s.
        lag_error_s: its standard error.
        scale: factor of the twist relative to the change of the pose, minus 1.
        scale_error: its standard error.
        turned: rotation vector of the twist relative to the pose, rad.
        turn_error: standard error of the angle.
        large: whether the differences are beyond those of sensors and of programs that stamp half a step late.
        alike: whether turned axes would look the same as the lag, as they do for a steady precession.
    """

    lag_s: float = 0.0
    lag_error_s: float = 0.0
    scale: float = 0.0
    scale_error: float = 0.0
    turned: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn_error: float = 0.0
    large: bool = False
    alike: bool = False

    @property
    def turn(self) -> float:
        """The angle between the axes, rad."""
        return float(np.linalg.norm(self.turned))

    def corrected(self, twist: TimeSeries) -> TimeSeries:
        """Return the twist without these differences."""
        turn = np.array(exp(self.turned))
        values = stored(
            (
                np.hstack([rotate_all(turn, part) / (1.0 + self.scale) for part in np.hsplit(rows, 2)])
                for rows in in_blocks(twist.values)
            ),
            6,
        )
        return replace(twist, time_ns=twist.time_ns - round(self.lag_s * 1e9), values=values)

    @property
    def words(self) -> str:
        """The differences with their standard errors; "" if none is significant."""
        told = []
        if self.lag_s:
            lags = "lags behind" if self.lag_s > 0.0 else "is ahead of"
            told.append(f"{lags} the pose by {1e3 * abs(self.lag_s):.4g} ± {1e3 * self.lag_error_s:.2g} ms")
            told[-1] += " (or has turned axes: this motion does not show which)" * self.alike
        if self.scale:
            told.append(f"has {1.0 + self.scale:.5g} ± {self.scale_error:.2g} times its values")
        if self.turn:
            told.append(f"has axes turned by {np.rad2deg(self.turn):.4g} ± {np.rad2deg(self.turn_error):.2g}°")
        return "the twist " + " and ".join(told) if told else ""


def fit_of_twist(ends: Times, gone: Array, time_ns: Times, said: Array, turn: float) -> TwistFit:
    """Return how a twist differs from the change of the pose.

    Args:
        ends: (n,) times of the pose.
        gone: (n - 1, 3) its change in each interval, in the axes of the twist; NaN where it is not known.
        time_ns: (m,) times of the twist.
        said: (m, 3) the twist.
        turn: usual rotation between two samples, rad.
    """
    blocks = _Blocks.of(ends, gone, time_ns, said)
    merged = filter(None, (blocks.merged(1 << k) for k in range(2, 24)))
    found = [each for each in merged if len(each.gone) <= _MOST_BLOCKS]
    if not found:
        return TwistFit()
    nearest = found[-1].nearest()
    blocks = found[0]
    for model in _MODELS[:2]:
        fits = [(fit.errors[model[0]], each) for each in found if (fit := each.fit(nearest, model)) is not None]
        if fits:
            blocks = min(fits, key=lambda pair: pair[0])[1]
            break
    models = [fit for model in _MODELS if (fit := blocks.fit(nearest, model)) is not None]
    if not models:
        return TwistFit()
    fit = next(each for each in models if not each.lacks(models[-1]))
    alike = len(models) == len(_MODELS) and not any(each.lacks(models[-1]) for each in models[:2])
    values, errors = fit.values, fit.errors
    interval = float(np.median(np.diff(time_ns))) * 1e-9
    least = max(_LEAST, _QUADRATURE * turn**2)
    inverse = 1.0 + float(values[1])
    if inverse <= 0.0:
        return TwistFit()
    sizes = (float(values[0]), 1.0 / inverse - 1.0, float(np.linalg.norm(values[2:5])))
    spreads = (float(errors[0]), float(errors[1]) / inverse**2, float(np.linalg.norm(errors[2:5])))
    told = []
    for size, spread, floor in zip(sizes, spreads, (least * interval, least, least), strict=True):
        error = float(np.hypot(spread, floor / _SIGNIFICANT))
        told += [size if abs(size) > _SIGNIFICANT * error else 0.0, error]
    lag, lag_error, scale, scale_error, turned, turn_error = told
    large = abs(lag) > _INTERVALS * interval or abs(scale) > _FACTOR or turned > _TURN
    x, y, z = values[2:5].tolist() if turned else (0.0, 0.0, 0.0)
    return TwistFit(lag, lag_error, scale, scale_error, (x, y, z), turn_error, large, alike)


@dataclass(frozen=True)
class _Fit:
    """Lag, s, θ and b, and their standard errors; the sum of squares that remains, and that of the change; blocks.

    What quadrature explains counts as remaining.
    """

    values: Array
    errors: Array
    left: float
    spread: float
    count: int

    def lacks(self, other: _Fit) -> bool:
        """Return whether the `other`, of more columns, fits significantly better."""
        more = int(np.count_nonzero(other.errors)) - int(np.count_nonzero(self.errors))
        return more > 0 and self.left - other.left > _NEEDED * more * other.left / (3 * self.count)


@dataclass(frozen=True)
class _Blocks:
    """Blocks of time.

    Attributes:
        begin: start of each, s.
        end: its end.
        gone: (k, 3) change of the pose.
        at: (m,) times of the twist, s.
        said: (3, m) twist.
        sums: (3, m) its integral.
        unknown: the intervals whose change is not known, ascending.
        longest: longest lag, s.
        away: distance of the instruments from a block, s.
        step: of which all values of the twist are multiples; 0 if it is not rounded.
    """

    begin: Array
    end: Array
    gone: Array
    at: Array
    said: Array
    sums: Array
    unknown: NDArray[np.intp]
    longest: float
    away: float
    step: float

    @staticmethod
    def of(ends: Times, gone: Array, time_ns: Times, said: Array) -> _Blocks:
        start = time_ns[0]
        at, edges = (time_ns - start) * 1e-9, (ends - start) * 1e-9
        columns = np.empty((3, len(said)))
        for part, rows in zip(parts(len(said)), in_blocks(said), strict=True):
            columns[:, part] = rows.T
        steps, sums = np.diff(at), np.zeros((3, len(said)))
        for begin in parts(len(steps)):
            end = slice(begin.start + 1, begin.stop + 1)
            added = 0.5 * steps[begin] * (columns[:, end] + columns[:, begin])
            sums[:, end] = np.cumsum(np.hstack([sums[:, begin][:, :1], added]), axis=1)[:, 1:]
        longest = min(_LONGEST, _PART * float(at[-1] - at[0]))
        away = _AWAY * float(np.median(steps, overwrite_input=True))
        unknown = np.flatnonzero(np.concatenate([np.isnan(rows[:, 0]) for rows in in_blocks(gone)]))
        return _Blocks(edges[:-1], edges[1:], gone, at, columns, sums, unknown, longest, away, _step(said))

    def merged(self, size: int) -> _Blocks | None:
        """Return blocks of `size` intervals that are known, lags included; None for too few."""
        count = len(self.gone) // size
        if count < _GROUPS * _LEAST_IN_GROUP:
            return None
        begin, end = self.begin[: count * size : size], self.end[size - 1 : count * size : size]
        gone = np.concatenate([rows.reshape(-1, size, 3).sum(axis=1) for rows in self._in_blocks(count, size)])
        beside = self.longest + self.away + 0.5 * (end - begin)
        first = np.searchsorted(self.end, begin - beside, side="right")
        last = np.searchsorted(self.begin, end + beside, side="left")
        kept = np.searchsorted(self.unknown, last) == np.searchsorted(self.unknown, first)
        kept &= np.isfinite(gone).all(axis=1)
        kept &= (begin - beside >= self.at[0]) & (end + beside <= self.at[-1])
        if int(kept.sum()) < _GROUPS * _LEAST_IN_GROUP:
            return None
        return replace(self, begin=begin[kept], end=end[kept], gone=gone[kept])

    def _in_blocks(self, count: int, size: int) -> Iterator[Array]:
        """Yield the changes of `count` times `size` intervals, in blocks of whole multiples of `size`."""
        for part in parts(count * size, size):
            yield self.gone[part]
            give_back(self.gone)

    def fit(self, lag: float, model: tuple[int, ...]) -> _Fit | None:
        """Return the fit of these columns, from about this `lag` on; None if there is none."""
        lag = lag if 0 in model else 0.0
        here = there = 1.0, (0.0, 0.0, 0.0, 1.0)
        for _ in range(_ITERATIONS):
            found = self._linear(lag, here[0], np.array(here[1]), list(model))
            found.errors[1] *= abs(here[0])
            lag = float(np.clip(lag + found.values[0], -self.longest, self.longest))
            x, y, z = found.values[2:5].tolist()
            there = here[0] * (1.0 + float(found.values[1])), multiply(exp((x, y, z)), here[1])
            # A turn that is not known, as about a straight path, would lead ever farther away.
            far = norm((x, y, z)) > max(_LEAST, _SIGNIFICANT * float(np.linalg.norm(found.errors[2:5])))
            if not far and abs(found.values[0]) <= 0.01 * found.errors[0]:
                break
            here = there if far else here
        if abs(lag) >= self.longest or found.left > _BETTER * found.spread:
            return None
        found.values[:5] = lag, there[0] - 1.0, *log(there[1])
        return found

    def nearest(self) -> float:
        """Return the lag nearest to zero at which the twist has about the shape of the motion."""
        lags = self.longest / _TRIED * np.arange(-_TRIED, _TRIED + 1)
        gone = self.gone - self.gone.mean(axis=0)
        left = np.empty(len(lags))
        for k, lag in enumerate(lags):
            moved = self._moved(self.begin + lag, self.end + lag)
            moved -= moved.mean(axis=0)
            size = float(np.sum(moved**2))
            left[k] = np.sum(gone**2) - (float(np.sum(moved * gone)) ** 2 / size if size > 0.0 else 0.0)
        lowest = np.flatnonzero(np.r_[True, left[1:] <= left[:-1]] & np.r_[left[:-1] <= left[1:], True])
        good = lowest[left[lowest] <= max(float(left.min()), _SEEN * float(np.sum(gone**2))) / _BETTER]
        return float(lags[good[np.abs(lags[good]).argmin()]])

    def _moved(self, begin: Array, end: Array) -> Array:
        """Return the integral of the twist over times."""
        return self._at(self.sums, end) - self._at(self.sums, begin)

    def _at(self, rows: Array, times: Array) -> Array:
        return np.stack([np.interp(times, self.at, column) for column in rows], axis=1)

    def _linear(self, lag: float, factor: float, turn: Array, kept: list[int]) -> _Fit:
        """Return the change of these columns, from a `lag`, a `factor` and a `turn` (quaternion) of the twist on.

        The noise of the twist is in the model, too, and would bias least squares. What the twist says shortly before
        and after a block, whose noise is independent, therefore serves as instrument.
        """
        begin, end = self.begin + lag, self.end + lag
        apart, seconds, count = self.away, end - begin, len(begin)
        length, told = 0.5 * seconds, self._moved(begin, end)
        moved, slope, before, after = (
            factor * rotate_all(turn, rows)
            for rows in (
                told,
                self._at(self.said, end) - self._at(self.said, begin),
                self._moved(begin - apart - length, begin - apart),
                self._moved(end + apart, end + apart + length),
            )
        )
        columns = _columns(slope, moved, seconds)
        beside_columns = _columns((after - before) / seconds[:, None], before + after, seconds)
        model, beside = columns[:, kept], beside_columns[:, kept]
        wanted = (self.gone - moved).ravel()
        values, errors, spread = np.zeros(8), np.zeros(8), float(np.sum((self.gone - self.gone.mean(axis=0)) ** 2))
        size = np.linalg.norm(beside, axis=0)
        for column in sorted({0, 1} & set(kept)):
            # Whatever else gives the same change may be the cause in its place.
            part, other = (_besides(every, column, _LIKE[column]) for every in (columns, beside_columns))
            own, follows = float(np.linalg.norm(part)), float(part @ other)
            least = _CHANGES * float(np.linalg.norm(columns[:, 1]))
            if not own > least or follows < _FOLLOWS * own * float(np.linalg.norm(other)):
                return _Fit(values, errors, np.inf, spread, count)
        size[size == 0.0] = 1.0
        model, beside = model / size, beside / size
        inverse = np.linalg.pinv(beside.T @ model, rcond=_SEEN)
        best = inverse @ (beside.T @ wanted)
        left = wanted - model @ best
        scores = (beside * left[:, None]).reshape(count, 3, -1).sum(axis=1)
        groups = np.add.reduceat(scores, np.arange(_GROUPS) * count // _GROUPS, axis=0)
        scatter = inverse @ (groups.T @ groups) @ inverse.T * _GROUPS / (_GROUPS - 1.0)
        effect = factor * rotate_all_inverse(turn, (inverse @ beside.T).reshape(-1, count, 3))
        rounding = self._rounding(told / seconds[:, None], seconds, effect)
        variances = np.maximum(np.diag(scatter), 0.0) + rounding
        values[kept], errors[kept] = best / size, np.sqrt(variances) / size
        return _Fit(values, errors, float(left @ left) + (_LEAST * float(np.linalg.norm(moved))) ** 2, spread, count)

    def _rounding(self, mean: Array, seconds: Array, effect: Array) -> Array:
        """Return the variances by the rounding of a twist of this `mean` in each block, of the `effect` of changes.

        Blocks in which an axis has the same value share its error.
        """
        found = np.zeros(len(effect))
        if self.step:
            levels = np.rint(mean / self.step).astype(np.intp)
            shares = effect * seconds[:, None]
            for axis, column in enumerate((levels - levels.min(axis=0)).T):
                found += [float(np.sum(np.bincount(column, share) ** 2)) for share in shares[:, :, axis]]
        return found * self.step**2 / 12.0


def _step(said: Array) -> float:
    """Return the largest number of which all values are multiples, by Euclid's algorithm; 0 if none is large enough."""
    largest = max(float(np.abs(rows).max(initial=0.0)) for rows in in_blocks(said))
    zero, values = _ZERO * largest, np.zeros(1)
    for rows in in_blocks(said):
        values = np.union1d(values, np.abs(rows))
        if len(values) > _STEPS:
            return 0.0
    step = 0.0
    for value in values:
        rest = float(value)
        while rest > zero:
            step, rest = rest, abs(step - rest * round(step / rest))
        if step and step * _STEPS < largest:
            return 0.0
    return step


def _besides(columns: Array, column: int, others: list[int]) -> Array:
    """Return what the `others` do not give of a column."""
    sizes = np.linalg.norm(columns, axis=0)
    scaled = columns / np.where(sizes > 0.0, sizes, 1.0)
    rest: Array = columns[:, column] - scaled[:, others] @ np.linalg.lstsq(scaled[:, others], columns[:, column])[0]
    return rest


def _columns(slope: Array, moved: Array, seconds: Array) -> Array:
    """Return the (3 n, 8) effects of lag, s, θ and b on n blocks."""
    columns = np.zeros((len(moved), 3, 8))
    columns[:, :, 0], columns[:, :, 1] = slope, moved
    for k, axis in enumerate(np.eye(3)):
        columns[:, :, 2 + k] = np.cross(axis, moved)
        columns[:, k, 5 + k] = seconds
    return columns.reshape(-1, 8)
