"""`RerunSink`: a run as one .rrd file that the Rerun viewer opens with a ready-made layout: 3D, plots, text.

A picture of the run, not its archive: rows are thinned beyond a limit and 3D poses are float32 (the scalars are
float64). The MCAP log keeps everything. Never changes a value of the run and never imports `rerun` before `open`.

Entities: `world/body` (pose and equivalent box), `world/center_of_mass` (arrows of angular momentum, angular velocity,
force, torque), `world/path`, and one scalar entity for each field of `Sample`. Timelines: `sim_time`, `sample`.
"""

from __future__ import annotations

import contextlib
import math
import os
import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.diagnostics import Sample
from rb_dynamics.errors import LogError, MissingExtraError
from rb_dynamics.recording.sink import AppliedWrench, Event, RunInfo, Status
from rb_dynamics.vector import ZERO, Vector

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from rb_dynamics.body.rigid_body import RigidBody

Array = NDArray[np.float64]
Color = tuple[int, int, int]

MAX_ROWS = 200_000
BATCH_ROWS = 2048
PATH_POINTS = 8192

RED, GREEN, BLUE = (236, 92, 92), (102, 194, 102), (96, 148, 245)
ORANGE, CYAN, MAGENTA, YELLOW, GREY = (255, 170, 51), (64, 208, 220), (224, 96, 200), (240, 220, 80), (170, 175, 185)
_AXES_COLORS: tuple[Color, ...] = (RED, GREEN, BLUE, GREY)
_KINDS = ("force", "torque")


@dataclass(frozen=True)
class _Series:
    """One field of `Sample` as an entity of scalars, with the names and colours of its lines."""

    entity: str
    attribute: str
    names: tuple[str, ...] = ("x", "y", "z")
    colors: tuple[Color, ...] = _AXES_COLORS


_SERIES = (
    _Series("position", "position_world"),
    _Series("attitude", "orientation_xyzw", ("x", "y", "z", "w")),
    _Series("linear_velocity", "linear_velocity_world"),
    _Series("angular_velocity", "angular_velocity_body"),
    _Series("angular_momentum", "angular_momentum_world"),
    _Series("linear_momentum", "linear_momentum_world"),
    _Series("energy/kinetic", "kinetic_energy", ("kinetic energy",), (ORANGE,)),
    _Series("energy/work", "work", ("work of the loads",), (CYAN,)),
    _Series("energy/defect", "energy_defect", ("T - T0 - work",), (MAGENTA,)),
    _Series("angular_momentum/defect", "angular_momentum_defect_world"),
    _Series("linear_momentum/defect", "linear_momentum_defect_world"),
)


class RerunSink:
    """Writes a run to one .rrd file; a `Sink`.

    At most about `max_rows` samples are kept: every k-th, with k chosen at the start where duration and output rate of
    the scene are known; k doubles each time another `max_rows` rows have been written, so that a run without end
    grows with its logarithm only. The last sample is always kept. Wrench edges are exact until `max_rows` of them;
    from then on only the last one before each kept sample. Memory is bounded by `batch_rows` and `PATH_POINTS`.
    """

    def __init__(self, path: str | os.PathLike[str], *, max_rows: int = MAX_ROWS, batch_rows: int = BATCH_ROWS) -> None:
        """Say where to write; folders above it are made, an earlier file is replaced, nothing happens before `open`."""
        self.path = Path(path)
        self._max_rows = max_rows
        self._batch_rows = batch_rows
        self._recorder: _Recorder | None = None

    def open(self, run: RunInfo) -> None:
        """Create the file, its layout and everything that does not change.

        Raises:
            MissingExtraError: rerun-sdk is not installed.
            LogError: the file cannot be written.
        """
        try:
            import rerun  # noqa: F401
        except ImportError as error:
            raise MissingExtraError("rerun-sdk", "log", "writing a .rrd file") from error
        recorder = _Recorder(self.path, run, self._max_rows, self._batch_rows)
        with recorder.writing():
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

    def close(self, result: Mapping[str, str]) -> None:
        """Write what is left and the facts in `result`, then the footer; closing again does nothing.

        Raises:
            LogError: the file can no longer be written.
        """
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            with recorder.writing():
                recorder.end(result)


