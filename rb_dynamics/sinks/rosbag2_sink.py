"""`BagSink`: a run as a rosbag2 folder: MCAP files of bounded size and duration, and the `metadata.yaml` of `ros2 bag`.

Every file is a log of its own, with scene, metadata and all channels. `states_sha256` continues from one file to the
next, so that the last one is that of the whole run.
"""

from __future__ import annotations

import os
import weakref
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

from rb_dynamics.errors import LogError
from rb_dynamics.formats.log_metadata import CONTINUES_IN
from rb_dynamics.formats.mcap_records import McapChannel
from rb_dynamics.formats.output_file import foreign_files, hold, make_folder
from rb_dynamics.formats.rosbag2_metadata import METADATA_FILE, BagFile, write_metadata
from rb_dynamics.run.sink import Epoch, Event, RunInfo, Sample
from rb_dynamics.sinks.mcap_sink import LogSettings, McapSink
from rb_dynamics.sinks.state_hash import StateHash


class BagSink:
    """Writes one run to one folder; a full file is closed and the next one begun before a sample."""

    def __init__(
        self,
        folder: str | os.PathLike[str],
        max_bytes: int = 0,
        max_duration_s: float = 0.0,
        namespace: str = "",
        remap: Mapping[str, str] | None = None,
        settings: LogSettings | None = None,
    ) -> None:
        """Say where to write; nothing is touched before `open`.

        Args:
            folder: made where it is missing; an earlier bag in it is replaced.
            max_bytes: size at which the next file is begun; what waits for its chunk comes on top. 0: no bound.
            max_duration_s: s of simulation time in one file; 0: no bound.
            namespace: put before relative topic names.
            remap: absolute names of single topics, by relative name.
            settings: how the log is kept.
        """
        self.path = Path(folder)
        self._max_bytes, self._max_ns = max_bytes, round(max_duration_s * 1e9)
        self._namespace, self._remap, self._settings = namespace, remap, settings or LogSettings()
        self._sink: McapSink | None = None
        self._files: list[BagFile] = []
        # A later file may have a topic that the first does not have.
        self._channels: dict[str, McapChannel] = {}
        self._end_ns: int | None = None
        self._epoch: Epoch | None = None
        # Ends the hold of the folder.
        self._release: Callable[[], object] = lambda: None

    def open(self, run: RunInfo) -> None:
        """Begin the first file.

        Raises:
            LogError: the folder holds what is not a part of a bag of its name, another run records into it, or it
                cannot be written.
        """
        self._hold()
        try:
            self._replace(self._earlier(), run)
        except LogError:
            self._release()
            raise

    def _replace(self, earlier: list[Path], run: RunInfo) -> None:
        self._run, self._states = run, StateHash()
        self._files, self._epoch, self._channels = [], None, {}
        self._end_ns = run.scene.end_ns
        self._begin_file(0)
        for file in earlier:
            if file.name != self._files[0].name:
                file.unlink()

    def write(self, event: Event) -> None:
        """Log one event.

        Raises:
            LogError: the file cannot be written any more; what was written before stays readable.
        """
        assert self._sink is not None, "open comes first"
        if isinstance(event, Sample) and self._full(event.time_ns):
            # What is in whole files is safe, however the next one ends.
            self._sink.flush()
            self._end_file({CONTINUES_IN: self._name(len(self._files))})
            self._begin_file(event.time_ns)
        if isinstance(event, Epoch):
            self._epoch = event
        self._sink.write(event)
        self._files[-1].end_ns = event.time_ns

    def close(self, result: Mapping[str, str]) -> None:
        """Finish the last file and write `metadata.yaml`.

        Raises:
            LogError: a file cannot be written, or does not read back where that is verified.
        """
        if self._sink is None:
            return
        try:
            self._end_file(result)
            write_metadata(self.path, list(self._channels.values()), self._files)
        finally:
            self._release()

    def _begin_file(self, time_ns: int) -> None:
        name = self._name(len(self._files))
        sink = McapSink(self.path / name, self._namespace, self._remap, self._settings, self._states, time_ns)
        sink.open(self._run)
        if self._epoch is not None:
            sink.write(self._epoch)
        self._sink = sink
        self._files.append(BagFile(name, time_ns, time_ns))

    def _end_file(self, result: Mapping[str, str]) -> None:
        assert self._sink is not None
        try:
            self._sink.close(result)
        finally:
            self._files[-1].counts = +Counter(self._sink.counts())
            # A full disk may have lost the end of what was logged.
            self._files[-1].end_ns = max(self._files[-1].start_ns, min(self._files[-1].end_ns, self._sink.end_ns))
            self._channels |= {channel.topic: channel for channel in self._sink.channels()}

    def _full(self, time_ns: int) -> bool:
        assert self._sink is not None
        if time_ns == self._end_ns:
            return False  # the last sample belongs to what it ends: no file of its own
        too_long = self._max_ns and time_ns - self._files[-1].start_ns >= self._max_ns
        return bool(too_long or (self._max_bytes and self._sink.size >= self._max_bytes))

    def _name(self, number: int) -> str:
        return f"{self.path.name}_{number}.mcap"

    def _hold(self) -> None:
        """Make the folder and hold it, see `hold`.

        Raises:
            LogError: it is a file, cannot be made, or another run records into it.
        """
        if self.path.exists() and not self.path.is_dir():
            raise LogError(f"cannot write {self.path}: it is a file, expected a folder for a bag; give another name")
        make_folder(self.path / METADATA_FILE)
        self._release()
        self._release = weakref.finalize(self, os.close, hold(self.path))

    def _earlier(self) -> list[Path]:
        """Return the files of an earlier bag, which this one replaces.

        Raises:
            LogError: the folder contains files that are not part of a bag.
        """
        if foreign := foreign_files(self.path):
            raise LogError(
                f"{self.path} holds {', '.join(foreign[:5])}, expected a new or empty folder or an earlier bag of that "
                "name; give another name"
            )
        return sorted(self.path.iterdir())
