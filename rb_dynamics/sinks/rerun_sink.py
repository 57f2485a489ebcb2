"""`RerunSink`: a run as one .rrd file that the Rerun viewer opens with a ready-made layout: 3D, plots, text.

A picture of the run, not its archive: rows are thinned beyond a limit and 3D poses are float32 (the scalars are
float64). The MCAP log keeps everything. Never changes a value of the run and never imports `rerun` before `open`.
This file decides which entities are sent and when. Their looks are in `rerun_style.py`, the rolling ellipsoid in
`rerun_poinsot.py`, the opening view in `rerun_blueprint.py`, the choice of rows in `rerun_thinning.py` and their
columns in `rerun_columns.py`.

Entities: `world/body` (pose and mesh or equivalent box), `world/center_of_mass` (arrows of angular momentum, angular
velocity, force, torque), `world/path`, `poinsot` (ellipsoid, plane and curves), one scalar entity for each field of
`Sample`, `force` and `torque` of each channel, and `log` (commands and warnings). Timelines: `sim_time`, `sample`.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import socket
import stat
import struct
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.body.inertia_quantities import equivalent_box
from rb_dynamics.errors import LogError, needing
from rb_dynamics.numerics.rotation import rotate
from rb_dynamics.numerics.rotation_arrays import rotate_all
from rb_dynamics.numerics.vector import ZERO, Vector, add, subtract
from rb_dynamics.run.event_arrays import EventArrays, chosen, one_by_one
from rb_dynamics.run.sample import Sample
from rb_dynamics.run.sink import (
    ActuatorCommand,
    AppliedWrench,
    Event,
    Measurement,
    ReceivedWrench,
    RejectedWrench,
    RunInfo,
    StateChange,
    Status,
)
from rb_dynamics.sinks import rerun_poinsot as poinsot
from rb_dynamics.sinks import rerun_style as style
from rb_dynamics.sinks.picture_style import eye_above
from rb_dynamics.sinks.rerun_blueprint import CLOSE_UP, OVERVIEW, blueprint
from rb_dynamics.sinks.rerun_columns import Columns, gather
from rb_dynamics.sinks.rerun_file import RerunFile
from rb_dynamics.sinks.rerun_sensors import Readings
from rb_dynamics.sinks.rerun_thinning import KeptSamples, Piece, Polyline, Thinner, WrenchHistory, WrenchPart
from rb_dynamics.theory.poinsot_contact import contact

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

Array = NDArray[np.float64]
Times = NDArray[np.int64]

SPAWN = "spawn"
"""In place of a file: start a viewer on this machine and show the run in it."""

# Where a viewer listens by default, and how long one may take to start, s.
_PORT, _STARTS_S = 9876, 30.0
# s for which a viewer may read nothing; then the connection is closed, as Rerun would wait forever.
_VIEWER_S = 30.0
# How often that is checked in this time.
_LOOKS = 10
# Bytes acknowledged and received, in the tcp_info of Linux.
_BYTES, _BYTES_AT = struct.Struct("QQ"), 120

MAX_ROWS = 200_000
BATCH_ROWS = 4096
# Wall time (s) after which rows are sent however few they are: a viewer follows a run in real time.
FOLLOW_S = 1.0
PATH_POINTS = 8192
# Longer pieces of the path, in half diagonals of the body, are not shown beside it.
_LONG_PIECE = 20.0


class Note(NamedTuple):
    """A line of text for the reader: when, the newest sample then, INFO, WARN or ERROR, and what."""

    time_ns: int
    sample: int
    level: str
    text: str


class Mark(NamedTuple):
    """A command in the pictures: when, the newest sample then, where the centre of mass was, and the energy (J)."""

    time_ns: int
    sample: int
    place: Vector
    kinetic_energy: float


class RerunSink:
    """Writes a run to one .rrd file; a `Sink`.

    At most about `max_rows` samples are kept: every k-th, with k chosen at the start where duration and output rate of
    the scene are known; k doubles each time another `max_rows` rows have been written, so that a run without end
    grows with its logarithm only. The last sample is always kept. Changes of wrenches are exact up to `max_rows`;
    from then on only the last one before each kept sample. Memory is bounded by `batch_rows` and `PATH_POINTS`.
    No row waits for longer than about `follow_s` of wall time while the run goes on.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        max_rows: int = MAX_ROWS,
        batch_rows: int = BATCH_ROWS,
        follow_s: float = FOLLOW_S,
        called: Path | None = None,
    ) -> None:
        """Say where to write; folders above it are made, an earlier file is replaced, nothing happens before `open`.

        `called` is the name in messages of a file that will be renamed.
        """
        self.address = viewer_address(os.fspath(path))
        self.path = Path(path)
        self._called = called or self.path
        self._max_rows = max_rows
        self._batch_rows, self._follow_s = batch_rows, follow_s
        self._recorder: Recorder | None = None

    def open(self, run: RunInfo) -> None:
        """Create the file, its layout and everything that does not change.

        Raises:
            MissingExtraError: rerun-sdk is not installed.
            LogError: the file cannot be written.
        """
        with needing("rerun-sdk", "log", "writing a .rrd file"):
            import_module("rerun")
        if self.address == SPAWN:
            self.address = started_viewer()
        elif self.address:
            require_viewer(self.address)
        recorder = Recorder(
            self.path, run, self._max_rows, self._batch_rows, self.address, self._follow_s, self._called
        )
        with recorder.writing(), sending_to(recorder.address):
            recorder.begin()
        self._recorder = recorder

    def write(self, event: Event) -> None:
        """Take one event.

        Raises:
            LogError: the file can no longer be written.
        """
        if self._recorder is None:
            raise RuntimeError(f"{self.path}: write() outside open() and close()")
        with self._recorder.writing():
            self._recorder.take(event)

    def write_block(self, block: EventArrays) -> None:
        """Take many events.

        Raises:
            LogError: the file can no longer be written.
        """
        if self._recorder is None:
            raise RuntimeError(f"{self.path}: write_block() outside open() and close()")
        with self._recorder.writing():
            self._recorder.take_block(block)

    def close(self, result: Mapping[str, str]) -> None:
        """Write what is left and the facts in `result`, then the footer; closing again does nothing.

        Raises:
            LogError: the file can no longer be written.
        """
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            with recorder.writing(), sending_to(recorder.address):
                recorder.end(result)
            del recorder
            _release()