@dataclass
class _Thinner:
    """Which samples become rows: every `stride`-th, `stride` doubling after each `max_rows` rows."""

    max_rows: int
    stride: int = 1
    rows: int = 0

    def keeps(self, index: int) -> bool:
        if index % self.stride:
            return False
        self.rows += 1
        if self.rows % self.max_rows == 0:
            self.stride *= 2
        return True


@dataclass
class _Polyline:
    """A path in at most 2 `PATH_POINTS` points, evenly thinned; the newest point is always its end."""

    points: list[Vector] = field(default_factory=list)
    stride: int = 1
    seen: int = 0
    last: Vector = ZERO
    sent: int = 0

    def extend(self, points: Array) -> None:
        for x, y, z in points.tolist():
            self.last = (x, y, z)
            if self.seen % self.stride == 0:
                self.points.append(self.last)
            self.seen += 1
            if len(self.points) > 2 * PATH_POINTS:
                self.points = self.points[::2]
                self.stride *= 2

    def due(self) -> bool:
        """Whether it has doubled since it was last sent: then all sendings together cost no more than two."""
        return self.seen >= 2 * self.sent


@dataclass
class _Steps:
    """One channel's force or torque in one frame as a step function; rows are (time_ns, sample, value).

    The next `exact` edges are kept; later ones wait, each in place of the one before, until a kept sample comes.
    """

    rows: list[tuple[int, int, Vector]]
    exact: int
    value: Vector = ZERO
    waiting: tuple[int, int, Vector] | None = None

    def set(self, time_ns: int, sample: int, value: Vector) -> None:
        self.value = value
        if self.exact > 0:
            self.exact -= 1
            self.rows.append((time_ns, sample, value))
        else:
            self.waiting = (time_ns, sample, value)

    def settle(self) -> None:
        """Keep the edge that waited."""
        if self.waiting is not None:
            self.rows.append(self.waiting)
            self.waiting = None


@dataclass
class _Arrow:
    """An arrow at the centre of mass, `length` metres long at its largest so far; `peak` is the root of that vector."""

    entity: str
    label: str
    color: Color
    length: float
    peak: float = 0.0


@dataclass(frozen=True)
class _Row:
    """A sample to be written, with the sums of the wrenches held then: (force, torque) in body and in world axes."""

    index: int
    sample: Sample
    body: tuple[Vector, Vector]
    world: tuple[Vector, Vector]


