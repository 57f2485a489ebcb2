"""`MemorySink`: a run as numpy arrays, for scripts and notebooks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from functools import cached_property
from itertools import groupby
from typing import TYPE_CHECKING, Any, cast

from rb_dynamics.loads.wrench_channels import AppliedWrench, RejectedWrench
from rb_dynamics.run.event_arrays import EventArrays, column, one_by_one
from rb_dynamics.run.sample import Sample
from rb_dynamics.run.sink import ActuatorCommand, Event, Measurement, RunInfo

if TYPE_CHECKING:
    import numpy.typing as npt

_FIELDS = frozenset(field.name for field in fields(Sample))


class MemorySink:
    """Keeps every sample; each field of `Sample` is an array over time with the name of the field.

    `sink.time_ns` is (n,) int64; `sink.position_world` is (n, 3), `sink.kinetic_energy` (n,) float64, and so on;
    `sink.potential_energy` holds None if no effect has one.

    Attributes:
        rejected: every command that was not honoured.
        commands: every command to an actuator, rejected ones too.
        measurements: everything that sensors gave.
    """

    def __init__(self) -> None:
        """Begin with nothing."""
        self._forget()

    def _forget(self) -> None:
        # Blocks stay arrays until somebody asks for the events in them.
        self._samples: list[Sample | EventArrays] = []
        self._applied: list[AppliedWrench | EventArrays] = []
        self.rejected: list[RejectedWrench] = []
        self.commands: list[ActuatorCommand] = []
        self.measurements: list[Measurement] = []
        self._changed()

    def _changed(self) -> None:
        self.__dict__.pop("samples", None)
        self.__dict__.pop("applied", None)

    @cached_property
    def samples(self) -> list[Sample]:
        """Every sample as an object."""
        return _opened(self._samples, lambda block: one_by_one(block.samples))

    @cached_property
    def applied(self) -> list[AppliedWrench]:
        """Every change of a wrench channel, and what acts meanwhile where it follows with a lag."""
        return _opened(self._applied, EventArrays.all_changes)

    def open(self, run: RunInfo) -> None:
        """Forget an earlier run."""
        self._forget()

    def write(self, event: Event) -> None:
        """Keep an event; a status is not a part of a run."""
        self._changed()
        if isinstance(event, Sample):
            self._samples.append(event)
        elif isinstance(event, AppliedWrench):
            self._applied.append(event)
        elif isinstance(event, RejectedWrench):
            self.rejected.append(event)
        elif isinstance(event, ActuatorCommand):
            self.commands.append(event)
        elif isinstance(event, Measurement):
            self.measurements.append(event)

    def write_block(self, block: EventArrays) -> None:
        """Keep many events."""
        self._changed()
        self._samples.append(block)
        self._applied.append(block)

    def close(self, result: Mapping[str, str]) -> None:
        """Keep what is there."""

    def __getattr__(self, name: str) -> npt.NDArray[Any]:
        """Return the field `name` of all samples as an array."""
        if name not in _FIELDS:
            raise AttributeError(f"MemorySink has no attribute {name!r}; the fields of a sample are {sorted(_FIELDS)}")
        import numpy as np

        columns = []
        for in_block, parts in groupby(self._samples, lambda part: isinstance(part, EventArrays)):
            if in_block:
                columns += [column(cast("EventArrays", part).samples, name) for part in parts]
            else:
                columns.append(np.array([getattr(sample, name) for sample in parts]))
        return np.concatenate(columns) if columns else np.array([])


def _opened(parts: list[Any], events_of: Callable[[EventArrays], Iterable[Any]]) -> list[Any]:
    """Return `parts` with the events of a block in its place."""
    return [each for part in parts for each in (events_of(part) if isinstance(part, EventArrays) else (part,))]
