"""Times in whole nanoseconds: each of an array as one alone."""

from __future__ import annotations

import random

import numpy as np

from rb_dynamics.numerics.nanoseconds import LONGEST, nanoseconds, nanoseconds_of_each


def test_each_of_an_array_is_rounded_as_one_alone() -> None:
    """Also halfway between two nanoseconds, where doubles may round to the other side, and where times are long."""
    draw = random.Random(1)
    halves = [(draw.randrange(10**9) + 0.5) / 1e9 for _ in range(2000)]
    others = [draw.uniform(0.0, 2.0) for _ in range(500)] + [10.0 ** draw.uniform(-12.0, 9.0) for _ in range(500)]
    times = [0.0, 1e-9, 0.5e-9, 1.5e-9, LONGEST, *halves, *others]
    assert nanoseconds_of_each(np.array(times)).tolist() == [nanoseconds(each) for each in times]
    assert [round(each * 1e9) for each in halves] != [nanoseconds(each) for each in halves]
