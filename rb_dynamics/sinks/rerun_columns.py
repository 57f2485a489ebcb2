"""Samples of a run as columns of numbers for Rerun, without importing `rerun`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import chain
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.numerics.rotation_arrays import rotate_all
from rb_dynamics.run.sample import Sample
from rb_dynamics.sinks.rerun_style import PlotLines
from rb_dynamics.sinks.rerun_thinning import KeptSample

Array = NDArray[np.float64]


class Columns(NamedTuple):
    """Rows that are sent at once.

    Attributes:
        stamps: (n, 2), time in ns and index of the sample.
        values: (n, width) for each entity of a `PlotLines`.
        force_world: (n, 3), held by all channels together, N, world axes.
        torque_world: (n, 3), N m, world axes.
    """

    stamps: NDArray[np.int64]
    values: dict[str, Array]
    force_world: Array
    torque_world: Array


def gather(rows: Sequence[KeptSample], series: Iterable[PlotLines]) -> Columns:
    """Return the rows as columns; there is at least one."""
    samples = [row.sample for row in rows]
    stamps = np.array([(row.sample.time_ns, row.index) for row in rows], dtype=np.int64)
    # A log that is converted does not contain everything.
    told = [one for one in series if getattr(samples[0], one.attribute) is not None]
    values = {one.entity: _rectangle(samples, one) for one in told}
    # A wrench is held for many samples: each is processed once.
    held = {id(row.held): row.held for row in rows}
    places = {key: place for place, key in enumerate(held)}
    place = np.fromiter((places[id(row.held)] for row in rows), dtype=np.intp, count=len(rows))
    attitude = values["attitude"]
    sums = [
        rotate_all(attitude, np.array(in_body)[place]) + np.array(in_world)[place]
        for in_body, in_world in (
            ([one.force_body for one in held.values()], [one.force_world for one in held.values()]),
            ([one.torque_body for one in held.values()], [one.torque_world for one in held.values()]),
        )
    ]
    return Columns(stamps, values, *sums)


def _rectangle(samples: Sequence[Sample], series: PlotLines) -> Array:
    """Return one field of all samples as rows."""
    width = len(series.names)
    field = map(attrgetter(series.attribute), samples)
    numbers = chain.from_iterable(field) if isinstance(getattr(samples[0], series.attribute), tuple) else field
    return np.fromiter(numbers, dtype=np.float64, count=width * len(samples)).reshape(-1, width)
