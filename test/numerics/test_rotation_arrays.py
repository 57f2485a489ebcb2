"""Arrays of vectors: what is computed faster than by numpy has the same bits."""

from __future__ import annotations

import numpy as np
import pytest

from rb_dynamics.numerics.rotation_arrays import lengths


@pytest.mark.parametrize("columns", [3, 4])
@pytest.mark.parametrize("count", [0, 1, 1000])
def test_lengths_are_the_norms_to_the_bit(count: int, columns: int) -> None:
    random = np.random.default_rng(1)
    rows = random.normal(size=(count, columns)) * 10.0 ** random.uniform(-9, 9, (count, 1))
    rows[1::50] = 0.0
    rows[2::50, 1] = np.nan
    rows[3::50, 2] = -np.inf
    assert lengths(rows).tobytes() == np.linalg.norm(rows, axis=1).tobytes()
    assert lengths(rows[:, :2][:, ::-1]).tobytes() == np.linalg.norm(rows[:, :2][:, ::-1], axis=1).tobytes()
