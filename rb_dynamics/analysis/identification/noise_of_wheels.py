"""`noise_of_wheels`: what noise in the recorded speeds of wheels does to a fit that takes these as true."""

from __future__ import annotations

from operator import methodcaller
from typing import NamedTuple

import numpy as np

from rb_dynamics.analysis.identification.measurement_model import Model
from rb_dynamics.analysis.identification.residuals import Fit
from rb_dynamics.analysis.identification.stacked_rows import covariance_of, stacked
from rb_dynamics.analysis.track import Array


class NoiseOfWheels(NamedTuple):
    """Of p numbers near the solution.

    Attributes:
        bias: (p,), how far they are moved on average: noise makes all that the wheels do look less.
        spread: (p, p), their covariance by that noise, less what the noise of the sensors already stands for: where
            speeds are recorded less often than the motion, it is not white noise of these.
    """

    bias: Array
    spread: Array


def noise_of_wheels(model: Model, fit: Fit, local: Array) -> NoiseOfWheels:
    """Return what further noise on the speeds does, as large again as theirs; zero without wheels.

    On average it moves the numbers as far as the noise that is there: what is odd in it drops out between it and its
    opposite. Cook and Stefanski, J. Am. Stat. Assoc. 89 (1994) 1314.

    Args:
        model: of which `fit` is the solution.
        fit: the solution.
        local: (n, p), the step of the parameters by each number.
    """
    count = local.shape[1]
    none = NoiseOfWheels(np.zeros(count), np.zeros((count, count)))
    opposite = model.with_speeds(methodcaller("disturbed", 0, -1.0))
    if fit.profile is not None or opposite is None:
        return none
    first, *others = model.with_noisy_speeds()

    def left(other: Model) -> Array:
        predicted = other.predict(fit.z, derivatives=False)
        return np.concatenate([np.ravel(each.left / fit.noise[each.key]) for each in predicted])

    (more, rising), (less, falling) = (stacked(list(each.predict(fit.z)), fit.noise) for each in (first, opposite))
    here = left(model)
    draws = np.array([0.5 * (more - less), *(left(other) - here for other in others)])
    weighted = 0.5 * (rising + falling) @ local
    if not (np.isfinite(draws).all() and np.isfinite(weighted).all()):
        return none
    covariance = covariance_of(weighted)
    bias = 0.25 * covariance @ (local.T @ ((rising - falling).T @ (more - less)))
    moves = draws @ weighted @ covariance
    # As if it were white noise of the sensors, of which the fit has taken account by what it left.
    # Of noise in the first speeds, which moves all that follows, it leaves next to nothing.
    ends = np.cumsum([each.left.size for each in fit.predicted])[:-1]
    remains = draws - moves @ weighted.T
    shares = [np.full(part.shape[1], np.mean(part**2)) for part in np.split(remains, ends, axis=1)]
    white = weighted * np.sqrt(np.concatenate(shares))[:, None] @ covariance
    values, directions = np.linalg.eigh(moves.T @ moves / len(draws) - white.T @ white)
    return NoiseOfWheels(bias, directions * np.maximum(values, 0.0) @ directions.T)
