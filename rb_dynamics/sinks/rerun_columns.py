"""Samples of a run as columns of numbers for Rerun, without importing `rerun`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.numerics.rotation_arrays import rotate_all
from rb_dynamics.run.event_arrays import column
from rb_dynamics.sinks.rerun_style import PlotLines
from rb_dynamics.sinks.rerun_thinning import KeptRows

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


def gather(rows: Sequence[KeptRows], series: Iterable[PlotLines]) -> Columns:
    """Return the rows as columns; there is at least one."""
    indices = np.concatenate([each.indices for each in rows])
    stamps = np.column_stack([np.concatenate([each.samples.time_ns for each in rows]), indices])
    # A log that is converted does not contain everything.
    told = [one for one in series if getattr(rows[0].samples, one.attribute) is not None]
    values = {
        one.entity: np.concatenate(
            [column(each.samples, one.attribute).reshape(len(each.indices), -1) for each in rows]
        )
        for one in told
    }
    # A wrench is held for many samples: each is processed once.
    each_held = [held for part in rows for held in part.held]
    numbers = np.fromiter(map(id, each_held), dtype=np.intp, count=len(each_held))
    _, first, place = np.unique(numbers, return_index=True, return_inverse=True)
    held = [each_held[k] for k in first.tolist()]
    attitude = values["attitude"]
    sums = [
        rotate_all(attitude, np.array(in_body)[place]) + np.array(in_world)[place]
        for in_body, in_world in (
            ([one.force_body for one in held], [one.force_world for one in held]),
            ([one.torque_body for one in held], [one.torque_world for one in held]),
        )
    ]
    return Columns(stamps, values, *sums)
