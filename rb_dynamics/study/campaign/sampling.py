"""The inputs of runs: probabilities in the unit cube, correlated, and turned into values.

Any block of runs can be had without the others: a random number depends on the seed of the campaign and the number of
the run alone.
"""

from __future__ import annotations

import warnings
from functools import lru_cache
from typing import TYPE_CHECKING

from rb_dynamics.study.campaign.model import Campaign

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Numbers = npt.NDArray[np.float64]

INPUTS, NOISE = 0, 1
"""Streams of random numbers that each run has."""

# Probabilities of 0 and 1 are infinities of a normal number.
_LEAST, _MOST = 2.0**-54, 1.0 - 2.0**-53


def generator(seed: int, run: int, stream: int) -> np.random.Generator:
    """Return the random numbers of a run: Philox keyed by (seed, run), streams apart by 2^192 in its counter.

    Salmon et al., Parallel random numbers: as easy as 1, 2, 3 (2011): streams of different keys are independent.
    """
    import numpy as np

    key, counter = np.array([seed, run], dtype=np.uint64), np.array([0, 0, 0, stream], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key, counter=counter))


def inputs(campaign: Campaign, first: int, last: int) -> Numbers:
    """Return the inputs of the runs from `first` to `last`, (n, inputs)."""
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
    """Return the whole design: each block of it needs all of it."""
    import numpy as np
    from scipy.stats import qmc

    design: Numbers = qmc.LatinHypercube(count, seed=np.random.default_rng(seed)).random(runs)
    return design


def _sobol(first: int, last: int, count: int, seed: int) -> Numbers:
    import numpy as np
    from scipy.stats import qmc

    engine = qmc.Sobol(count, seed=np.random.default_rng(seed))
    with warnings.catch_warnings():
        # It warns of numbers that are no power of two; a block is a part of the whole.
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
    # Added up one by one: the order of a matrix product depends on the number of runs.
    mixed = np.zeros_like(scores)
    for k, row in enumerate(mixing):
        for j, weight in enumerate(row):
            mixed[:, k] += weight * scores[:, j]
    # What depends on itself alone keeps its bits.
    same = [k for k, row in enumerate(mixing) if row[k] == 1.0]
    result: Numbers = ndtr(mixed).clip(_LEAST, _MOST)
    result[:, same] = probabilities[:, same]
    return result