class Recorder:
    """An open .rrd: buffers rows and sends them in columns."""

    def __init__(
        self,
        path: Path,
        run: RunInfo,
        max_rows: int,
        batch_rows: int,
        address: str = "",
        follow_s: float = FOLLOW_S,
        called: Path | None = None,
    ) -> None:
        scene = run.scene
        self.path, self.called, self.address = path, called or path, address
        self.file: RerunFile | None = None
        self.run = run
        self.batch_rows, self.follow_s = batch_rows, follow_s
        self.sent_s = time.monotonic()
        self.max_rows = max_rows
        self.half_sizes, self.size = equivalent_box(scene.body)
        self.offset = _recentre(scene.initial.position_world, self.size)
        self.paths = {"center_of_mass": Polyline(PATH_POINTS)}
        if any(scene.body.center_of_mass):
            self.paths["body_origin"] = Polyline(PATH_POINTS)
        self.series = style.series_of(scene)
        self.peaks = {series.entity: 0.0 for series in self.series}
        self.exponents: dict[str, int] = {}
        self.arrow_peaks = dict.fromkeys(style.ARROWS, 0.0)
        self.notes: list[Note] = []
        self.note_count = 0
        self.commands: list[Mark] = []
        self.command_count = 0
        self.mark_stride = 1
        self.newest: Sample | None = None
        self.start_ns = self.time_ns = scene.initial.time_ns
        self.readings = Readings(scene, max_rows)
        thinner = Thinner.of_run(scene.duration, scene.output_rate, max_rows)
        rows = round(scene.duration * scene.output_rate / thinner.stride) if scene.duration else None
        self.curves = None if scene.body.is_particle else poinsot.Curves(scene.body, rows)
        self.rows = KeptSamples(thinner, WrenchHistory(scene.frames.world_frame, self.start_ns, max_rows))

    # ---- life of the file

    def begin(self) -> None:
        """Create the file, with all that does not change."""
        import rerun as rr

        # A recording id of its own: two files with one id would be merged by the viewer.
        self.stream = rr.RecordingStream("rb_dynamics", recording_id=uuid.uuid4())
        layout_at_start = self._blueprint(self.run.scene.duration)
        if self.address:
            self.stream.connect_grpc(self.address, default_blueprint=layout_at_start)
        else:
            self.file = RerunFile(self.stream, self.path, layout_at_start)
        if not rr.is_enabled(self.stream):
            raise LogError(f"{self.called}: Rerun is switched off by the environment variable RERUN; unset it to log")
        self.stream.send_recording_name(Path(self.run.scene.source).name)
        for entity, looks in style.fixed_looks(self.run.scene, self.half_sizes, self.size):
            self.stream.log(entity, *looks, static=True)
        if self.curves is not None:
            for entity, looks in poinsot.fixed_looks(self.run.scene.body):
                self.stream.log(entity, *looks, static=True)
        self.stream.log(CLOSE_UP, rr.Transform3D(scale=self.size), static=True)
        self._send_overview()
        self._send_facts({})
        self._arrive()

    def take(self, event: Event) -> None:
        """Take one event."""
        self.time_ns = event.time_ns
        if isinstance(event, ReceivedWrench):
            return
        if isinstance(event, Measurement):
            attitude = None if self.newest is None else self.newest.orientation_xyzw
            self.readings.take(event, self.rows.newest, attitude)
            self._flush_if_due()
            return
        if isinstance(event, ActuatorCommand):
            if event.reason:
                self._note("WARN", f"{event.topic}: rejected: {event.reason}")
            return
        if isinstance(event, Sample):
            self.newest = event
            self.rows.take_sample(event)
        elif isinstance(event, AppliedWrench):
            for part in self.rows.take_wrench(event):
                self._send_wrench_looks(part)
            if not event.on_its_way:
                self._mark(event)
                self._note("INFO", _told(event))
        elif isinstance(event, RejectedWrench):
            self._note("WARN", f"{event.topic}: rejected: {event.reason}")
        elif isinstance(event, StateChange):
            self._note("INFO", "moved to another state by ~/set_state")
        elif isinstance(event, Status) and event.level > 0:
            self._note("WARN" if event.level == 1 else "ERROR", _sentence(event))
        self._flush_if_due()

    def take_block(self, block: EventArrays) -> None:
        """Take many events: the samples between two changes of the wrench at once."""
        is_change = block.order >= block.taken
        # At the time of the last sample before a change, the wrench may change.
        is_last = ~is_change & np.append(is_change[1:], True)
        last_ones = one_by_one(chosen(block.samples, block.order[is_last]))
        changes, first = block.all_changes(with_commands=False), 0
        for number in block.order[is_change | is_last].tolist():
            if number >= block.taken:
                self.take(next(changes))
                continue
            while first < number:
                until = min(first + self.batch_rows, number)
                self.rows.take_samples(chosen(block.samples, slice(first, until)))
                self._flush_if_due()
                first = until
            self.take(next(last_ones))
            first = number + 1

    def _flush_if_due(self) -> None:
        many = self.rows.unsent() + len(self.notes) + self.readings.unsent() >= self.batch_rows
        if many or time.monotonic() - self.sent_s >= self.follow_s:
            with sending_to(self.address):
                self._flush()

    def _note(self, level: str, text: str) -> None:
        if self.note_count < self.max_rows:
            self.notes.append(Note(self.time_ns, self.rows.newest, level, text))
            self.note_count += 1

    def _mark(self, event: AppliedWrench) -> None:
        """Remember where the body was, and its energy, by the newest sample: it marks the command in the pictures."""
        sample, count = self.newest, self.command_count
        self.command_count += 1
        if sample is not None and count % self.mark_stride == 0:
            arm = rotate(sample.orientation_xyzw, self.run.scene.body.center_of_mass)
            place = subtract(add(sample.position_world, arm), self.offset)
            self.commands.append(Mark(event.time_ns, self.rows.newest, place, sample.kinetic_energy))
            if len(self.commands) > style.MARKS:
                self.commands, self.mark_stride = self.commands[::2], 2 * self.mark_stride

    def end(self, result: Mapping[str, str]) -> None:
        """Write what is left, with what is known only now."""
        self.rows.finish(self.time_ns)
        for kind in ("force", "torque"):
            if not any(part.kind == kind for part in self.rows.wrenches.parts):
                self._send_no_wrench(kind)
        self._flush()
        if self.commands:
            self._send_marks(self.commands)
        if self.curves is not None:
            self._send_curves(self.curves.finish())
        for name in self.paths:
            self._send_path(name)
        self._send_overview()
        self._send_facts(result)
        # The same layout again, now that the extent of the path and the duration are known; the last one counts.
        self.stream.send_blueprint(self._blueprint(self.time_ns * 1e-9), make_active=False, make_default=True)
        self._arrive()
        self.stream.disconnect()
        if self.file is not None:
            self.file.close()

    @contextlib.contextmanager
    def writing(self) -> Iterator[None]:
        """Turn errors of Rerun and the file system into a `LogError`."""
        try:
            yield
        except (RuntimeError, OSError) as error:
            raise LogError(
                f"{self.called}: cannot be written ({error}); give a path that you may write to, on a disk with room"
            ) from error

    def _blueprint(self, duration: float | None) -> rrb.Blueprint:
        eye = None if self.curves is None else eye_above(self.curves.normal)
        return blueprint(eye, self.peaks, duration, self.exponents, self._path_beside_body(duration), self.run.scene)

    def _path_beside_body(self, duration: float | None) -> bool:
        """Return whether the pieces of the path are of the size of the body: as drawn, or, before, as expected."""
        points = self.paths["center_of_mass"].line()
        if len(points) > 1:
            longest = float(np.linalg.norm(np.diff(points, axis=0), axis=1).max())
        else:
            longest = math.hypot(*self.run.scene.initial.linear_velocity_world) * (duration or 0.0) / PATH_POINTS
        return longest < _LONG_PIECE * self.size

    # ---- events to columns

    def _flush(self) -> None:
        if rows := self.rows.fetch():
            self.send_columns(gather(rows, self.series))
        notes, self.notes = self.notes, []
        if notes:
            self._send_notes(notes)
        for part, changes in self.rows.wrenches.fetch():
            times = _times([change.time_ns for change in changes], [change.sample for change in changes])
            self._send_scalars(_wrench_entity(part), times, np.array([change.value for change in changes]))
        for entity, readings in self.readings.fetch().items():
            times = _times([each.taken_ns for each in readings], [each.sample for each in readings])
            self._send_scalars(entity, times, np.array([each.numbers for each in readings]))
        self._arrive()
        self.sent_s = time.monotonic()

    def _arrive(self) -> None:
        """Wait until what was sent is in the file, or on its way to the viewer."""
        self.stream.flush()
        if self.file is not None:
            self.file.check()

    def send_columns(self, columns: Columns) -> None:
        """Send rows to every entity that moves or is plotted."""
        times = _times(columns.stamps[:, 0], columns.stamps[:, 1])
        for entity, values in columns.values.items():
            self._send_scalars(entity, times, values)
            self.peaks[entity] = max(self.peaks[entity], float(np.abs(values).max()))
        self._send_scaled_defects(times, columns.values)
        attitude, rates = columns.values["attitude"], columns.values["angular_velocity"]
        self._send_poses(times, columns.values["position"], attitude)
        if self.curves is not None:
            touch = contact(self.run.scene.body, attitude, rates)
            for entity, moving in poinsot.columns(attitude, touch):
                self._send(entity, times, moving)
            self._send_curves(self.curves.take(columns.stamps, touch, rates))
        self._send_arrow(style.MOMENTUM, times, columns.values["angular_momentum"])
        self._send_arrow(style.RATE, times, rotate_all(attitude, rates))
        self._send_arrow(style.FORCE, times, columns.force_world)
        self._send_arrow(style.TORQUE, times, columns.torque_world)

    def _send_scaled_defects(self, times: list[rr.TimeColumn], values: Mapping[str, Array]) -> None:
        """Send the defects once more, in units that the labels of a plot can show; the first rows show which."""
        for entity in style.DEFECTS:
            if entity not in self.exponents and (reach := style.half_range(self.peaks, entity)) > 0.0:
                self.exponents[entity] = math.floor(math.log10(reach))
                looks = style.scaled_lines(entity, self.exponents[entity])
                self.stream.log(f"{entity}/scaled", looks, static=True)
            if entity in self.exponents:
                self._send_scalars(f"{entity}/scaled", times, values[entity] * 10.0 ** -self.exponents[entity])

    def _send_poses(self, times: list[rr.TimeColumn], position_world: Array, attitude: Array) -> None:
        import rerun as rr

        position = position_world - np.array(self.offset)
        center = position + rotate_all(attitude, np.array(self.run.scene.body.center_of_mass))
        self._send("world/body", times, rr.Transform3D.columns(translation=position, quaternion=attitude))
        self._send("world/center_of_mass", times, rr.Transform3D.columns(translation=center))
        for name, points in (("center_of_mass", center), ("body_origin", position)):
            if name in self.paths:
                self.paths[name].extend(points)
                if self.paths[name].due():
                    self._send_path(name)

    def _send_curves(self, pieces: list[Piece]) -> None:
        if pieces:
            times = _times([piece.time_ns for piece in pieces], [piece.sample for piece in pieces])
            for entity, columns in poinsot.curves(pieces):
                self._send(entity, times, columns)

    def _send_overview(self) -> None:
        """Put the frame of the overview into the middle of the path so far; its unit is a quarter of the extent."""
        import rerun as rr

        points = self.paths["center_of_mass"].line()
        points = points if len(points) else np.zeros((1, 3))
        low, high = points.min(axis=0), points.max(axis=0)
        unit = max(0.25 * float(np.linalg.norm(high - low)), self.size)
        self.stream.log(OVERVIEW, rr.Transform3D(translation=0.5 * (low + high), scale=unit), static=True)

    def _send_arrow(self, arrow: style.Arrow, times: list[rr.TimeColumn], vectors: Array) -> None:
        """Send arrows as long as the root of their vector, so that small ones are seen beside the largest.

        Their scale in the picture is a static transform, renewed when a longer one comes: the peak of a run is known
        only at its end.
        """
        import rerun as rr

        roots = np.sqrt(np.linalg.norm(vectors, axis=1))
        peak = float(roots.max())
        if peak > self.arrow_peaks[arrow]:
            self.arrow_peaks[arrow] = peak
            self.stream.log(arrow.entity, rr.Transform3D(scale=arrow.length * self.size / peak), static=True)
        if self.arrow_peaks[arrow] > 0.0:
            shown = roots > 0.0
            drawn = vectors[shown] / roots[shown, None]
            # A point a little beyond the tip carries the letter, where it hides no other arrow's.
            columns = [*rr.Arrows3D.columns(vectors=drawn), *rr.Points3D.columns(positions=1.1 * drawn)]
            self._send(arrow.entity, times, rr.ComponentColumnList(columns).partition(shown.astype(int)))

    def _send_path(self, name: str) -> None:
        path = self.paths[name]
        path.sent()
        self.stream.log(f"world/path/{name}", style.path_line(name, path.line()), static=True)

    def _send_wrench_looks(self, part: WrenchPart) -> None:
        before = [other for other in self.rows.wrenches.parts if other.kind == part.kind].index(part)
        looks = style.wrench_lines(part.topic, part.frame_id, before % 3)
        self.stream.log(_wrench_entity(part), looks, static=True)

    def _send_no_wrench(self, kind: str) -> None:
        """Show by a line at zero that there was none, where the plot would be empty."""
        self.stream.log(f"{kind}/none", style.no_wrench_line(), static=True)
        times = _times([self.start_ns, self.time_ns], [0, self.rows.newest])
        self._send_scalars(f"{kind}/none", times, np.zeros((2, 1)))

    def _send_notes(self, notes: list[Note]) -> None:
        import rerun as rr

        times = _times([note.time_ns for note in notes], [note.sample for note in notes])
        text, levels = [note.text for note in notes], [note.level for note in notes]
        self._send("log", times, rr.TextLog.columns(text=text, level=levels))

    def _send_marks(self, marks: list[Mark]) -> None:
        import rerun as rr

        times = _times([mark.time_ns for mark in marks], [mark.sample for mark in marks])
        places = np.array([mark.place for mark in marks])
        self._send(style.COMMANDS_ON_PATH, times, rr.Points3D.columns(positions=places))
        self._send_scalars("energy/commands", times, np.array([[mark.kinetic_energy] for mark in marks]))

    def _send_facts(self, result: Mapping[str, str]) -> None:
        """Send what is known about the run, as text to read and as properties to query."""
        import rerun as rr

        facts = {"method": self.run.method, **self.run.metadata, **result}
        if (stride := self.rows.thinner.stride) > 1:
            facts["thinned"] = f"to one sample in {stride} towards the end; the MCAP log has all"
        self.stream.send_property("run", rr.AnyValues(drop_untyped_nones=True, **facts))
        self.stream.log("about", style.about(facts, self.size, self.offset, self.run.scene), static=True)

    def _send_scalars(self, entity: str, times: list[rr.TimeColumn], values: Array) -> None:
        import rerun as rr

        self._send(entity, times, rr.Scalars.columns(scalars=values))

    def _send(self, entity: str, times: list[rr.TimeColumn], columns: rr.ComponentColumnList) -> None:
        self.stream.send_columns(entity, times, columns, strict=True)


