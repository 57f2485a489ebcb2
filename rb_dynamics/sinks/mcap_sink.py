"""`McapSink`: a run as one MCAP file that ROS 2, Foxglove, PlotJuggler and Rerun open unchanged.

Profile `ros2`, CDR, one channel for each topic of the node with the node's QoS. Each wrench channel has two: every
command received, rejected ones too (`<topic>`), and the wrench applied (`<topic>/applied`). Log times are simulation
time in nanoseconds: for a command, when it took effect, whatever the clock of its stamp. The scene is attached as
`scene.yaml`. Metadata: `rb_dynamics` describes the run, `rb_dynamics.topics` names each topic in the file, and
`rb_dynamics.result` has the end of the run, with `states_sha256` over all samples. After each chunk
`rb_dynamics.checkpoint` has that hash so far, so that a log that was cut off can be compared with a replay. If the
body was moved from outside, `set_state` has the states that were set. If messages are stamped with ROS time,
`rb_dynamics.epoch` has the ROS time of simulation time 0.

Never imports ROS, never changes or drops a value, and holds nothing back from the file for longer than `flush_s` of
wall time. An earlier file of the name is replaced.
"""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, cast

from rb_dynamics.errors import LogError
from rb_dynamics.formats import cdr
from rb_dynamics.formats.channel_metadata import log_channel, qos_profile
from rb_dynamics.formats.log_metadata import (
    CHECKPOINT,
    CUT_OFF,
    EPOCH,
    INTERRUPTED,
    RESULT,
    RUN,
    SCENE,
    TOPICS,
    version,
)
from rb_dynamics.formats.mcap_integrity import require_library, verify
from rb_dynamics.formats.mcap_records import McapChannel
from rb_dynamics.formats.mcap_writer import HEAD, InPieces, McapWriter, copies, framed, in_rows
from rb_dynamics.formats.message_types import VECTOR, WRENCH
from rb_dynamics.formats.output_file import OutputFile
from rb_dynamics.logs.messages import (
    APPLIED,
    COMMAND_DEPTH,
    LATENCY,
    MASS_PROPERTIES,
    SET_STATE,
    TF_STATIC,
    block_encoder,
    encode_applied,
    encode_fixed,
    encode_inertia,
    encode_latency,
    encode_received,
    encode_setpoint,
    encode_state_change,
    encode_status,
    log_topics,
    measurement_packers,
    sample_encoder,
    sample_topics,
)
from rb_dynamics.numerics.distinct import distinct
from rb_dynamics.run.event_arrays import EventArrays
from rb_dynamics.run.sample import Sample
from rb_dynamics.run.sink import (
    ActuatorCommand,
    AppliedWrench,
    Event,
    Latency,
    Measurement,
    ReceivedWrench,
    RejectedWrench,
    RunInfo,
    StateChange,
    Status,
)
from rb_dynamics.run.stop_signals import uninterrupted
from rb_dynamics.sinks.state_hash import StateHash, hashed_rows

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.loads.wrench_command_arrays import Changes
    from rb_dynamics.logs.messages import Bytes, Times
    from rb_dynamics.scene.model import Scene

    Records = npt.NDArray[np.object_]

FLUSH_S = 0.5
"""s of wall time: what a kill costs at most."""

# Relative name, message type, QoS.
_Topic = tuple[str, str, str]


@dataclass(frozen=True, slots=True)
class LogSettings:
    """How a log is kept.

    Attributes:
        flush_s: s of wall time after which what was written survives a kill; 0 leaves that to the size of the chunks,
            and makes the bytes of the file depend on the run alone.
        verify: read the finished file again with the package mcap (extra: log), and count its messages.
        accel: log the acceleration too, on `accel`.
    """

    flush_s: float = FLUSH_S
    verify: bool = False
    accel: bool = False


