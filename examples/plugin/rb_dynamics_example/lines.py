"""A log for people: one line of text for each second of the run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from rb_dynamics.formats.output_file import OutputFile
from rb_dynamics.run.sink import Event, RunInfo, Sample

SECOND_NS = 1_000_000_000


class Lines:
    """Writes time, position and energy to a text file; a `Sink`. An error to be told is a `LogError`."""

    def __init__(self, target: str) -> None:
        """Say where to write; nothing happens before `open`."""
        self.path = Path(target)

    def open(self, run: RunInfo) -> None:
        """Create the file."""
        self._file = OutputFile(self.path)
        self._next_ns = 0
        self._file.write(f"# {run.scene.source}, {run.method}\n".encode())

    def write(self, event: Event) -> None:
        """Write the first sample of each second."""
        if isinstance(event, Sample) and event.time_ns >= self._next_ns:
            self._next_ns += SECOND_NS
            x, y, z = event.position_world
            line = f"{event.time_ns / SECOND_NS:g} s  {x:.6f} {y:.6f} {z:.6f} m  {event.kinetic_energy:.6f} J\n"
            self._file.write(line.encode())

    def close(self, result: Mapping[str, str]) -> None:
        """Close the file."""
        self._file.close()
