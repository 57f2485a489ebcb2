"""`MemorySink`: a run as numpy arrays, for scripts and notebooks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from rb_dynamics.loads.command_channels import AppliedWrench, RejectedWrench
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
        samples: the samples themselves.
        applied: every change of a wrench channel, and what acts meanwhile where it follows with a lag.
        rejected: every command that was not honoured.
        commands: every command to an actuator, rejected ones too.
        measurements: everything that sensors gave.
    """

    def __init__(self) -> None:
        """Begin with nothing."""
        self.samples: list[Sample] = []
        self.applied: list[AppliedWrench] = []
        self.rejected: list[RejectedWrench] = []
        self.commands: list[ActuatorCommand] = []
        self.measurements: list[Measurement] = []

    def open(self, run: RunInfo) -> None:
        """Forget an earlier run."""
        self.samples, self.applied, self.rejected, self.commands, self.measurements = [], [], [], [], []

    def write(self, event: Event) -> None:
        """Keep an event; a status is not a part of a run."""
        if isinstance(event, Sample):
            self.samples.append(event)
        elif isinstance(event, AppliedWrench):
            self.applied.append(event)
        elif isinstance(event, RejectedWrench):
            self.rejected.append(event)
        elif isinstance(event, ActuatorCommand):
            self.commands.append(event)
        elif isinstance(event, Measurement):
            self.measurements.append(event)

    def close(self, result: Mapping[str, str]) -> None:
        """Keep what is there."""

    def __getattr__(self, name: str) -> npt.NDArray[Any]:
        """Return the field `name` of all samples as an array."""
        if name not in _FIELDS:
            raise AttributeError(f"MemorySink has no attribute {name!r}; the fields of a sample are {sorted(_FIELDS)}")
        import numpy as np

        return np.array([getattr(sample, name) for sample in self.samples])