class _Recorder:
    """An open .rrd: buffers rows and sends them in columns."""

    def __init__(self, path: Path, run: RunInfo, max_rows: int, batch_rows: int) -> None:
        scene = run.scene
        self.path = path
        self.run = run
        self.batch_rows = batch_rows
        self.max_rows = max_rows
        self.half_sizes, self.size = equivalent_box(scene.body)
        self.offset = _recentre(scene.initial.position_world, self.size)
        self.thinner = _Thinner(max_rows, _first_stride(scene.duration, scene.output_rate, max_rows))
        self.paths = {"center_of_mass": _Polyline()}
        if any(scene.body.center_of_mass):
            self.paths["body_origin"] = _Polyline()
        at = "world/center_of_mass"
        self.momentum = _Arrow(f"{at}/angular_momentum", "L", ORANGE, 3.0 * self.size)
        self.rate = _Arrow(f"{at}/angular_velocity", "ω", CYAN, 1.9 * self.size)
        self.force = _Arrow(f"{at}/force", "F", MAGENTA, 2.4 * self.size)
        self.torque = _Arrow(f"{at}/torque", "τ", YELLOW, 1.6 * self.size)
        self.peaks = {series.entity: 0.0 for series in _SERIES}
        self.rows: list[_Row] = []
        self.notes: list[tuple[int, int, Status]] = []
        self.note_count = 0
        self.steps: dict[tuple[str, str, str], _Steps] = {}  # by kind, topic and frame
        self.pending: _Row | None = None
        self.pending_kept = False
        self.samples = 0
        self.start_ns = self.time_ns = scene.initial.time_ns
        self.held: tuple[tuple[Vector, Vector], tuple[Vector, Vector]] = ((ZERO, ZERO), (ZERO, ZERO))

    # ---- life of the file

    def begin(self) -> None:
        import rerun as rr

        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.write_bytes(b"")  # a path that cannot be written fails here, before Rerun has anything to lose
        # A recording id of its own: two files with one id would be merged by the viewer.
        self.stream = rr.RecordingStream("rb_dynamics", recording_id=uuid.uuid4())
        self.stream.save(self.path, default_blueprint=self._blueprint(self.run.scene.duration))
        if not rr.is_enabled(self.stream):
            raise LogError(f"{self.path}: Rerun is switched off by the environment variable RERUN; unset it to log")
        self.stream.send_recording_name(Path(self.run.scene.source).name)
        self._send_static()
        self._send_facts({})
        self.stream.flush()

    def take(self, event: Event) -> None:
        self.time_ns = event.time_ns
        if isinstance(event, Sample):
            self._settle()
            self.pending = _Row(self.samples, event, *self.held)
            self.pending_kept = self.thinner.keeps(self.samples)
            self.samples += 1
            if self.pending_kept:
                for steps in self.steps.values():
                    steps.settle()
        elif isinstance(event, AppliedWrench):
            self._take_wrench(event)
        elif event.level > 0 and self.note_count < self.max_rows:
            self.notes.append((event.time_ns, self._newest(), event))
            self.note_count += 1
        if len(self.rows) + len(self.notes) + sum(len(steps.rows) for steps in self.steps.values()) >= self.batch_rows:
            self._flush()

    def end(self, result: Mapping[str, str]) -> None:
        self.pending_kept = True
        self._settle()
        for steps in self.steps.values():
            steps.settle()
            # The line of a held command reaches the end of the run.
            steps.rows.append((self.time_ns, self._newest(), steps.value))
        for kind in _KINDS:
            if not any(key[0] == kind for key in self.steps):
                self._send_no_wrench(kind)
        self._flush()
        for name in self.paths:
            self._send_path(name)
        self._send_facts(result)
        # The same layout again, now that the extent of the path and the duration are known; the last one counts.
        self.stream.send_blueprint(self._blueprint(self.time_ns * 1e-9), make_active=False, make_default=True)
        self.stream.flush()
        self.stream.disconnect()

    @contextlib.contextmanager
    def writing(self) -> Iterator[None]:
        """Turn what Rerun and the file system complain of into a `LogError`."""
        try:
            yield
        except (RuntimeError, OSError) as error:
            raise LogError(
                f"{self.path}: cannot be written ({error}); give a path that you may write to, on a disk with room"
            ) from error

    # ---- events to rows

    def _newest(self) -> int:
        return max(self.samples - 1, 0)

    def _settle(self) -> None:
        """Make the waiting sample a row. It waited so that wrenches of the very same instant count for it."""
        row, self.pending = self.pending, None
        if row is not None and self.pending_kept:
            self.rows.append(row)

    def _take_wrench(self, event: AppliedWrench) -> None:
        if self.pending is not None and event.time_ns > self.pending.sample.time_ns:
            self._settle()
        for kind, value in zip(_KINDS, (event.force, event.torque), strict=True):
            key = (kind, event.topic, event.frame_id)
            for other, steps in self.steps.items():
                if other[:2] == key[:2] and other != key and any(steps.value):
                    steps.set(event.time_ns, self._newest(), ZERO)
            # What never acts has no line: three at zero for each silent part would hide the others.
            if key in self.steps or any(value):
                self._steps(key).set(event.time_ns, self._newest(), value)
        self.held = (self._total(in_world=False), self._total(in_world=True))
        if self.pending is not None:
            self.pending = _Row(self.pending.index, self.pending.sample, *self.held)

    def _steps(self, key: tuple[str, str, str]) -> _Steps:
        if key not in self.steps:
            self._send_wrench_style(*key)
            self.steps[key] = _Steps([(self.start_ns, 0, ZERO)], self.max_rows)
        return self.steps[key]

    def _total(self, *, in_world: bool) -> tuple[Vector, Vector]:
        """Return the sums of force and torque held in world axes, or in body axes."""
        world = self.run.scene.frames.world_frame
        acting = [(key[0], steps.value) for key, steps in self.steps.items() if (key[2] == world) == in_world]
        force, torque = ([value for kind, value in acting if kind == wanted] for wanted in _KINDS)
        return _sum(force), _sum(torque)

    # ---- rows to columns

    def _flush(self) -> None:
        rows, self.rows = self.rows, []
        notes, self.notes = self.notes, []
        if rows:
            self._send_samples(rows)
        if notes:
            self._send_notes(notes)
        for key, steps in self.steps.items():
            if steps.rows:
                times = _times([row[0] for row in steps.rows], [row[1] for row in steps.rows])
                self._send_scalars(_wrench_entity(*key), times, np.array([row[2] for row in steps.rows]))
                steps.rows = []
        self.stream.flush()

    def _send_samples(self, rows: list[_Row]) -> None:
        import rerun as rr

        samples = [row.sample for row in rows]
        times = _times([sample.time_ns for sample in samples], [row.index for row in rows])
        for series in _SERIES:
            values = np.array([getattr(sample, series.attribute) for sample in samples], dtype=np.float64)
            self._send_scalars(series.entity, times, values.reshape(len(samples), -1))
            self.peaks[series.entity] = max(self.peaks[series.entity], float(np.abs(values).max()))
        position = np.array([sample.position_world for sample in samples]) - np.array(self.offset)
        attitude = np.array([sample.orientation_xyzw for sample in samples])
        center = position + _rotate(attitude, np.array(self.run.scene.body.center_of_mass))
        self._send("world/body", times, rr.Transform3D.columns(translation=position, quaternion=attitude))
        self._send("world/center_of_mass", times, rr.Transform3D.columns(translation=center))
        for name, points in (("center_of_mass", center), ("body_origin", position)):
            if name in self.paths:
                self.paths[name].extend(points)
                if self.paths[name].due():
                    self._send_path(name)
        rates = np.array([sample.angular_velocity_body for sample in samples])
        self._send_arrow(self.momentum, times, np.array([sample.angular_momentum_world for sample in samples]))
        self._send_arrow(self.rate, times, _rotate(attitude, rates))
        for part, arrow in enumerate((self.force, self.torque)):
            turning = _rotate(attitude, np.array([row.body[part] for row in rows]))
            self._send_arrow(arrow, times, turning + np.array([row.world[part] for row in rows]))

    def _send_arrow(self, arrow: _Arrow, times: list[rr.TimeColumn], vectors: Array) -> None:
        """Send arrows as long as the root of their vector, so that small ones are seen beside the largest.

        Their scale in the picture is a static transform, renewed when a longer one comes: the peak of a run is known
        only at its end.
        """
        import rerun as rr

        roots = np.sqrt(np.linalg.norm(vectors, axis=1))
        peak = float(roots.max())
        if peak > arrow.peak:
            arrow.peak = peak
            self.stream.log(arrow.entity, rr.Transform3D(scale=arrow.length / peak), static=True)
        if arrow.peak > 0.0:
            shown = roots > 0.0
            drawn = vectors[shown] / roots[shown, None]
            # A point a little beyond the tip carries the letter, where it hides no other arrow's.
            columns = [*rr.Arrows3D.columns(vectors=drawn), *rr.Points3D.columns(positions=1.1 * drawn)]
            self._send(arrow.entity, times, rr.ComponentColumnList(columns).partition(shown.astype(int)))

    def _send_path(self, name: str) -> None:
        import rerun as rr

        path = self.paths[name]
        path.sent = path.seen
        strip = [*path.points, path.last] if path.points else []
        color, radius = (GREY, -1.5) if name == "center_of_mass" else (BLUE, -0.75)
        line = rr.LineStrips3D([strip], colors=[color], radii=[radius])
        self.stream.log(f"world/path/{name}", line, static=True)

    def _send_no_wrench(self, kind: str) -> None:
        """Say by a line at zero that there was none, where the plot would be empty."""
        import rerun as rr

        self.stream.log(f"{kind}/none", rr.SeriesLines(names=["none"], colors=[GREY]), static=True)
        times = _times([self.start_ns, self.time_ns], [0, self._newest()])
        self._send_scalars(f"{kind}/none", times, np.zeros((2, 1)))

    def _send_notes(self, notes: list[tuple[int, int, Status]]) -> None:
        import rerun as rr

        times = _times([note[0] for note in notes], [note[1] for note in notes])
        levels = [rr.TextLogLevel.WARN if status.level == 1 else rr.TextLogLevel.ERROR for _, _, status in notes]
        text = [_sentence(status) for _, _, status in notes]
        self._send("log", times, rr.TextLog.columns(text=text, level=levels))

    def _send_scalars(self, entity: str, times: list[rr.TimeColumn], values: Array) -> None:
        import rerun as rr

        columns = rr.Scalars.columns(scalars=values.ravel()).partition([values.shape[1]] * len(values))
        self._send(entity, times, columns)

    def _send(self, entity: str, times: list[rr.TimeColumn], columns: rr.ComponentColumnList) -> None:
        self.stream.send_columns(entity, times, columns, strict=True)

    # ---- what does not change

    def _send_static(self) -> None:
        import rerun as rr

        body = self.run.scene.body
        box = rr.Boxes3D(
            half_sizes=[self.half_sizes],
            centers=[body.center_of_mass],
            quaternions=[rr.Quaternion(xyzw=body.principal_orientation_xyzw)],
            colors=[GREY],
            fill_mode=rr.components.FillMode.TransparentFillMajorWireframe,
        )
        self.stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self.stream.log("world/body", rr.TransformAxes3D(1.6 * self.size), static=True)
        self.stream.log("world/body/box", box, static=True)
        # Of constant size on the screen: shows where the body is when the whole path is in view.
        self.stream.log("world/center_of_mass", rr.Points3D([ZERO], radii=[-3.0], colors=[GREY]), static=True)
        for arrow in (self.momentum, self.rate, self.force, self.torque):
            shaft = rr.Arrows3D.from_fields(colors=[arrow.color], radii=[-4.0])
            letter = rr.Points3D.from_fields(colors=[arrow.color], radii=[-0.5], labels=[arrow.label], show_labels=True)
            self.stream.log(arrow.entity, shaft, letter, static=True)
        for series in _SERIES:
            style_lines = rr.SeriesLines(names=list(series.names), colors=list(series.colors[: len(series.names)]))
            self.stream.log(series.entity, style_lines, static=True)
        yaml = rr.TextDocument(f"```yaml\n{self.run.scene.text}\n```", media_type=rr.MediaType.MARKDOWN)
        self.stream.log("scene", yaml, static=True)

    def _send_wrench_style(self, kind: str, topic: str, frame_id: str) -> None:
        import rerun as rr

        shade = sum(key[0] == kind for key in self.steps) % 3
        colors = [tuple(c + (255 - c) * shade // 3 for c in color) for color in (RED, GREEN, BLUE)]
        names = [f"{topic} {axis} ({frame_id})" for axis in "xyz"]
        steps = rr.components.InterpolationMode.StepAfter
        lines = rr.SeriesLines(names=names, colors=colors, interpolation_mode=steps)
        self.stream.log(_wrench_entity(kind, topic, frame_id), lines, static=True)

    def _send_facts(self, result: Mapping[str, str]) -> None:
        """Send what is known about the run, as text to read and as properties to query."""
        import rerun as rr

        facts = {"method": self.run.method, **self.run.metadata, **result}
        if self.thinner.stride > 1:
            facts["thinned"] = f"to one sample in {self.thinner.stride} towards the end; the MCAP log has all"
        self.stream.send_property("run", rr.AnyValues(drop_untyped_nones=True, **facts))
        about = rr.TextDocument(self._about(facts), media_type=rr.MediaType.MARKDOWN)
        self.stream.log("about", about, static=True)

    def _about(self, facts: Mapping[str, str]) -> str:
        where = "The 3D views use world coordinates."
        if any(self.offset):
            where = (
                f"The start position {list(self.offset)} m (world) has been subtracted in the 3D views, "
                "because they compute in single precision; the plots show true values in double precision."
            )
        table = "\n".join(f"| {key} | {value} |" for key, value in facts.items() if value)
        return _ABOUT.format(where=where, size=_short(2.0 * self.size), table=table)

    def _blueprint(self, duration: float | None) -> rrb.Blueprint:
        import rerun.blueprint as rrb

        left = rrb.Vertical(
            rrb.Tabs(self._close_up(), self._overview(), active_tab=0),
            rrb.Tabs(
                rrb.TextDocumentView(origin="/about", name="What you see"),
                rrb.TextDocumentView(origin="/scene", name="Scene"),
                rrb.TextLogView(origin="/log", name="Warnings"),
                active_tab=0,
            ),
            row_shares=[5, 2],
        )
        layout = rrb.Horizontal(left, _plots(self.peaks), column_shares=[5, 6])
        panel = rrb.TimePanel(
            timeline="sim_time",
            state="collapsed",
            playback_speed=_playback_speed(duration),
            loop_mode="all",
            play_state="playing",
        )
        return rrb.Blueprint(layout, panel, collapse_panels=True)

    def _close_up(self) -> rrb.Spatial3DView:
        import rerun.blueprint as rrb

        # The frame of the centre of mass, not the world's: the body stays in view and exact however far it goes.
        return rrb.Spatial3DView(
            origin="/world/center_of_mass",
            contents="/world/**",
            name="Body, followed",
            eye_controls=_eye(np.zeros(3), self.size),
            line_grid=False,
        )

    def _overview(self) -> rrb.Spatial3DView:
        import rerun.blueprint as rrb

        path = self.paths["center_of_mass"]
        points = np.array([*path.points, path.last])
        low, high = points.min(axis=0), points.max(axis=0)
        eye = _eye(0.5 * (low + high), max(0.25 * float(np.linalg.norm(high - low)), self.size))
        return rrb.Spatial3DView(origin="/world", name="Whole path, fixed in the world", eye_controls=eye)


def _eye(center: Array, size: float) -> rrb.EyeControls3D:
    """Return an eye that sees what lies within some 3 `size` of `center`, all axes about equally foreshortened."""
    import rerun.blueprint as rrb

    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=(center + np.array([3.6, -4.0, 2.8]) * size).tolist(),
        look_target=center.tolist(),
        eye_up=[0.0, 0.0, 1.0],
    )


_ABOUT = """\
The **box** has the mass and inertia of the body ({size} m from corner to corner); its red, green and blue lines are the
body axes. **Orange L**: angular momentum; only a torque turns it. **Cyan ω**: angular velocity. **Magenta F**: force.
**Yellow τ**: torque. Arrows grow with the square root, each kind on its own scale. **Grey line**: path of the centre of
mass. {where}

| run | |
|---|---|
{table}
"""


def _plots(peaks: Mapping[str, float]) -> rrb.Grid:
    """Return the plots; `peaks` are the largest absolute values so far, 0 before there are any."""
    import rerun.blueprint as rrb
    from rerun import TimeRange, TimeRangeBoundary

    # Said, or a long run would show only what lies near the time cursor.
    whole_run = TimeRange(start=TimeRangeBoundary.infinite(), end=TimeRangeBoundary.infinite())

    def plot(name: str, *entities: str, half_range: float | None = None) -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(
            origin="/",
            contents=[f"/{entity}" for entity in entities],
            name=name,
            axis_x=rrb.TimeAxis(view_range=whole_run),
            axis_y=rrb.ScalarAxis(range=(-half_range, half_range)) if half_range else None,
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
        )

    def defect(name: str, entity: str, *of: str) -> rrb.TimeSeriesView:
        # Round-off shall look like zero, not like a signal that fills the plot; labels end at about 1e-15.
        whole = max(peaks[other] for other in of)
        return plot(name, entity, half_range=max(1.2 * peaks[entity], 1e-12 * whole, 1e-14) if whole else None)

    return rrb.Grid(
        plot("Angular velocity, body axes [rad/s]", "angular_velocity"),
        plot("Angular momentum, world [kg m²/s]", "angular_momentum"),
        plot("Energy and work [J]", "energy/kinetic", "energy/work"),
        rrb.Tabs(
            plot("Linear momentum [kg m/s]", "linear_momentum"),
            plot("Position [m]", "position"),
            plot("Velocity [m/s]", "linear_velocity"),
            plot("Attitude", "attitude"),
            active_tab=0,
        ),
        defect("Energy defect [J]", "energy/defect", "energy/kinetic", "energy/work"),
        rrb.Tabs(
            defect("Angular momentum defect [kg m²/s]", "angular_momentum/defect", "angular_momentum"),
            defect("Linear [kg m/s]", "linear_momentum/defect", "linear_momentum"),
            active_tab=0,
        ),
        plot("Applied force [N]", "force/**"),
        plot("Applied torque [N m]", "torque/**"),
        grid_columns=2,
    )


def equivalent_box(body: RigidBody) -> tuple[Vector, float]:
    """Return (half sizes, half diagonal) in m of the uniform box with the mass and principal moments of `body`.

    I1 = m/3 (h2^2 + h3^2) and its permutations, solved for h. A flat or thin body gets 1 % of its half diagonal there,
    to be seen; one without extent is drawn as a cube of 1 m diagonal.
    """
    i1, i2, i3 = body.principal_moments
    squares = [1.5 * (pair - own) / body.mass for pair, own in ((i2 + i3, i1), (i3 + i1, i2), (i1 + i2, i3))]
    half = [math.sqrt(max(square, 0.0)) for square in squares]
    size = math.hypot(*half)
    if size == 0.0:
        return (0.5 / math.sqrt(3.0),) * 3, 0.5
    x, y, z = (max(h, 0.01 * size) for h in half)
    return (x, y, z), size


def _recentre(start: Vector, size: float) -> Vector:
    """Return what to subtract from positions: the start, where float32 there would be coarser than size/10 000."""
    coarse = math.hypot(*start) * float(np.finfo(np.float32).eps)
    return start if coarse > 1e-4 * size else ZERO


def _first_stride(duration: float | None, output_rate: float, max_rows: int) -> int:
    if duration is None or output_rate <= 0.0:
        return 1
    return max(1, math.ceil(duration * output_rate / max_rows))


def _playback_speed(duration: float | None) -> float:
    """Return real time for runs that can be watched, else what shows the run in 30 s."""
    if duration is None or duration <= 0.0 or 2.0 <= duration <= 120.0:
        return 1.0
    return duration / 30.0


def _times(time_ns: Sequence[int], sample: Sequence[int]) -> list[rr.TimeColumn]:
    import rerun as rr

    nanoseconds = np.array(time_ns, dtype=np.int64).astype("timedelta64[ns]")
    return [rr.TimeColumn("sim_time", duration=nanoseconds), rr.TimeColumn("sample", sequence=sample)]


def _rotate(xyzw: Array, v: Array) -> Array:
    """Return v turned by each unit quaternion: v + w t + u x t with t = 2 u x v."""
    u, w = xyzw[:, :3], xyzw[:, 3:]
    t = 2.0 * np.cross(u, v)
    turned: Array = v + w * t + np.cross(u, t)
    return turned


def _sum(vectors: Sequence[Vector]) -> Vector:
    return (sum(v[0] for v in vectors), sum(v[1] for v in vectors), sum(v[2] for v in vectors))


def _wrench_entity(kind: str, topic: str, frame_id: str) -> str:
    import rerun as rr

    return rr.new_entity_path([kind, *filter(None, topic.split("/")), frame_id])


def _sentence(status: Status) -> str:
    values = ", ".join(f"{key}: {value}" for key, value in status.values.items())
    return f"{status.message} ({values})" if values else status.message


def _short(value: float) -> str:
    return f"{value:.3g}"
