"""The inputs of runs: probabilities in the unit cube, correlated, and mapped to values.

Any block of runs can be computed without the others: a random number depends only on the seed of the campaign and the
number of the run.
"""

from __future__ import annotations

import warnings
from functools import lru_cache
from typing import TYPE_CHECKING

from rb_dynamics.sensors.random_numbers import philox
from rb_dynamics.study.campaign.model import Campaign

if TYPE_CHECKING:
    import numpy as np

    from rb_dynamics.numerics.array_types import Numbers

INPUTS, NOISE, LAW, SENSORS = range(4)
"""Independent streams of random numbers per run."""

# The normal quantiles of 0 and 1 are infinite.
_LEAST, _MOST = 2.0**-54, 1.0 - 2.0**-53


def generator(seed: int, run: int, stream: int) -> np.random.Generator:
    """Return the random generator of a run: Philox keyed by (seed, run); streams are 2^192 apart in its counter.

    Salmon et al., Parallel random numbers: as easy as 1, 2, 3 (2011): streams of different keys are independent.
    """
    import numpy as np

    key, counter = np.array([seed, run], dtype=np.uint64), np.array([0, 0, 0, stream], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key, counter=counter))


def seed_of_run(seed: int, run: int) -> int:
    """Return the seed of the sensors of a run, from 0 to 2^53 - 1."""
    return philox((0, 0, 0, SENSORS), (seed, run))[0] >> 11


def inputs(campaign: Campaign, first: int, last: int) -> Numbers:
    """Return the inputs of the runs from `first` up to, not including, `last`, (n, inputs)."""
    import numpy as np

    count = len(campaign.inputs)
    if count == 0:
        return np.empty((last - first, 0))
    probabilities = _correlated(_design(campaign, first, last).clip(_LEAST, _MOST), campaign.mixing)
    columns = [each.distribution.quantile(probabilities[:, k]) for k, each in enumerate(campaign.inputs)]
    return np.stack(columns, axis=1)


def _design(campaign: Campaign, first: int, last: int) -> Numbers:
    import numpy as np

    count, seed = len(campaign.inputs), campaign.seed
    if campaign.sampling == "random":
        return np.array([generator(seed, run, INPUTS).random(count) for run in range(first, last)])
    if campaign.sampling == "latin_hypercube":
        return _hypercube(campaign.runs, count, seed)[first:last]
    return _sobol(first, last, count, seed)


@lru_cache(maxsize=1)
def _hypercube(runs: int, count: int, seed: int) -> Numbers:
    """Return the whole design, which every block needs."""
    import numpy as np
    from scipy.stats import qmc

    design: Numbers = qmc.LatinHypercube(count, seed=np.random.default_rng(seed)).random(runs)
    return design


def _sobol(first: int, last: int, count: int, seed: int) -> Numbers:
    import numpy as np
    from scipy.stats import qmc

    engine = qmc.Sobol(count, seed=np.random.default_rng(seed))
    with warnings.catch_warnings():
        # scipy warns if the number is not a power of two, but this is only a block of the sequence.
        warnings.simplefilter("ignore", UserWarning)
        if first:
            engine.fast_forward(first)
        points: Numbers = engine.random(last - first)
    return points


def _correlated(probabilities: Numbers, mixing: tuple[tuple[float, ...], ...]) -> Numbers:
    """Return probabilities whose normal scores have the correlations of `mixing` (Gaussian copula)."""
    if not mixing:
        return probabilities
    import numpy as np
    from scipy.special import ndtr, ndtri

    scores = ndtri(probabilities)
    # Sum one by one: the order of summation in a matrix product depends on the number of runs.
    mixed = np.zeros_like(scores)
    for k, row in enumerate(mixing):
        for j, weight in enumerate(row):
            mixed[:, k] += weight * scores[:, j]
    # An input without correlations keeps its bits.
    same = [k for k, row in enumerate(mixing) if row[k] == 1.0]
    result: Numbers = ndtr(mixed).clip(_LEAST, _MOST)
    result[:, same] = probabilities[:, same]
    return result
