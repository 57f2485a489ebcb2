"""Fit the parameters of a `Model`: least squares from several starts over a growing horizon, and what they determine.

A flight over many turns has many minima. Over its first turn it has few: each start is fitted there first, then over
longer and longer pieces. Where a longer piece loses the motion, as near a middle axis, a piece goes only as far as the
fit to the one before foresees it. Each sensor is weighted by its own noise, which the fit estimates along the way.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rb_dynamics.analysis.identification.first_guess import first_guess
from rb_dynamics.analysis.identification.flights import Flight
from rb_dynamics.analysis.identification.measurement_model import Model, Predicted
from rb_dynamics.analysis.identification.multiple_shooting import joined
from rb_dynamics.analysis.identification.residuals import MOST, Fit, fit_bands, level, residuals_of
from rb_dynamics.analysis.identification.sensor_noise import Key, floor_of, largest, noise_shown
from rb_dynamics.analysis.identification.stacked_rows import sane, stacked, tame, triangle
from rb_dynamics.analysis.track import Array
from rb_dynamics.errors import LogError
from rb_dynamics.motion.fixed_step_kernel import Tally, counted_by

LOSSES = ("linear", "soft_l1", "huber", "cauchy")

# Plausible values lie within this many units of a parameter. It keeps what no measurement determines at its start, and
# hardly changes what is determined.
_FAR = 30.0
# rad turned in the first piece of a flight, and how much longer each piece is than the one before.
_FIRST_PIECE = 3.0
_LONGER = 3.0
# rad turned beyond which a search may lose the motion on its way from a piece to the whole.
_LONG = 300.0
# Two fits are the same minimum if their costs differ by this fraction.
_SAME = 1e-3
_COARSE = 1e-3
# Logarithm of a factor between the size of a body in the scene and the one that balances of momentum give roughly.
_OTHER_SIZE = 2.0
# Of the misfit of the scene, what that of the balances is at most if they are nearer.
_NEARER = 0.1
# Residuals up to this many times the noise leave nothing to look for.
_ENOUGH = 1.3
_ITERATIONS = 80
# Of the cost: a gain that its rounding may hide.
_ROUNDING = 1e-11
# Of the noise, what the error of the steps may be.
_STEPS = 0.05
_SMALLEST_TURN = 2e-3
# Of the mean second derivative of a loss.
_LEAST_BEND = 1e-3
# Degrees of freedom from which on a sensor has a noise of its own in each flight.
_ALONE = 30.0


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
    coarse = {key: max(level, _COARSE * largest(model, key)) for key, level in noise.items()}
    found: list[tuple[Any, Any]] = []
    shot: Fit | None = None
    for start in tries:
        at, longest, follows = start, None, start
        for piece in pieces[:-1]:
            longest = _least_squares(model, at, coarse, loss, _ends(model, piece))
            at = longest.x
            follows = at if _leaves_noise(model, longest, piece) else follows
            bar.step()
        if shot is None and follows is not at:
            # Beyond what a start can follow, the segments are joined: if they can be, no other start is needed.
            others = [each for each in tries if not np.array_equal(each, follows)]
            shot = joined(model, [follows, *others], noise, _FAR)
            if shot is not None and (fit := _from_one_start(model, shot, noise, loss)) is not None:
                return fit
        # A start that comes to the minimum of another in the longest piece would go on like that.
        whole = next((each for other, each in found if _same_minimum(other, longest)), None)
        if whole is None:
            whole = _least_squares(model, at, coarse, loss, None)
            if coarse != noise:
                whole = _least_squares(model, whole.x, noise, loss, None)
        bar.step()
        found.append((longest, whole))
        # A fit that has come to rest and leaves only noise is the minimum: no other start can improve it.
        if whole.status > 0 and _explained(model, whole.x, noise, loss):
            break
    costs = np.array([whole.cost for _, whole in found])
    best = found[int(costs.argmin())][1]
    agreeing = int((costs <= costs.min() * (1.0 + _SAME) + 1.0).sum())
    try:
        fit = settled(model, best.x, noise, loss, bool(best.status > 0))
    except LogError:
        if shot is None:
            raise
        fit = shot
    # Of a robust loss, what is left may hold outliers, which the joined segments of least squares would follow.
    if not (_only_noise(model, fit) or (loss != "linear" and fit.converged and _explained(model, fit.z, noise, loss))):
        shot = shot or joined(model, [best.x, *tries], noise, _FAR)
        if shot is not None:
            fit = _from_one_start(model, shot, noise, loss) or fit._replace(joined=None if fit is shot else shot)
    bar.step()
    return fit._replace(starts=len(found), agreeing=agreeing)


def _from_one_start(model: Model, shot: Fit, noise: dict[Key, float], loss: str) -> Fit | None:
    """Return the fit that segments without gaps lead to; None if there are gaps, or more than noise is left.

    Where errors grow so fast that the numbers of a start have too few digits to fly on from, it is that of segments.
    """
    if shot.disturbance or not _only_noise(model, shot):
        return None
    if _explained(model, shot.z, noise, loss):
        fit = settled(model, shot.z, noise, loss)
        if _only_noise(model, fit):
            return fit
    return shot


def _only_noise(model: Model, fit: Fit) -> bool:
    return fit.converged and all(each.only_noise for each in residuals_of(model, fit, fit_bands(fit)))


def starts_of(model: Model, noise: dict[Key, float]) -> list[Array]:
    """Return the parameters of the scene and those of `first_guess`; what is nearer to the motion comes first."""
    pieces = _pieces(model)
    return _starts(model, 1 + ("shape" in model.layout), noise, _ends(model, pieces[0]), 0)


def followed(model: Model, z: Array, noise: dict[Key, float]) -> Array:
    """Return the parameters of the fit from one start, with this noise."""
    for piece in _pieces(model):
        z = _least_squares(model, z, noise, "linear", _ends(model, piece)).x
    return z


def _leaves_noise(model: Model, fit: Any, piece: float) -> bool:
    """Return whether the cost of a search of a piece is about that of noise; see `_against_plausible`."""
    ends = _ends(model, piece)
    flights = model.flights if ends is None else [f.until(end) for f, end in zip(model.flights, ends, strict=True)]
    count = 3 * sum(len(stream.time_ns) for flight in flights for stream in flight.streams)
    return bool(2.0 * fit.cost <= (1.0 + _ENOUGH**2) * count + len(fit.x))


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
    robust = None
    if loss != "linear":
        errors = _of_errors(predicted, noise, loss)
        weighted, robust = stacked(predicted, errors)[1], _likelihood(predicted, noise, errors, loss)
    kept = [each.without_derivatives() for each in predicted]
    return Fit(z, noise, kept, weighted, left, 1, 1, converged, robust=robust)


def _explained(model: Model, z: Array, noise: dict[Key, float], loss: str) -> bool:
    """Return whether what is left of each stream is about the noise that its differences show.

    Of a robust loss, nearly a third may be outliers; by the median, a motion that fits half of the samples would do.
    """
    return all(
        level(p.left, loss != "linear", MOST) <= _ENOUGH * noise[p.key] for p in model.predict(z, derivatives=False)
    )


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
        left, by = tame(*stacked(block, noise))
        samples += len(left)
        both = np.column_stack([by, left])
        rows.append(triangle(both) if loss == "linear" else both)
    rows.append(np.append(np.zeros(count), np.sqrt(samples))[None])
    every = np.vstack(rows)
    if loss == "linear":
        every = triangle(every)
    return every[:, -1], every[:, :-1]


def _of_a_motion(model: Model, z: Array, noise: dict[Key, float]) -> list[Predicted]:
    """Return what the streams should have measured.

    Raises:
        LogError: the motion has diverged.
    """
    predicted = list(model.predict(z))
    if not all(sane(each.left, each.by, unit=noise[each.key]) for each in predicted):
        turned = max(_angles(model))
        shorter = (
            f", or give a part of it (convert --to): the body turns by some {turned:.0f} rad" if turned > _LONG else ""
        )
        raise LogError(
            f"{', '.join(flight.name for flight in model.flights)}: found no motion that follows the recording, "
            "expected one near that of the scene; correct body.inertia in the scene, which must be of the right order, "
            f"or try more starts{shorter}"
        )
    return predicted


def _estimated(model: Model, predicted: Sequence[Predicted], noise: dict[Key, float], loss: str) -> dict[Key, float]:
    """Return the noise of each sensor in each flight that the residuals show, over the freedom that the fit left."""
    freedoms = _freedoms(predicted, noise)
    taken = {
        each.key: (each.left.size * level(each.left, loss != "linear") ** 2, freedoms[each.key]) for each in predicted
    }
    found = {}
    for each in predicted:
        squares, freedom = taken[each.key]
        if freedom < _ALONE:
            # Numbers that few samples leave by chance would take the whole weight: all flights of the sensor count.
            alike = [taken[other] for other in taken if other[:2] == each.key[:2]]
            squares, freedom = (sum(numbers) for numbers in zip(*alike, strict=True))
        found[each.key] = max(math.sqrt(squares / max(freedom, 1.0)), floor_of(model, each.key))
    return found


def _freedoms(predicted: Sequence[Predicted], noise: dict[Key, float]) -> dict[Key, float]:
    """Return how many of the numbers of each stream the fit leaves free: all but the sum of their leverages."""
    roots = [triangle(each.by.reshape(-1, each.by.shape[2])) / noise[each.key] for each in predicted]
    basis = np.linalg.qr(np.vstack([*roots, np.eye(roots[0].shape[1]) / _FAR]))[0]
    parts = np.split(basis, np.cumsum([len(root) for root in roots]))
    return {each.key: each.left.size - float(np.sum(mine**2)) for each, mine in zip(predicted, parts, strict=False)}


def _of_errors(predicted: Sequence[Predicted], noise: dict[Key, float], loss: str) -> dict[Key, float]:
    """Return the noise of each stream with which the errors of least squares are those of a robust loss.

    They are larger by sqrt(E psi^2) / E psi', with the derivative psi of the loss, corrected for the freedom that the
    fit took: Huber & Ronchetti, Robust Statistics (2009), section 7.6.
    """
    freedoms = _freedoms(predicted, noise)
    return {
        each.key: noise[each.key] * _times_larger(each.left / noise[each.key], freedoms[each.key], loss)
        for each in predicted
    }


def _times_larger(left: Array, freedom: float, loss: str) -> float:
    free = max(freedom, 1.0) / left.size
    _, psi, bends = _of_loss(left, loss)
    bend = _mean_bend(bends)
    correction = 1.0 + (1.0 - free) * float(np.var(bends)) / bend**2
    return correction * float(np.sqrt(np.mean(psi**2) / free)) / bend


def _mean_bend(bends: Array) -> float:
    # Nothing is known of a stream of outliers alone.
    return max(float(np.mean(bends)), _LEAST_BEND)


def _of_loss(left: Array, loss: str) -> tuple[Array, Array, Array]:
    """Return twice a robust loss of residuals over noise, its derivative psi, and that of psi."""
    squares = left**2
    if loss == "huber":
        size = np.sqrt(np.maximum(squares, 1.0))
        near: Array = (squares <= 1.0).astype(np.float64)
        return np.where(squares <= 1.0, squares, 2.0 * size - 1.0), left / size, near
    if loss == "soft_l1":
        size = np.sqrt(1.0 + squares)
        return 2.0 * (size - 1.0), left / size, 1.0 / size**3
    return np.log1p(squares), left / (1.0 + squares), (1.0 - squares) / (1.0 + squares) ** 2


def _likelihood(
    predicted: Sequence[Predicted], noise: dict[Key, float], errors: dict[Key, float], loss: str
) -> Callable[[Sequence[Predicted]], tuple[float, Array]]:
    """Return `Fit.robust`: near `predicted` it grows with parameters as the `errors` of the loss say."""
    bends = {each.key: _mean_bend(_of_loss(each.left / noise[each.key], loss)[2]) for each in predicted}

    def judged(others: Sequence[Predicted]) -> tuple[float, Array]:
        total, left = 0.0, []
        for each in others:
            times, bend = errors[each.key] / noise[each.key], bends[each.key]
            losses, psi, _ = _of_loss(each.left / noise[each.key], loss)
            total += float(np.sum(losses)) / (bend * times**2)
            left.append(np.ravel(psi) / (bend * times))
        return total, np.concatenate(left)

    return judged


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