def viewer_address(target: str) -> str:
    """Return the address of a viewer, `SPAWN` for one that is to be started, "" of a file.

    Raises:
        LogError: it is the address of something else.
    """
    if target == SPAWN:
        return SPAWN
    if "://" not in target:
        return ""
    if not re.fullmatch(r"rerun(\+https?)?://[^/:]+:[0-9]{1,5}/proxy", target):
        raise LogError(
            f"rerun: found {target!r}, expected a file, spawn or the address of a viewer; write it as in "
            "rerun+http://127.0.0.1:9876/proxy"
        )
    return target


def require_viewer(address: str) -> None:
    """Refuse an address without a server: Rerun itself would wait, and then drop its data.

    Raises:
        LogError: names the remedy.
    """
    try:
        socket.create_connection(_host_and_port(address), timeout=3.0).close()
    except (OSError, OverflowError) as error:
        raise LogError(
            f"cannot reach a Rerun viewer at {address}: {error}; start one with `rerun`, or give a file such as run.rrd"
        ) from error


@contextlib.contextmanager
def sending_to(address: str) -> Iterator[None]:
    """Close the connections to a viewer that reads nothing: nothing else ends Rerun's waiting. A file ("") has none.

    One that is slow may take as long as it needs. Only Linux shows whether bytes move: elsewhere, the time is for all.
    Computing in between counts as time in which it reads nothing, so there should be little of it.

    Raises:
        LogError: that happened.
    """
    if not address:
        yield
        return
    done, late = threading.Event(), threading.Event()

    def watch() -> None:
        moved, looks = 0, 0
        # Counted in checks: a process that was stopped for a while has not checked.
        while not done.wait(_VIEWER_S / _LOOKS):
            now = _moved(address)
            moved, looks = now, 0 if now != moved else looks + 1
            if looks >= _LOOKS:
                late.set()
                _close_connections(address)
                return

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    except (RuntimeError, OSError):
        # Else the stream would wait when it is deleted.
        _close_connections(address)
        if not late.is_set():
            raise
    finally:
        done.set()
        watcher.join()
    if late.is_set():
        raise LogError(
            f"the Rerun viewer at {address} received nothing for {_VIEWER_S:g} s; start another one, or give a file "
            "such as run.rrd"
        )


