"""`EventArrays`: the events at many edges of a run as arrays, for sinks that accept many events at once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields
from itertools import repeat
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from rb_dynamics.loads.wrench_channels import AppliedWrench
from rb_dynamics.loads.wrench_command_arrays import Changes
from rb_dynamics.run.sample import Sample

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Whole = npt.NDArray[np.int64]


class EventArrays(NamedTuple):
    """Samples and changes of the wrench.

    Attributes:
        taken: number of samples.
        samples: a sample whose fields are arrays of `taken` numbers.
        changes: k changes of the wrench.
        order: (`taken` + k,), index of the sample, or `taken` + index of the change, in order of time.
    """

    taken: int
    samples: Sample
    changes: Changes
    order: Whole

    @classmethod
    def of(cls, samples: Sample, changes: Changes) -> EventArrays:
        """Return both; at equal times the sample comes first."""
        import numpy as np

        times: Any = samples.time_ns
        both = np.concatenate([times, changes.time_ns])
        return cls(len(times), samples, changes, np.argsort(both, kind="stable"))

    def events(self) -> Iterator[tuple[int, Sample | AppliedWrench]]:
        """Yield each event as a run edge by edge would write it, with its index in `order`."""
        samples, changes = one_by_one(self.samples), self.all_changes()
        for number in self.order.tolist():
            yield number, next(samples) if number < self.taken else next(changes)

    def change(self, i: int) -> AppliedWrench:
        """Return change i."""
        return next(self.all_changes(slice(i, i + 1)))

    def all_changes(self, rows: slice = slice(None), *, with_commands: bool = True) -> Iterator[AppliedWrench]:
        """Yield the changes in these rows; to find the commands as received takes time, so they can be left out."""
        changes = self.changes
        columns: list[list[Any]] = [
            column[rows].tolist()
            for column in (changes.time_ns, changes.channel, changes.in_world, changes.row, changes.wrench)
        ]
        for time_ns, channel, in_world, row, (fx, fy, fz, tx, ty, tz) in zip(*columns, strict=True):
            received = changes.came.received(row) if with_commands and row >= 0 else None
            topic, frame, wrench = changes.topics[channel], changes.frames[in_world], ((fx, fy, fz), (tx, ty, tz))
            yield AppliedWrench(time_ns, topic, received, frame, *wrench, timed_out=row < 0)


def chosen(samples: Sample, rows: slice | Whole) -> Sample:
    """Return some of the samples, of one whose fields are arrays."""

    def of(field: Any) -> Any:
        if isinstance(field, tuple):
            return tuple(part[rows] for part in field)
        return None if field is None else field[rows]

    return Sample(*(of(field) for field in _fields_of(samples)))


def column(samples: Sample, name: str) -> npt.NDArray[Any]:
    """Return a field of samples, of one whose fields are arrays, as an array: (n,) or (n, width), or n times None."""
    import numpy as np

    field: Any = getattr(samples, name)
    if isinstance(field, tuple):
        return np.stack(field, axis=-1)
    return np.full(len(cast("Whole", samples.time_ns)), None) if field is None else np.asarray(field)


def stacked(samples: Sequence[Sample]) -> Sample:
    """Return the samples as one whose fields are arrays."""
    import numpy as np

    def joined(name: str) -> Any:
        values = [getattr(sample, name) for sample in samples]
        if values[0] is None:
            return None
        found = np.array(values)
        return tuple(found.T) if found.ndim > 1 else found

    return Sample(*(joined(field.name) for field in fields(Sample)))


def one_by_one(samples: Sample) -> Iterator[Sample]:
    """Yield the samples, of one whose fields are arrays."""
    columns: list[Iterable[Any]] = []
    for field in _fields_of(samples):
        if isinstance(field, tuple):
            columns.append(zip(*(part.tolist() for part in field), strict=True))
        else:
            columns.append(repeat(None) if field is None else field.tolist())
    return (Sample(*row) for row in zip(*columns, strict=False))


def _fields_of(samples: Sample) -> list[Any]:
    return [getattr(samples, field.name) for field in fields(Sample)]
