"""Fit the parameters of a `Model`: least squares from several starts over a growing horizon, and what they determine.

A flight over many turns has many minima. Over its first turn it has few: each start is fitted there first, then over
longer and longer pieces. Where a longer piece loses the motion, as near a middle axis, a piece goes only as far as the
fit to the one before foresees it. Each sensor is weighted by its own noise, which the fit estimates along the way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from rb_dynamics.analysis.identification import rotations
from rb_dynamics.analysis.identification.first_guess import first_guess
from rb_dynamics.analysis.identification.flights import ATTITUDE, Flight, Stream
from rb_dynamics.analysis.identification.prediction import Model, Predicted
from rb_dynamics.analysis.track import Array
from rb_dynamics.errors import LogError
from rb_dynamics.motion.fixed_step_kernel import Tally, counted_by

LOSSES = ("linear", "soft_l1", "huber", "cauchy")

Key = tuple[str, str]

# Plausible values lie within this many units of a parameter. It keeps what no measurement determines at its start, and
# hardly changes what is determined.
_FAR = 30.0
# rad turned in the first piece of a flight, and how much longer each piece is than the one before.
_FIRST_PIECE = 3.0
_LONGER = 3.0
# Of the motion, or times the noise, what a prediction may be off: a fit from one that is off by more may go astray.
_ASTRAY, _ASTRAY_IN_NOISE = 0.2, 10.0
# rad by which a piece grows at least where it must be short, and how many flights all such pieces may add up to.
_SHORTEST, _PATIENCE = 0.5, 10.0
# Two fits are the same minimum if their costs differ by this fraction.
_SAME = 1e-3
_COARSE = 1e-3
# Logarithm of a factor between the size of a body in the scene and the one that balances of momentum give roughly.
_OTHER_SIZE = 2.0
# Of the misfit of the scene, what that of the balances is at most if they are nearer.
_NEARER = 0.1
# Of its scale: no recording is believed to be more exact than that, not even one of a simulation without noise.
_FLOOR = 1e-6
# Residuals up to this many times the noise leave nothing to look for.
_ENOUGH = 1.3
_ITERATIONS = 80
# Of the cost: a gain that its rounding may hide.
_ROUNDING = 1e-11
# Of the noise: a larger one is not that of a moving body.
_RUNAWAY = 1e12
# Of the noise, what the error of the steps may be.
_STEPS = 0.05
_SMALLEST_TURN = 2e-3
# Of a matrix that are decomposed at a time: no large one is copied.
_ROWS = 1 << 14


class Fit(NamedTuple):
    """The outcome of `fitted`.

    Attributes:
        z: parameters.
        noise: standard deviation of one component of a sample, by topic and kind.
        predicted: what is left of each stream; without derivatives.
        weighted: (n, p), derivatives over noise.
        left: (n,), residuals over noise.
        starts: fits that were tried.
        agreeing: how many of them found the best minimum.
        converged: whether the best one converged.
    """

    z: Array
    noise: dict[Key, float]
    predicted: list[Predicted]
    weighted: Array
    left: Array
    starts: int
    agreeing: int
    converged: bool


@dataclass
class _Progress:
    """Reports the progress of a fit, 0 to 1."""

    tell: Callable[[float], None] | None
    total: int
    done: int = 0

    def step(self) -> None:
        self.done += 1
        if self.tell is not None:
            self.tell(min(1.0, self.done / self.total))


def fitted(model: Model, starts: int, loss: str, seed: int, progress: Callable[[float], None] | None = None) -> Fit:
    """Return the best fit of several starts."""
    # A fit waits for its kernel: without it each flight takes a hundred times as long.
    with counted_by(Tally()):
        return _best(model, starts, loss, seed, progress)


def _best(model: Model, starts: int, loss: str, seed: int, progress: Callable[[float], None] | None) -> Fit:
    noise = noise_shown(model)
    pieces = _pieces(model)
    tries = _starts(model, starts, noise, _ends(model, pieces[0]), seed)
    bar = _Progress(progress, len(tries) * len(pieces) + 2)
    # A search need not be more exact than that, and a recording without noise would keep it long.
    coarse = {key: max(level, _COARSE * _largest(model, key)) for key, level in noise.items()}
    found: list[tuple[Any, Any]] = []
    for start in tries:
        at, longest, reached = start, None, 0.0
        for piece in pieces[:-1]:
            longest, reached = _longer(model, at, coarse, loss, reached, piece)
            at = longest.x
            bar.step()
        # A start that comes to the minimum of another in the longest piece would go on like that.
        whole = next((each for other, each in found if _same_minimum(other, longest)), None)
        if whole is None:
            whole, _ = _longer(model, at, coarse, loss, reached, np.inf)
            if coarse != noise:
                whole = _least_squares(model, whole.x, noise, loss, None)
        bar.step()
        found.append((longest, whole))
        # A fit that leaves only noise is the minimum: no other start can improve it.
        if _explained(model, whole.x, noise):
            break
    costs = np.array([whole.cost for _, whole in found])
    best = found[int(costs.argmin())][1]
    agreeing = int((costs <= costs.min() * (1.0 + _SAME) + 1.0).sum())
    found_fit = settled(model, best.x, noise, loss, bool(best.status > 0))
    bar.step()
    return found_fit._replace(starts=len(found), agreeing=agreeing)


def starts_of(model: Model, noise: dict[Key, float]) -> list[Array]:
    """Return the parameters of the scene and those of `first_guess`; what is nearer to the motion comes first."""
    pieces = _pieces(model)
    return _starts(model, 1 + ("shape" in model.layout), noise, _ends(model, pieces[0]), 0)


def followed(model: Model, z: Array, noise: dict[Key, float]) -> Array:
    """Return the parameters of the fit from one start, with this noise."""
    reached = 0.0
    for piece in _pieces(model):
        found, reached = _longer(model, z, noise, "linear", reached, piece)
        z = found.x
    return z


def _longer(
    model: Model, z: Array, noise: dict[Key, float], loss: str, reached: float, piece: float
) -> tuple[Any, float]:
    """Return the fit to a piece and, if that leaves only noise, its length; else 0.

    `reached` is that of the fit `z`. If from there the motion is lost, the piece grows in steps that are foreseen.
    """
    found = _least_squares(model, z, noise, loss, _ends(model, piece))
    if _leaves_noise(model, found, piece):
        return found, piece
    whole = max(_angles(model))
    last = min(piece, whole)
    patience = _PATIENCE * whole
    end = _foreseen(model, z, noise, reached, piece) if reached else last
    # What is foreseen is not lost: the model does not explain it.
    while end < last and patience > 0.0:
        nearer = _least_squares(model, z, noise, loss, _ends(model, end))
        patience -= end
        if _leaves_noise(model, nearer, end):
            z, reached = nearer.x, end
            end = min(_foreseen(model, z, noise, reached, piece), _LONGER * reached)
            if end >= last:
                again = _least_squares(model, z, noise, loss, _ends(model, piece))
                if _leaves_noise(model, again, piece):
                    return again, piece
                found = min(found, again, key=lambda each: float(each.cost))
                break
        else:
            end = 0.5 * (reached + end)
            if end - reached < _SHORTEST:
                break
    return found, 0.0


def _leaves_noise(model: Model, fit: Any, piece: float) -> bool:
    """Return whether the cost of a search of a piece is about that of noise; see `_against_plausible`."""
    ends = _ends(model, piece)
    flights = model.flights if ends is None else [f.until(end) for f, end in zip(model.flights, ends, strict=True)]
    count = 3 * sum(len(stream.time_ns) for flight in flights for stream in flight.streams)
    return bool(2.0 * fit.cost <= (1.0 + _ENOUGH**2) * count + len(fit.x))


def _foreseen(model: Model, z: Array, noise: dict[Key, float], reached: float, piece: float) -> float:
    """Return how far (rad turned) parameters predict the motion from `reached` on: so far at least, `piece` at most."""
    least = reached + 2.0 * _SHORTEST
    found = piece
    for each in model.predict(z, _ends(model, piece), derivatives=False):
        start, first = model.starts[each.flight], model.flights[each.flight].span_ns[0]
        angles = start.fastest * 1e-9 * (each.time_ns - first)
        new = angles > reached
        squares = np.cumsum(np.nan_to_num(np.mean(each.left[new] ** 2, axis=1), nan=np.inf))
        most = min(_ASTRAY * _largest(model, each.key), _ASTRAY_IN_NOISE * noise[each.key])
        off = squares > most**2 * np.arange(1, len(squares) + 1)
        if off.any():
            found = min(found, float(angles[new][int(off.argmax())]))
    return max(found, least)


def _same_minimum(one: Any, other: Any) -> bool:
    """Return whether two searches of a piece came to one minimum: by its derivatives, the cost hardly changes between.

    Not without a piece.
    """
    if one is None or other is None:
        return False
    step = other.x - one.x
    return all(0.5 * float(np.sum((each.jac @ step) ** 2)) <= _SAME * each.cost for each in (one, other))


def settled(model: Model, z: Array, noise: dict[Key, float], loss: str, converged: bool = True) -> Fit:
    """Return the fit near parameters, with the noise of each sensor and the steps that it takes.

    Raises:
        LogError: the motion diverges.
    """
    predicted = _of_a_motion(model, z, noise)
    for _ in range(6):
        before = dict(noise)
        noise = _estimated(model, predicted, noise, loss)
        steady = all(abs(noise[key] / before[key] - 1.0) < 0.01 for key in noise)
        finer = _refine(model, z, noise, predicted)
        if steady and not finer:
            break
        again = _least_squares(model, z, noise, loss, None)
        z, converged = again.x, bool(again.status > 0)
        predicted = _of_a_motion(model, z, noise)
    left, weighted = stacked(predicted, noise)
    return Fit(z, noise, [each.without_derivatives() for each in predicted], weighted, left, 1, 1, converged)


def _explained(model: Model, z: Array, noise: dict[Key, float]) -> bool:
    """Return whether what is left of each stream is about the noise that its differences show."""
    return all(
        float(np.sqrt(np.mean(p.left**2))) <= _ENOUGH * noise[p.key] for p in model.predict(z, derivatives=False)
    )


def _streams(model: Model) -> dict[Key, list[Stream]]:
    found: dict[Key, list[Stream]] = {}
    for flight in model.flights:
        for stream in flight.streams:
            if len(stream.time_ns):
                found.setdefault((stream.topic, stream.kind), []).append(stream)
    return found


def _noise_of(streams: Sequence[Stream]) -> float:
    """Return the noise that third differences show, which neither smooth motion nor a few wild samples change much."""
    every = np.abs(np.concatenate([_third_differences(stream).ravel() for stream in streams]))
    if not len(every):
        return 0.0
    # Of a coarse sensor most differences may be zero.
    usual = 1.4826 * float(np.median(every)) or float(np.sqrt(np.mean(every**2)))
    return usual / float(np.sqrt(20.0))


def _third_differences(stream: Stream) -> Array:
    values = stream.values
    if stream.kind == ATTITUDE:
        steps = rotations.logarithms(rotations.products(rotations.conjugates(values[:-1]), values[1:]))
        return np.diff(steps, n=2, axis=0)
    return np.diff(values, n=3, axis=0)


def _angles(model: Model) -> list[float]:
    """Return by how much (rad) the body turns in each flight, about."""
    spans = [flight.span_ns for flight in model.flights]
    return [start.fastest * (last - first) * 1e-9 for start, (first, last) in zip(model.starts, spans, strict=True)]


def _pieces(model: Model) -> list[float]:
    """Return the lengths (rad turned) of ever longer pieces of the flights; the last one is infinite, the whole."""
    found, angle = [], _FIRST_PIECE
    while angle < 0.7 * max(_angles(model)):
        found.append(angle)
        angle *= _LONGER
    return [*found, np.inf]


def _ends(model: Model, piece: float) -> list[int] | None:
    """Return the ends (ns) of a piece of each flight; None of the whole."""
    if np.isinf(piece):
        return None
    return [
        min(flight.span_ns[1], max(_twelfth(flight, 12), flight.span_ns[0] + round(1e9 * piece / start.fastest)))
        for flight, start in zip(model.flights, model.starts, strict=True)
    ]


def _twelfth(flight: Flight, count: int) -> int:
    """Return the time (ns) at which the fastest stream has this many samples: fewer are not enough."""
    return min(int(s.time_ns[min(count, len(s.time_ns)) - 1]) for s in flight.streams if len(s.time_ns))


def _starts(model: Model, count: int, noise: dict[Key, float], until: Sequence[int] | None, seed: int) -> list[Array]:
    """Return parameters to start from: the scene's, those of `first_guess`, and other shapes of the body.

    Where the two disagree on the size of the body and the guess is nearer to the motion, it comes first.
    """
    scene, guess = np.zeros(model.layout.count), first_guess(model)
    sizes = [model.layout[name].at for name in ("size", "mass") if name in model.layout]
    found, near = [scene], scene
    if guess is not None:
        far = any(abs(float(guess[at][0])) > _OTHER_SIZE for at in sizes)
        if far and _misfit(model, guess, noise, until) < _NEARER * _misfit(model, scene, noise, until):
            found, near = [guess, scene], guess
        else:
            found = [scene, guess]
    random = np.random.default_rng(seed)
    while "shape" in model.layout and len(found) < count:
        other = scene.copy()
        for at in sizes:
            other[at] = near[at]
        other[model.layout["shape"].at] = random.normal(0.0, 0.5, 5)
        found.append(other)
    return found[:count]


def _misfit(model: Model, z: Array, noise: dict[Key, float], until: Sequence[int] | None) -> float:
    """Return the sum of squares that parameters leave; infinite if the motion diverges."""
    left, _ = stacked(list(model.predict(z, until, derivatives=False)), noise)
    return float(left @ left) if sane(left) else np.inf


def _least_squares(model: Model, z: Array, noise: dict[Key, float], loss: str, until: Sequence[int] | None) -> Any:
    from scipy.optimize import OptimizeResult, least_squares

    cache: dict[bytes, tuple[Array, Array]] = {}
    least = np.inf

    def both(at: Array) -> tuple[Array, Array]:
        nonlocal least
        name = at.tobytes()
        if name not in cache:
            cache.clear()
            cache[name] = left, by = _against_plausible(model, at, noise, loss, until)
            if loss == "linear":
                cost = 0.5 * float(left @ left)
                gain = 0.5 * float(np.sum((by @ np.linalg.lstsq(by, -left, rcond=None)[0]) ** 2))
                # Nothing that the cost could show: a search would end only when its steps are too short.
                if cost <= least and gain < _ROUNDING * cost:
                    raise _AtRest(OptimizeResult(x=at.copy(), cost=cost, jac=by, status=1))
                least = min(least, cost)
        return cache[name]

    try:
        return least_squares(
            lambda at: both(at)[0],
            z,
            jac=lambda at: both(at)[1],
            loss=loss,
            xtol=1e-12,
            ftol=1e-7 if until is None else 1e-3,
            gtol=1e-12,
            max_nfev=_ITERATIONS if until is None else 20,
        )
    except _AtRest as end:
        return end.result


class _AtRest(Exception):  # noqa: N818 - no error
    """A search has come to its minimum."""

    def __init__(self, result: Any) -> None:
        super().__init__()
        self.result = result


def _against_plausible(
    model: Model, z: Array, noise: dict[Key, float], loss: str, until: Sequence[int] | None
) -> tuple[Array, Array]:
    """Return residuals over noise, followed by parameters over what is plausible, and the derivatives of both.

    With linear loss these are Q^T of both: the same cost and the same step, from as few rows as there are parameters.
    """
    count = len(z)
    # As much as noise leaves, a constant: an improvement counts against it, also where nothing is left.
    rows = [np.column_stack([np.eye(count) / _FAR, z / _FAR])]
    samples = 0
    for block in model.blocks(z, until):
        left, by = stacked(block, noise)
        # If the motion diverges, the squares of its numbers are not finite.
        if not sane(left, by):
            left = np.nan_to_num(np.clip(left, -_RUNAWAY, _RUNAWAY), nan=_RUNAWAY)
            by = np.nan_to_num(np.clip(by, -_RUNAWAY, _RUNAWAY), nan=0.0)
        samples += len(left)
        both = np.column_stack([by, left])
        rows.append(triangle(both) if loss == "linear" else both)
    rows.append(np.append(np.zeros(count), np.sqrt(samples))[None])
    every = np.vstack(rows)
    if loss == "linear":
        every = triangle(every)
    return every[:, -1], every[:, :-1]


def triangle(matrix: Array) -> Array:
    """Return R of the QR decomposition, block by block: with small matrices LAPACK does not wait for threads."""
    count, columns = matrix.shape
    if count > _ROWS > columns:
        return triangle(np.vstack([triangle(matrix[row : row + _ROWS]) for row in range(0, count, _ROWS)]))
    block = 4 * columns
    while len(matrix) > 2 * block:
        padded = np.vstack([matrix, np.zeros((-len(matrix) % block, columns))])
        matrix = np.asarray(np.linalg.qr(padded.reshape(-1, block, columns), mode="r")).reshape(-1, columns)
    return np.asarray(np.linalg.qr(matrix, mode="r"), dtype=np.float64)


def information(by: Array) -> Array:
    """Return J^T J of derivatives over noise."""
    root = triangle(by)
    found: Array = root.T @ root
    return found


def stacked(predicted: Sequence[Predicted], noise: dict[Key, float]) -> tuple[Array, Array]:
    """Return residuals (n,) and derivatives (n, p) of all streams over noise, one below the other."""
    left = [each.left.ravel() / noise[each.key] for each in predicted]
    by = [each.by.reshape(each.left.size, each.by.shape[2]) / noise[each.key] for each in predicted]
    return np.concatenate(left), np.vstack(by)


def _of_a_motion(model: Model, z: Array, noise: dict[Key, float]) -> list[Predicted]:
    """Return what the streams should have measured.

    Raises:
        LogError: the motion has diverged.
    """
    predicted = list(model.predict(z))
    if not all(sane(each.left, each.by, unit=noise[each.key]) for each in predicted):
        raise LogError(
            f"{', '.join(flight.name for flight in model.flights)}: found no motion that follows the recording, "
            "expected one near that of the scene; correct body.inertia in the scene, which must be of the right order, "
            "or try more starts"
        )
    return predicted


def sane(*parts: Array, unit: float = 1.0) -> bool:
    """Return whether residuals and derivatives, in units of the noise, are finite and have not diverged."""
    largest = (max(float(each.max(initial=0.0)), -float(each.min(initial=0.0))) for each in parts)
    return all(each < _RUNAWAY * unit for each in largest)


def _estimated(model: Model, predicted: Sequence[Predicted], noise: dict[Key, float], loss: str) -> dict[Key, float]:
    """Return the noise of each sensor that the residuals show, with the degrees of freedom that the fit took."""
    told = [information(each.by.reshape(-1, each.by.shape[2])) / noise[each.key] ** 2 for each in predicted]
    covariance = np.linalg.inv(sum(told) + np.eye(len(told[0])) / _FAR**2)
    taken: dict[Key, list[float]] = {}
    for each, mine in zip(predicted, told, strict=True):
        total = taken.setdefault(each.key, [0.0, 0.0, 0.0])
        total[0] += float(np.sum(each.left**2))
        total[1] += each.left.size - float(np.sum(mine * covariance))
        total[2] = max(total[2], 1.4826 * float(np.median(np.abs(each.left))))
    found = {}
    for key, (squares, freedom, typical) in taken.items():
        level = np.sqrt(squares / max(freedom, 1.0)) if loss == "linear" else typical
        found[key] = max(float(level), floor_of(model, key))
    return found


def noise_shown(model: Model) -> dict[Key, float]:
    """Return the noise of each sensor that its own differences show, whatever the model."""
    return {key: max(_noise_of(streams), floor_of(model, key)) for key, streams in _streams(model).items()}


def floor_of(model: Model, key: Key) -> float:
    """Return the least noise that a sensor is believed to have."""
    return _FLOOR * _largest(model, key)


def _largest(model: Model, key: Key) -> float:
    """Return the largest number of a sensor, 1 rad of an attitude."""
    sizes = [1.0 if s.kind == ATTITUDE else float(np.abs(s.values).max(initial=0.0)) for s in _streams(model)[key]]
    return max(*sizes, 1e-9)


def _refine(model: Model, z: Array, noise: dict[Key, float], predicted: Sequence[Predicted]) -> bool:
    """Halve the steps where their error counts against the noise; return whether that was so.

    `predicted` is what was predicted with the steps so far.
    """
    if model.turn <= _SMALLEST_TURN:
        return False
    kept = model.turn
    model.turn = 0.5 * kept
    finer = model.predict(z, derivatives=False)
    worst = max(
        float(np.sqrt(np.mean((fine.left - each.left) ** 2))) / noise[fine.key]
        for fine, each in zip(finer, predicted, strict=True)
    )
    if worst <= _STEPS:
        model.turn = kept
        return False
    # The error goes with the fourth power of the step.
    model.turn = max(_SMALLEST_TURN, kept * min(0.5, (_STEPS / worst) ** 0.25))
    return True