class McapSink:
    """Writes one run to one file.

    A killed run leaves a file that is readable up to `flush_s` before the kill; on a full disk the file is finished
    with what has room, and its metadata `rb_dynamics.interrupted` says so.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        namespace: str = "",
        remap: Mapping[str, str] | None = None,
        settings: LogSettings | None = None,
        states: StateHash | None = None,
        start_ns: int = 0,
    ) -> None:
        """Say where to write; nothing is touched before `open`.

        Args:
            path: the file; folders above it are made.
            namespace: put before relative topic names.
            remap: absolute names of single topics, by relative name; they win over `namespace`.
            settings: how the log is kept.
            states: continues the hash of an earlier file of the same run.
            start_ns: when this file of the run begins.
        """
        self.path = Path(path)
        self.settings = settings or LogSettings()
        self._namespace = "".join(f"/{part}" for part in namespace.split("/") if part)
        self._remap = dict(remap or {})
        self._ids: dict[str, int] = {}
        self._channels: list[McapChannel] = []
        self._states = states or StateHash()
        self._start_ns = start_ns
        self._checked = self._states.samples
        self._file: OutputFile | None = None
        self._failure: LogError | None = None
        # Held while the writer is at work: the flusher may come at any time.
        self._lock = threading.Lock()
        self._stop = threading.Event()

    def open(self, run: RunInfo) -> None:
        """Begin the file: metadata, scene, all channels and the inertia are in it when this returns.

        Raises:
            LogError: the file cannot be written, or two channels have one name.
            MissingExtraError: the file is to be verified, and the package mcap is not installed.
        """
        if self.settings.verify:
            require_library(f"verifying {self.path}")
        acceleration = run.acceleration if self.settings.accel else None
        samples = sample_topics(run.scene, acceleration is not None)
        topics = self._topics(run.scene, acceleration is not None)
        self._file = OutputFile(self.path)
        self._writer = McapWriter(self._file, f"rb_dynamics {version()}")
        self._guarded(self._begin, run, topics)
        self._sample_ids = [self._ids[name] for name, _ in samples]
        self._encode_sample = sample_encoder(run.scene, acceleration)
        self._block = block_encoder(run.scene)
        self._encode_measurement = measurement_packers(run.scene)
        if self.settings.flush_s > 0.0:
            threading.Thread(target=self._keep_flushing, name=f"flush {self.path.name}", daemon=True).start()

    def write(self, event: Event) -> None:
        """Log one event.

        Raises:
            LogError: the file cannot be written any more; what was written before stays readable.
        """
        self._guarded(self._log, event)

    @property
    def write_block(self) -> Callable[[EventArrays], None] | None:
        """Log many events, to the same bytes as one by one; None if the acceleration is asked for, of each sample.

        Raises:
            LogError: when it is called: as `write`.
        """
        return None if self.settings.accel else lambda block: self._guarded(self._log_block, block)

    def flush(self) -> None:
        """End the chunk in progress, so that everything up to now survives a kill.

        Raises:
            LogError: the file cannot be written any more.
        """
        self._guarded(self._end_chunk)

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return 0 if self._file is None else self._file.tell()

    @property
    def end_ns(self) -> int:
        """The latest time of a message that is in the file, ns."""
        return self._writer.end_time

    def counts(self) -> dict[str, int]:
        """Return how many messages are in the file, by the name of the topic."""
        return {self._absolute(name): self._writer.counts[number] for name, number in self._ids.items()}

    def channels(self) -> list[McapChannel]:
        """Return the channels of the file."""
        return list(self._channels)

    def close(self, result: Mapping[str, str]) -> None:
        """Write `result` and the index, and close the file; does nothing where nothing is open or writing has failed.

        Raises:
            LogError: the file cannot be written, or does not read back where that is verified.
        """
        self._stop.set()
        if self._file is None or self._file.closed:
            return
        self._guarded(self._finish, result)
        if self.settings.verify:
            verify(self.path, self.counts())

    def _guarded(self, action: Callable[..., None], *arguments: object) -> None:
        """Run `action`, which writes; if the disk fails, finish the file with what fits, then raise the error."""
        with uninterrupted(), self._lock:
            if self._failure is not None:
                raise self._failure
            try:
                action(*arguments)
            except LogError as error:
                if self._file is not None and self._file.failure is not None:
                    self._failure = error
                    self._writer.rescue(INTERRUPTED, {"reason": f"{CUT_OFF}: {error}"})
                    with contextlib.suppress(LogError):
                        self._file.close()
                raise

    def _keep_flushing(self) -> None:
        """Flush from time to time, however seldom something is written; a failure shows at the next write."""
        with contextlib.suppress(LogError):
            while not self._stop.wait(self.settings.flush_s):
                self.flush()

    def _begin(self, run: RunInfo, topics: list[_Topic]) -> None:
        self._frames = run.scene.frames
        self._writer.begin()
        self._writer.add_metadata(RUN, {"method": run.method, **run.metadata})
        self._writer.add_metadata(TOPICS, {name: self._absolute(name) for name, _, _ in topics})
        self._writer.add_attachment(SCENE, "application/yaml", run.scene.text.encode("utf-8", "replace"))
        self._register(topics)
        self._add(MASS_PROPERTIES[0], encode_inertia(run.scene, self._start_ns), self._start_ns)
        if run.scene.frames.fixed:
            self._add(TF_STATIC[0], encode_fixed(run.scene.frames, self._start_ns), self._start_ns)
        self._writer.end_chunk()

    def _log(self, event: Event) -> None:
        if isinstance(event, Sample):
            self._states.update(event)
            self._writer.add_messages(self._sample_ids, self._encode_sample(event), event.time_ns, event.time_ns)
            if self._writer.between_chunks:
                self._end_chunk()
        elif isinstance(event, AppliedWrench):
            self._write_received(event)
            self._write_applied(event)
        elif isinstance(event, (ReceivedWrench, RejectedWrench)):
            self._write_received(event)
        elif isinstance(event, ActuatorCommand):
            self._add(event.topic, encode_setpoint(event.value), event.time_ns)
        elif isinstance(event, Measurement):
            self._add(event.topic, self._encode_measurement[event.topic](event, event.taken_ns), event.time_ns)
        elif isinstance(event, Status):
            self._write_status(event)
        elif isinstance(event, StateChange):
            self._add_late(*SET_STATE, encode_state_change(event, self._frames), event.time_ns)
        elif isinstance(event, Latency):
            self._add_late(event.topic + LATENCY, VECTOR, encode_latency(event), event.time_ns)
        else:
            self._end_chunk()
            facts = {"epoch_ns": event.epoch_ns, "from_time_ns": event.time_ns}
            self._writer.add_metadata(EPOCH, {name: str(value) for name, value in facts.items()})

    def _log_block(self, block: EventArrays) -> None:
        import numpy as np

        changes, times = block.changes, cast("Times", block.samples.time_ns)
        models, fill = self._block
        records = [framed(number, model) for number, model in zip(self._sample_ids, models, strict=True)]
        places = np.cumsum([0, *map(len, records)]).tolist()
        rows = copies(b"".join(records), places[:-1], times)
        fill([rows[:, begin + HEAD : end] for begin, end in pairwise(places)], block.samples, times)
        data: bytes | memoryview
        if len(changes.time_ns):
            pieces, at, kind = self._with_changes(in_rows(rows), block)
            data, sizes = b"".join(pieces), np.fromiter(map(len, pieces), np.int64, len(pieces))
        else:
            data, sizes, at, kind = (
                rows.reshape(-1).data,
                np.full(len(rows), rows.shape[1]),
                times,
                np.full(len(rows), -1),
            )
        where = [
            InPieces(number, (kind == -1).nonzero()[0], start)
            for number, start in zip(self._sample_ids, places, strict=False)
        ]
        for channel, topic in enumerate(changes.topics):
            names = ((topic, 2 * channel), (topic + APPLIED, 2 * channel + 1))
            where += [InPieces(self._ids[name], (kind == k).nonzero()[0], 0) for name, k in names if name in self._ids]
        hashed, counted = hashed_rows(block.samples), 0
        of_samples = np.cumsum(kind == -1)
        for end in self._writer.add_pieces(data, np.cumsum(sizes), at, where):
            self._states.update_all(hashed[counted : of_samples[end - 1]])
            counted = int(of_samples[end - 1])
            if kind[end - 1] == -1:
                self._end_chunk()
        self._states.update_all(hashed[counted:])

    def _with_changes(self, rows: list[bytes], block: EventArrays) -> tuple[list[bytes], Times, Times]:
        """Return rows of samples and records of changes in order: pieces, times, and kinds.

        A command has two records: as received (kind 2 k for channel k) and as it acts (2 k + 1). A row has kind -1.
        """
        import numpy as np

        changes, taken, events = block.changes, block.taken, len(block.order)
        place = np.empty(events, dtype=np.int64)
        place[block.order] = np.arange(events)
        pieces, kinds = np.empty((events, 2), dtype=object), np.empty((events, 2), dtype=np.int64)
        pieces[place[:taken], 0], kinds[place[:taken]] = rows, -1
        pieces[place[taken:], 0], pieces[place[taken:], 1] = self._framed_changes(changes)
        kinds[place[taken:]] = 2 * changes.channel[:, None] + [0, 1]
        times = np.append(block.samples.time_ns, changes.time_ns)[block.order]
        written = pieces.astype(bool)
        return pieces[written].tolist(), np.repeat(times, written.sum(axis=1)), kinds[written]

    def _framed_changes(self, changes: Changes) -> tuple[Records, Records]:
        """Return the records of commands as received, "" for a timeout, and as they act."""
        import numpy as np

        came, acts = np.full(len(changes.row), b"", object), np.full(len(changes.row), b"", object)
        messages, received = changes.came.received.messages(), changes.came.received

        def add(to: Records, number: int, rows: Times, each: Bytes) -> None:
            records = copies(framed(number, bytes(each.shape[1])), (0,), changes.time_ns[rows])
            records[:, HEAD:] = each
            to[rows] = in_rows(records)

        for channel, topic in enumerate(changes.topics):
            mine = changes.channel == channel
            for in_world, frame in enumerate(changes.frames):
                rows = (mine & (changes.in_world == in_world)).nonzero()[0]
                model = cdr.stamped_packer(WRENCH, frame)(0, 0, *(0.0,) * 6)
                each = cdr.like(WRENCH, model, changes.time_ns[rows], [changes.wrench[rows]])
                add(acts, self._ids[topic + APPLIED], rows, each)
            if (number := self._ids.get(topic)) is not None:
                rows = (mine & (changes.row >= 0)).nonzero()[0]
                sent = [messages[row] or encode_received(received(row)) for row in changes.row[rows].tolist()]
                lengths = np.array([len(message) for message in sent])
                for length in distinct(lengths):
                    alike = (lengths == length).nonzero()[0]
                    data = np.frombuffer(b"".join(sent[i] for i in alike.tolist()), np.uint8)
                    add(came, number, rows[alike], data.reshape(len(alike), -1))
        return came, acts

    def _add_late(self, name: str, type_name: str, message: bytes, time_ns: int) -> None:
        """Log on a channel that begins with its first message."""
        if name not in self._ids:
            self._register([(name, type_name, qos_profile(COMMAND_DEPTH))])
        self._add(name, message, time_ns)

    def _end_chunk(self) -> None:
        """Write the chunk in progress, and the hash of the states up to here where there are new ones."""
        if self._file is None or self._file.closed:
            return  # the flusher came after the end
        self._writer.end_chunk()
        states = self._states
        if states.samples > self._checked:
            self._checked = states.samples
            facts = {"samples": states.samples, "time_ns": states.time_ns, "states_sha256": states.hexdigest()}
            self._writer.add_metadata(CHECKPOINT, {name: str(value) for name, value in facts.items()})

    def _finish(self, result: Mapping[str, str]) -> None:
        assert self._file is not None
        self._writer.end_chunk()
        self._writer.add_metadata(RESULT, {**result, "states_sha256": self._states.hexdigest()})
        self._writer.finish()
        self._file.close()

    def _add(self, name: str, message: bytes, time_ns: int) -> None:
        self._writer.add_messages((self._ids[name],), (message,), time_ns, time_ns)

    def _topics(self, scene: Scene, accel: bool) -> list[_Topic]:
        """Return all topics.

        Raises:
            LogError: two of them have one absolute name.
        """
        topics = log_topics(scene, accel)
        names = sorted(self._absolute(name) for name, _, _ in topics)
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise LogError(
                f"topics {twice} would each be logged twice, expected one channel for each of {names}; "
                "give the wrench channel another topic"
            )
        return topics

    def _absolute(self, name: str) -> str:
        """Return the name under which ROS knows a topic."""
        if name in self._remap:
            return self._remap[name]
        for suffix in (APPLIED, LATENCY):
            if name.endswith(suffix) and name.removesuffix(suffix) in self._remap:
                return self._remap[name.removesuffix(suffix)] + suffix
        return name if name.startswith("/") else f"{self._namespace}/{name}"

    def _register(self, topics: list[_Topic]) -> None:
        for name, type_name, qos in topics:
            channel = log_channel(self._absolute(name), type_name, qos)
            self._ids[name] = self._writer.add_channel(channel)
            self._channels.append(channel)

    def _write_received(self, event: AppliedWrench | ReceivedWrench | RejectedWrench) -> None:
        command = event.received
        reported = not isinstance(event, ReceivedWrench) and event.delayed
        if command is not None and not reported and event.topic in self._ids:
            # Whatever its stamp is, the times of the record are simulation time.
            self._add(event.topic, encode_received(command), event.time_ns)

    def _write_applied(self, event: AppliedWrench) -> None:
        self._add(event.topic + APPLIED, encode_applied(event), event.time_ns)

    def _write_status(self, event: Status) -> None:
        self._add("/diagnostics", encode_status(event, self._frames.body_frame), event.time_ns)
