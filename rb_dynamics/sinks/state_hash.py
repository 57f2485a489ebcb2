"""`StateHash`: a SHA-256 that two runs share exactly if all their samples agree to the last bit."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Mapping
from dataclasses import fields
from typing import TYPE_CHECKING

from rb_dynamics.run.sample import Sample
from rb_dynamics.run.sink import Event, RunInfo

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.run.event_arrays import EventArrays

_RECORD = struct.Struct("<q28d")


class StateHash:
    """SHA-256 over samples in the order of time.

    Each sample enters as 232 bytes, little endian: `time_ns` as int64, then 28 float64 in the order of the fields of
    `Sample`: position, orientation (x, y, z, w), linear velocity, angular velocity, angular momentum, linear momentum,
    kinetic energy, work, energy defect, angular momentum defect, linear momentum defect; and behind them the potential
    energy where an effect has one.

    Attributes:
        samples: how many entered.
        time_ns: of the newest; 0 before the first.
    """

    def __init__(self) -> None:
        """Begin with no sample."""
        self._hash = hashlib.sha256()
        self.samples = self.time_ns = 0

    def update(self, sample: Sample) -> None:
        """Add one sample."""
        self.samples += 1
        self.time_ns = sample.time_ns
        self._hash.update(
            _RECORD.pack(
                sample.time_ns,
                *sample.position_world,
                *sample.orientation_xyzw,
                *sample.linear_velocity_world,
                *sample.angular_velocity_body,
                *sample.angular_momentum_world,
                *sample.linear_momentum_world,
                sample.kinetic_energy,
                sample.work,
                sample.energy_defect,
                *sample.angular_momentum_defect_world,
                *sample.linear_momentum_defect_world,
            )
        )
        if sample.potential_energy is not None:
            self._hash.update(struct.pack("<d", sample.potential_energy))
        if sample.wheel_speeds is not None:
            inner = *sample.wheel_speeds, sample.motor_work, sample.friction_heat
            self._hash.update(struct.pack(f"<{len(inner)}d", *inner))

    def update_all(self, rows: npt.NDArray[np.uint8]) -> None:
        """Add samples, from `hashed_rows`."""
        self.samples += len(rows)
        if len(rows):
            self.time_ns = int.from_bytes(rows[-1, :8].tobytes(), "little", signed=True)
            self._hash.update(rows.tobytes())

    def hexdigest(self) -> str:
        """Return the hash of all samples so far, 64 hexadecimal digits."""
        return self._hash.hexdigest()


def hashed_rows(samples: Sample) -> npt.NDArray[np.uint8]:
    """Return the bytes as which samples, one with arrays, enter a `StateHash`: (n, 232 or 240)."""
    import numpy as np

    first, *others = (getattr(samples, field.name) for field in fields(Sample))
    columns = [part for each in others if each is not None for part in (each if isinstance(each, tuple) else (each,))]
    rows = np.empty((len(first), 1 + len(columns)), dtype="<f8")
    rows[:, 0] = first.astype("<i8").view("<f8")
    for k, column in enumerate(columns, 1):
        rows[:, k] = column
    return rows.view(np.uint8)


class HashSink:
    """Keeps only the hash of the samples of a run, which a log of the same run has as `states_sha256`."""

    def __init__(self) -> None:
        """Begin with no sample."""
        self._states = StateHash()

    def open(self, run: RunInfo) -> None:
        """Begin anew."""
        self._states = StateHash()

    def write(self, event: Event) -> None:
        """Add a sample; other events do not count."""
        if isinstance(event, Sample):
            self._states.update(event)

    def write_block(self, block: EventArrays) -> None:
        """Add samples."""
        self._states.update_all(hashed_rows(block.samples))

    def close(self, result: Mapping[str, str]) -> None:
        """Keep the hash."""

    def hexdigest(self) -> str:
        """Return the hash of all samples so far, 64 hexadecimal digits."""
        return self._states.hexdigest()
