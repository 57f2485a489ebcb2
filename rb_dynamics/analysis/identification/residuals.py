"""`Fit`, and its `Residuals`: those of each kind of measurement, compared with noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from rb_dynamics.analysis.identification import rotations
from rb_dynamics.analysis.identification.flights import ATTITUDE, UNITS, usual_interval
from rb_dynamics.analysis.identification.measurement_model import Model, Predicted
from rb_dynamics.analysis.identification.residual_whiteness import Band, bands_of, noise_beneath, root_of, whiteness
from rb_dynamics.analysis.identification.sensor_noise import Key, floor_of
from rb_dynamics.analysis.identification.stacked_rows import covariance_of
from rb_dynamics.analysis.track import Array

# Residuals of more than this many times their noise are not explained by the model. Noise alone reaches 1.3, that of
# throws whose truth is known 4.3. A fit that leaves more of the motion itself unexplained means nothing.
EXPLAINED, _FOLLOWED = 5.0, 0.1
# Of a robust loss, the part of the residuals that must be noise: the others may be outliers.
MOST = 0.7


class Fit(NamedTuple):
    """The outcome of `estimation.fitted`.

    Attributes:
        z: parameters.
        noise: standard deviation of one component of a sample, by sensor and flight.
        predicted: what is left of each stream; without derivatives.
        weighted: (n, p), derivatives over noise.
        left: (n,), residuals over noise.
        starts: fits that were tried.
        agreeing: how many of them found the best minimum.
        converged: whether the best one converged.
        disturbance: of a fit of joined segments, by how much the rates (rad/s) changed between them; None of a flight
            from a single start.
        profile: of joined segments, -2 times the logarithm of the likelihood of other parameters.
        joined: the fit of joined segments, if it is likelier than the one from a single start.
        robust: of a robust loss, returns for residuals of other parameters -2 times the logarithm of the likelihood,
            and equivalent residuals of least squares; None of least squares.
    """

    z: Array
    noise: dict[Key, float]
    predicted: list[Predicted]
    weighted: Array
    left: Array
    starts: int
    agreeing: int
    converged: bool
    disturbance: float | None = None
    profile: Callable[[Array], float] | None = None
    joined: Fit | None = None
    robust: Callable[[Sequence[Predicted]], tuple[float, Array]] | None = None


@dataclass(frozen=True)
class Residuals:
    """The residuals of one kind of measurement of a topic.

    Attributes:
        topic: as recorded.
        kind: what it measures.
        unit: of `rms` and `noise`.
        count: samples.
        rms: of one component.
        noise: of one component, as the fit estimates it.
        white: whether they are independent, as noise is; None where they are below the accuracy that a recording is
            believed to have: too small to judge.
        correlation: of neighbouring samples.
        times_noise: `rms` over the noise that the quickest changes show, which no model explains; of a robust loss, if
            they are white, in place of `rms` that of normal noise with the size of seven tenths of them.
        unexplained: the same over the motion.
    """

    topic: str
    kind: str
    unit: str
    count: int
    rms: float
    noise: float
    white: bool | None
    correlation: float
    times_noise: float
    unexplained: float

    @property
    def explained(self) -> bool:
        """Whether the model explains them up to noise."""
        return self.times_noise <= EXPLAINED

    @property
    def coloured(self) -> bool:
        """Whether they are judged, and not white."""
        return self.white is False

    @property
    def only_noise(self) -> bool:
        """Whether they are explained and show no colour."""
        return self.explained and not self.coloured

    @property
    def whiteness(self) -> str:
        """The same in words."""
        if self.white is None:
            return "too small to judge"
        return "white" if self.white else f"not white: neighbours correlate by {self.correlation:.2f}"

    @property
    def follows(self) -> bool:
        """Whether the fit is of this motion at all."""
        return self.explained or self.unexplained <= _FOLLOWED


def fit_bands(fit: Fit, local: Array | None = None, of: Callable[..., list[list[Band]]] = bands_of) -> list[list[Band]]:
    """Return the bands of each stream of a fit, with its derivatives by coordinates of which `local` are derivatives.

    These are the parameters themselves where none are given. With `of=axes_of` they are its axes.
    """
    local = np.eye(fit.weighted.shape[1]) if local is None else local
    root = root_of(covariance_of(fit.weighted @ local))
    return of(fit.left, fit.weighted, local @ root, [len(each.left) for each in fit.predicted])


def residuals_of(model: Model, fit: Fit, bands: Sequence[Sequence[Band]]) -> list[Residuals]:
    """Return the residuals of each topic and kind, from the bands of their streams."""
    found = []
    for topic, kind in dict.fromkeys(each.key[:2] for each in fit.predicted):
        mine = [(each, of) for each, of in zip(fit.predicted, bands, strict=True) if each.key[:2] == (topic, kind)]
        parts = [each.left for each, _ in mine]
        every = np.vstack(parts)
        judged, correlation = whiteness(parts, [of for _, of in mine])
        rms = _rms(every)
        white = judged if any(_rms(each.left) > floor_of(model, each.key) for each, _ in mine) else None
        told = [noise for each, _ in mine if np.isfinite(noise := noise_of(model, each))]
        beneath = float(np.sqrt(np.mean(np.square(told)))) if told else 0.0
        motion = np.sqrt(np.mean([_motion(each) ** 2 for each, _ in mine]))
        # Without a motion, and of too few samples, there is nothing to judge by.
        # Outliers are independent; slow residuals are of a fit that lost the motion.
        size = level(every, fit.robust is not None and judged, MOST)
        times, share = (float(size / of) if of > 0.0 else 0.0 for of in (beneath, motion))
        noise = float(np.sqrt(np.average([fit.noise[p.key] ** 2 for p, _ in mine], weights=list(map(len, parts)))))
        found.append(Residuals(topic, kind, UNITS[kind], len(every), rms, noise, white, correlation, times, share))
    return found


def level(left: Array, robust: bool, part: float = 0.5) -> float:
    """Return the root mean square of residuals; of a robust loss that of normal noise with the size of this part."""
    if not robust:
        return _rms(left)
    return float(np.quantile(np.abs(left), part)) / NormalDist().inv_cdf(0.5 + 0.5 * part)


def _rms(rows: Array) -> float:
    return float(np.sqrt(np.mean(rows**2)))


def noise_of(model: Model, each: Predicted) -> float:
    """Return the noise of a sample beneath residuals."""
    interval = usual_interval(each.time_ns) * 1e-9
    steps = np.abs(np.diff(each.measured, axis=0))
    least = float(steps[steps > 0.0].min(initial=np.inf))
    turn, least = model.starts[each.flight].fastest * interval, least if np.isfinite(least) else 0.0
    found = noise_beneath(each.left, turn, least)
    if _rms(each.left) > _FOLLOWED * _motion(each):
        # A body that is predicted to tumble changes faster than what was measured: that is no noise of the sensor.
        found = min(found, noise_beneath(_moved(each), turn, least))
    return max(found, floor_of(model, each.key))


def _moved(each: Predicted) -> Array:
    """Return what a stream measured, of attitudes the sum of the turns (rad) from sample to sample."""
    if each.key[1] != ATTITUDE:
        return each.measured
    turns = rotations.products(rotations.conjugates(each.measured[:-1]), each.measured[1:])
    return np.cumsum(np.vstack([np.zeros(3), rotations.logarithms(turns)]), axis=0)


def _motion(each: Predicted) -> float:
    """Return how much a stream changes: root mean square about its mean, of attitudes the turn since the first."""
    if each.key[1] == ATTITUDE:
        since = rotations.products(rotations.conjugates(each.measured[:1]), each.measured)
        return _rms(rotations.logarithms(since))
    return _rms(each.measured - each.measured.mean(axis=0))
