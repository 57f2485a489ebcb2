"""`EventArrays`: the events at many edges of a run as arrays, for sinks that accept many events at once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from rb_dynamics.loads.command_channels import AppliedWrench
from rb_dynamics.loads.command_table import Changes
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
        samples = self._samples()
        for number in self.order.tolist():
            yield number, next(samples) if number < self.taken else self.change(number - self.taken)

    def _samples(self) -> Iterator[Sample]:
        columns: list[list[Any]] = []
        for field in fields(Sample):
            found = getattr(self.samples, field.name)
            if isinstance(found, tuple):
                columns.append(list(zip(*(part.tolist() for part in found), strict=True)))
            else:
                columns.append([None] * self.taken if found is None else found.tolist())
        return (Sample(*row) for row in zip(*columns, strict=True))

    def change(self, i: int) -> AppliedWrench:
        """Return change i."""
        changes = self.changes
        row, (fx, fy, fz, tx, ty, tz) = int(changes.row[i]), changes.wrench[i].tolist()
        received = changes.came.received(row) if row >= 0 else None
        frame = changes.frames[int(changes.in_world[i])]
        topic = changes.topics[int(changes.channel[i])]
        applied = AppliedWrench(int(changes.time_ns[i]), topic, received, frame, (fx, fy, fz), (tx, ty, tz))
        return applied if received is not None else replace(applied, timed_out=True)