def _close_connections(address: str) -> None:
    """Close this process's connections to the server at `address`."""
    for connection in _connections(address):
        with connection, contextlib.suppress(OSError):
            connection.shutdown(socket.SHUT_RDWR)


def _moved(address: str) -> int:
    """Return how many bytes the server at `address` has acknowledged and sent; 0 if the system does not show it."""
    total = 0
    for connection in _connections(address):
        with connection, contextlib.suppress(OSError, struct.error):
            if sys.platform == "linux":
                facts = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _BYTES_AT + _BYTES.size)
                total += sum(_BYTES.unpack_from(facts, _BYTES_AT))
    return total


def _connections(address: str) -> list[socket.socket]:
    """Return this process's connections to the server at `address`, to be closed."""
    host, port = _host_and_port(address)
    found = []
    with contextlib.suppress(OSError):
        peers = {each[4][:2] for each in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)}
        for name in os.listdir("/dev/fd"):
            with contextlib.suppress(OSError):
                if stat.S_ISSOCK(os.fstat(int(name)).st_mode):
                    with socket.socket(fileno=os.dup(int(name))) as connection:
                        if connection.getpeername()[:2] in peers:
                            found.append(connection.dup())
    return found


def _host_and_port(address: str) -> tuple[str, int]:
    host, _, port = address.split("/")[2].rpartition(":")
    return host.strip("[]"), int(port)


def started_viewer() -> str:
    """Start a viewer, unless one is there, and return its address; it stays open after the run.

    Raises:
        LogError: none can be started, as where there is no display.
    """
    address = f"rerun+http://127.0.0.1:{_PORT}/proxy"
    with contextlib.suppress(LogError):
        require_viewer(address)
        return address
    nowhere = (
        "rerun: found that spawn starts no viewer, expected a display to open it on; give a file such as run.rrd, or "
        "the address of a viewer elsewhere"
    )
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        # It would listen for a moment before it ends.
        raise LogError(nowhere)
    viewer = subprocess.Popen(
        [sys.executable, "-m", "rerun", f"--port={_PORT}"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    give_up = time.monotonic() + _STARTS_S
    while viewer.poll() is None and time.monotonic() < give_up:
        with contextlib.suppress(LogError):
            require_viewer(address)
            return address
        time.sleep(0.2)
    viewer.kill()
    raise LogError(nowhere)


def _release() -> None:
    """Free what Rerun keeps of recordings without references: some MB and two threads each."""
    from rerun_bindings import flush_and_cleanup_orphaned_recordings

    # Also one whose viewer is gone may be among them: that is no error of this one.
    with contextlib.suppress(RuntimeError):
        flush_and_cleanup_orphaned_recordings()  # as `rerun.init` does; nothing else of its interface frees them


def _recentre(start: Vector, size: float) -> Vector:
    """Return what to subtract from positions: the start, where float32 there would be coarser than size/10 000."""
    coarse = math.hypot(*start) * float(np.finfo(np.float32).eps)
    return start if coarse > 1e-4 * size else ZERO


def _times(time_ns: Sequence[int] | Times, sample: Sequence[int] | Times) -> list[rr.TimeColumn]:
    import rerun as rr

    nanoseconds = np.array(time_ns, dtype=np.int64).astype("timedelta64[ns]")
    indices = np.array(sample, dtype=np.int64)
    return [rr.TimeColumn("sim_time", duration=nanoseconds), rr.TimeColumn("sample", sequence=indices)]


def _wrench_entity(part: WrenchPart) -> str:
    import rerun as rr

    return rr.new_entity_path([part.kind, *filter(None, part.topic.split("/")), part.frame_id])


def _told(event: AppliedWrench) -> str:
    if event.timed_out:
        return f"{event.topic}: timed out, drops to zero"
    force, torque = (", ".join(f"{value:.6g}" for value in vector) for vector in (event.force, event.torque))
    return f"{event.topic}: force ({force}) N, torque ({torque}) N m, in {event.frame_id} axes"


def _sentence(status: Status) -> str:
    values = ", ".join(f"{key}: {value}" for key, value in status.values.items())
    return f"{status.message} ({values})" if values else status.message
